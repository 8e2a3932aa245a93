//! The collapse loop over a mesh of any size: round after round, region by region.
//!
//! ```text
//! until few enough triangles are left, or no edge may collapse:
//!     cut the mesh into regions, elsewhere than before
//!     choose a priority up to which at most three quarters of the triangles should go
//!     each region, on any thread: collapse up to this priority, the rim locked
//!     put the remains together
//! ```
//!
//! Within a round, all regions go up to the same priority, as one queue for the whole mesh would: the order differs
//! from that of one queue only along the rims, and there by one round. Regions, priorities and numbering follow
//! from the mesh alone, so the result has the same bits for any number of threads. Regions fit into the
//! cache, which makes this faster than one queue also on a single core.

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

/// How far to go, and on how many threads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Stop as soon as no more triangles are left.
    pub triangles: usize,
    /// At least 1.
    pub threads: usize,
    /// Triangles of a region. The result depends on it.
    pub region: usize,
    /// A round that collapses fewer edges, as a share of the triangles, is the last; 0 to go on until none may. What is left
    /// then are single edges that lay on a rim each time, and a round costs what it costs for any number of them.
    pub least: f64,
    /// Record where the survivor of each collapse went.
    pub record: bool,
}

/// Triangles of a region by default: small enough for the caches; half as many is no faster, and has more rim.
pub const REGION_TRIANGLES: usize = 8192;

/// Share of the triangles that one round may remove: more saves rounds, less follows one queue's order closer.
const SHARE: f64 = 0.75;

/// Free pages stay where only one collapse took place for so many triangles: they are needed again at once.
const FEW: usize = 16;

/// With at most so many regions, all are sampled, and their engines are kept: they take as much memory as on as many
/// threads.
const MAX_BEGUN: usize = 8;

type Bound<const D: usize, R> = <<R as Records<D>>::Measure as Measure<D>>::Bound;

pub struct Outcome<const D: usize, R: Records<D>> {
    pub mesh: Whole<D, Bound<D, R>>,
    pub records: R,
    pub stop: Stop,
    pub collapses: usize,
    /// In an order in which they can be repeated; empty where the records keep none and none was asked for.
    pub logs: Vec<Log<D>>,
    pub attempts: u64,
}

/// Collapse edges until the goal is reached or none may go.
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
        // The end: every edge waits on a refusal.
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

/// The whole mesh between two rounds, and what has happened so far.
struct Rounds<'a, const D: usize, R: Records<D>> {
    mesh: Whole<D, Bound<D, R>>,
    records: R,
    goal: &'a Goal,
    at_start: usize,
    /// The number of the round.
    round: usize,
    /// Rounds in a row in which nothing happened.
    idle: u32,
    /// True if the last round collapsed no edge.
    is_stalled: bool,
    /// Priorities of the edges that were left to wait by the last round.
    waiting: Option<Histogram>,
    collapses: usize,
    logs: Vec<Log<D>>,
    attempts: AtomicU64,
}

/// A mesh cut into regions.
struct Cut {
    partition: Partition,
    /// Vertices that no region has alone.
    rim: Vec<bool>,
}

/// What the regions of a round left.
struct Done<const D: usize, R: Records<D>> {
    remains: Vec<Remains<D, Bound<D, R>, R::Remains>>,
    waiting: Histogram,
    /// Up to which edges were to collapse.
    priority: f64,
    /// How many did, before what was too much was left out.
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

    /// Triangles gone so far.
    fn gone(&self) -> usize {
        self.at_start - self.mesh.triangles.len()
    }

    /// Triangles that may go.
    fn total(&self) -> usize {
        self.at_start - self.goal.triangles.min(self.at_start)
    }

    fn has_open_edges(&self) -> bool {
        self.mesh.refused.iter().any(|refused| refused.iter().any(Option::is_none))
    }

    /// Estimate the number of edges that no refusal holds back; boundary edges count half.
    fn open_edges(&self) -> usize {
        if self.mesh.refused.is_empty() {
            return 3 * self.mesh.triangles.len() / 2;
        }
        self.mesh.refused.as_flattened().iter().filter(|refused| refused.is_none()).count() / 2
    }

    /// Cut the mesh, elsewhere than before.
    fn cut(&self) -> Result<Cut, KernelError> {
        let (mesh, threads) = (&self.mesh, self.goal.threads);
        // While nothing happens but some edges were on a rim each time, larger regions leave fewer of them.
        let regions = (self.records.size(mesh.triangles.len()) / self.goal.region.max(1)) >> self.idle;
        let partition = Partition::new(&mesh.points, &mesh.triangles, regions.max(1), self.round, threads);
        let mut owner = find_owners(mesh.points.len(), &mesh.triangles, &partition, threads);
        self.records.keep_together(&mut owner);
        let rim: Vec<bool> = owner.into_iter().map(|owner| owner == SHARED).collect();
        // What goes on from an earlier call was looked at then.
        if self.round == 0 && mesh.refused.is_empty() {
            check_seam(mesh, &rim, partition.len())?;
        }
        Ok(Cut { partition, rim })
    }

    /// Collapse in all regions, up to a priority that should leave about as many triangles as the round is to leave, and
    /// none too few.
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
        // Removing two triangles each, or one at a boundary, the collapses may have gone too far.
        if is_one || left >= goal.triangles {
            return Ok(Done { remains, waiting, priority, collapsed });
        }
        let limits = first_merges(&remains, goal.triangles, count);
        drop(remains);
        let (remains, waiting) = run.all(|p| Until { collapses: limits[p], ..until }, progress)?;
        Ok(Done { remains, waiting, priority, collapsed })
    }

    /// Put together what the regions left.
    fn join(mut self, cut: Cut, mut done: Done<D, R>) -> Self {
        let Cut { partition, rim } = cut;
        drop(partition);
        for left in &mut done.remains {
            self.collapses += left.merges.len();
            // The remains do not need them any more.
            let (merges, path) = left.take_merges(&self.mesh.vertex_source);
            if R::KEEPS_MERGES || self.goal.record {
                self.logs.push(Log { round: self.round, merges, path });
            }
        }
        let (mesh, records) = self.mesh.join(&rim, self.records, done.remains, self.goal.threads);
        if self.goal.record && done.collapsed > mesh.triangles.len() / FEW {
            // Paths stay between what the regions needed for a while.
            memory::give_back();
        }
        Self { mesh, records, waiting: Some(done.waiting), round: self.round + 1, ..self }
    }
}

/// Collapses to ask of a round that starts with `count` triangles. The last rounds aim a little short, then too far, and
/// are cut to the goal.
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

/// One round at work.
struct Run<'a, const D: usize, R: Records<D>> {
    rounds: &'a Rounds<'a, D, R>,
    cut: &'a Cut,
    /// Triangles gone so far, of how many that may go.
    gone: AtomicU64,
    total: u64,
    /// Engines of the regions that were sampled, if they are few enough to wait for their turn.
    begun: Vec<Mutex<Option<Engine<D, R::Measure>>>>,
}

impl<const D: usize, R: Records<D>> Run<'_, D, R> {
    /// What all regions left, each taken as far as said for it, and which edges wait there.
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

    /// Whether fewer edges are open than `wanted` collapses, even if all of them were in the regions of a sample.
    fn has_few_open(&self, wanted: usize) -> bool {
        let open = 2 * self.rounds.open_edges();
        !self.rounds.mesh.refused.is_empty() && open.saturating_mul(2 * self.step()) < wanted
    }

    /// Of so many regions one is looked at before the first round.
    fn step(&self) -> usize {
        (self.cut.partition.len() / 8).max(1)
    }

    /// The priorities in some of the regions, before the first round.
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

    /// Work for each number below `count`, on all threads.
    fn each<T: Send>(
        &self,
        count: usize,
        one: impl Fn(&mut Scratch, usize) -> Result<T, KernelError> + Sync,
    ) -> Result<Vec<T>, KernelError> {
        let scratch = || Scratch::new(self.rounds.mesh.points.len());
        map(count, self.rounds.goal.threads, scratch, one).into_iter().collect()
    }

    /// The engine of a region: the one of the sample, if it was kept.
    fn engine(&self, scratch: &mut Scratch, p: usize) -> Result<Engine<D, R::Measure>, KernelError> {
        let begun = self.begun.get(p).and_then(|engine| engine.lock().ok()?.take());
        if let Some(engine) = begun {
            return Ok(engine);
        }
        let (mesh, refusals) = self.rounds.mesh.cut(self.cut.partition.region(p), &self.cut.rim, scratch)?;
        let measure = self.rounds.records.load(&mesh);
        Ok(Engine::resume(mesh, measure, refusals))
    }

    /// Collapse in one region.
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

/// How many merges of each region to keep so that `triangles` are left: those of least priority.
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

/// Check the manifold around vertices of the rim, whose triangles no region has all.
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
    // Here it is the others that have triangles elsewhere.
    let others: Vec<bool> = rim.iter().map(|is_rim| !is_rim).collect();
    let mut scratch = Scratch::new(mesh.points.len());
    mesh.cut(&touching, &others, &mut scratch).map_err(|error| explained(mesh, error))?;
    Ok(())
}

/// What a region found wrong, in the numbers of the whole mesh.
fn explained<const D: usize, B>(mesh: &Whole<D, B>, error: KernelError) -> KernelError {
    if error.is_given_up() {
        return error;
    }
    Connectivity::from_triangles(mesh.points.len(), &mesh.triangles).err().unwrap_or(error)
}
