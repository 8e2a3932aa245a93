//! Smoothing of boundaries, which marching cubes leaves as stairs.
//!
//! Boundary vertices move between their two neighbours on the boundary, within the surface. Every step towards
//! the neighbours is followed by a slightly larger one away from them, so that loops do not shrink (Taubin, "A
//! signal processing approach to fair surface design", 1995).

use super::folds::undo_folds;
use super::normal_filter::{area_normals, limit_move};
use crate::base::geometry::{Vec3, add_scaled, dot};
use crate::base::ids::VertexId;
use crate::mesh::connectivity::Connectivity;

const STEPS: [f64; 2] = [0.5, -0.53];
const ITERATIONS: usize = 10;
/// Minimum cosine between the normals of a triangle before and after (37°): moves are within the surface.
pub const MIN_COSINE: f64 = 0.8;

/// Smooth the boundaries. `normals` are unit normals of the vertices; no vertex moves farther than `max_move`,
/// and no triangle folds.
pub fn smooth_boundaries(
    connectivity: &Connectivity,
    points: &mut [Vec3],
    normals: &[Vec3],
    max_move: f64,
    threads: usize,
) {
    let origins = points.to_vec();
    // Each boundary vertex with its neighbours on the boundary.
    let rim: Vec<(usize, [usize; 2])> = connectivity
        .vertices()
        .filter(|&v| connectivity.is_boundary_vertex(v))
        .filter_map(|v: VertexId| {
            let mut edges = connectivity.vertex_edges(v);
            let first = edges.next()?.1;
            let last = edges.last()?.1;
            Some((v.index(), [first.index(), last.index()]))
        })
        .collect();
    for step in [STEPS; ITERATIONS].as_flattened() {
        let moved: Vec<Vec3> = rim
            .iter()
            .map(|&(v, [a, b])| {
                let to_middle: Vec3 = [0, 1, 2].map(|i| 0.5 * (points[a][i] + points[b][i]) - points[v][i]);
                let within = add_scaled(&to_middle, -dot(&to_middle, &normals[v]), &normals[v]);
                limit_move(&origins[v], add_scaled(&points[v], *step, &within), max_move)
            })
            .collect();
        rim.iter().zip(moved).for_each(|(&(v, _), to)| points[v] = to);
    }
    let references = area_normals(connectivity, &origins, threads);
    let limit = |v: usize, to| limit_move(&origins[v], to, max_move);
    undo_folds(connectivity, &origins, points, &references, MIN_COSINE, limit, threads);
}
