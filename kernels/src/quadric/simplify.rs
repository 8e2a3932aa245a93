//! Simplification to a triangle count: collapse of independent edges in passes, then edge by edge.

use crate::base::errors::KernelError;
use crate::base::progress::Progress;
use crate::collapse::rounds::{Goal, Outcome, collapse};
use crate::collapse::whole_mesh::WholeMesh;
use crate::quadric::independent_collapses::collapse_independent_edges;
use crate::quadric::qem::QemState;

/// The passes leave one triangle in this many to the collapse engine, which stops at the exact number.
const LEFT_TO_ENGINE: usize = 50;

/// Triangles that the passes leave at least. Edges of a small mesh collapse in no time.
pub(super) const MIN_LEFT: usize = 1 << 12;

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
    // In a recorded sequence, all meshes between count, not only the last one.
    if goal.record_positions {
        return collapse(mesh, state, goal, progress);
    }
    simplify_in_passes(mesh, state, MIN_LEFT, goal, progress)
}

/// As [`simplify_by_quadrics`]; the passes leave at least `min_left` triangles.
///
/// # Errors
/// As [`collapse`].
pub fn simplify_in_passes<const D: usize, const K: usize>(
    mesh: WholeMesh<D, ()>,
    state: QemState<K>,
    min_left: usize,
    goal: &Goal,
    progress: &mut Progress,
) -> Result<Outcome<D, QemState<K>>, KernelError> {
    let at_start = mesh.triangles.len();
    let left = goal.triangles.saturating_add(goal.triangles / LEFT_TO_ENGINE).max(min_left);
    let (mesh, state, mut logs) = collapse_independent_edges(mesh, state, left, goal, progress)?;
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
