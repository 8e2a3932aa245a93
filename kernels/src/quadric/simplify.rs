//! Simplification to a triangle count: removal of independent vertices, then edge collapses in order of error.

use crate::base::errors::KernelError;
use crate::base::progress::Progress;
use crate::collapse::rounds::{Goal, Outcome, collapse};
use crate::collapse::whole_mesh::WholeMesh;
use crate::quadric::qem::QemState;
use crate::quadric::vertex_removal::remove_independent_vertices;

/// Triangles that the removal of vertices leaves, relative to the goal. With 6, the RMS distance of the result
/// grows by about a hundredth; with 4, by three hundredths.
const LEFT_PER_WANTED_TRIANGLE: usize = 6;

/// Triangles that the removal of vertices leaves at least. Edges of a small mesh collapse in no time.
const MIN_LEFT: usize = 1 << 14;

/// Simplify by attribute quadrics until the goal is reached or no edge can collapse.
///
/// # Errors
/// As [`collapse`].
pub fn simplify_by_quadrics<const D: usize, const K: usize>(
    mesh: WholeMesh<D, ()>,
    state: QemState<K>,
    goal: &Goal,
    progress: &mut Progress,
) -> Result<Outcome<D, QemState<K>>, KernelError> {
    let at_start = mesh.triangles.len();
    // In a recorded sequence, all meshes between count, not only the last one.
    if goal.record_positions {
        return collapse(mesh, state, goal, progress);
    }
    let left = goal.triangles.saturating_mul(LEFT_PER_WANTED_TRIANGLE).max(MIN_LEFT);
    let (mesh, state, mut logs) = remove_independent_vertices(mesh, state, left, goal, progress)?;
    let removed = at_start - mesh.triangles.len();
    let wanted = at_start.saturating_sub(goal.triangles);
    let mut outcome = collapse(mesh, state, goal, &mut progress.for_part(removed as u64, wanted as u64))?;
    let passes = logs.len();
    let removals: usize = logs.iter().map(|log| log.merges.len()).sum();
    outcome.logs.iter_mut().for_each(|log| log.round += passes);
    logs.append(&mut outcome.logs);
    outcome.logs = logs;
    outcome.collapses += removals;
    outcome.attempts += removals as u64;
    Ok(outcome)
}
