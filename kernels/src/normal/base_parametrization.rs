//! Position of each input vertex on the base mesh, updated with every collapse.
//!
//! As in MAPS (Lee, Sweldens, Schröder, Cowsar and Dobkin, 1998), the star of a vertex is flattened before
//! its removal, with proportional angles. The vertex and all earlier vertices in the star are then located in
//! the new triangles. Li, Li, Xu and Li do not use positions. They resolve two cases: a line that pierces the
//! associated set several times, and a line that pierces it nowhere.

use std::f64::consts::PI;

use crate::base::geometry::{Vec3, dot, norm2, sub};
use crate::mesh::edge_star::EdgeStar;

const NONE: u32 = u32::MAX;
/// Minimum angle of a triangle in the flattened star, in radians.
const MIN_ANGLE: f64 = 1e-3;
/// Minimum height of a flattened triangle, in lengths of its longest side.
const MIN_HEIGHT_RATIO: f64 = 1e-3;

type PlanePoint = [f64; 2];

/// Point on a triangle mesh: a triangle and barycentric coordinates in the order of its corners.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BasePoint {
    pub triangle: u32,
    pub barycentric: [f64; 3],
}

impl BasePoint {
    /// Placeholder for a vertex without a position.
    pub const UNDEFINED: Self = Self { triangle: NONE, barycentric: [0.0; 3] };

    /// Build the point at a corner of a triangle.
    pub fn from_corner(triangle: u32, corner: usize) -> Self {
        let mut barycentric = [0.0; 3];
        barycentric[corner] = 1.0;
        Self { triangle, barycentric }
    }
}

/// Positions of removed input vertices on the current mesh.
#[derive(Clone, Debug)]
pub struct BaseParametrization {
    /// Position of each removed input vertex; [`BasePoint::UNDEFINED`] for vertices that still exist.
    of: Vec<BasePoint>,
    /// Current corners of each triangle, or the last ones before its removal.
    corners: Vec<[u32; 3]>,
    /// Linked lists of vertices per triangle: the first vertex of each triangle, and the next vertex in the
    /// same triangle.
    first: Vec<u32>,
    next: Vec<u32>,
    scratch: Scratch,
}

#[derive(Clone, Debug, Default)]
struct Scratch {
    /// Neighbours of the removed vertex in order, and their flattened positions. The removed vertex is at the
    /// origin.
    ring: Vec<(u32, Vec3)>,
    positions: Vec<PlanePoint>,
    moved: Vec<(u32, PlanePoint)>,
}

impl BaseParametrization {
    pub fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        Self {
            of: vec![BasePoint::UNDEFINED; vertices],
            corners: triangles.to_vec(),
            first: vec![NONE; triangles.len()],
            next: vec![NONE; vertices],
            scratch: Scratch::default(),
        }
    }

    /// Look up the position of a removed vertex, with the corners its coordinates refer to.
    pub fn of(&self, v: usize) -> Option<(BasePoint, [u32; 3])> {
        let parameter = self.of[v];
        (parameter.triangle != NONE).then(|| (parameter, self.corners[parameter.triangle as usize]))
    }

    /// Update the positions for a collapse of end `removed` (0 or 1) of the star's edge.
    pub fn collapse(&mut self, star: &EdgeStar<3>, removed: usize) {
        let mut scratch = std::mem::take(&mut self.scratch);
        let gone = star.ends[removed].0;
        let survivor = star.ends[1 - removed].0;
        scratch.flatten_star(star, removed);
        let place = |v: u32, ring: &[(u32, Vec3)], flat: &[PlanePoint]| {
            ring.iter().position(|(w, _)| *w == v).map_or([0.0; 2], |i| flat[i])
        };
        let wings = || star.remaining.iter().filter(|w| w.end == removed).map(|w| w.triangle.index());
        if wings().next().is_none() {
            self.scratch = scratch;
            self.move_ear_contents(star, removed);
            return;
        }

        // Collect all vertices in the star, in flattened coordinates.
        scratch.moved.clear();
        scratch.moved.push((gone, [0.0; 2]));
        for triangle in wings().chain(star.vanishing.iter().map(|(t, ..)| t.index())) {
            let at = self.corners[triangle].map(|v| place(v, &scratch.ring, &scratch.positions));
            let mut v = std::mem::replace(&mut self.first[triangle], NONE);
            while v != NONE {
                let [a, b, c] = self.of[v as usize].barycentric;
                scratch.moved.push((v, [0, 1].map(|i| a * at[0][i] + b * at[1][i] + c * at[2][i])));
                v = self.next[v as usize];
            }
        }
        for triangle in wings() {
            self.corners[triangle] = self.corners[triangle].map(|v| if v == gone { survivor } else { v });
        }

        for &(v, at) in &scratch.moved {
            let mut best = (f64::NEG_INFINITY, NONE, [0.0; 3]);
            for triangle in wings() {
                let corners = self.corners[triangle].map(|v| place(v, &scratch.ring, &scratch.positions));
                let Some(barycentric) = compute_barycentric(&at, corners.each_ref()) else { continue };
                let least = barycentric.iter().fold(f64::INFINITY, |least, &x| least.min(x));
                if least > best.0 {
                    best = (least, triangle as u32, barycentric);
                }
                if least >= 0.0 {
                    break;
                }
            }
            let (_, triangle, barycentric) = best;
            let inside = barycentric.map(|x| x.max(0.0));
            let sum: f64 = inside.iter().sum();
            self.of[v as usize] = BasePoint { triangle, barycentric: inside.map(|x| x / sum) };
            if triangle != NONE {
                self.next[v as usize] = std::mem::replace(&mut self.first[triangle as usize], v);
            }
        }
        self.scratch = scratch;
    }

    /// Handle a removed vertex with a single triangle: its contents move to the remaining side of the
    /// triangle.
    fn move_ear_contents(&mut self, star: &EdgeStar<3>, removed: usize) {
        let (ear, apex, _) = star.vanishing[0];
        let (gone, survivor) = (star.ends[removed].0, star.ends[1 - removed].0);
        let beside = star.remaining.iter().find(|w| w.side_start == apex || w.side_end == apex);
        let Some(triangle) = beside.map(|w| w.triangle.index()) else { return };
        let corners = self.corners[triangle];
        let put = |v: u32, at_survivor: f64, at_apex: f64, this: &mut Self| {
            let barycentric = corners.map(|c| {
                if c == survivor { at_survivor } else { f64::from(u8::from(c == apex.0)) * at_apex }
            });
            this.of[v as usize] = BasePoint { triangle: triangle as u32, barycentric };
            this.next[v as usize] = std::mem::replace(&mut this.first[triangle], v);
        };
        let was = self.corners[ear.index()];
        let mut v = std::mem::replace(&mut self.first[ear.index()], NONE);
        while v != NONE {
            let next = self.next[v as usize];
            let of = |corner: u32| {
                was.iter().position(|c| *c == corner).map_or(0.0, |i| self.of[v as usize].barycentric[i])
            };
            let half = 0.5 * of(gone);
            let (at_survivor, at_apex) = (of(survivor) + half, of(apex.0) + half);
            put(v, at_survivor, at_apex, self);
            v = next;
        }
        put(gone, 0.5, 0.5, self);
    }
}

impl Scratch {
    /// Flatten the neighbours of one end of the edge, counter-clockwise. Distances are kept unless the
    /// survivor would not see all neighbours; then the neighbours are placed on a circle.
    fn flatten_star(&mut self, star: &EdgeStar<3>, removed: usize) {
        let origin = &star.end_points[removed];
        let survivor = (star.ends[1 - removed].0, star.end_points[1 - removed]);
        self.ring.clear();
        let wings = || star.remaining.iter().filter(|w| w.end == removed);
        let closed = star.vanishing.len() == 2;
        // A boundary edge has its triangle on the left, as viewed from its first end.
        let survivor_first = closed || removed == 0;
        if survivor_first {
            let (_, apex, point) = star.vanishing[if closed { removed } else { 0 }];
            self.ring.extend([survivor, (apex.0, point)]);
        } else {
            // Far end of the boundary: a vertex where one wing starts and none ends.
            let start = wings().find(|w| wings().all(|other| other.side_end != w.side_start));
            self.ring.extend(start.map(|w| (w.side_start.0, w.from_point)));
        }
        while let Some(wing) = wings().find(|w| self.ring.last().is_some_and(|(v, _)| *v == w.side_start.0)) {
            self.ring.push((wing.side_end.0, wing.to_point));
        }
        let survivor_at = if survivor_first { 0 } else { self.ring.len() };
        if !survivor_first {
            self.ring.push(survivor);
        }
        self.flatten(origin, closed, survivor_at);
    }

    fn flatten(&mut self, origin: &Vec3, closed: bool, survivor: usize) {
        let count = self.ring.len();
        let spokes: Vec<Vec3> = self.ring.iter().map(|(_, p)| sub(p, origin)).collect();
        let gaps = if closed { count } else { count - 1 };
        let angle = |i: usize| {
            let (a, b) = (&spokes[i], &spokes[(i + 1) % count]);
            let lengths = (norm2(a) * norm2(b)).sqrt();
            let angle = if lengths > 0.0 { (dot(a, b) / lengths).clamp(-1.0, 1.0).acos() } else { 0.0 };
            angle.max(MIN_ANGLE)
        };
        let angles: Vec<f64> = (0..gaps).map(angle).collect();
        let total: f64 = angles.iter().sum();
        let turn = if closed { 2.0 * PI } else { PI };
        let mut directions = Vec::with_capacity(count);
        let mut at: f64 = 0.0;
        for i in 0..count {
            directions.push([at.cos(), at.sin()]);
            at += angles.get(i).map_or(0.0, |a| a * turn / total);
        }
        self.positions.clear();
        self.positions.extend((0..count).map(|i| directions[i].map(|x| x * norm2(&spokes[i]).sqrt())));
        let s = self.positions[survivor];
        let seen = (0..gaps).all(|i| {
            let j = (i + 1) % count;
            let corners = [&s, &self.positions[i], &self.positions[j]];
            i == survivor
                || j == survivor
                || twice_signed_area(corners) > MIN_HEIGHT_RATIO * longest_side2(corners)
        });
        if !seen {
            self.positions = directions;
        }
    }
}

/// Compute the squared longest side of a 2-D triangle.
fn longest_side2([a, b, c]: [&PlanePoint; 3]) -> f64 {
    let distance2 = |p: &PlanePoint, q: &PlanePoint| (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2);
    distance2(a, b).max(distance2(b, c)).max(distance2(c, a))
}

/// Compute twice the signed area of a 2-D triangle; positive if counter-clockwise.
pub fn twice_signed_area([a, b, c]: [&PlanePoint; 3]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Compute barycentric coordinates in a 2-D triangle. None if its area is not positive.
pub fn compute_barycentric(p: &PlanePoint, [a, b, c]: [&PlanePoint; 3]) -> Option<[f64; 3]> {
    let whole = twice_signed_area([a, b, c]);
    let (u, v) = (twice_signed_area([p, b, c]) / whole, twice_signed_area([a, p, c]) / whole);
    (whole > 0.0).then_some([u, v, 1.0 - u - v])
}
