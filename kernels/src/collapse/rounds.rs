//! Collapse loop over a mesh of any size: in rounds, region by region.
//!
//! ```text
//! until few enough triangles are left, or no edge can collapse:
//!     partition the mesh into regions, with rims elsewhere than before
//!     choose a priority limit so that at most three quarters of the triangles go
//!     each region, on any thread: collapse up to this limit, with the rim locked
//!     join the regions
//! ```
//!
//! All regions of a round collapse up to the same priority, as a single queue for the whole mesh would. The
//! order differs from a single queue only along the rims, by at most one round. Regions, limits and numbering
//! depend only on the mesh, so the result is bit-identical for any number of threads. Regions fit into the
//! cache, which makes this faster than a single queue even on one core.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use crate::base::errors::KernelError;
use crate::base::memory;
use crate::base::parallel::map;
use crate::base::progress::Progress;
use crate::collapse::collapse_log::{RegionLog, order_by_priority};
use crate::collapse::engine::{Engine, Measure, Stop, StopCriteria};
use crate::collapse::method_state::MethodState;
use crate::collapse::partition::Partition;
use crate::collapse::priority_histogram::PriorityHistogram;
use crate::collapse::region::{SHARED, Scratch, SimplifiedRegion, find_owners};
use crate::collapse::whole_mesh::WholeMesh;
use crate::mesh::connectivity::Connectivity;

/// Stop criteria and number of threads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Stop when at most this many triangles are left.
    pub triangles: usize,
    /// At least 1.
    pub threads: usize,
    /// Triangles per region. The result depends on it.
    pub region: usize,
    /// Minimum ratio of collapses to triangles in a round; a round below it is the last one. 0 continues
    /// until no edge can collapse. The last edges are single ones that were on a rim each time, and every
    /// further round costs the same.
    pub min_collapse_ratio: f64,
    /// Record the positions of the survivors.
    pub record_positions: bool,
}

/// Default triangles per region: small enough for the caches. Half of it is no faster and has more rim.
pub const REGION_TRIANGLES: usize = 8192;

/// Maximum ratio of triangles that one round removes. A larger one saves rounds; a smaller one is closer to a
/// single queue.
const MAX_REMOVED_RATIO: f64 = 0.75;

/// With fewer than one collapse per this many triangles, free memory is kept, because the next round needs it
/// at once.
const TRIANGLES_PER_COLLAPSE_TO_KEEP_MEMORY: usize = 16;

/// Up to this many regions, all are sampled, and their engines are kept. They take as much memory as on the
/// same number of threads.
const MAX_KEPT_ENGINES: usize = 8;

type Bound<const D: usize, R> = <<R as MethodState<D>>::Measure as Measure<D>>::Reason;

/// Result of the collapse loop.
pub struct Outcome<const D: usize, R: MethodState<D>> {
    pub mesh: WholeMesh<D, Bound<D, R>>,
    pub records: R,
    pub stop: Stop,
    pub collapses: usize,
    /// In replay order; empty if the records keep no merges and none were requested.
    pub logs: Vec<RegionLog<D>>,
    pub attempts: u64,
}

/// Collapse edges until the goal is reached or no edge can collapse.
///
/// # Errors
/// As [`Connectivity::from_triangles`], and [`KernelError::Interrupted`].
pub fn collapse<const D: usize, R: MethodState<D>>(
    mesh: WholeMesh<D, Bound<D, R>>,
    records: R,
    goal: &Goal,
    progress: &mut Progress,
) -> Result<Outcome<D, R>, KernelError> {
    let mut rounds = RoundLoop::new(mesh, records, goal);
    progress.report(0, rounds.to_remove_count() as u64)?;
    let stop = loop {
        let cut = rounds.cut_into_regions()?;
        progress.report(rounds.removed_count() as u64, rounds.to_remove_count() as u64)?;
        let done = rounds.simplify_regions(&cut, progress)?;
        let enough = progress.is_stopping_early();
        let (is_one, is_unlimited, collapsed) =
            (cut.partition.len() == 1, done.priority == f64::INFINITY, done.collapsed);
        rounds = rounds.join(cut, done);
        if enough {
            break Stop::StoppedByCaller;
        }
        if rounds.mesh.triangles.len() <= goal.triangles {
            break Stop::Target;
        }
        // Every edge is refused.
        if is_unlimited && (is_one || !rounds.has_open_edges()) {
            break Stop::Exhausted;
        }
        if is_unlimited && (collapsed as f64) < goal.min_collapse_ratio * rounds.mesh.triangles.len() as f64 {
            break Stop::Stalled;
        }
        rounds.is_stalled = collapsed == 0;
        rounds.idle_rounds = if collapsed == 0 && is_unlimited { rounds.idle_rounds + 1 } else { 0 };
    };
    let RoundLoop { mesh, records, collapses, logs, attempts, .. } = rounds;
    Ok(Outcome { mesh, records, stop, collapses, logs, attempts: attempts.into_inner() })
}

/// The whole mesh between two rounds, and the history so far.
struct RoundLoop<'a, const D: usize, R: MethodState<D>> {
    mesh: WholeMesh<D, Bound<D, R>>,
    records: R,
    goal: &'a Goal,
    at_start: usize,
    /// Index of the round.
    round: usize,
    /// Number of consecutive rounds without a collapse.
    idle_rounds: u32,
    /// True if the last round had no collapse.
    is_stalled: bool,
    /// Priorities of the edges left in the queues of the last round.
    queued_priorities: Option<PriorityHistogram>,
    collapses: usize,
    logs: Vec<RegionLog<D>>,
    attempts: AtomicU64,
}

/// Partition of a mesh into regions.
struct RegionCut {
    partition: Partition,
    /// Vertices that belong to several regions.
    rim: Vec<bool>,
}

/// Result of all regions of a round.
struct RoundResult<const D: usize, R: MethodState<D>> {
    remains: Vec<SimplifiedRegion<D, Bound<D, R>, R::RegionState>>,
    waiting: PriorityHistogram,
    /// Priority limit of the round.
    priority: f64,
    /// Number of collapses before surplus ones were dropped.
    collapsed: usize,
}

impl<'a, const D: usize, R: MethodState<D>> RoundLoop<'a, D, R> {
    fn new(mesh: WholeMesh<D, Bound<D, R>>, records: R, goal: &'a Goal) -> Self {
        Self {
            at_start: mesh.triangles.len(),
            mesh,
            records,
            goal,
            round: 0,
            idle_rounds: 0,
            is_stalled: false,
            queued_priorities: None,
            collapses: 0,
            logs: vec![],
            attempts: AtomicU64::new(0),
        }
    }

    /// Number of triangles removed so far.
    fn removed_count(&self) -> usize {
        self.at_start - self.mesh.triangles.len()
    }

    /// Number of triangles to remove.
    fn to_remove_count(&self) -> usize {
        self.at_start - self.goal.triangles.min(self.at_start)
    }

    fn has_open_edges(&self) -> bool {
        self.mesh.refused.iter().any(|refused| refused.iter().any(Option::is_none))
    }

    /// Estimate the number of edges without a refusal; boundary edges count half.
    fn estimate_open_edges(&self) -> usize {
        if self.mesh.refused.is_empty() {
            return 3 * self.mesh.triangles.len() / 2;
        }
        self.mesh.refused.as_flattened().iter().filter(|refused| refused.is_none()).count() / 2
    }

    /// Partition the mesh, with rims elsewhere than before.
    fn cut_into_regions(&self) -> Result<RegionCut, KernelError> {
        let (mesh, threads) = (&self.mesh, self.goal.threads);
        // If nothing collapsed except that edges on rims were skipped, larger regions leave fewer of them.
        let regions =
            (self.records.workload(mesh.triangles.len()) / self.goal.region.max(1)) >> self.idle_rounds;
        let partition = Partition::new(&mesh.points, &mesh.triangles, regions.max(1), self.round, threads);
        let mut owner = find_owners(mesh.points.len(), &mesh.triangles, &partition, threads);
        self.records.share_linked_vertices(&mut owner);
        let rim: Vec<bool> = owner.into_iter().map(|owner| owner == SHARED).collect();
        // A mesh with refusals comes from an earlier call, which checked it.
        if self.round == 0 && mesh.refused.is_empty() {
            check_rim_manifold(mesh, &rim, partition.len())?;
        }
        Ok(RegionCut { partition, rim })
    }

    /// Collapse in all regions up to the priority limit of the round.
    ///
    /// If too few triangles are left, the round is repeated with a limit on the collapses of each region.
    fn simplify_regions(
        &self,
        cut: &RegionCut,
        progress: &Progress,
    ) -> Result<RoundResult<D, R>, KernelError> {
        let (mesh, goal, count) = (&self.mesh, self.goal, self.mesh.triangles.len());
        let gone = AtomicU64::new(self.removed_count() as u64);
        let mut run = RoundRun {
            rounds: self,
            cut,
            gone,
            total: self.to_remove_count() as u64,
            sampled_engines: vec![],
        };
        let is_one = cut.partition.len() == 1;
        let priority = match &self.queued_priorities {
            _ if is_one || self.is_stalled => f64::INFINITY,
            Some(waiting) => waiting.estimate_priority_limit(
                wanted_collapses(count, goal.triangles),
                count / 2,
                self.estimate_open_edges(),
            ),
            None if run.has_few_open(wanted_collapses(count, goal.triangles)) => f64::INFINITY,
            None => {
                let sample = run.sample_priorities(progress).map_err(|error| translate_error(mesh, error))?;
                sample.estimate_priority_limit(
                    wanted_collapses(count, goal.triangles),
                    count / 2,
                    self.estimate_open_edges(),
                )
            }
        };
        let until = StopCriteria {
            triangles: if is_one { goal.triangles } else { 0 },
            priority,
            ..StopCriteria::EXHAUSTED
        };
        let (remains, waiting) =
            run.simplify_all(|_| until, progress).map_err(|error| translate_error(mesh, error))?;
        let collapsed: usize = remains.iter().map(|left| left.merges.len()).sum();
        let left: usize = remains.iter().map(SimplifiedRegion::triangles).sum();
        // A collapse removes one or two triangles, so the estimate may overshoot.
        if is_one || left >= goal.triangles {
            return Ok(RoundResult { remains, waiting, priority, collapsed });
        }
        let limits = merges_to_keep(&remains, goal.triangles, count);
        drop(remains);
        let (remains, waiting) =
            run.simplify_all(|p| StopCriteria { collapses: limits[p], ..until }, progress)?;
        Ok(RoundResult { remains, waiting, priority, collapsed })
    }

    /// Join the results of the regions.
    fn join(mut self, cut: RegionCut, mut done: RoundResult<D, R>) -> Self {
        let RegionCut { partition, rim } = cut;
        drop(partition);
        for left in &mut done.remains {
            self.collapses += left.merges.len();
            // The join does not need the merges.
            let (merges, path) = left.take_merges(&self.mesh.vertex_source);
            if R::KEEPS_MERGES || self.goal.record_positions {
                self.logs.push(RegionLog { round: self.round, merges, survivor_points: path });
            }
        }
        let (mesh, records) = self.mesh.join_regions(&rim, self.records, done.remains, self.goal.threads);
        if self.goal.record_positions
            && done.collapsed > mesh.triangles.len() / TRIANGLES_PER_COLLAPSE_TO_KEEP_MEMORY
        {
            // Recorded positions are allocated between freed blocks of the regions, so freed memory is
            // returned explicitly.
            memory::release_free_memory();
        }
        Self { mesh, records, queued_priorities: Some(done.waiting), round: self.round + 1, ..self }
    }
}

/// Number of collapses to request in a round that starts with `count` triangles.
///
/// Near the goal, rounds first stop a little short, then overshoot and are cut back to the goal.
fn wanted_collapses(count: usize, goal: usize) -> usize {
    let needed = count.saturating_sub(goal).div_ceil(2);
    let most = (MAX_REMOVED_RATIO * count as f64 / 2.0) as usize;
    if needed > most {
        most
    } else if needed > count / 64 {
        needed - needed / 8
    } else {
        2 * needed
    }
}

/// A round in progress.
struct RoundRun<'a, const D: usize, R: MethodState<D>> {
    rounds: &'a RoundLoop<'a, D, R>,
    cut: &'a RegionCut,
    /// Triangles removed so far; `to_remove_count` is the number to remove.
    gone: AtomicU64,
    total: u64,
    /// Engines of the sampled regions, if they are few enough to keep.
    sampled_engines: Vec<Mutex<Option<Engine<D, R::Measure>>>>,
}

impl<const D: usize, R: MethodState<D>> RoundRun<'_, D, R> {
    /// Simplify all regions, each up to its stop criteria. Also returns the priorities of waiting edges.
    #[allow(clippy::type_complexity)]
    fn simplify_all(
        &self,
        until: impl Fn(usize) -> StopCriteria + Sync,
        progress: &Progress,
    ) -> Result<(Vec<SimplifiedRegion<D, Bound<D, R>, R::RegionState>>, PriorityHistogram), KernelError> {
        let waiting = PriorityHistogram::default();
        let one = |scratch: &mut Scratch, p: usize| {
            self.simplify_region(scratch, p, until(p), &waiting, &mut progress.clone())
        };
        let remains = self.map_indices(self.cut.partition.len(), one)?;
        Ok((remains, waiting))
    }

    /// Test if fewer edges are open than `wanted_collapses` collapses.
    ///
    /// The estimate assumes that all of them are in sampled regions.
    fn has_few_open(&self, wanted: usize) -> bool {
        let open = 2 * self.rounds.estimate_open_edges();
        !self.rounds.mesh.refused.is_empty() && open.saturating_mul(2 * self.sampling_step()) < wanted
    }

    /// One of this many regions is sampled before the first round.
    fn sampling_step(&self) -> usize {
        (self.cut.partition.len() / 8).max(1)
    }

    /// Sample the priorities of some regions before the first round.
    fn sample_priorities(&mut self, progress: &Progress) -> Result<PriorityHistogram, KernelError> {
        let partition = &self.cut.partition;
        let step = self.sampling_step();
        let is_kept = partition.len() <= MAX_KEPT_ENGINES;
        let waiting = PriorityHistogram::default();
        let one = |scratch: &mut Scratch, i: usize| {
            progress.check()?;
            let engine = self.take_engine(scratch, i * step)?;
            waiting.add(engine.queued_priorities());
            Ok(Mutex::new(is_kept.then_some(engine)))
        };
        self.sampled_engines = self.map_indices(partition.len().div_ceil(step), one)?;
        Ok(waiting)
    }

    /// Call `one` for each index below `count`, in parallel.
    fn map_indices<T: Send>(
        &self,
        count: usize,
        one: impl Fn(&mut Scratch, usize) -> Result<T, KernelError> + Sync,
    ) -> Result<Vec<T>, KernelError> {
        let scratch = || Scratch::new(self.rounds.mesh.points.len());
        map(count, self.rounds.goal.threads, scratch, one).into_iter().collect()
    }

    /// Take the engine of a region from the sample, or create it.
    fn take_engine(&self, scratch: &mut Scratch, p: usize) -> Result<Engine<D, R::Measure>, KernelError> {
        let begun = self.sampled_engines.get(p).and_then(|engine| engine.lock().ok()?.take());
        if let Some(engine) = begun {
            return Ok(engine);
        }
        let (mesh, refusals) =
            self.rounds.mesh.cut_region(self.cut.partition.region(p), &self.cut.rim, scratch)?;
        let measure = self.rounds.records.load_region(&mesh);
        Ok(Engine::resume(mesh, measure, refusals))
    }

    /// Simplify one region.
    fn simplify_region(
        &self,
        scratch: &mut Scratch,
        p: usize,
        until: StopCriteria,
        waiting: &PriorityHistogram,
        progress: &mut Progress,
    ) -> Result<SimplifiedRegion<D, Bound<D, R>, R::RegionState>, KernelError> {
        progress.check()?;
        let RoundLoop { mesh, records, .. } = self.rounds;
        let (region, rim) = (self.cut.partition.region(p), &self.cut.rim);
        if mesh.is_idle(region, rim)
            && let Some(left) = mesh.unchanged_region(region, rim, records, scratch)
        {
            return Ok(left);
        }
        let mut engine = self.take_engine(scratch, p)?;
        if self.rounds.goal.record_positions {
            engine.record_survivor_points();
        }
        engine.run(until, progress)?;
        let collapsed: u64 = engine.merges().iter().map(|m| u64::from(m.triangles)).sum();
        let gone = self.gone.fetch_add(collapsed, Relaxed) + collapsed;
        progress.report(gone.min(self.total), self.total)?;
        waiting.add(engine.queued_priorities());
        self.rounds.attempts.fetch_add(engine.attempts(), Relaxed);
        let (mesh, measure, refusals, merges, path) = engine.into_parts();
        let records = R::unload_region(measure, &mesh);
        Ok(SimplifiedRegion::new(
            &mesh,
            &self.rounds.mesh,
            |edge| refusals[edge.index()],
            &merges,
            path,
            records,
        ))
    }
}

/// Compute the number of merges to keep in each region.
///
/// In priority order, as many are kept as leave `triangles`.
fn merges_to_keep<const D: usize, B: Copy, R>(
    remains: &[SimplifiedRegion<D, B, R>],
    triangles: usize,
    mut count: usize,
) -> Vec<usize> {
    let mut limits = vec![0; remains.len()];
    for (p, i) in order_by_priority(remains.iter().map(|left| &left.merges[..])) {
        if count <= triangles {
            break;
        }
        limits[p] += 1;
        count -= usize::from(remains[p].merges[i].triangles);
    }
    limits
}

/// Check that the mesh is manifold around vertices of the rim.
///
/// No region has all triangles around them.
fn check_rim_manifold<const D: usize, B: Copy>(
    mesh: &WholeMesh<D, B>,
    rim: &[bool],
    regions: usize,
) -> Result<(), KernelError> {
    if regions == 1 {
        return Ok(());
    }
    let touches = |t: &u32| mesh.triangles[*t as usize].iter().any(|&v| rim[v as usize]);
    let touching: Vec<u32> = (0..mesh.triangles.len() as u32).filter(touches).collect();
    // Mark the inverse of the rim, because here the other vertices have triangles elsewhere.
    let others: Vec<bool> = rim.iter().map(|is_rim| !is_rim).collect();
    let mut scratch = Scratch::new(mesh.points.len());
    mesh.cut_region(&touching, &others, &mut scratch).map_err(|error| translate_error(mesh, error))?;
    Ok(())
}

/// Translate an error of a region to vertex indices of the whole mesh.
fn translate_error<const D: usize, B>(mesh: &WholeMesh<D, B>, error: KernelError) -> KernelError {
    if error.is_aborted() {
        return error;
    }
    Connectivity::from_triangles(mesh.points.len(), &mesh.triangles).err().unwrap_or(error)
}
