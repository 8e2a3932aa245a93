//! Removal of needle triangles that ordinary collapses keep.
//!
//! Needles of the input, as marching cubes produce them, have arbitrary normals. The rule against flipped
//! triangles therefore keeps a needle and all its descendants, and rounding then flips them. This module
//! collapses the shortest side of a needle under three conditions. The worst triangle around improves, the
//! new triangles follow the surface, and the cost is negligible.

use super::base_mesh::Collapse;
use super::half_edge::{HalfEdge, quality};
use super::unfold::soundness;
use crate::base::geometry::{cross, distance2, dot, norm2, sub};
use crate::base::ids::{EdgeId, HalfedgeId, TriangleId};
use crate::collapse::engine::Measure;
use crate::mesh::legality::{Marks, can_collapse};
use crate::mesh::star::{Star, Wing};
use crate::mesh::triangle_mesh::Mesh;

/// Triangles below this quality (1 equilateral, 0 degenerate) are needles.
const NEEDLE: f64 = 0.15;
/// Minimum cosine between a new triangle and the surface.
const LEAST_SOUNDNESS: f64 = 0.3;
/// Minimum cosine between a triangle before and after a collapse for which the surface normal is not checked.
const LEAST_COSINE: f64 = 0.7;
/// Maximum number of passes over all needles.
const TURNS: usize = 8;

/// Collapse needles where the cost is at most `limit`, and return the collapses.
pub fn remove(mesh: &mut Mesh<3>, measure: &mut HalfEdge<'_>, limit: f64) -> Vec<Collapse> {
    let in_order = |mesh: &Mesh<3>| {
        let mut edges = shortest_sides(mesh);
        edges.sort_unstable_by_key(|edge| edge.index());
        edges
    };
    collapsed(mesh, measure, in_order, |mesh, measure, star| better_end(mesh, measure, star, limit))
}

/// Collapse needle sides between vertices flagged in `among`, shortest first, and return the collapses. Every
/// other triangle around must keep its direction.
pub fn remove_among(mesh: &mut Mesh<3>, measure: &mut HalfEdge<'_>, among: &[bool]) -> Vec<Collapse> {
    let shortest_first = |mesh: &Mesh<3>| {
        let mut edges = shortest_sides(mesh);
        edges.retain(|&edge| mesh.connectivity.ends(edge).iter().all(|v| among[v.index()]));
        let length2 = |edge: &EdgeId| {
            let [a, b] = mesh.connectivity.ends(*edge).map(|v| mesh.point(v));
            distance2(a, b)
        };
        edges.sort_by(|a, b| length2(a).total_cmp(&length2(b)).then(a.index().cmp(&b.index())));
        edges
    };
    collapsed(mesh, measure, shortest_first, |_, measure, star| {
        (0..2).find(|&end| !star.end_stays[1 - end] && turns_little(measure, star, end))
    })
}

/// Collapse the `edges` into the end that `end` selects, in passes until nothing changes.
fn collapsed(
    mesh: &mut Mesh<3>,
    measure: &mut HalfEdge<'_>,
    edges: impl Fn(&Mesh<3>) -> Vec<EdgeId>,
    end: impl Fn(&Mesh<3>, &HalfEdge<'_>, &Star<3>) -> Option<usize>,
) -> Vec<Collapse> {
    let mut collapses = vec![];
    let (mut marks, mut star) = (Marks::new(mesh.points.len()), Star::default());
    for _ in 0..TURNS {
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
fn turns_little(measure: &HalfEdge<'_>, star: &Star<3>, end: usize) -> bool {
    star.wings.iter().filter(|wing| wing.end != end).all(|wing| {
        let [old, new] = [wing.end, end].map(|e| [&star.end_points[e], &wing.from_point, &wing.to_point]);
        let [before, after] = [old, new].map(|[a, b, c]| cross(&sub(b, a), &sub(c, a)));
        let is_kept = dot(&before, &after) >= LEAST_COSINE * (norm2(&before) * norm2(&after)).sqrt();
        is_kept || {
            let is_needle = quality(old[0], old[1], old[2]) < NEEDLE;
            is_needle
                && soundness(new, measure.normals([star.ends[end], wing.from, wing.to])) >= LEAST_SOUNDNESS
        }
    })
}

/// List the shortest side of each needle.
fn shortest_sides(mesh: &Mesh<3>) -> Vec<EdgeId> {
    let connectivity = &mesh.connectivity;
    let shortest = |t: TriangleId| {
        let points = connectivity.corners(t).map(|v| mesh.point(v));
        let length2 = |i: usize| distance2(points[i], points[(i + 1) % 3]);
        let side = (0..3).fold(0, |least, i| if length2(i) < length2(least) { i } else { least });
        let is_needle = quality(points[0], points[1], points[2]) < NEEDLE;
        is_needle.then(|| connectivity.edge(HalfedgeId::from_index(3 * t.index() + side)))
    };
    connectivity.triangles().filter_map(shortest).collect()
}

/// Select the end into which an edge may collapse. If both are allowed, choose the end with the better worst
/// triangle.
fn better_end(mesh: &Mesh<3>, measure: &HalfEdge<'_>, star: &Star<3>, limit: f64) -> Option<usize> {
    let gone =
        star.vanishing.iter().map(|(_, _, apex)| quality(&star.end_points[0], &star.end_points[1], apex));
    let old = gone.fold(1.0, f64::min);
    let mut best = None;
    for end in 0..2 {
        let point = &star.end_points[end];
        let moved = || star.wings.iter().filter(|wing| wing.end != end);
        let before = |wing: &Wing<3>| quality(&star.end_points[wing.end], &wing.from_point, &wing.to_point);
        let (mut now, mut was) = (1.0f64, old);
        for wing in moved() {
            now = now.min(quality(point, &wing.from_point, &wing.to_point));
            was = was.min(before(wing));
        }
        let looks_along = || {
            moved().all(|wing| {
                let normals = measure.normals([star.ends[end], wing.from, wing.to]);
                soundness([point, &wing.from_point, &wing.to_point], normals) >= LEAST_SOUNDNESS
            })
        };
        let better = now > was && best.is_none_or(|(most, _)| now > most);
        if better && measure.allows(mesh, star, end, limit) && looks_along() {
            best = Some((now, end));
        }
    }
    best.map(|(_, end)| end)
}
