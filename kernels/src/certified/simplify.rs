//! The loop of certified simplification: simplify, prove, undo.

use super::original::Original;
use super::tracked::{Rules, TrackedRecords};
use super::tracker::{Bound, Limits, Lists};
use crate::base::errors::KernelError;
use crate::base::geometry::position;
use crate::base::progress::Progress;
use crate::certify::{self, Certificate, Deviation, Surface, Verdict};
use crate::collapse::engine::{Refusal, Stop};
use crate::collapse::logs::Way;
use crate::collapse::rounds::{Goal, collapse};
use crate::collapse::whole::Whole;
use crate::mesh::triangle_mesh::Compact;

use super::history::History;
use super::ledger::{Apart, Ledger, Open};
use super::retreat::Retreat;
use super::watched::Watched;

/// Ratio of the bounds that samples may use; the rest is a margin for the points between samples.
const SHARE: f64 = 0.9;

/// Factor on the limits of the samples around a failed proof.
const TIGHTER: f32 = 0.6;

/// Average number of pieces per triangle that may be spent on undecided triangles.
const EFFORT: f64 = 8.0;

/// Passes before unproven triangles are tested for being provable at all.
const HOPE: usize = 6;

/// Failures at a vertex before its surroundings are locked for good. Locked vertices cause failures next to
/// them, so the neighbours need a few attempts, too.
const PATIENCE: usize = 8;

/// Failures at a vertex before the proof there is given up.
const END: usize = 20;

/// After `IMPATIENCE × PATIENCE` passes, the surroundings of all unproven triangles are locked. After
/// `IMPATIENCE × END` passes, all remaining proofs are given up.
const IMPATIENCE: usize = 4;

/// Ratio of triangles below which a round stops the collapse loop, so that a proof follows.
const LEAST_ROUND: f64 = 1.0 / 2000.0;

/// Smallest provable bound on colour in levels. Colours are stored as whole levels; proofs of closer bounds
/// cost too much.
const LEAST_COLOR: f64 = 0.5;

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
    pub close: bool,
    /// Continue until no edge can collapse, not only until hardly any does.
    pub to_the_end: bool,
    /// Ratio of the bounds that samples may use; the rest is a margin for the points between samples.
    pub share: f64,
    pub rules: Rules,
}

impl Options {
    pub fn new(bounds: Deviation) -> Self {
        Self {
            bounds,
            weight: 0.0,
            importance: vec![],
            proof: certify::Options::default(),
            close: true,
            to_the_end: true,
            share: SHARE,
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
pub struct Certified<const D: usize> {
    pub mesh: Compact<D>,
    pub certificate: Certificate,
    /// True if the bounds are proven. False if the caller stopped the work, or if the bounds do not even hold
    /// between the input and itself. The latter happens where sheets of different colours touch.
    pub proven: bool,
    pub stop: Stop,
    pub passes: Vec<Pass>,
    /// For each edge that cannot collapse: the reason.
    pub refused: Vec<Refusal<Bound>>,
    /// Collapses that were not undone; empty unless `Goal::record` is set.
    pub way: Way<D>,
}

/// Compute the smallest provable bounds for a surface of this size.
///
/// A proof needs twice the slack of single precision.
pub fn least_bounds<const D: usize>(original: &Original<D>, options: &certify::Options) -> Deviation {
    let corners = original.triangles.iter().flatten().map(|&v| position(&original.points[v as usize]));
    Deviation { shape: 2.0 * certify::slack(corners, options.slack), color: LEAST_COLOR }
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
) -> Result<Certified<D>, KernelError> {
    let given = triangles.len();
    let whole = Whole::<D, Bound>::new(points, triangles, locked)?;
    let locked = whole.locked;
    let proper = (whole.triangles.len() < given).then_some(whole.triangle_source);
    progress.check()?;
    let original = Original::new(whole.points, whole.triangles);
    progress.check()?;
    let start = State::of_input(&original, goal.record)?;
    // Without a bound on colour, the largest colour difference is bounded along with the proof of shape.
    let of_all = D > 3 && options.bounds.color == f64::INFINITY && !options.close;
    let part = vec![0; if of_all { original.triangles.len() } else { 0 }];
    let apart = of_all.then_some(Apart { part: &part, close: &options.proof });
    let Reached { state, mut ledger, proven, stop, mut passes } =
        go_on::<D, K>(&original, start, locked, apart.as_ref(), options, goal, progress)?;
    let refused = state.mesh.refused_edges();
    let colors = match apart {
        Some(_) => ledger.bounds_of_parts(&state.mesh, |_| true, progress)?.first().copied(),
        None => None,
    };
    let mut mesh = state.mesh.into_compact();
    let mut certificate =
        certificate_of(&mesh, &mut ledger, proven, options, goal.threads, &mut progress.silent())?;
    if let Some(Verdict { bound, attained, .. }) = colors {
        let bound =
            Deviation { color: bound.color.min(farthest_colors(&mesh.points, &original.points)), ..bound };
        certificate.bound.color = bound.color;
        certificate.attained.color = attained.color;
        let Certificate { result, own, original, .. } = &mut certificate;
        [result, own, original].into_iter().flatten().for_each(|d| d.color = bound.color);
    }
    // The certificate is computed with more effort than the decisions, so it may prove the rest.
    let proven = proven || certificate.bound.within(ledger.bounds());
    if let Some(last) = passes.last_mut().filter(|_| proven) {
        last.unproven = [0, 0];
    }
    let way = if goal.record { state.history.way() } else { Way::default() };
    if let Some(proper) = proper {
        mesh.triangle_source.iter_mut().for_each(|t| *t = proper[*t as usize]);
    }
    Ok(Certified { mesh, certificate, proven, stop, passes, refused, way })
}

/// Bound the difference between any two colours.
fn farthest_colors<const D: usize>(a: &[[f64; D]], b: &[[f64; D]]) -> f64 {
    let extent = |i: usize| {
        let all = || a.iter().chain(b).map(|p| p[i]);
        all().fold(f64::NEG_INFINITY, f64::max) - all().fold(f64::INFINITY, f64::min)
    };
    (3..D).map(|i| extent(i).max(0.0).powi(2)).sum::<f64>().sqrt()
}

/// Final state of the loop.
pub struct Reached<'a, const D: usize> {
    pub state: State<'a, D>,
    pub ledger: Ledger<'a, D>,
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
pub fn go_on<'a, const D: usize, const K: usize>(
    original: &'a Original<D>,
    start: State<'a, D>,
    locked: Vec<bool>,
    apart: Option<&Apart<'_>>,
    options: &Options,
    goal: &Goal,
    progress: &mut Progress,
) -> Result<Reached<'a, D>, KernelError> {
    let least = least_bounds(original, &options.proof);
    let bounds = options.bounds.max(least);
    let mut limits = limits_of(options, bounds, least, original.points.len());
    let decision =
        certify::Options { limit: Some(bounds), threads: goal.threads, effort: EFFORT, ..options.proof };
    let mut goal = Goal { least: LEAST_ROUND, record: true, ..*goal };
    let to_go = original.triangles.len().saturating_sub(goal.triangles) as u64;
    let mut passes: Vec<Pass> = vec![];
    let mut attempts = 0;
    let mut lost = Lost { failures: vec![0; original.points.len()], locked };
    let mut ledger = None;
    let mut state = start.with_locks(&lost.locked);
    loop {
        let State { mesh, lists, mut history } = state;
        let importance = importance_of(&mesh, &history, &options.importance);
        let records =
            TrackedRecords::<D, K>::new(original, &limits, options.weight, importance, lists, options.rules);
        // Undone triangles have to go again, and proofs have no comparable unit: only collapses report
        // progress.
        let gone = original.triangles.len() - mesh.triangles.len();
        let outcome = collapse(mesh, records, &goal, &mut progress.part(gone as u64, to_go))?;
        let proving = &mut progress.silent();
        let (mesh, lists) = (outcome.mesh, outcome.records.lists);
        attempts += outcome.attempts;
        history.append(outcome.logs);
        let mut known = match ledger.take() {
            Some(known) => known,
            None => Ledger::new(original, decision, apart)?,
        };
        let unproven = known.look(&mesh, proving)?;
        passes.push(Pass { triangles: mesh.triangles.len(), unproven, collapses: history.kept(), attempts });
        let proven = unproven == [0, 0];
        let news = if passes.len() >= HOPE { known.look_for_hopeless(proving)? } else { 0 };
        let open = known.open();
        let settled = open.is_empty() && (proven || passes.len() >= HOPE && news == 0);
        state = State { mesh, lists, history };
        let is_rest_left = options.to_the_end && outcome.stop == Stop::Few;
        let settled = settled || state.history.is_settled();
        if (settled && !is_rest_left) || outcome.stop == Stop::Enough {
            return Ok(Reached { state, ledger: known, proven, stop: outcome.stop, passes });
        }
        progress.check()?;
        if settled {
            // Everything is proven: now try the remaining single edges, too.
            goal.least = 0.0;
        } else {
            state = state.step_back(original, &mut known, &open, &mut limits, &mut lost, passes.len());
        }
        ledger = Some(known);
    }
}

/// Compute the initial limits of the samples.
fn limits_of(options: &Options, bounds: Deviation, least: Deviation, vertices: usize) -> Limits {
    let factor = |v: usize| options.importance.get(v).map_or(1.0, |i| i.max(1.0) as f32);
    Limits {
        shape: options.share * (bounds.shape - 0.5 * least.shape),
        color: options.share * (bounds.color - certify::COLOR_SLACK),
        factors: (0..vertices).map(|v| 1.0 / factor(v)).collect(),
        needle: options.rules.needle,
    }
}

/// Compute the certificate of a result: bounds per triangle, or only the requested bounds.
fn certificate_of<const D: usize>(
    mesh: &Compact<D>,
    ledger: &mut Ledger<'_, D>,
    proven: bool,
    options: &Options,
    threads: usize,
    progress: &mut Progress,
) -> Result<Certificate, KernelError> {
    if !options.close {
        return ledger.certificate(mesh, &options.proof, progress);
    }
    let result = Surface::new(&mesh.points, &mesh.triangles, threads)?;
    let proof = certify::Options { limit: None, threads, ..options.proof };
    let close = certify::certify(&result, ledger.surface(), &proof, progress)?;
    Ok(if proven { ledger.closer(close) } else { close })
}

/// The mesh between two passes, with the samples of its triangles and its history.
pub struct State<'a, const D: usize> {
    pub mesh: Whole<D, Bound>,
    pub lists: Lists,
    pub history: History<'a, D>,
}

impl<'a, const D: usize> State<'a, D> {
    /// Create the state of the unchanged input; `in_order` if the collapse order is needed.
    ///
    /// # Errors
    /// As [`Whole::new`].
    pub fn of_input(original: &'a Original<D>, in_order: bool) -> Result<Self, KernelError> {
        Ok(Self {
            mesh: Whole::new(original.points.clone(), original.triangles.clone(), vec![])?,
            lists: Lists::of_input(original),
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
struct Lost {
    /// Number of failures, saturating.
    failures: Vec<u8>,
    locked: Vec<bool>,
}

impl<'a, const D: usize> State<'a, D> {
    /// Undo collapses around unproven triangles, and tighten the limits there.
    ///
    /// `passes` is the number of passes so far.
    fn step_back(
        self,
        original: &'a Original<D>,
        ledger: &mut Ledger<'_, D>,
        open: &Open,
        limits: &mut Limits,
        lost: &mut Lost,
        passes: usize,
    ) -> Self {
        let Self { mesh, lists, history } = self;
        let watched = Watched::new(original, &mesh.triangle_source, &lists);
        let mut retreat = Retreat::new(original, history, watched);
        let Lost { failures, locked } = lost;
        for v in retreat.samples_around(&mesh, open) {
            limits.factors[v as usize] *= TIGHTER;
            failures[v as usize] = failures[v as usize].saturating_add(1);
        }
        let stubborn = |times: usize| {
            let times = if passes < IMPATIENCE * times { times as u8 } else { 0 };
            retreat.stubborn(open, failures, times)
        };
        let mut for_good = retreat.vertices_around(&stubborn(PATIENCE));
        for_good.extend(ledger.hopeless.iter().flat_map(|&t| original.triangles[t as usize]));
        let given_up = stubborn(END);
        ledger.give_up(retreat.take_back(open, failures));
        ledger.give_up([given_up.of_result, given_up.of_input].concat());
        retreat.lock(&for_good, locked);
        let (mesh, lists, history) = retreat.mesh(mesh, locked);
        Self { mesh, lists, history }
    }
}

/// Compute the importance of each vertex of the current mesh: the maximum of the input vertices it contains.
fn importance_of<const D: usize>(
    mesh: &Whole<D, Bound>,
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
