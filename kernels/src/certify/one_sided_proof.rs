//! One direction of a proof: triangles of one surface against the other, in parallel and in rounds.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use super::decision::{Scratch, decide};
use super::piece_bounds::{AttributionMode, BoundContext, Deviation, SlotDeviation};
use super::polygon::Corner;
use super::refinement::{Goal, Outcome, refine};
use super::surface::Surface;
use crate::base::errors::KernelError;
use crate::base::parallel;
use crate::base::progress::Progress;

/// Triangles or vertices per parallel task.
const TRIANGLES_PER_TASK: usize = 256;
/// Triangles whose results are buffered before they are stored.
const TRIANGLES_PER_WAVE: usize = 1 << 16;
/// Neighbouring vertices that share the start of their searches.
const VERTICES_PER_SEARCH_START: usize = 32;

/// Result for one triangle, without attributed deviations.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Verdict {
    pub bound: Deviation,
    /// Largest deviation at any measured point.
    pub attained: Deviation,
    /// Upper bound in metres on the distance of target triangles that affect the result, including the slack.
    pub reach: f64,
}

impl Verdict {
    /// Neither measured nor proven.
    pub const UNKNOWN: Self = Self {
        bound: Deviation { shape: f64::INFINITY, color: f64::INFINITY },
        attained: Deviation { shape: 0.0, color: 0.0 },
        reach: f64::INFINITY,
    };
}

impl Outcome {
    fn verdict(&self) -> Verdict {
        Verdict { bound: self.bound, attained: self.attained, reach: self.reach }
    }
}

/// Triangles of `mesh` against the target surface.
pub struct OneSidedProof<'a> {
    pub mesh: &'a Surface,
    pub against: BoundContext<'a>,
    /// Sorted slots of the triangles to bound, and the result of each.
    slots: Vec<u32>,
    pub verdicts: Vec<Verdict>,
    /// Largest measured deviation of all triangles.
    pub attained: Deviation,
    /// Triangles whose bound is not tight enough yet, by index in `slots`.
    pub pending: Vec<(u32, Outcome)>,
    /// By vertex, from `first_vertex` on: the nearest slot of the target, and the deviation.
    vertices: Vec<(u32, Deviation)>,
    first_vertex: u32,
    on_target: AttributedDeviations,
}

/// State shared by all rounds: threads, progress, and number of pieces.
pub struct ProofRun<'a> {
    threads: usize,
    progress: Progress<'a>,
    done_count: AtomicU64,
    total: u64,
    pub pieces: u64,
}

impl<'a> OneSidedProof<'a> {
    /// Create the state of one direction; `slots` must be sorted and unique.
    pub fn new(mesh: &'a Surface, slots: Vec<u32>, against: BoundContext<'a>) -> Self {
        let on_target = AttributedDeviations::new(if against.attribution == AttributionMode::None {
            0
        } else {
            against.target.len()
        });
        Self {
            mesh,
            against,
            verdicts: vec![Verdict::default(); slots.len()],
            slots,
            attained: Deviation::default(),
            pending: vec![],
            vertices: vec![],
            first_vertex: 0,
            on_target,
        }
    }

    /// Measure the deviation at all corners, because simplified surfaces deviate most at vertices.
    ///
    /// The result for a vertex does not depend on the other triangles asked for.
    pub fn measure_vertices(&mut self, run: &ProofRun<'_>) -> Result<(), KernelError> {
        if self.slots.is_empty() {
            return Ok(());
        }
        // Neighbouring slots have neighbouring vertices.
        let vertices = || self.slots.iter().flat_map(|&s| self.mesh.vertices[s as usize]);
        let first = vertices().min().unwrap_or(0);
        let mut used = vec![false; vertices().max().map_or(0, |last| (last - first) as usize + 1)];
        vertices().for_each(|v| used[(v - first) as usize] = true);
        let asked: Vec<u32> = (first..).zip(&used).filter(|(_, used)| **used).map(|(v, _)| v).collect();
        let (mesh, against) = (self.mesh, &self.against);
        let look = |vertices: &[u32]| {
            // Block index, and the slot at which its searches start.
            let mut start = (usize::MAX, 0);
            let found = vertices.iter().map(|&v| {
                let block = v as usize / VERTICES_PER_SEARCH_START;
                if start.0 != block {
                    start = (
                        block,
                        against.target.nearest(&mesh.points[block * VERTICES_PER_SEARCH_START], 0).slot,
                    );
                }
                let corner = corner(mesh, v);
                let found = against.target.nearest(&corner.at, start.1);
                (found.slot, against.measure_deviation(&corner, found.slot, found.distance))
            });
            found.collect::<Vec<_>>()
        };
        let mut vertices = vec![(0, Deviation::default()); used.len()];
        for wave in asked.chunks(TRIANGLES_PER_WAVE) {
            let found =
                run.map_chunks(wave.len(), TRIANGLES_PER_TASK, || (), |range, (), _| Ok(look(&wave[range])))?;
            for (&v, found) in wave.iter().zip(found.into_iter().flatten()) {
                vertices[(v - first) as usize] = found;
                self.attained = self.attained.max(found.1);
            }
        }
        (self.first_vertex, self.vertices) = (first, vertices);
        Ok(())
    }

    /// Bound all triangles; those not within `keep` stay pending.
    pub fn bound_all(
        &mut self,
        goal: &Goal,
        keep: Deviation,
        run: &mut ProofRun<'_>,
    ) -> Result<(), KernelError> {
        let all: Vec<u32> = (0..self.slots.len() as u32).collect();
        self.bound_some(&all, goal, keep, TRIANGLES_PER_TASK, run)
    }

    /// Bound the triangles at the given indices in `slots`.
    fn bound_some(
        &mut self,
        places: &[u32],
        goal: &Goal,
        keep: Deviation,
        chunk: usize,
        run: &mut ProofRun<'_>,
    ) -> Result<(), KernelError> {
        places.chunks(TRIANGLES_PER_WAVE).try_for_each(|wave| self.bound_wave(wave, goal, keep, chunk, run))
    }

    fn bound_wave(
        &mut self,
        places: &[u32],
        goal: &Goal,
        keep: Deviation,
        chunk: usize,
        run: &mut ProofRun<'_>,
    ) -> Result<(), KernelError> {
        let this = &*self;
        let work = |range: Range<usize>, scratch: &mut Scratch, progress: &mut Progress<'_>| {
            let mut found = Vec::with_capacity(range.len());
            let (mut pending, mut pieces) = (vec![], 0);
            for &place in &places[range] {
                let outcome = this.bound_triangle(this.slots[place as usize], goal, scratch, progress)?;
                pieces += outcome.pieces as u64;
                found.push(outcome.verdict());
                if outcome.bound.is_within(keep) {
                    this.on_target.receive(&outcome.slot_deviations);
                } else {
                    pending.push((place, outcome));
                }
            }
            Ok((found, pending, pieces))
        };
        let chunks = run.map_chunks(places.len(), chunk, Scratch::default, work)?;
        let mut at = places.iter();
        for (found, pending, pieces) in chunks {
            for (found, &place) in found.into_iter().zip(&mut at) {
                self.attained = self.attained.max(found.attained);
                self.verdicts[place as usize] = found;
            }
            self.pending.extend(pending);
            run.pieces += pieces;
        }
        Ok(())
    }

    fn bound_triangle(
        &self,
        slot: u32,
        goal: &Goal,
        scratch: &mut Scratch,
        progress: &mut Progress<'_>,
    ) -> Result<Outcome, KernelError> {
        let vertices = self.mesh.vertices[slot as usize];
        let at_corners = vertices.map(|v| self.vertices[(v - self.first_vertex) as usize]);
        let so_far = at_corners.iter().fold(Deviation::default(), |most, c| most.max(c.1));
        let corners =
            [0, 1, 2].map(|i| Corner { reach: at_corners[i].1.shape, ..corner(self.mesh, vertices[i]) });
        let near = at_corners.map(|(slot, _)| slot);
        if goal.decide {
            return decide(&self.against, corners, near, so_far, goal, scratch, progress);
        }
        let mut hint = near[0];
        refine(&self.against, corners, &mut hint, so_far, goal, &mut scratch.workspace, progress)
    }

    /// Bound the pending triangles with more pieces; earlier results stay valid.
    pub fn tighten(&mut self, goal: &Goal, run: &mut ProofRun<'_>) -> Result<(), KernelError> {
        let mut before = std::mem::take(&mut self.pending);
        let places: Vec<u32> = before.iter().map(|(place, _)| *place).collect();
        // No bound is within this, so all triangles stay pending; `remove_finished` sorts them out when the largest
        // deviation is known.
        let nothing = Deviation { shape: -1.0, color: -1.0 };
        self.bound_some(&places, goal, nothing, 1, run)?;
        for ((place, now), (_, before)) in self.pending.iter_mut().zip(&mut before) {
            now.bound = now.bound.min(before.bound);
            now.attained = now.attained.max(before.attained);
            now.reach = now.reach.min(before.reach);
            now.slot_deviations = combine_proofs(&now.slot_deviations, &before.slot_deviations);
            self.verdicts[*place as usize] = now.verdict();
        }
        Ok(())
    }

    /// Remove the pending triangles for which `done_count` is true.
    pub fn remove_finished(&mut self, done: impl Fn(&Outcome) -> bool) {
        let on_target = &self.on_target;
        self.pending.retain(|(_, outcome)| {
            let done = done(outcome);
            if done {
                on_target.receive(&outcome.slot_deviations);
            }
            !done
        });
    }

    /// Return the result for the triangle in `slot`; `None` if it was not asked for.
    pub fn verdict_of_slot(&self, slot: u32) -> Option<Verdict> {
        let all = self.slots.len() == self.mesh.len();
        let place = if all { Some(slot as usize) } else { self.slots.binary_search(&slot).ok() };
        place.map(|place| self.verdicts[place])
    }

    /// Return the largest deviation attributed to a slot of the target.
    pub fn on_target(&self, slot: usize) -> Deviation {
        self.on_target.at(slot)
    }
}

fn corner(mesh: &Surface, v: u32) -> Corner {
    Corner { at: mesh.points[v as usize], color: mesh.vertex_color(v), reach: f64::INFINITY }
}

/// By slot of the target: largest attributed shape and colour, independent of the thread order.
struct AttributedDeviations(Vec<[AtomicU64; 2]>);

impl AttributedDeviations {
    fn new(slots: usize) -> Self {
        Self((0..slots).map(|_| [0, 0].map(AtomicU64::new)).collect())
    }

    fn receive(&self, shares: &[SlotDeviation]) {
        for share in shares {
            let there = &self.0[share.slot as usize];
            // Non-negative floats have the same order as their bits.
            for (most, value) in there.iter().zip([share.deviation.shape, share.deviation.color]) {
                most.fetch_max(value.max(0.0).to_bits(), Relaxed);
            }
        }
    }

    fn at(&self, slot: usize) -> Deviation {
        let [shape, color] = self.0[slot].each_ref().map(|bits| f64::from_bits(bits.load(Relaxed)));
        Deviation { shape, color }
    }
}

/// Combine two proofs: the lower bound wins, and a slot that one of them excludes is dropped.
fn combine_proofs(a: &[SlotDeviation], b: &[SlotDeviation]) -> Vec<SlotDeviation> {
    let other =
        |share: &SlotDeviation| b.binary_search_by_key(&share.slot, |s| s.slot).ok().map(|i| b[i].deviation);
    a.iter()
        .filter_map(|share| {
            Some(SlotDeviation { slot: share.slot, deviation: share.deviation.min(other(share)?) })
        })
        .collect()
}

impl<'a> ProofRun<'a> {
    /// Create the state of a run for `triangles` in total.
    ///
    /// The progress also counts as many vertices.
    pub fn new(threads: usize, triangles: usize, progress: &Progress<'a>) -> Self {
        let (threads, progress) = (parallel::resolve_thread_count(threads), progress.clone());
        Self { threads, progress, done_count: AtomicU64::new(0), total: 2 * triangles as u64, pieces: 0 }
    }

    /// Run `work` on ranges of up to `size` items in parallel; returns the results in order.
    fn map_chunks<S, R: Send>(
        &self,
        items: usize,
        size: usize,
        scratch: impl Fn() -> S + Sync,
        work: impl Fn(Range<usize>, &mut S, &mut Progress<'_>) -> Result<R, KernelError> + Sync,
    ) -> Result<Vec<R>, KernelError> {
        let one = |(scratch, progress): &mut (S, Progress<'_>), chunk: usize| {
            let range = chunk * size..items.min((chunk + 1) * size);
            let done = self.done_count.fetch_add(range.len() as u64, Relaxed);
            progress.report(done.min(self.total), self.total)?;
            work(range, scratch, progress)
        };
        let scratch = || (scratch(), self.progress.clone());
        parallel::map(items.div_ceil(size), self.threads, scratch, one).into_iter().collect()
    }
}
