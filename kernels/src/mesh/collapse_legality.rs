//! Legality of edge collapses, independent of the error measure. Nothing here changes the mesh.

use crate::base::geometry::{Vec3, cross, dot, norm2, position_of, sub};
use crate::base::ids::{EdgeId, VertexId};
use crate::mesh::connectivity::Connectivity;
use crate::mesh::edge_star::EdgeStar;
use crate::mesh::triangle_mesh::{Mesh, VertexLock};

/// Reason why a collapse is illegal.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum IllegalCollapse {
    /// It would change the topology: the link condition fails, or a component or a hole would vanish.
    Topology,
    /// It joins two boundary vertices across the interior, which would pinch the surface.
    Bridge,
    /// Both ends are fixed.
    Locked,
    /// A triangle would flip or become degenerate.
    Fold,
}

/// Minimum cosine between the normals of a triangle before and after a collapse: about 75° per step. With
/// 90°, a few successive steps flip a triangle.
const MIN_COSINE: f64 = 0.25;

/// A triangle is degenerate if twice its area is below this ratio of its longest side squared, a height of a
/// thousandth of the side.
const MIN_FLATNESS: f64 = 1e-3;

/// Marks on vertices that can be cleared in constant time.
#[derive(Clone, Debug)]
pub struct VertexMarks {
    stamps: Vec<u32>,
    stamp: u32,
}

impl VertexMarks {
    /// Create cleared marks for a number of vertex slots.
    pub fn new(slots: usize) -> Self {
        Self { stamps: vec![0; slots], stamp: 0 }
    }

    fn clear(&mut self) {
        if self.stamp == u32::MAX {
            self.stamps.fill(0);
            self.stamp = 0;
        }
        self.stamp += 1;
    }

    #[inline]
    fn mark(&mut self, v: VertexId) {
        self.stamps[v.index()] = self.stamp;
    }

    #[inline]
    fn is_marked(&self, v: VertexId) -> bool {
        self.stamps[v.index()] == self.stamp
    }
}

/// Find the lock of a vertex that a collapse into a locked vertex would connect to it by a new edge. Prefers
/// `Locked` over `BoundarySpans`, because a rim vertex may be locked as well.
///
/// If the two sides of a border of locked vertices are simplified separately, both could create the same
/// edge.
pub fn find_new_chord<const D: usize>(mesh: &Mesh<D>, star: &EdgeStar<D>) -> Option<VertexLock> {
    let end = (0..2).find(|&end| mesh.lock(star.ends[end]) == VertexLock::Locked)?;
    let is_apex = |v: VertexId| star.vanishing.iter().any(|(_, apex, _)| *apex == v);
    let moving = star
        .remaining
        .iter()
        .filter(|wing| wing.end != end)
        .flat_map(|wing| [wing.side_start, wing.side_end]);
    let locks =
        moving.filter(|&v| !is_apex(v)).map(|v| mesh.lock(v)).filter(|&lock| lock != VertexLock::Free);
    locks.min_by_key(|&lock| lock == VertexLock::Rim)
}

/// Check whether collapsing `edge` preserves an oriented manifold of the same topology.
///
/// Link condition for a surface with boundary (Dey, Edelsbrunner, Guha and Nekhayev 1999): the ends share
/// only the corners opposite to the edge, both ends are on the boundary only if the edge is, and the links
/// share no edge. The last condition fails exactly for a tetrahedron and for a single triangle.
pub fn can_collapse(
    mesh: &Connectivity,
    edge: EdgeId,
    marks: &mut VertexMarks,
) -> Result<(), IllegalCollapse> {
    let [v1, v2] = mesh.ends(edge);
    let first = mesh.halfedge(edge);
    let on_boundary = mesh.is_boundary_edge(edge);
    let ends_on_boundary = [v1, v2].map(|v| mesh.is_boundary_vertex(v));
    if !on_boundary && ends_on_boundary == [true, true] {
        return Err(IllegalCollapse::Bridge);
    }
    let is_open = |h| mesh.twin(h).is_none();
    if on_boundary && is_open(Connectivity::next(first)) && is_open(Connectivity::prev(first)) {
        return Err(IllegalCollapse::Topology);
    }
    marks.clear();
    let mut valence = [0, 0];
    for (_, v) in mesh.vertex_edges(v1) {
        marks.mark(v);
        valence[0] += 1;
    }
    let mut shared = 0;
    for (_, v) in mesh.vertex_edges(v2) {
        shared += usize::from(marks.is_marked(v));
        valence[1] += 1;
    }
    let beside = if on_boundary { 1 } else { 2 };
    let tetrahedron = valence == [3, 3] && ends_on_boundary == [false, false];
    if shared != beside || tetrahedron { Err(IllegalCollapse::Topology) } else { Ok(()) }
}

/// Check that every remaining triangle keeps its orientation and area if both ends move to `point`.
pub fn check_triangles<const D: usize>(star: &EdgeStar<D>, point: &[f64; D]) -> Result<(), IllegalCollapse> {
    let to = position_of(point);
    let ends = star.end_points.map(|p| position_of(&p));
    let is_kept = star.remaining.iter().all(|wing| {
        let side = [position_of(&wing.from_point), position_of(&wing.to_point)];
        keeps_triangle([&ends[wing.end], &to], side.each_ref(), || star.mean_normal())
    });
    if is_kept { Ok(()) } else { Err(IllegalCollapse::Fold) }
}

/// Check that a triangle keeps its orientation and area if a corner moves.
///
/// A needle may stay a needle if it gets no thinner. The normal of a degenerate triangle is compared with the
/// mean normal of the star.
#[inline]
pub fn keeps_triangle([from, to]: [&Vec3; 2], [a, b]: [&Vec3; 2], mean_normal: impl Fn() -> Vec3) -> bool {
    let (old, old_side2) = normal_and_longest_side(from, a, b);
    let (new, new_side2) = normal_and_longest_side(to, a, b);
    let (old_area2, new_area2) = (norm2(&old), norm2(&new));
    let least2 = MIN_FLATNESS * MIN_FLATNESS;
    if new_area2 <= least2 * new_side2 * new_side2
        && new_area2 * old_side2 * old_side2 < old_area2 * new_side2 * new_side2
    {
        return false;
    }
    let flat = old_area2 <= least2 * least2 * old_side2 * old_side2;
    let reference = if flat { mean_normal() } else { old };
    let least = if flat { 0.0 } else { MIN_COSINE };
    let folds = dot(&reference, &new) < least * (old_area2 * new_area2).sqrt();
    !folds
}

/// Compute the normal of a triangle (length: twice the area) and its longest side squared.
#[inline]
fn normal_and_longest_side(p: &Vec3, a: &Vec3, b: &Vec3) -> (Vec3, f64) {
    let (pa, pb) = (sub(a, p), sub(b, p));
    (cross(&pa, &pb), norm2(&pa).max(norm2(&pb)).max(norm2(&sub(b, a))))
}
