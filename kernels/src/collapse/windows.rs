//! The collapse loop over a large mesh in one engine: round after round, window after window of its edges.

use super::engine::{Engine, Measure, Reach, Stop, Until};
use crate::base::errors::KernelError;
use crate::base::progress::Progress;

/// Share of the triangles that one round over all windows may remove at most.
const SHARE: f64 = 0.75;

/// One in so many priorities is looked at to find up to which the edges of a round go.
const SAMPLED: usize = 7;

/// When less than one in so many triangles has to go, one queue does it.
const LAST: usize = 24;

impl<const D: usize, M: Measure<D>> Engine<D, M> {
    /// Collapse until at most so many triangles are left, a window of so many edges at a time: nearly in the order
    /// of one queue, and much faster on a mesh that is large and whose neighbours are near in memory.
    ///
    /// Every edge of a round goes up to the same priority. The last few go in the order of one queue, so that the
    /// number of triangles is as exact as with [`Engine::run`].
    ///
    /// # Errors
    /// [`KernelError::Interrupted`] when `progress` says so.
    pub fn run_by_windows(
        &mut self,
        triangles: usize,
        window: usize,
        progress: &mut Progress,
    ) -> Result<Stop, KernelError> {
        const { assert!(matches!(M::REACH, Reach::Spokes | Reach::Star), "no edge is stale") };
        let at_start = self.mesh.connectivity.triangle_count();
        let total = at_start.saturating_sub(triangles) as u64;
        let slots = self.mesh.connectivity.edge_slots();
        let mut sample = vec![];
        loop {
            let left = self.mesh.connectivity.triangle_count();
            let needed = left.saturating_sub(triangles) / 2;
            self.queue.close();
            if slots < 4 * window || needed <= left / LAST {
                break;
            }
            // Of three edges one collapses and two merge with others when all go.
            let wanted = (needed - needed / 8).min((SHARE * left as f64 / 2.0) as usize);
            let share = 2.0 * wanted as f64 / left as f64;
            sample.clear();
            sample.extend(
                self.queue.remembered().iter().copied().step_by(SAMPLED).filter(|key| key.is_finite()),
            );
            let rank = (wanted as f64 * (1.0 + 2.0 * share)) as usize / SAMPLED;
            if rank + 1 >= sample.len() {
                break;
            }
            let (_, &mut ceiling, _) = sample.select_nth_unstable_by(rank, f64::total_cmp);
            let before = self.merges.len();
            for start in (0..slots).step_by(window) {
                self.queue.open(start..(start + window).min(slots), ceiling);
                let stop = self.run(Until { triangles, priority: ceiling, ..Until::EXHAUSTED }, progress)?;
                let left = self.mesh.connectivity.triangle_count();
                progress.tell((at_start - left) as u64, total)?;
                if stop == Stop::Enough || left <= triangles {
                    return Ok(stop);
                }
            }
            if self.merges.len() - before < needed / LAST {
                break;
            }
        }
        self.queue.open(0..slots, f64::INFINITY);
        self.run(Until { triangles, ..Until::EXHAUSTED }, progress)
    }
}
