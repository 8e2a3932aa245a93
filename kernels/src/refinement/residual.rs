//! Smooth correction of a surface along its normals, from noisy distances to the measurements.
//!
//! Weighted distances and weights diffuse over the mesh separately; their ratio is a mean over the
//! neighbourhood in which precise measurements count more (normalised convolution: Knutsson and Westin, 1993).
//! Nothing diffuses across creases.

use super::observations::Observation;
use crate::base::geometry::{Vec3, dot};
use crate::base::ids::{EdgeId, VertexId};
use crate::base::parallel::collect;
use crate::mesh::connectivity::Connectivity;

/// Weight of "no correction" relative to a typical measured vertex: where nothing was measured, the surface
/// stays.
const PRIOR_RATIO: f64 = 1e-3;

/// Compute the correction of each vertex along its normal. `normals` are filtered normals of triangles;
/// `cutoff` is the angle, in radians, at which an edge is a crease.
pub fn smooth_residuals(
    connectivity: &Connectivity,
    normals: &[Vec3],
    observations: &[Observation],
    cutoff: f64,
    iterations: usize,
    threads: usize,
) -> Vec<f64> {
    let count = connectivity.vertex_slots();
    let min_cosine = cutoff.cos();
    let span = 1.0 / (1.0 - min_cosine);
    let edge_weights: Vec<f64> = collect(connectivity.edge_slots(), threads, |e| {
        let h = connectivity.halfedge(EdgeId::from_index(e));
        let twin = connectivity.twin(h);
        if twin.is_none() {
            return 1.0;
        }
        let [a, b] = [h, twin].map(|h| &normals[Connectivity::triangle(h).index()]);
        let like = ((dot(a, b) - min_cosine) * span).max(0.0);
        like * like
    });
    let typical = typical_weight(observations);
    let prior = if typical > 0.0 { PRIOR_RATIO } else { 1.0 };
    let scale = if typical > 0.0 { 1.0 / typical } else { 0.0 };
    let mut sums: Vec<[f64; 2]> = collect(count, threads, |v| {
        let one = &observations[v];
        [one.distance * scale, one.weight * scale + prior]
    });
    let neighbours = Neighbours::gather(connectivity, &edge_weights);
    for _ in 0..iterations {
        sums = collect(count, threads, |v| {
            let (mut sum, mut total) = ([0.0; 2], 0.0);
            for &(other, weight) in neighbours.of(v) {
                total += weight;
                sum = [0, 1].map(|i| sum[i] + weight * sums[other as usize][i]);
            }
            if total > 0.0 { [0, 1].map(|i| 0.5 * (sums[v][i] + sum[i] / total)) } else { sums[v] }
        });
    }
    collect(count, threads, |v| sums[v][0] / sums[v][1])
}

/// Neighbours of each vertex with the weights of the edges, one vertex after another.
struct Neighbours {
    first: Vec<usize>,
    all: Vec<(u32, f64)>,
}

impl Neighbours {
    fn gather(connectivity: &Connectivity, edge_weights: &[f64]) -> Self {
        let (mut first, mut all) = (vec![0], Vec::with_capacity(2 * edge_weights.len()));
        for v in 0..connectivity.vertex_slots() {
            let edges = connectivity.vertex_edges(VertexId::from_index(v));
            all.extend(edges.map(|(edge, other)| (other.0, edge_weights[edge.index()])));
            first.push(all.len());
        }
        Self { first, all }
    }

    fn of(&self, v: usize) -> &[(u32, f64)] {
        &self.all[self.first[v]..self.first[v + 1]]
    }
}

/// Median weight of the observed vertices; 0 without any.
fn typical_weight(observations: &[Observation]) -> f64 {
    let mut weights: Vec<f64> = observations.iter().map(|one| one.weight).filter(|&w| w > 0.0).collect();
    if weights.is_empty() {
        return 0.0;
    }
    let middle = weights.len() / 2;
    *weights.select_nth_unstable_by(middle, f64::total_cmp).1
}
