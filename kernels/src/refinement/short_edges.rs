//! Removal of short edges, which marching cubes produce where the surface passes next to a corner of a cube.
//!
//! Their thin triangles have arbitrary normals, and fold when their vertices move.

use crate::base::geometry::distance2;
use crate::base::ids::EdgeId;
use crate::mesh::collapse_legality::{VertexMarks, can_collapse, check_triangles};
use crate::mesh::edge_star::EdgeStar;
use crate::mesh::triangle_mesh::Mesh;

/// Passes over all edges.
const MAX_PASSES: usize = 3;

/// Collapse all edges shorter than `min_length` into their midpoint, or into an end on the boundary, where no
/// triangle folds. Returns the number of collapses.
pub fn collapse_short_edges(mesh: &mut Mesh<3>, min_length: f64) -> usize {
    let (mut marks, mut star) = (VertexMarks::new(mesh.points.len()), EdgeStar::default());
    let mut collapses = 0;
    for _ in 0..MAX_PASSES {
        let before = collapses;
        for e in 0..mesh.connectivity.edge_slots() {
            let edge = EdgeId::from_index(e);
            if !mesh.connectivity.is_edge(edge) {
                continue;
            }
            let [a, b] = mesh.connectivity.ends(edge);
            if distance2(mesh.point(a), mesh.point(b)) >= min_length * min_length
                || can_collapse(&mesh.connectivity, edge, &mut marks).is_err()
            {
                continue;
            }
            star.gather(mesh, edge);
            let (survivor, point) = match star.end_is_fixed {
                [true, true] => continue,
                [true, false] => (star.ends[0], star.end_points[0]),
                [false, true] => (star.ends[1], star.end_points[1]),
                [false, false] => (star.ends[0], star.middle),
            };
            if check_triangles(&star, &point).is_ok() {
                mesh.collapse(edge, survivor, point);
                collapses += 1;
            }
        }
        if collapses == before {
            break;
        }
    }
    collapses
}
