//! Removal of needle triangles that ordinary collapses keep.
//!
//! Needles of the input, as marching cubes produce them, have arbitrary normals. The rule against flipped
//! triangles therefore keeps a needle and all its descendants, and rounding then flips them. This module
//! collapses the shortest side of a needle under three conditions. The worst triangle around improves, the
//! new triangles follow the surface, and the cost is negligible.

use super::base_mesh::Collapse;
use super::fold_repair::compute_normal_cosine;
use super::half_edge_measure::{HalfEdgeMeasure, compute_quality};
use crate::base::geometry::{cross, distance2, dot, norm2, sub};
use crate::base::ids::{EdgeId, HalfedgeId, TriangleId};
use crate::collapse::engine::Measure;
use crate::mesh::collapse_legality::{VertexMarks, can_collapse};
use crate::mesh::edge_star::{EdgeStar, StarTriangle};
use crate::mesh::triangle_mesh::Mesh;

/// Triangles below this quality (1 equilateral, 0 degenerate) are needles.
const NEEDLE_QUALITY: f64 = 0.15;
/// Minimum cosine between a new triangle and the surface.
const MIN_SURFACE_COSINE: f64 = 0.3;
/// Minimum cosine between a triangle before and after a collapse for which the surface normal is not checked.
const MIN_TURN_COSINE: f64 = 0.7;
/// Maximum number of passes over all needles.
const MAX_PASSES: usize = 8;

/// Collapse needles where the cost is at most `limit`, and return the collapses.
pub fn remove_needles(mesh: &mut Mesh<3>, measure: &mut HalfEdgeMeasure<'_>, limit: f64) -> Vec<Collapse> {
    let in_order = |mesh: &Mesh<3>| {
        let mut edges = find_shortest_sides(mesh);
        edges.sort_unstable_by_key(|edge| edge.index());
        edges
    };
    collapse_edges(mesh, measure, in_order, |mesh, measure, star| select_end(mesh, measure, star, limit))
}

/// Collapse needle sides between vertices flagged in `among`, shortest first, and return the collapses. Every
/// other triangle around must keep its direction.
pub fn remove_needles_among(
    mesh: &mut Mesh<3>,
    measure: &mut HalfEdgeMeasure<'_>,
    among: &[bool],
) -> Vec<Collapse> {
    let shortest_first = |mesh: &Mesh<3>| {
        let mut edges = find_shortest_sides(mesh);
        edges.retain(|&edge| mesh.connectivity.ends(edge).iter().all(|v| among[v.index()]));
        let length2 = |edge: &EdgeId| {
            let [a, b] = mesh.connectivity.ends(*edge).map(|v| mesh.point(v));
            distance2(a, b)
        };
        edges.sort_by(|a, b| length2(a).total_cmp(&length2(b)).then(a.index().cmp(&b.index())));
        edges
    };
    collapse_edges(mesh, measure, shortest_first, |_, measure, star| {
        (0..2).find(|&end| !star.end_is_fixed[1 - end] && keeps_direction(measure, star, end))
    })
}

/// Collapse the `edges` into the end that `end` selects, in passes until nothing changes.
fn collapse_edges(
    mesh: &mut Mesh<3>,
    measure: &mut HalfEdgeMeasure<'_>,
    edges: impl Fn(&Mesh<3>) -> Vec<EdgeId>,
    end: impl Fn(&Mesh<3>, &HalfEdgeMeasure<'_>, &EdgeStar<3>) -> Option<usize>,
) -> Vec<Collapse> {
    let mut collapses = vec![];
    let (mut marks, mut star) = (VertexMarks::new(mesh.points.len()), EdgeStar::default());
    for _ in 0..MAX_PASSES {
        let before = collapses.len();
        let mut edges = edges(mesh);
        edges.dedup();
        for edge in edges {
            if !mesh.connectivity.is_edge(edge) || can_collapse(&mesh.connectivity, edge, &mut marks).is_err()
            {
                continue;
            }
            star.gather(mesh, edge);
            let Some(end) = end(mesh, measure, &star) else { continue };
            let done = mesh.collapse(edge, star.ends[end], star.end_points[end]);
            measure.commit(mesh, &star, &done, 0.0);
            collapses.push(Collapse { removed: done.removed, survivor: done.survivor });
        }
        if collapses.len() == before {
            break;
        }
    }
    collapses
}

/// Check a collapse into one end: every moved triangle must keep its direction, unless it was a needle and
/// follows the surface afterwards.
fn keeps_direction(measure: &HalfEdgeMeasure<'_>, star: &EdgeStar<3>, end: usize) -> bool {
    star.remaining.iter().filter(|wing| wing.end != end).all(|wing| {
        let [old, new] = [wing.end, end].map(|e| [&star.end_points[e], &wing.from_point, &wing.to_point]);
        let [before, after] = [old, new].map(|[a, b, c]| cross(&sub(b, a), &sub(c, a)));
        let is_kept = dot(&before, &after) >= MIN_TURN_COSINE * (norm2(&before) * norm2(&after)).sqrt();
        is_kept || {
            let is_needle = compute_quality(old[0], old[1], old[2]) < NEEDLE_QUALITY;
            is_needle
                && compute_normal_cosine(
                    new,
                    measure.normals([star.ends[end], wing.side_start, wing.side_end]),
                ) >= MIN_SURFACE_COSINE
        }
    })
}

/// List the shortest side of each needle.
fn find_shortest_sides(mesh: &Mesh<3>) -> Vec<EdgeId> {
    let connectivity = &mesh.connectivity;
    let shortest = |t: TriangleId| {
        let points = connectivity.corners(t).map(|v| mesh.point(v));
        let length2 = |i: usize| distance2(points[i], points[(i + 1) % 3]);
        let side = (0..3).fold(0, |least, i| if length2(i) < length2(least) { i } else { least });
        let is_needle = compute_quality(points[0], points[1], points[2]) < NEEDLE_QUALITY;
        is_needle.then(|| connectivity.edge(HalfedgeId::from_index(3 * t.index() + side)))
    };
    connectivity.triangles().filter_map(shortest).collect()
}

/// Select the end into which an edge may collapse. If both are allowed, choose the end with the better worst
/// triangle.
fn select_end(
    mesh: &Mesh<3>,
    measure: &HalfEdgeMeasure<'_>,
    star: &EdgeStar<3>,
    limit: f64,
) -> Option<usize> {
    let gone = star
        .vanishing
        .iter()
        .map(|(_, _, apex)| compute_quality(&star.end_points[0], &star.end_points[1], apex));
    let old = gone.fold(1.0, f64::min);
    let mut best = None;
    for end in 0..2 {
        let point = &star.end_points[end];
        let moved = || star.remaining.iter().filter(|wing| wing.end != end);
        let before = |wing: &StarTriangle<3>| {
            compute_quality(&star.end_points[wing.end], &wing.from_point, &wing.to_point)
        };
        let (mut now, mut was) = (1.0f64, old);
        for wing in moved() {
            now = now.min(compute_quality(point, &wing.from_point, &wing.to_point));
            was = was.min(before(wing));
        }
        let looks_along = || {
            moved().all(|wing| {
                let normals = measure.normals([star.ends[end], wing.side_start, wing.side_end]);
                compute_normal_cosine([point, &wing.from_point, &wing.to_point], normals)
                    >= MIN_SURFACE_COSINE
            })
        };
        let better = now > was && best.is_none_or(|(most, _)| now > most);
        if better && measure.is_affordable(mesh, star, end, limit) && looks_along() {
            best = Some((now, end));
        }
    }
    best.map(|(_, end)| end)
}
