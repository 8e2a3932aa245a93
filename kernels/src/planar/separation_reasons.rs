//! Reasons why two adjacent patches stay separate.

use super::border::Borders;
use super::growth_context::THICKNESS_RATIO;
use super::patches::{Options, Patches};
use crate::base::geometry::{cross, dot, normalize, position_of, sub};
use crate::base::ids::{HalfedgeId, TriangleId};
use crate::base::parallel;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::Mesh;

/// The paper's two criteria, the distance bound, and all others: colours, a locked vertex, or the order of
/// growth.
pub const REASONS: [&str; 4] = ["fidelity", "detail", "shape", "other"];

/// Halfedges per parallel batch.
const BATCH: usize = 1 << 13;

/// Count the edges between two patches by the first reason that applies in both directions.
pub fn count_reasons<const D: usize>(
    mesh: &Mesh<D>,
    patches: &Patches,
    borders: &Borders,
    options: &Options,
) -> [u64; 4] {
    let connectivity = &mesh.connectivity;
    // Few triangles are at a border, so recomputing their normals is cheap.
    let normal = |t: u32| {
        let [a, b, c] = mesh.triangle_points(TriangleId(t)).map(|p| position_of(&p));
        normalize(&cross(&sub(&b, &a), &sub(&c, &a)))
    };
    let patch = |t: u32| &patches.patches[patches.patch_of_triangle[t as usize] as usize];
    let suits = |t: u32, beside: u32| dot(&normal(t), &patch(beside).normal) > options.fidelity;
    let holds = |t: u32, beside: u32| {
        let patch = patch(beside);
        let heights = mesh
            .triangle_points(TriangleId(t))
            .map(|p| dot(&patch.normal, &sub(&position_of(&p), &patch.origin)));
        let low = heights.into_iter().fold(patch.heights[0], f64::min);
        let high = heights.into_iter().fold(patch.heights[1], f64::max);
        high - low <= THICKNESS_RATIO * options.max_distance
    };
    let reason = |s: u32, t: u32| {
        if !suits(s, t) && !suits(t, s) {
            0
        } else if dot(&normal(s), &normal(t)) <= options.detail {
            1
        } else if !holds(s, t) && !holds(t, s) {
            2
        } else {
            3
        }
    };
    let batches: Vec<&[HalfedgeId]> = borders.all_halfedges().chunks(BATCH).collect();
    let counted = parallel::map(
        batches.len(),
        options.threads,
        || (),
        |(), batch| {
            let mut refused = [0; 4];
            for &h in batches[batch] {
                let twin = connectivity.twin(h);
                if twin.is_some() && h < twin {
                    let [s, t] = [h, twin].map(|h| Connectivity::triangle(h).0);
                    refused[reason(s, t)] += 1;
                }
            }
            refused
        },
    );
    counted.into_iter().fold([0; 4], |sum: [u64; 4], part| std::array::from_fn(|i| sum[i] + part[i]))
}
