//! Needles that no rule of collapses lets go.
//!
//! A needle of the input, as marching cubes leave them, looks anywhere. That a triangle must not turn then keeps it, with
//! all that refines it, and rounding turns it over. Here its shortest side collapses where that makes the worst triangle
//! around better, the new ones look along the surface, and it costs next to nothing.

use super::half_edge::{HalfEdge, quality};
use super::unfold::soundness;
use crate::base::geometry::distance2;
use crate::base::ids::{EdgeId, HalfedgeId, TriangleId};
use crate::collapse::engine::Measure;
use crate::mesh::legality::{Marks, can_collapse};
use crate::mesh::star::{Star, Wing};
use crate::mesh::triangle_mesh::Mesh;

/// Triangles of less quality are needles.
const NEEDLE: f64 = 0.15;
/// Least soundness of a triangle that such a collapse makes.
const LEAST_SOUNDNESS: f64 = 0.3;
/// Turns over all needles.
const TURNS: usize = 8;

/// Collapse what can be at no more than `limit`.
pub fn remove(mesh: &mut Mesh<3>, measure: &mut HalfEdge<'_>, limit: f64) {
    let (mut marks, mut star) = (Marks::new(mesh.points.len()), Star::default());
    for _ in 0..TURNS {
        let mut edges: Vec<EdgeId> = shortest_sides(mesh);
        edges.sort_unstable_by_key(|edge| edge.index());
        edges.dedup();
        let mut collapsed = false;
        for edge in edges {
            if !mesh.connectivity.is_edge(edge) || can_collapse(&mesh.connectivity, edge, &mut marks).is_err()
            {
                continue;
            }
            star.gather(mesh, edge);
            let Some(end) = better_end(mesh, measure, &star, limit) else { continue };
            let done = mesh.collapse(edge, star.ends[end], star.end_points[end]);
            measure.commit(mesh, &star, &done, 0.0);
            collapsed = true;
        }
        if !collapsed {
            break;
        }
    }
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
