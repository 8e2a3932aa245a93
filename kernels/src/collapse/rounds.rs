//! The collapse loop over a mesh of any size: round after round, region by region.
//!
//! ```text
//! until few enough triangles are left, or no edge may collapse:
//!     cut the mesh into regions, elsewhere than before
//!     choose a priority up to which at most three quarters of the triangles should go
//!     each region, on any thread: collapse up to this priority, the rim locked
//!     put the pieces together
//! ```
//!
//! Within a round, all regions go up to the same priority, as one queue for the whole mesh would: the order differs
//! from that of one queue only along the rims, and there by one round. Regions, priorities and numbering follow
//! from the mesh alone, so the result has the same bits for any number of threads. Regions fit into the
//! cache, which makes this faster than one queue also on a single core.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};

use crate::base::errors::KernelError;
use crate::base::memory;
use crate::base::parallel::map;
use crate::base::progress::Progress;
use crate::collapse::engine::{Engine, Measure, Merge, Stop, Until};
use crate::collapse::partition::Partition;
use crate::collapse::region::{CornerRefusals, Piece, Records, SHARED, Scratch, Whole, find_owners};
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
    /// Record where the survivor of each collapse went.
    pub record: bool,
}

/// Triangles of a region by default: small enough for the caches; half as many is no faster, and has more rim.
pub const REGION_TRIANGLES: usize = 8192;

/// Share of the triangles that one round may remove: more saves rounds, less follows one queue's order closer.
const SHARE: f64 = 0.75;

type Bound<const D: usize, R> = <<R as Records<D>>::Measure as Measure<D>>::Bound;

/// What happened in one region.
#[derive(Clone, Debug, PartialEq)]
pub struct Log<const D: usize> {
    pub round: usize,
    /// In numbers of the vertices at the start.
    pub merges: Vec<Merge>,
    /// Where their survivors went; empty unless asked for.
    pub path: Vec<[f64; D]>,
}

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
    mut mesh: Whole<D, Bound<D, R>>,
    mut records: R,
    goal: &Goal,
    progress: &mut Progress,
) -> Result<Outcome<D, R>, KernelError> {
    let at_start = mesh.triangles.len();
    let (mut collapses, mut logs) = (0, vec![]);
    let attempts = AtomicU64::new(0);
    let mut histogram: Option<Histogram> = None;
    let mut idle: u32 = 0;
    let mut round = 0;
    progress.tell(0, (at_start - goal.triangles.min(at_start)) as u64)?;
    let stop = loop {
        let count = mesh.triangles.len();
        if count <= goal.triangles && round > 0 {
            break Stop::Target;
        }
        // While nothing happens but some edges were on a rim each time, larger regions leave fewer of them.
        let regions = ((records.size(count) / goal.region.max(1)) >> idle).max(1);
        let partition = Partition::new(&mesh.points, &mesh.triangles, regions, round, goal.threads);
        let mut owner = find_owners(mesh.points.len(), &mesh.triangles, &partition, goal.threads);
        records.keep_together(&mut owner);
        let rim: Vec<bool> = owner.into_iter().map(|owner| owner == SHARED).collect();
        if round == 0 {
            check_seam(&mesh, &rim, regions)?;
        }
        let total = (at_start - goal.triangles.min(at_start)) as u64;
        progress.tell((at_start - count) as u64, total)?;

        let gone = AtomicU64::new((at_start - count) as u64);
        let run = Run { mesh: &mesh, records: &records, partition: &partition, rim: &rim, goal, gone, total };
        let needed = count.saturating_sub(goal.triangles).div_ceil(2);
        let priority = if regions == 1 {
            f64::INFINITY
        } else {
            let seen = match histogram.take() {
                Some(seen) => seen,
                None => run.sample(progress).map_err(|error| explained(&mesh, error))?,
            };
            seen.priority_for(wanted(needed, count), count / 2)
        };
        let seen = Histogram::default();
        let until =
            Until { triangles: if regions == 1 { goal.triangles } else { 0 }, priority, ..Until::EXHAUSTED };
        let work = |limit: &(dyn Fn(usize) -> usize + Sync), seen: &Histogram| {
            let one = |scratch: &mut Scratch, p: usize| {
                run.region(
                    scratch,
                    p,
                    &Until { collapses: limit(p), ..until },
                    seen,
                    &attempts,
                    &mut progress.clone(),
                )
            };
            let scratch = || Scratch::new(mesh.points.len());
            map(regions, goal.threads, scratch, one).into_iter().collect::<Result<Vec<_>, _>>()
        };
        let mut pieces = work(&|_| usize::MAX, &seen).map_err(|error| explained(&mesh, error))?;
        let collapsed: usize = pieces.iter().map(|piece| piece.merges.len()).sum();
        let mut histogram_of_round = seen;
        // Removing two triangles each, or one at a boundary, the collapses may have gone too far.
        let removed = count - pieces.iter().map(Piece::triangles).sum::<usize>();
        if regions > 1 && count - removed < goal.triangles {
            let limits = first_merges(&pieces, goal.triangles, count);
            drop(pieces);
            histogram_of_round = Histogram::default();
            pieces = work(&|p| limits[p], &histogram_of_round)?;
        }
        let enough = progress.is_enough();
        drop(partition);
        collapses += pieces.iter().map(|piece| piece.merges.len()).sum::<usize>();
        for piece in &mut pieces {
            // The pieces do not need them any more.
            let (merges, path) = piece.take_merges(&mesh.vertex_source);
            if R::KEEPS_MERGES || goal.record {
                logs.push(Log { round, merges, path });
            }
        }
        (mesh, records) = mesh.join(&rim, records, pieces, goal.threads);
        if goal.record {
            // Paths stay between what the regions needed for a while.
            memory::give_back();
        }
        histogram = Some(histogram_of_round);
        round += 1;
        if enough {
            break Stop::Enough;
        }
        if mesh.triangles.len() <= goal.triangles {
            break Stop::Target;
        }
        // The end: every edge waits on a refusal.
        let open = |refused: &CornerRefusals<_>| refused.iter().any(Option::is_none);
        if priority == f64::INFINITY && (regions == 1 || !mesh.refused.iter().any(open)) {
            break Stop::Exhausted;
        }
        idle = if collapsed == 0 && priority == f64::INFINITY { idle + 1 } else { 0 };
    };
    Ok(Outcome { mesh, records, stop, collapses, logs, attempts: attempts.into_inner() })
}

/// Collapses to ask of a round. The last rounds aim a little short, then too far, and are cut to the goal.
fn wanted(needed: usize, triangles: usize) -> usize {
    let most = (SHARE * triangles as f64 / 2.0) as usize;
    if needed > most {
        most
    } else if needed > triangles / 64 {
        needed - needed / 8
    } else {
        2 * needed
    }
}

struct Run<'a, const D: usize, R: Records<D>> {
    mesh: &'a Whole<D, Bound<D, R>>,
    records: &'a R,
    partition: &'a Partition,
    rim: &'a [bool],
    goal: &'a Goal,
    /// Triangles gone so far, of how many that may go.
    gone: AtomicU64,
    total: u64,
}

impl<const D: usize, R: Records<D>> Run<'_, D, R> {
    fn engine(&self, scratch: &mut Scratch, p: usize) -> Result<Engine<D, R::Measure>, KernelError> {
        let (mesh, refusals) = self.mesh.cut(self.partition.region(p), self.rim, scratch)?;
        let measure = self.records.load(&mesh);
        Ok(Engine::resume(mesh, measure, refusals))
    }

    fn region(
        &self,
        scratch: &mut Scratch,
        p: usize,
        until: &Until,
        seen: &Histogram,
        attempts: &AtomicU64,
        progress: &mut Progress,
    ) -> Result<Piece<D, Bound<D, R>, R::Piece>, KernelError> {
        progress.check()?;
        let mut engine = self.engine(scratch, p)?;
        if self.goal.record {
            engine.record_path();
        }
        engine.run(*until, progress)?;
        let collapsed: u64 = engine.merges().iter().map(|m| u64::from(m.triangles)).sum();
        let gone = self.gone.fetch_add(collapsed, Relaxed) + collapsed;
        progress.tell(gone.min(self.total), self.total)?;
        seen.add(engine.waiting());
        attempts.fetch_add(engine.attempts(), Relaxed);
        let (mesh, measure, refusals, merges, path) = engine.into_parts();
        let records = R::unload(measure, &mesh);
        Ok(Piece::new(&mesh, self.mesh, |edge| refusals[edge.index()], &merges, path, records))
    }

    /// The priorities in some of the regions, before the first round.
    fn sample(&self, progress: &Progress) -> Result<Histogram, KernelError> {
        let step = (self.partition.len() / 8).max(1);
        let chosen = self.partition.len().div_ceil(step);
        let seen = Histogram::default();
        let one = |scratch: &mut Scratch, i: usize| -> Result<usize, KernelError> {
            progress.check()?;
            let engine = self.engine(scratch, i * step)?;
            seen.add(engine.waiting());
            Ok(self.partition.region(i * step).len())
        };
        let scratch = || Scratch::new(self.mesh.points.len());
        let sizes =
            map(chosen, self.goal.threads, scratch, one).into_iter().collect::<Result<Vec<_>, _>>()?;
        let sampled: usize = sizes.iter().sum();
        Ok(Histogram { scale: self.mesh.triangles.len() as f64 / sampled as f64, ..seen })
    }
}

/// Sixteen classes for every doubling of a priority.
struct Histogram {
    counts: Vec<AtomicU32>,
    scale: f64,
}

const CLASS_BITS: u32 = 48;

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: (0..1 << (63 - CLASS_BITS)).map(|_| AtomicU32::new(0)).collect(), scale: 1.0 }
    }
}

impl Histogram {
    fn add(&self, priorities: impl Iterator<Item = f64>) {
        for priority in priorities {
            let class = (priority.max(0.0).to_bits() >> CLASS_BITS) as usize;
            self.counts[class].fetch_add(1, Relaxed);
        }
    }

    /// The priority up to which about `collapses` take place on a mesh where `most` can.
    fn priority_for(&self, collapses: usize, most: usize) -> f64 {
        // Of three edges one collapses and two merge with others when all go, while the first few are all
        // collapses.
        let share = collapses as f64 / most.max(1) as f64;
        let wanted = collapses as f64 * (1.0 + 2.0 * share);
        let mut below = 0.0;
        for (class, count) in self.counts.iter().enumerate() {
            below += self.scale * f64::from(count.load(Relaxed));
            if below >= wanted {
                return f64::from_bits((class as u64 + 1) << CLASS_BITS);
            }
        }
        f64::INFINITY
    }
}

/// List and place of all merges, those of least priority first.
fn by_priority<'a>(lists: impl Iterator<Item = &'a [Merge]>) -> impl Iterator<Item = (usize, usize)> {
    let mut order: Vec<(f64, u32, u32)> = vec![];
    for (list, merges) in lists.enumerate() {
        order.extend(merges.iter().enumerate().map(|(i, m)| (m.priority, list as u32, i as u32)));
    }
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    order.into_iter().map(|(_, list, i)| (list as usize, i as usize))
}

/// All collapses one after the other: the log of each, and its place there.
pub fn in_order<const D: usize>(logs: &[Log<D>]) -> impl Iterator<Item = (usize, usize)> {
    let rounds = logs.chunk_by(|a, b| a.round == b.round).scan(0, |first, round| {
        let start = *first;
        *first += round.len();
        Some((start, round))
    });
    rounds.flat_map(|(start, round)| {
        by_priority(round.iter().map(|log| &log.merges[..])).map(move |(log, i)| (start + log, i))
    })
}

/// The collapses one after the other, in numbers of the vertices at the start, and where their survivors went.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Way<const D: usize> {
    pub removed: Vec<u32>,
    pub survivor: Vec<u32>,
    pub path: Vec<[f64; D]>,
}

impl<const D: usize> Way<D> {
    /// All that was recorded: nothing, if that was not asked for.
    pub fn new(logs: &[Log<D>]) -> Self {
        if logs.iter().all(|log| log.path.is_empty()) {
            return Self::default();
        }
        let recorded =
            in_order(logs).filter_map(|(log, i)| Some((&logs[log].merges[i], logs[log].path.get(i)?)));
        recorded.map(|(merge, to)| (merge.removed.0, merge.survivor.0, *to)).collect()
    }
}

impl<const D: usize> FromIterator<(u32, u32, [f64; D])> for Way<D> {
    fn from_iter<I: IntoIterator<Item = (u32, u32, [f64; D])>>(collapses: I) -> Self {
        let mut way = Self { removed: vec![], survivor: vec![], path: vec![] };
        for (removed, survivor, to) in collapses {
            way.removed.push(removed);
            way.survivor.push(survivor);
            way.path.push(to);
        }
        way
    }
}

/// How many merges of each region to keep so that `triangles` are left: those of least priority.
fn first_merges<const D: usize, B: Copy, R>(
    pieces: &[Piece<D, B, R>],
    triangles: usize,
    mut count: usize,
) -> Vec<usize> {
    let mut limits = vec![0; pieces.len()];
    for (p, i) in by_priority(pieces.iter().map(|piece| &piece.merges[..])) {
        if count <= triangles {
            break;
        }
        limits[p] += 1;
        count -= usize::from(pieces[p].merges[i].triangles);
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
    if error == KernelError::Interrupted {
        return error;
    }
    Connectivity::from_triangles(mesh.points.len(), &mesh.triangles).err().unwrap_or(error)
}
