//! The loop of certified simplification: simplify, prove, undo.

use super::bounded_qem::{BoundedQemState, Rules};
use super::input_surface::InputSurface;
use super::sample_tracker::{LimitKind, SampleLimits, SampleLists};
use crate::base::errors::KernelError;
use crate::base::geometry::position_of;
use crate::base::progress::Progress;
use crate::certify::{self, Certificate, Deviation, Surface};
use crate::collapse::collapse_log::CollapseSequence;
use crate::collapse::engine::{Refusal, Stop};
use crate::collapse::rounds::{Goal, collapse};
use crate::collapse::whole_mesh::WholeMesh;
use crate::mesh::triangle_mesh::CompactMesh;

use super::collapse_history::History;
use super::collapse_undo::CollapseUndo;
use super::proof_cache::{ProofCache, SeparatePartitions, UnprovenSet};
use super::sample_owners::SampleOwners;

/// Ratio of the bounds that samples may use; the rest is a margin for the points between samples.
const SAMPLE_RATIO: f64 = 0.9;

/// Factor on the limits of the samples around a failed proof, and the number of failures up to which it applies:
/// where it does not help, the samples are not the cause.
const TIGHTENING_FACTOR: f32 = 0.6;
const MAX_TIGHTENINGS: u8 = 5;

/// Average number of pieces per triangle that may be spent on undecided triangles.
const DECISION_EFFORT: f64 = 8.0;

/// Passes before unproven triangles are tested for being provable at all.
const PASSES_BEFORE_PROVABILITY_CHECK: usize = 6;

/// Failures at a vertex before its surroundings are refined. Each further failure refines them once more, which
/// doubles their vertices: a large triangle that fails at one place is not restored to the resolution of the
/// input.
const FAILURES_BEFORE_REFINING: usize = 8;

/// Refinements before the surroundings are locked, too: without locks, the same collapses may follow forever.
const REFINEMENTS_BEFORE_LOCKING: usize = 3;

/// Failures at a vertex before the proof there is given up.
const FAILURES_BEFORE_GIVING_UP: usize = 20;

/// After this many passes per failure, every unproven triangle counts as having failed as often.
const MAX_PASSES_PER_FAILURE: usize = 4;

/// Ratio of triangles below which a round stops the collapse loop, so that a proof follows.
const MIN_COLLAPSE_RATIO: f64 = 1.0 / 2000.0;

/// Smallest provable bound on colour in levels. Colours are stored as whole levels; proofs of closer bounds
/// cost too much.
const MIN_COLOR_BOUND: f64 = 0.5;

/// Parameters of the certified simplification.
#[derive(Clone, Debug)]
pub struct Options {
    /// Two-sided distance in metres and colour difference in levels; infinite for no bound. Values below the
    /// smallest provable bounds are raised to them.
    pub bounds: Deviation,
    /// Length in metres that counts as much as one colour level when a vertex is placed.
    pub weight: f64,
    /// By vertex: factor on the error, and divisor of the sample limits; empty for 1.
    pub importance: Vec<f64>,
    /// Options of the proof; `limit` is ignored.
    pub proof: certify::Options,
    /// Bound each triangle to the tolerances of `proof` instead of only proving the requested bounds. If
    /// false and the bound on colour is infinite, only the largest colour difference is bounded.
    pub tight_bounds: bool,
    /// Continue until no edge can collapse, not only until hardly any does.
    pub until_exhausted: bool,
    /// Ratio of the bounds that samples may use; the rest is a margin for the points between samples.
    pub sample_ratio: f64,
    pub rules: Rules,
}

impl Options {
    pub fn new(bounds: Deviation) -> Self {
        Self {
            bounds,
            weight: 0.0,
            importance: vec![],
            proof: certify::Options::default(),
            tight_bounds: true,
            until_exhausted: true,
            sample_ratio: SAMPLE_RATIO,
            rules: Rules::default(),
        }
    }
}

/// Statistics of one pass of the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pass {
    pub triangles: usize,
    /// Unproven triangles of the mesh and of the input.
    pub unproven: [usize; 2],
    /// Collapses that were not undone, and all attempts so far.
    pub collapses: usize,
    pub attempts: u64,
}

/// Result of the certified simplification.
#[derive(Clone, Debug)]
pub struct CertifiedMesh<const D: usize> {
    pub mesh: CompactMesh<D>,
    pub certificate: Certificate,
    /// True if the bounds are proven. False if the caller stopped the work, or if the bounds do not even hold
    /// between the input and itself. The latter happens where sheets of different colours touch.
    pub proven: bool,
    pub stop: Stop,
    pub passes: Vec<Pass>,
    /// For each edge that cannot collapse: the reason.
    pub refused: Vec<Refusal<LimitKind>>,
    /// Collapses that were not undone; empty unless `SeamGoal::record` is set.
    pub collapse_sequence: CollapseSequence<D>,
}

/// Compute the smallest provable bounds for a surface of this size.
///
/// A proof needs twice the slack of single precision.
pub fn min_provable_bounds<const D: usize>(
    original: &InputSurface<D>,
    options: &certify::Options,
) -> Deviation {
    let corners = original.triangles.iter().flatten().map(|&v| position_of(&original.points[v as usize]));
    Deviation { shape: 2.0 * certify::slack(corners, options.slack), color: MIN_COLOR_BOUND }
}

/// Simplify as far as the bounds can be proven.
///
/// The bounds hold for every point of both surfaces.
///
/// # Errors
/// As [`crate::mesh::connectivity::Connectivity::from_triangles`], and [`KernelError::Interrupted`].
pub fn simplify<const D: usize, const K: usize>(
    points: Vec<[f64; D]>,
    triangles: Vec<[u32; 3]>,
    locked: Vec<bool>,
    options: &Options,
    goal: &Goal,
    progress: &mut Progress,
) -> Result<CertifiedMesh<D>, KernelError> {
    let given = triangles.len();
    let whole = WholeMesh::<D, LimitKind>::new(points, triangles, locked)?;
    let locked = whole.locked;
    let proper = (whole.triangles.len() < given).then_some(whole.triangle_source);
    progress.check()?;
    let original = InputSurface::new(whole.points, whole.triangles);
    progress.check()?;
    let start = LoopState::of_input(&original, goal.record_positions)?;
    let LoopResult { state, mut ledger, proven, stop, mut passes } =
        run_loop::<D, K>(&original, start, locked, None, options, goal, progress)?;
    let refused = state.mesh.refused_edges();
    let mut mesh = state.mesh.into_compact();
    let mut certificate =
        create_certificate(&mesh, &mut ledger, proven, options, goal.threads, &mut progress.silent())?;
    // Without a bound on colour, only the largest difference is bounded, and only of the result: it would cost
    // more than the proof of shape to bound it in every pass. With a weight of 0, colours do not matter.
    if D > 3 && options.weight > 0.0 && options.bounds.color == f64::INFINITY && !options.tight_bounds {
        let result = Surface::new(&mesh.points, &mesh.triangles, goal.threads)?;
        let proof = certify::Options { limit: None, threads: goal.threads, ..options.proof };
        let found = certify::bound_whole(&result, ledger.surface(), &proof, &mut progress.silent())?;
        let color = found.bound.color.min(bound_color_difference(&mesh.points, &original.points));
        certificate.bound.color = color;
        certificate.attained.color = found.attained.color;
        let Certificate { result, from_result: own, original, .. } = &mut certificate;
        [result, own, original].into_iter().flatten().for_each(|d| d.color = color);
    }
    // The certificate is computed with more effort than the decisions, so it may prove the rest.
    let proven = proven || certificate.bound.is_within(ledger.bounds());
    if let Some(last) = passes.last_mut().filter(|_| proven) {
        last.unproven = [0, 0];
    }
    let way =
        if goal.record_positions { state.history.replay_sequence() } else { CollapseSequence::default() };
    if let Some(proper) = proper {
        mesh.triangle_source.iter_mut().for_each(|t| *t = proper[*t as usize]);
    }
    Ok(CertifiedMesh { mesh, certificate, proven, stop, passes, refused, collapse_sequence: way })
}

/// Bound the difference between any two colours.
fn bound_color_difference<const D: usize>(a: &[[f64; D]], b: &[[f64; D]]) -> f64 {
    let extent = |i: usize| {
        let all = || a.iter().chain(b).map(|p| p[i]);
        all().fold(f64::NEG_INFINITY, f64::max) - all().fold(f64::INFINITY, f64::min)
    };
    (3..D).map(|i| extent(i).max(0.0).powi(2)).sum::<f64>().sqrt()
}

/// Final state of the loop.
pub struct LoopResult<'a, const D: usize> {
    pub state: LoopState<'a, D>,
    pub ledger: ProofCache<'a, D>,
    pub proven: bool,
    pub stop: Stop,
    pub passes: Vec<Pass>,
}

/// Run the loop of simplification, proof and undo from a given state.
///
/// `start` must be within the bounds; its earlier collapses are never undone. `locked` is by input vertex,
/// empty for none. Partitions in `apart` must be locked where they touch.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn run_loop<'a, const D: usize, const K: usize>(
    original: &'a InputSurface<D>,
    start: LoopState<'a, D>,
    locked: Vec<bool>,
    apart: Option<&SeparatePartitions<'_>>,
    options: &Options,
    goal: &Goal,
    progress: &mut Progress,
) -> Result<LoopResult<'a, D>, KernelError> {
    let least = min_provable_bounds(original, &options.proof);
    let bounds = options.bounds.max(least);
    let mut limits = initial_limits(options, bounds, least, original.points.len());
    let decision = certify::Options {
        limit: Some(bounds),
        threads: goal.threads,
        effort: DECISION_EFFORT,
        ..options.proof
    };
    let mut goal = Goal { min_collapse_ratio: MIN_COLLAPSE_RATIO, record_positions: true, ..*goal };
    let to_go = original.triangles.len().saturating_sub(goal.triangles) as u64;
    let mut passes: Vec<Pass> = vec![];
    let mut attempts = 0;
    let mut lost = FailureTracker { failures: vec![0; original.points.len()], locked };
    let mut ledger = None;
    let mut state = start.with_locks(&lost.locked);
    loop {
        let LoopState { mesh, sample_lists: lists, mut history } = state;
        let importance = compute_importance(&mesh, &history, &options.importance);
        let records =
            BoundedQemState::<D, K>::new(original, &limits, options.weight, importance, lists, options.rules);
        // Undone triangles have to go again, and proofs have no comparable unit: only collapses report
        // progress.
        let gone = original.triangles.len() - mesh.triangles.len();
        let outcome = collapse(mesh, records, &goal, &mut progress.for_part(gone as u64, to_go))?;
        let proving = &mut progress.silent();
        let (mesh, lists) = (outcome.mesh, outcome.records.lists);
        attempts += outcome.attempts;
        history.append(outcome.logs);
        let mut known = match ledger.take() {
            Some(known) => known,
            None => ProofCache::new(original, decision, apart)?,
        };
        let unproven = known.update(&mesh, proving)?;
        passes.push(Pass {
            triangles: mesh.triangles.len(),
            unproven,
            collapses: history.active_count(),
            attempts,
        });
        let proven = unproven == [0, 0];
        let news = if passes.len() >= PASSES_BEFORE_PROVABILITY_CHECK {
            known.find_unprovable(proving)?
        } else {
            0
        };
        let open = known.unproven_set();
        let settled =
            open.is_empty() && (proven || passes.len() >= PASSES_BEFORE_PROVABILITY_CHECK && news == 0);
        state = LoopState { mesh, sample_lists: lists, history };
        let is_rest_left = options.until_exhausted && outcome.stop == Stop::Stalled;
        let settled = settled || state.history.has_nothing_to_undo();
        if (settled && !is_rest_left) || outcome.stop == Stop::StoppedByCaller {
            return Ok(LoopResult { state, ledger: known, proven, stop: outcome.stop, passes });
        }
        progress.check()?;
        if settled {
            // Everything is proven: now try the remaining single edges, too.
            goal.min_collapse_ratio = 0.0;
        } else {
            state = state.undo_unproven(original, &mut known, &open, &mut limits, &mut lost, passes.len());
        }
        ledger = Some(known);
    }
}

/// Compute the initial limits of the samples.
fn initial_limits(options: &Options, bounds: Deviation, least: Deviation, vertices: usize) -> SampleLimits {
    let factor = |v: usize| options.importance.get(v).map_or(1.0, |i| i.max(1.0) as f32);
    SampleLimits {
        shape: options.sample_ratio * (bounds.shape - 0.5 * least.shape),
        color: options.sample_ratio * (bounds.color - certify::COLOR_SLACK),
        factors: (0..vertices).map(|v| 1.0 / factor(v)).collect(),
        min_needle_ratio: options.rules.min_needle_ratio,
    }
}

/// Compute the certificate of a result: bounds per triangle, or only the requested bounds.
fn create_certificate<const D: usize>(
    mesh: &CompactMesh<D>,
    ledger: &mut ProofCache<'_, D>,
    proven: bool,
    options: &Options,
    threads: usize,
    progress: &mut Progress,
) -> Result<Certificate, KernelError> {
    if !options.tight_bounds {
        return ledger.certificate(mesh, &options.proof, progress);
    }
    let result = Surface::new(&mesh.points, &mesh.triangles, threads)?;
    let proof = certify::Options { limit: None, threads, ..options.proof };
    let close = certify::certify(&result, ledger.surface(), &proof, progress)?;
    Ok(if proven { ledger.combine_with(close) } else { close })
}

/// The mesh between two passes, with the samples of its triangles and its history.
pub struct LoopState<'a, const D: usize> {
    pub mesh: WholeMesh<D, LimitKind>,
    pub sample_lists: SampleLists,
    pub history: History<'a, D>,
}

impl<'a, const D: usize> LoopState<'a, D> {
    /// Create the state of the unchanged input; `in_order` if the collapse order is needed.
    ///
    /// # Errors
    /// As [`Whole::new`].
    pub fn of_input(original: &'a InputSurface<D>, in_order: bool) -> Result<Self, KernelError> {
        Ok(Self {
            mesh: WholeMesh::new(original.points.clone(), original.triangles.clone(), vec![])?,
            sample_lists: SampleLists::of_input(original),
            history: History::new(original, in_order),
        })
    }

    /// Lock other input vertices, and forget all refusals.
    fn with_locks(mut self, locked: &[bool]) -> Self {
        let is_locked = |&v: &u32| locked[v as usize];
        self.mesh.locked =
            if locked.is_empty() { vec![] } else { self.mesh.vertex_source.iter().map(is_locked).collect() };
        self.mesh.refused.clear();
        self
    }
}

/// Failed proofs by input vertex.
struct FailureTracker {
    /// Number of failures, saturating.
    failures: Vec<u8>,
    locked: Vec<bool>,
}

impl<'a, const D: usize> LoopState<'a, D> {
    /// Undo collapses around unproven triangles, and tighten the limits there.
    ///
    /// `passes` is the number of passes so far.
    fn undo_unproven(
        self,
        original: &'a InputSurface<D>,
        ledger: &mut ProofCache<'_, D>,
        open: &UnprovenSet,
        limits: &mut SampleLimits,
        lost: &mut FailureTracker,
        passes: usize,
    ) -> Self {
        let Self { mesh, sample_lists: lists, history } = self;
        let watched = SampleOwners::new(original, &mesh.triangle_source, &lists);
        let mut retreat = CollapseUndo::new(original, history, watched);
        let FailureTracker { failures, locked } = lost;
        for v in retreat.collect_samples_around(&mesh, open) {
            if failures[v as usize] < MAX_TIGHTENINGS {
                limits.factors[v as usize] *= TIGHTENING_FACTOR;
            }
            failures[v as usize] = failures[v as usize].saturating_add(1);
        }
        let stubborn = |times: usize| {
            let times = if passes < MAX_PASSES_PER_FAILURE * times { times as u8 } else { 0 };
            retreat.repeatedly_failed(open, failures, times)
        };
        let refined: Vec<Vec<u32>> = (FAILURES_BEFORE_REFINING..FAILURES_BEFORE_GIVING_UP)
            .map(|times| retreat.collect_vertices_around(&stubborn(times)))
            .take_while(|vertices| !vertices.is_empty())
            .collect();
        let given_up = stubborn(FAILURES_BEFORE_GIVING_UP);
        ledger.mark_unprovable(retreat.undo_unproven(open, failures));
        ledger.mark_unprovable([given_up.mesh_triangles, given_up.input_triangles].concat());
        refined.iter().for_each(|vertices| retreat.refine(vertices));
        retreat.lock(refined.get(REFINEMENTS_BEFORE_LOCKING).map_or(&[], Vec::as_slice), locked);
        let unprovable: Vec<u32> =
            ledger.unprovable.iter().flat_map(|&t| original.triangles[t as usize]).collect();
        retreat.restore_and_lock(&unprovable, locked);
        let (mesh, lists, history) = retreat.into_state(mesh, locked);
        Self { mesh, sample_lists: lists, history }
    }
}

/// Compute the importance of each vertex of the current mesh: the maximum of the input vertices it contains.
fn compute_importance<const D: usize>(
    mesh: &WholeMesh<D, LimitKind>,
    history: &History<'_, D>,
    importance: &[f64],
) -> Vec<f64> {
    if importance.is_empty() {
        return vec![];
    }
    let most = |&v: &u32| {
        let mut most = 0.0;
        history.visit_members(v, |member| most = f64::max(most, importance[member as usize]));
        most
    };
    mesh.vertex_source.iter().map(most).collect()
}
