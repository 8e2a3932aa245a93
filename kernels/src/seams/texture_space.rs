//! Texture space: charts, folds, and seam drift.

use super::surface::SeamSurface;
use super::wedges::{input_corner, uv_of};
use crate::base::ids::{EdgeId, HalfedgeId};
use crate::base::parallel::fill;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::Mesh;

/// Texture coordinate, as a length.
pub type Uv = [f64; 2];

/// Compute twice the signed area of a triangle in the texture.
#[inline]
pub fn signed_area(a: Uv, b: Uv, c: Uv) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Minimum ratio of twice the area to the squared longest side of a triangle in the texture.
const MIN_FLATNESS: f64 = 1e-4;

/// Test if a triangle in the texture keeps its orientation and area.
///
/// A triangle without area passes.
pub fn keeps_orientation(before: [Uv; 3], after: [Uv; 3]) -> bool {
    let side2 = |a: Uv, b: Uv| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
    let longest2 = |[a, b, c]: [Uv; 3]| side2(a, b).max(side2(b, c)).max(side2(c, a));
    let [was, is] = [before, after].map(|[a, b, c]| signed_area(a, b, c));
    if was == 0.0 {
        return true;
    }
    // A thin triangle may stay if it does not become thinner.
    let flatness = |area: f64, longest2: f64| area.abs() / longest2.max(f64::MIN_POSITIVE);
    let is_flatter = || {
        let now = flatness(is, longest2(after));
        now < MIN_FLATNESS && now < flatness(was, longest2(before))
    };
    was * is > 0.0 && !is_flatter()
}

/// Texture coordinates of a triangle, and the opposite halfedges in the same chart.
#[derive(Clone, Copy)]
struct Face {
    uvs: [Uv; 3],
    across: [u32; 3],
}

/// Charts of the input: its triangles in the texture, connected except across seams.
pub struct Charts {
    faces: Vec<Face>,
}

/// Maximum number of steps of a walk; in a folded texture, a walk might cycle.
const MAX_WALK_STEPS: usize = 4096;

const NO_HALFEDGE: u32 = u32::MAX;

impl Charts {
    pub fn new<const K: usize>(
        mesh: &Mesh<3>,
        surface: &SeamSurface<K>,
        is_seam: &[bool],
        threads: usize,
    ) -> Self {
        let connectivity = &mesh.connectivity;
        let across = |h: HalfedgeId| {
            if is_seam[connectivity.edge(h).index()] { NO_HALFEDGE } else { connectivity.twin(h).0 }
        };
        let mut faces =
            vec![Face { uvs: [[0.0; 2]; 3], across: [NO_HALFEDGE; 3] }; connectivity.triangle_slots()];
        fill(&mut faces, threads, |t| {
            let halfedges = [0, 1, 2].map(|i| HalfedgeId::from_index(3 * t + i));
            Face {
                uvs: halfedges.map(|h| uv_of(&surface.corners[input_corner(mesh, h)])),
                across: halfedges.map(across),
            }
        });
        Self { faces }
    }

    /// Find the triangle that contains `uv` by walking from `start` within its chart.
    ///
    /// `None` if the walk leaves the chart, crosses a fold or is too long.
    pub fn find_triangle(&self, start: u32, uv: Uv) -> Option<u32> {
        let area = |[a, b, c]: [Uv; 3]| signed_area(a, b, c);
        let mut t = start;
        let side = area(self.faces[t as usize].uvs).signum();
        let mut came_from = NO_HALFEDGE;
        for step in 0..MAX_WALK_STEPS {
            let Face { uvs: points, across } = &self.faces[t as usize];
            if area(*points) * side <= 0.0 {
                return None;
            }
            // Rotate the side tested first from step to step, so that no walk cycles.
            let outside = (0..3).map(|i| (i + step) % 3).find(|&i| {
                let h = 3 * t + i as u32;
                h != came_from && signed_area(points[i], points[(i + 1) % 3], uv) * side < 0.0
            });
            let Some(i) = outside else {
                return Some(t);
            };
            came_from = across[i];
            if came_from == NO_HALFEDGE {
                return None;
            }
            t = came_from / 3;
        }
        None
    }
}

/// Compute the distance of two points in the texture.
///
/// The values are far from the limits that `hypot` guards against.
pub fn uv_distance(a: Uv, b: Uv) -> f64 {
    ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt()
}

/// Find the next seam edge from the target of `h`, in the same chart.
///
/// Returns the halfedge that starts there.
pub fn next_seam_halfedge(mesh: &Mesh<3>, is_seam: &[bool], h: HalfedgeId) -> HalfedgeId {
    let connectivity = &mesh.connectivity;
    let mut at = Connectivity::next(h);
    while !is_seam[connectivity.edge(at).index()] {
        at = Connectivity::next(connectivity.twin(at));
    }
    at
}

/// Find the previous seam edge at the origin of `h`, in the same chart.
///
/// Returns the halfedge that ends there.
pub fn previous_seam_halfedge(mesh: &Mesh<3>, is_seam: &[bool], h: HalfedgeId) -> HalfedgeId {
    let connectivity = &mesh.connectivity;
    let mut at = Connectivity::prev(h);
    while !is_seam[connectivity.edge(at).index()] {
        at = Connectivity::prev(connectivity.twin(at));
    }
    at
}

/// Compute the distance of `p` from the segment `a`–`b`.
///
/// If the seam vertex at `p` vanishes and the segment remains, this is the maximum distance between the old
/// and the new seam, in both directions. To see this, match the ends with each other and `p` with its nearest
/// point: between them, both seams are straight.
pub fn segment_distance(p: Uv, a: Uv, b: Uv) -> f64 {
    let (along, to_p) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let length2 = along[0] * along[0] + along[1] * along[1];
    let dot = along[0] * to_p[0] + along[1] * to_p[1];
    let t = if length2 > 0.0 { (dot / length2).clamp(0.0, 1.0) } else { 0.0 };
    uv_distance(to_p, along.map(|x| t * x))
}

/// By seam edge: upper bound on the texture distance from the seam of the input.
pub struct SeamDrifts {
    of_edge: Vec<f64>,
    pub largest: f64,
}

impl SeamDrifts {
    pub fn new(edges: usize) -> Self {
        Self { of_edge: vec![0.0; edges], largest: 0.0 }
    }

    pub fn drift_of(&self, edge: EdgeId) -> f64 {
        self.of_edge[edge.index()]
    }

    /// Raise the drift of an edge to at least `drift`.
    pub fn raise(&mut self, edge: EdgeId, drift: f64) {
        let own = &mut self.of_edge[edge.index()];
        *own = own.max(drift);
        self.largest = self.largest.max(drift);
    }
}
