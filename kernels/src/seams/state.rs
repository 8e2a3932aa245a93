//! What is known of a surface with seams while it is simplified.

use std::cell::RefCell;

use super::classes::Plan;
use super::record::Log;
use super::surface::Surface;
use super::texture::{Charts, Drifts};
use super::wedges::{NONE, Wedges, input_corner, seams};
use super::weld::UNTIED;
use crate::base::geometry::position;
use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::Mesh;
use crate::quadrics::quadric::Quadric;

/// Strength of the spring that holds a vertex at the middle of its edge where the error does not: on a plane.
pub(super) const TETHER: f64 = 1e-9;

/// The same for the choice among edges that cost nothing: shorter ones go first.
pub(super) const SHORTER_FIRST: f64 = 1e-10;

/// Weight of the walls on seams and boundaries, against the area of the square over the edge.
const WALL: f64 = 1.0;

/// A penalty for valence counts from here.
pub(super) const HIGH_VALENCE: u32 = 8;

/// What a user can set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knobs {
    /// Share of itself by which the cost of a collapse grows that meets several materials.
    pub across_materials: f64,
    /// The same for several parts.
    pub across_parts: f64,
    /// The same for each edge a vertex would have beyond eight.
    pub valence: f64,
    /// The same for each wedge of the ends beyond two.
    pub wedges: f64,
    /// Weight of the quadric of shape against that of shape and attributes, near seams.
    pub shape: f64,
    /// Largest distance in the image between a seam and what it was, as a length.
    pub seam_drift: f64,
}

/// A refusal of this measure.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Rule {
    /// Both ends must stay where they are.
    Locked,
    /// A triangle would turn over, or lose its area.
    Fold,
    /// A seam would be cut, joined with another, or left.
    Seam,
    /// A triangle of the image would turn over, or a texture coordinate leave its chart.
    Chart,
    /// The image of a seam would be too far from what it was.
    Drift,
}

/// Materials, or parts, that differ.
pub(super) const SEVERAL: i32 = i32::MIN;

/// What is looked at together of a vertex, and kept together for it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    /// The wedge of all its corners, or none.
    pub only: u32,
    /// Its seam and boundary edges.
    pub seam_degree: u32,
    pub valence: u32,
    /// Of all triangles around it, or [`SEVERAL`].
    pub material: i32,
    pub part: i32,
}

/// What two have in common.
#[inline]
pub(super) fn common(a: i32, b: i32) -> i32 {
    if a == b { a } else { SEVERAL }
}

pub struct Seams<const D: usize, const K: usize> {
    pub(super) knobs: Knobs,
    pub(super) wedges: Wedges<K>,
    pub(super) shape: Vec<Quadric<0>>,
    pub(super) quadrics: Vec<Quadric<K>>,
    pub(super) spots: Vec<Spot>,
    pub(super) is_seam: Vec<bool>,
    /// The set of each vertex that must stay with others; see [`super::weld`].
    pub(super) tie: Vec<u32>,
    /// Tied vertices by their sets, in order.
    pub(super) sheets: Vec<(u32, VertexId)>,
    pub(super) charts: Charts,
    pub(super) drifts: Drifts,
    pub(super) plan: RefCell<Plan<K>>,
    pub(super) log: Option<Log<K>>,
}

impl<const D: usize, const K: usize> Seams<D, K> {
    pub fn new(mesh: &Mesh<3>, surface: &Surface<K>, tie: Vec<u32>, knobs: Knobs, record: bool) -> Self {
        const { assert!(D == K + 3) };
        let connectivity = &mesh.connectivity;
        let slots = connectivity.vertex_slots();
        let is_seam = seams(mesh, surface);
        let wedges = Wedges::new(mesh, surface, &is_seam);
        let mut quadrics = vec![Quadric::default(); wedges.attributes.len()];
        let mut shape = vec![Quadric::default(); slots];
        let nothing = Spot { only: NONE, seam_degree: 0, valence: 0, material: SEVERAL, part: SEVERAL };
        let mut spots = vec![nothing; slots];
        for t in connectivity.triangles() {
            let source = mesh.triangle_source[t.index()] as usize;
            let (material, part) = (surface.materials[source], surface.parts[source]);
            let halfedges = [0, 1, 2].map(|i| HalfedgeId(3 * t.0 + i));
            let points = halfedges.map(|h| {
                let place = mesh.point(connectivity.origin(h));
                let attributes = &wedges.attributes[wedges.of(h) as usize];
                std::array::from_fn::<f64, D, _>(|i| if i < 3 { place[i] } else { attributes[i - 3] })
            });
            let mut quadric = Quadric::<K>::of_triangle(points.each_ref(), 1.0);
            let mut plane = Quadric::<0>::of_triangle(points.map(|p| position(&p)).each_ref(), 0.0);
            if let Some(&importance) = surface.importance.get(source) {
                quadric.scale(importance);
                plane.scale(importance);
            }
            for h in halfedges {
                let v = connectivity.origin(h).index();
                quadrics[wedges.of(h) as usize].add(&quadric);
                shape[v].add(&plane);
                let spot = &mut spots[v];
                let is_first = h == connectivity.outgoing[v];
                (spot.material, spot.part) = if spot.valence == 0 {
                    (material, part)
                } else {
                    (common(spot.material, material), common(spot.part, part))
                };
                spot.valence += 1 + u32::from(is_first && connectivity.twin(h).is_none());
            }
        }
        for edge in connectivity.edges().filter(|e| is_seam[e.index()]) {
            let first = connectivity.halfedge(edge);
            let ends = connectivity.ends(edge);
            for h in [first, connectivity.twin(first)].into_iter().filter(|h| h.is_some()) {
                let across = mesh.point(connectivity.origin(Connectivity::prev(h)));
                let [a, b] = ends.map(|v| mesh.point(v));
                let source = mesh.triangle_source[Connectivity::triangle(h).index()] as usize;
                let weight = WALL * surface.importance.get(source).unwrap_or(&1.0);
                ends.iter().for_each(|v| shape[v.index()].add_wall(weight, [a, b, across]));
            }
            ends.iter().for_each(|v| spots[v.index()].seam_degree += 1);
        }
        for v in connectivity.vertices() {
            spots[v.index()].only = wedges.only(connectivity, v).unwrap_or(NONE);
        }
        let log = record.then(|| {
            let left_out = vec![NONE; 3 * surface.triangles.len()];
            let mut log = Log { corner_wedge: left_out.clone(), corner_vertex: left_out, ..Log::default() };
            for h in (0..3 * connectivity.triangle_slots() as u32).map(HalfedgeId) {
                let corner = input_corner(mesh, h);
                log.corner_wedge[corner] = wedges.of(h);
                log.corner_vertex[corner] = connectivity.origin(h).0;
            }
            log
        });
        let tied = connectivity.vertices().filter(|v| tie[v.index()] != UNTIED);
        let mut sheets: Vec<(u32, VertexId)> = tied.map(|v| (tie[v.index()], v)).collect();
        sheets.sort_unstable();
        Self {
            knobs,
            charts: Charts::new(mesh, &wedges, &is_seam),
            drifts: Drifts::new(connectivity.edge_slots()),
            plan: RefCell::default(),
            wedges,
            shape,
            quadrics,
            is_seam,
            spots,
            tie,
            sheets,
            log,
        }
    }

    /// Attributes of a corner, and the corner of the input that has the same.
    pub fn corner(&self, t: TriangleId, corner: u32) -> ([f64; K], u32) {
        let wedge = self.wedges.of(HalfedgeId(3 * t.0 + corner)) as usize;
        (self.wedges.attributes[wedge], self.wedges.source[wedge])
    }

    pub fn largest_drift(&self) -> f64 {
        self.drifts.largest
    }

    pub fn into_log(self) -> Option<Log<K>> {
        self.log
    }

    /// Whether a wedge has a texture coordinate.
    pub(super) fn is_textured(&self, wedge: u32) -> bool {
        self.wedges.is_textured[wedge as usize]
    }

    /// Whether the ends have one wedge each and no seam: the most there is of a surface.
    #[inline]
    pub(super) fn is_plain(&self, ends: [VertexId; 2]) -> bool {
        ends.map(|v| &self.spots[v.index()]).iter().all(|spot| spot.only != NONE && spot.seam_degree == 0)
    }
}
