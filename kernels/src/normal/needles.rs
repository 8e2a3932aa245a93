//! Needles that no rule of collapses lets go.
//!
//! A needle of the input, as marching cubes leave them, looks anywhere. That a triangle must not turn then keeps it, with
//! all that refines it, and rounding turns it over. Here its shortest side collapses where that makes the worst triangle
//! around better, the new ones look along the surface, and it costs next to nothing.

use super::base_mesh::Collapse;
use super::half_edge::{HalfEdge, quality};
use super::unfold::soundness;
use crate::base::geometry::{cross, distance2, dot, norm2, sub};
use crate::base::ids::{EdgeId, HalfedgeId, TriangleId};
use crate::collapse::engine::Measure;
use crate::mesh::legality::{Marks, can_collapse};
use crate::mesh::star::{Star, Wing};
use crate::mesh::triangle_mesh::Mesh;

/// Triangles of less quality are needles.
const NEEDLE: f64 = 0.15;
/// Least soundness of a triangle that such a collapse makes.
const LEAST_SOUNDNESS: f64 = 0.3;
/// Least cosine between a triangle before and after a collapse that is done whatever it looks along.
const LEAST_COSINE: f64 = 0.7;
/// Turns over all needles.
const TURNS: usize = 8;

/// Collapse what can be at no more than `limit`; returns the collapses.
pub fn remove(mesh: &mut Mesh<3>, measure: &mut HalfEdge<'_>, limit: f64) -> Vec<Collapse> {
    let in_order = |mesh: &Mesh<3>| {
        let mut edges = shortest_sides(mesh);
        edges.sort_unstable_by_key(|edge| edge.index());
        edges
    };
    collapsed(mesh, measure, in_order, |mesh, measure, star| better_end(mesh, measure, star, limit))
}

/// Collapse the shortest sides of needles between some vertices, the shortest first, as long as no other triangle around
/// turns by much; returns the collapses.
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

/// Collapse edges into the ends that may stay, turn after turn.
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

/// Whether no triangle turns by much when an edge collapses into one of its ends, or a needle looks along the surface then.
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

/// The shortest side of each needle.
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

/// The end into which an edge may collapse; the one that leaves better triangles, if both may stay.
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
