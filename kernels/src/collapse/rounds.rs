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
use crate::collapse::engine::{Engine, Measure, Stop, Until};
use crate::collapse::histogram::Histogram;
use crate::collapse::logs::{Log, by_priority};
use crate::collapse::partition::Partition;
use crate::collapse::records::Records;
use crate::collapse::region::{Remains, SHARED, Scratch, find_owners};
use crate::collapse::whole::Whole;
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
    pub least: f64,
    /// Record the positions of the survivors.
    pub record: bool,
}

/// Default triangles per region: small enough for the caches. Half of it is no faster and has more rim.
pub const REGION_TRIANGLES: usize = 8192;

/// Maximum ratio of triangles that one round removes. A larger one saves rounds; a smaller one is closer to a
/// single queue.
const SHARE: f64 = 0.75;

/// With fewer than one collapse per this many triangles, free memory is kept, because the next round needs it
/// at once.
const FEW: usize = 16;

/// Up to this many regions, all are sampled, and their engines are kept. They take as much memory as on the
/// same number of threads.
const MAX_BEGUN: usize = 8;

type Bound<const D: usize, R> = <<R as Records<D>>::Measure as Measure<D>>::Bound;

/// Result of the collapse loop.
pub struct Outcome<const D: usize, R: Records<D>> {
    pub mesh: Whole<D, Bound<D, R>>,
    pub records: R,
    pub stop: Stop,
    pub collapses: usize,
    /// In replay order; empty if the records keep no merges and none were requested.
    pub logs: Vec<Log<D>>,
    pub attempts: u64,
}

/// Collapse edges until the goal is reached or no edge can collapse.
///
/// # Errors
/// As [`Connectivity::from_triangles`], and [`KernelError::Interrupted`].
pub fn collapse<const D: usize, R: Records<D>>(
    mesh: Whole<D, Bound<D, R>>,
    records: R,
    goal: &Goal,
    progress: &mut Progress,
) -> Result<Outcome<D, R>, KernelError> {
    let mut rounds = Rounds::new(mesh, records, goal);
    progress.tell(0, rounds.total() as u64)?;
    let stop = loop {
        let cut = rounds.cut()?;
        progress.tell(rounds.gone() as u64, rounds.total() as u64)?;
        let done = rounds.work(&cut, progress)?;
        let enough = progress.is_enough();
        let (is_one, is_unlimited, collapsed) =
            (cut.partition.len() == 1, done.priority == f64::INFINITY, done.collapsed);
        rounds = rounds.join(cut, done);
        if enough {
            break Stop::Enough;
        }
        if rounds.mesh.triangles.len() <= goal.triangles {
            break Stop::Target;
        }
        // Every edge is refused.
        if is_unlimited && (is_one || !rounds.has_open_edges()) {
            break Stop::Exhausted;
        }
        if is_unlimited && (collapsed as f64) < goal.least * rounds.mesh.triangles.len() as f64 {
            break Stop::Few;
        }
        rounds.is_stalled = collapsed == 0;
        rounds.idle = if collapsed == 0 && is_unlimited { rounds.idle + 1 } else { 0 };
    };
    let Rounds { mesh, records, collapses, logs, attempts, .. } = rounds;
    Ok(Outcome { mesh, records, stop, collapses, logs, attempts: attempts.into_inner() })
}

/// The whole mesh between two rounds, and the history so far.
struct Rounds<'a, const D: usize, R: Records<D>> {
    mesh: Whole<D, Bound<D, R>>,
    records: R,
    goal: &'a Goal,
    at_start: usize,
    /// Index of the round.
    round: usize,
    /// Number of consecutive rounds without a collapse.
    idle: u32,
    /// True if the last round had no collapse.
    is_stalled: bool,
    /// Priorities of the edges left in the queues of the last round.
    waiting: Option<Histogram>,
    collapses: usize,
    logs: Vec<Log<D>>,
    attempts: AtomicU64,
}

/// Partition of a mesh into regions.
struct Cut {
    partition: Partition,
    /// Vertices that belong to several regions.
    rim: Vec<bool>,
}

/// Result of all regions of a round.
struct Done<const D: usize, R: Records<D>> {
    remains: Vec<Remains<D, Bound<D, R>, R::Remains>>,
    waiting: Histogram,
    /// Priority limit of the round.
    priority: f64,
    /// Number of collapses before surplus ones were dropped.
    collapsed: usize,
}

impl<'a, const D: usize, R: Records<D>> Rounds<'a, D, R> {
    fn new(mesh: Whole<D, Bound<D, R>>, records: R, goal: &'a Goal) -> Self {
        Self {
            at_start: mesh.triangles.len(),
            mesh,
            records,
            goal,
            round: 0,
            idle: 0,
            is_stalled: false,
            waiting: None,
            collapses: 0,
            logs: vec![],
            attempts: AtomicU64::new(0),
        }
    }

    /// Number of triangles removed so far.
    fn gone(&self) -> usize {
        self.at_start - self.mesh.triangles.len()
    }

    /// Number of triangles to remove.
    fn total(&self) -> usize {
        self.at_start - self.goal.triangles.min(self.at_start)
    }

    fn has_open_edges(&self) -> bool {
        self.mesh.refused.iter().any(|refused| refused.iter().any(Option::is_none))
    }

    /// Estimate the number of edges without a refusal; boundary edges count half.
    fn open_edges(&self) -> usize {
        if self.mesh.refused.is_empty() {
            return 3 * self.mesh.triangles.len() / 2;
        }
        self.mesh.refused.as_flattened().iter().filter(|refused| refused.is_none()).count() / 2
    }

    /// Partition the mesh, with rims elsewhere than before.
    fn cut(&self) -> Result<Cut, KernelError> {
        let (mesh, threads) = (&self.mesh, self.goal.threads);
        // If nothing collapsed except that edges on rims were skipped, larger regions leave fewer of them.
        let regions = (self.records.size(mesh.triangles.len()) / self.goal.region.max(1)) >> self.idle;
        let partition = Partition::new(&mesh.points, &mesh.triangles, regions.max(1), self.round, threads);
        let mut owner = find_owners(mesh.points.len(), &mesh.triangles, &partition, threads);
        self.records.keep_together(&mut owner);
        let rim: Vec<bool> = owner.into_iter().map(|owner| owner == SHARED).collect();
        // A mesh with refusals comes from an earlier call, which checked it.
        if self.round == 0 && mesh.refused.is_empty() {
            check_seam(mesh, &rim, partition.len())?;
        }
        Ok(Cut { partition, rim })
    }

    /// Collapse in all regions up to the priority limit of the round.
    ///
    /// If too few triangles are left, the round is repeated with a limit on the collapses of each region.
    fn work(&self, cut: &Cut, progress: &Progress) -> Result<Done<D, R>, KernelError> {
        let (mesh, goal, count) = (&self.mesh, self.goal, self.mesh.triangles.len());
        let gone = AtomicU64::new(self.gone() as u64);
        let mut run = Run { rounds: self, cut, gone, total: self.total() as u64, begun: vec![] };
        let is_one = cut.partition.len() == 1;
        let priority = match &self.waiting {
            _ if is_one || self.is_stalled => f64::INFINITY,
            Some(waiting) => {
                waiting.priority_for(wanted(count, goal.triangles), count / 2, self.open_edges())
            }
            None if run.has_few_open(wanted(count, goal.triangles)) => f64::INFINITY,
            None => {
                let sample = run.sample(progress).map_err(|error| explained(mesh, error))?;
                sample.priority_for(wanted(count, goal.triangles), count / 2, self.open_edges())
            }
        };
        let until =
            Until { triangles: if is_one { goal.triangles } else { 0 }, priority, ..Until::EXHAUSTED };
        let (remains, waiting) = run.all(|_| until, progress).map_err(|error| explained(mesh, error))?;
        let collapsed: usize = remains.iter().map(|left| left.merges.len()).sum();
        let left: usize = remains.iter().map(Remains::triangles).sum();
        // A collapse removes one or two triangles, so the estimate may overshoot.
        if is_one || left >= goal.triangles {
            return Ok(Done { remains, waiting, priority, collapsed });
        }
        let limits = first_merges(&remains, goal.triangles, count);
        drop(remains);
        let (remains, waiting) = run.all(|p| Until { collapses: limits[p], ..until }, progress)?;
        Ok(Done { remains, waiting, priority, collapsed })
    }

    /// Join the results of the regions.
    fn join(mut self, cut: Cut, mut done: Done<D, R>) -> Self {
        let Cut { partition, rim } = cut;
        drop(partition);
        for left in &mut done.remains {
            self.collapses += left.merges.len();
            // The join does not need the merges.
            let (merges, path) = left.take_merges(&self.mesh.vertex_source);
            if R::KEEPS_MERGES || self.goal.record {
                self.logs.push(Log { round: self.round, merges, path });
            }
        }
        let (mesh, records) = self.mesh.join(&rim, self.records, done.remains, self.goal.threads);
        if self.goal.record && done.collapsed > mesh.triangles.len() / FEW {
            // Recorded positions are allocated between freed blocks of the regions, so freed memory is
            // returned explicitly.
            memory::give_back();
        }
        Self { mesh, records, waiting: Some(done.waiting), round: self.round + 1, ..self }
    }
}

/// Number of collapses to request in a round that starts with `count` triangles.
///
/// Near the goal, rounds first stop a little short, then overshoot and are cut back to the goal.
fn wanted(count: usize, goal: usize) -> usize {
    let needed = count.saturating_sub(goal).div_ceil(2);
    let most = (SHARE * count as f64 / 2.0) as usize;
    if needed > most {
        most
    } else if needed > count / 64 {
        needed - needed / 8
    } else {
        2 * needed
    }
}

/// A round in progress.
struct Run<'a, const D: usize, R: Records<D>> {
    rounds: &'a Rounds<'a, D, R>,
    cut: &'a Cut,
    /// Triangles removed so far; `total` is the number to remove.
    gone: AtomicU64,
    total: u64,
    /// Engines of the sampled regions, if they are few enough to keep.
    begun: Vec<Mutex<Option<Engine<D, R::Measure>>>>,
}

impl<const D: usize, R: Records<D>> Run<'_, D, R> {
    /// Simplify all regions, each up to its stop criteria. Also returns the priorities of waiting edges.
    #[allow(clippy::type_complexity)]
    fn all(
        &self,
        until: impl Fn(usize) -> Until + Sync,
        progress: &Progress,
    ) -> Result<(Vec<Remains<D, Bound<D, R>, R::Remains>>, Histogram), KernelError> {
        let waiting = Histogram::default();
        let one = |scratch: &mut Scratch, p: usize| {
            self.region(scratch, p, until(p), &waiting, &mut progress.clone())
        };
        let remains = self.each(self.cut.partition.len(), one)?;
        Ok((remains, waiting))
    }

    /// Test if fewer edges are open than `wanted` collapses.
    ///
    /// The estimate assumes that all of them are in sampled regions.
    fn has_few_open(&self, wanted: usize) -> bool {
        let open = 2 * self.rounds.open_edges();
        !self.rounds.mesh.refused.is_empty() && open.saturating_mul(2 * self.step()) < wanted
    }

    /// One of this many regions is sampled before the first round.
    fn step(&self) -> usize {
        (self.cut.partition.len() / 8).max(1)
    }

    /// Sample the priorities of some regions before the first round.
    fn sample(&mut self, progress: &Progress) -> Result<Histogram, KernelError> {
        let partition = &self.cut.partition;
        let step = self.step();
        let is_kept = partition.len() <= MAX_BEGUN;
        let waiting = Histogram::default();
        let one = |scratch: &mut Scratch, i: usize| {
            progress.check()?;
            let engine = self.engine(scratch, i * step)?;
            waiting.add(engine.waiting());
            Ok(Mutex::new(is_kept.then_some(engine)))
        };
        self.begun = self.each(partition.len().div_ceil(step), one)?;
        Ok(waiting)
    }

    /// Call `one` for each index below `count`, in parallel.
    fn each<T: Send>(
        &self,
        count: usize,
        one: impl Fn(&mut Scratch, usize) -> Result<T, KernelError> + Sync,
    ) -> Result<Vec<T>, KernelError> {
        let scratch = || Scratch::new(self.rounds.mesh.points.len());
        map(count, self.rounds.goal.threads, scratch, one).into_iter().collect()
    }

    /// Take the engine of a region from the sample, or create it.
    fn engine(&self, scratch: &mut Scratch, p: usize) -> Result<Engine<D, R::Measure>, KernelError> {
        let begun = self.begun.get(p).and_then(|engine| engine.lock().ok()?.take());
        if let Some(engine) = begun {
            return Ok(engine);
        }
        let (mesh, refusals) = self.rounds.mesh.cut(self.cut.partition.region(p), &self.cut.rim, scratch)?;
        let measure = self.rounds.records.load(&mesh);
        Ok(Engine::resume(mesh, measure, refusals))
    }

    /// Simplify one region.
    fn region(
        &self,
        scratch: &mut Scratch,
        p: usize,
        until: Until,
        waiting: &Histogram,
        progress: &mut Progress,
    ) -> Result<Remains<D, Bound<D, R>, R::Remains>, KernelError> {
        progress.check()?;
        let Rounds { mesh, records, .. } = self.rounds;
        let (region, rim) = (self.cut.partition.region(p), &self.cut.rim);
        if mesh.is_idle(region, rim)
            && let Some(left) = mesh.untouched(region, rim, records, scratch)
        {
            return Ok(left);
        }
        let mut engine = self.engine(scratch, p)?;
        if self.rounds.goal.record {
            engine.record_path();
        }
        engine.run(until, progress)?;
        let collapsed: u64 = engine.merges().iter().map(|m| u64::from(m.triangles)).sum();
        let gone = self.gone.fetch_add(collapsed, Relaxed) + collapsed;
        progress.tell(gone.min(self.total), self.total)?;
        waiting.add(engine.waiting());
        self.rounds.attempts.fetch_add(engine.attempts(), Relaxed);
        let (mesh, measure, refusals, merges, path) = engine.into_parts();
        let records = R::unload(measure, &mesh);
        Ok(Remains::new(&mesh, &self.rounds.mesh, |edge| refusals[edge.index()], &merges, path, records))
    }
}

/// Compute the number of merges to keep in each region.
///
/// In priority order, as many are kept as leave `triangles`.
fn first_merges<const D: usize, B: Copy, R>(
    remains: &[Remains<D, B, R>],
    triangles: usize,
    mut count: usize,
) -> Vec<usize> {
    let mut limits = vec![0; remains.len()];
    for (p, i) in by_priority(remains.iter().map(|left| &left.merges[..])) {
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
fn check_seam<const D: usize, B: Copy>(
    mesh: &Whole<D, B>,
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
    mesh.cut(&touching, &others, &mut scratch).map_err(|error| explained(mesh, error))?;
    Ok(())
}

/// Translate an error of a region to vertex indices of the whole mesh.
fn explained<const D: usize, B>(mesh: &Whole<D, B>, error: KernelError) -> KernelError {
    if error.is_given_up() {
        return error;
    }
    Connectivity::from_triangles(mesh.points.len(), &mesh.triangles).err().unwrap_or(error)
}
