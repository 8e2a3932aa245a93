//! Bounds between two surfaces in both directions: for every triangle, or only to decide a given limit.

use super::one_sided_proof::{OneSidedProof, ProofRun, Verdict};
use super::piece_bounds::{AttributionMode, BoundContext, Deviation};
use super::refinement::{Goal, Outcome};
use super::surface::Surface;

use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, bounding_box, diagonal, norm2};
use crate::base::progress::Progress;

/// Error of colours that are measured, interpolated and compared in single precision, in levels.
pub const COLOR_SLACK: f64 = 1.0 / 512.0;
/// Maximum pieces per triangle before the largest bound is known; most triangles need fewer than ten.
const FIRST_ROUND_PIECES: usize = 64;
/// Maximum pieces per triangle in the first round of a decision; few undecided triangles are decided later.
const DECISION_PIECES: usize = super::decision::DECISION_FIRST_PIECES;
/// Triangles added to the budget, so that small meshes get enough pieces.
const EXTRA_BUDGET_TRIANGLES: usize = 4096;
/// Factor on the pieces per triangle from round to round.
const PIECES_GROWTH: usize = 8;
/// Maximum excess of the bound of a single triangle over its measured deviation, as a ratio.
const MAX_TRIANGLE_EXCESS_RATIO: f64 = 0.2;
/// Triangles below this ratio of the largest deviation are not bounded more tightly.
const UNIMPORTANT_RATIO: f64 = 0.02;

/// Infinite deviation.
const INFINITE_DEVIATION: Deviation = Deviation { shape: f64::INFINITY, color: f64::INFINITY };

/// Parameters of a proof.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Maximum excess of the largest bound over the largest measured deviation, as a ratio of the latter.
    pub tolerance: Deviation,
    /// The same in metres and levels. The larger one of both tolerances applies.
    pub absolute_tolerance: Deviation,
    /// Pieces per triangle, on average over both meshes, that may be spent on tightening.
    pub effort: f64,
    /// Only decide which triangles stay within this deviation; an infinite component does not matter.
    pub limit: Option<Deviation>,
    /// Slack in metres. Triangles farther than the nearest one by up to this, and points around the nearest
    /// point on each, count as nearest. `None` for the precision of a single-precision search.
    pub slack: Option<f64>,
    /// Number of threads; 0 for all processors. The result does not depend on it.
    pub threads: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            tolerance: Deviation { shape: 0.05, color: 0.05 },
            absolute_tolerance: Deviation { shape: 0.0, color: 1.0 },
            effort: 16.0,
            limit: None,
            slack: None,
            threads: 0,
        }
    }
}

impl Options {
    /// Compute the bound that is tight enough, given the largest measured deviation.
    pub fn sufficient_bound(&self, attained: Deviation) -> Deviation {
        tolerance_bound(attained, self.tolerance, self.absolute_tolerance)
    }
}

/// Proven upper bounds by triangle, in input order, and overall.
#[derive(Clone, Debug)]
pub struct Certificate {
    /// By triangle of the result, both directions: deviation of its points, and of all points of the original
    /// whose nearest point may be on it.
    pub result: Vec<Deviation>,
    /// By triangle of the result: deviation of its points only.
    pub from_result: Vec<Deviation>,
    /// By triangle of the original: deviation of its points from the result.
    pub original: Vec<Deviation>,
    pub bound: Deviation,
    /// Largest deviation at any measured point, a lower limit for `bound`.
    pub attained: Deviation,
    pub slack: f64,
    pub color_slack: f64,
    /// Number of pieces that were bounded.
    pub pieces: u64,
}

/// Bound the deviation between `result` and `original` in both directions.
///
/// If one of them has no triangles, the deviation of the other is infinite. With `options.limit`, a triangle
/// is finished as soon as it is proven to stay within the limit, or a point of it exceeds the limit. Its
/// bound then is the limit, or more.
///
/// # Errors
/// [`KernelError::Interrupted`] when the caller wants to stop.
pub fn certify(
    result: &Surface,
    original: &Surface,
    options: &Options,
    progress: &mut Progress,
) -> Result<Certificate, KernelError> {
    let everything = [result, original].map(|surface| (0..surface.len() as u32).collect());
    certify_slots(result, original, options, everything, progress)
}

/// As [`certify`], for some triangles.
///
/// `asked` are triangles of the result and of the original (input indices). Other triangles only get the
/// deviations attributed to them.
///
/// # Errors
/// [`KernelError::Interrupted`] when the caller wants to stop.
pub fn certify_triangles(
    result: &Surface,
    original: &Surface,
    options: &Options,
    asked: [&[u32]; 2],
    progress: &mut Progress,
) -> Result<Certificate, KernelError> {
    certify_slots(result, original, options, sorted_slots([result, original], asked), progress)
}

fn certify_slots(
    result: &Surface,
    original: &Surface,
    options: &Options,
    slots: [Vec<u32>; 2],
    progress: &mut Progress,
) -> Result<Certificate, KernelError> {
    let slack = compute_slack([result, original], options);
    // Bounds include the slack, but measured deviations do not.
    let least = Deviation { shape: 2.0 * slack, color: 0.0 };
    let limit = options.limit.map(subtract_color_slack);
    let options = &Options { absolute_tolerance: options.absolute_tolerance.max(least), limit, ..*options };
    let absolute = options.absolute_tolerance;
    let wanted = limit.map_or(AttributionMode::All, AttributionMode::Beyond);
    let all = slots.iter().map(Vec::len).sum();
    let mut sides = create_both_sides(result, original, slots, options, wanted);
    if result.is_empty() || original.is_empty() {
        return Ok(empty_surface_certificate(&sides, slack));
    }
    let mut run = ProofRun::new(options.threads, all, progress);
    for side in &mut sides {
        side.measure_vertices(&run)?;
    }
    let attained = |sides: &[OneSidedProof; 2]| sides[0].attained.max(sides[1].attained);
    let first = options.limit.map_or_else(
        || Goal {
            at_most: Deviation::default(),
            times_attained: 1.0 + MAX_TRIANGLE_EXCESS_RATIO,
            above_attained: unimportant_excess(attained(&sides), absolute),
            pieces: FIRST_ROUND_PIECES,
            decide: false,
        },
        |limit| Goal::decision(limit, DECISION_PIECES),
    );
    let keep =
        options.limit.unwrap_or_else(|| tolerance_bound(attained(&sides), options.tolerance, absolute));
    for side in &mut sides {
        side.bound_all(&first, keep, &mut run)?;
    }
    tighten(&mut sides, options, all, &mut run)?;
    Ok(assemble_certificate(&sides, attained(&sides), slack, limit, run.pieces))
}

/// As [`certify`], but bound only the surfaces as a whole, which is faster.
///
/// No triangle is bounded more tightly than the largest deviation requires. `options.limit` is ignored.
///
/// # Errors
/// [`KernelError::Interrupted`] when the caller wants to stop.
pub fn bound_whole(
    result: &Surface,
    original: &Surface,
    options: &Options,
    progress: &mut Progress,
) -> Result<Verdict, KernelError> {
    let surfaces = [result, original];
    if surfaces.iter().any(|surface| surface.is_empty()) {
        let none = surfaces.iter().all(|surface| surface.is_empty());
        let all = if none { Deviation::default() } else { INFINITE_DEVIATION };
        return Ok(Verdict { bound: all, attained: all, reach: all.shape });
    }
    // Bounds include the slack, but measured deviations do not.
    let least = Deviation { shape: 2.0 * compute_slack(surfaces, options), color: 0.0 };
    let absolute_tolerance = options.absolute_tolerance.max(least);
    let options = &Options { absolute_tolerance, limit: None, ..*options };
    let slots = surfaces.map(|surface| (0..surface.len() as u32).collect());
    let mut sides = create_both_sides(result, original, slots, options, AttributionMode::None);
    let all = result.len() + original.len();
    let mut run = ProofRun::new(options.threads, all, progress);
    for side in &mut sides {
        side.measure_vertices(&run)?;
    }
    let attained = |sides: &[OneSidedProof; 2]| sides[0].attained.max(sides[1].attained);
    // The largest deviation is usually at a vertex, so the remaining question is if any point exceeds it.
    let enough = tolerance_bound(attained(&sides), options.tolerance, absolute_tolerance);
    for side in &mut sides {
        side.bound_all(&Goal::decision(enough, FIRST_ROUND_PIECES), enough, &mut run)?;
    }
    tighten(&mut sides, options, all, &mut run)?;
    let found = sides.iter().flat_map(|side| &side.verdicts);
    let mut bound = found.fold(Deviation::default(), |most, found| most.max(found.bound));
    bound.color = if sides[0].against.with_color { bound.color + COLOR_SLACK } else { 0.0 };
    Ok(Verdict { bound, attained: attained(&sides), reach: bound.shape })
}

/// Decide which triangles stay within `options.limit`, in the order asked.
///
/// `asked` are triangles of the result and of the original (input indices). The cost depends only on their
/// number. With `options.effort` 0, the decision about a triangle does not depend on the others.
///
/// # Errors
/// [`KernelError::Interrupted`] when the caller wants to stop.
pub fn decide(
    result: &Surface,
    original: &Surface,
    options: &Options,
    asked: [&[u32]; 2],
    progress: &mut Progress,
) -> Result<[Vec<Verdict>; 2], KernelError> {
    let limit = options.limit.unwrap_or(INFINITE_DEVIATION);
    decide_with_limit(result, original, options, asked, |_| limit, progress).map(|(_, verdicts)| verdicts)
}

/// As [`decision`], with a limit computed from the largest deviation at the corners.
///
/// Also returns that limit. `options.limit` only states if colours matter.
///
/// # Errors
/// [`KernelError::Interrupted`] when the caller wants to stop.
pub fn decide_with_limit(
    result: &Surface,
    original: &Surface,
    options: &Options,
    asked: [&[u32]; 2],
    limit: impl FnOnce(Deviation) -> Deviation,
    progress: &mut Progress,
) -> Result<(Deviation, [Vec<Verdict>; 2]), KernelError> {
    if result.is_empty() || original.is_empty() {
        let verdicts = asked
            .map(|asked| vec![Verdict { attained: INFINITE_DEVIATION, ..Verdict::UNKNOWN }; asked.len()]);
        return Ok((limit(INFINITE_DEVIATION), verdicts));
    }
    let slots = sorted_slots([result, original], asked);
    let mut sides = create_both_sides(result, original, slots, options, AttributionMode::None);
    let all = asked[0].len() + asked[1].len();
    let mut run = ProofRun::new(options.threads, all, progress);
    for side in &mut sides {
        side.measure_vertices(&run)?;
    }
    let within = limit(sides[0].attained.max(sides[1].attained));
    let limit = subtract_color_slack(within);
    let options = &Options { limit: Some(limit), ..*options };
    for side in &mut sides {
        side.bound_all(&Goal::decision(limit, DECISION_PIECES), limit, &mut run)?;
    }
    tighten(&mut sides, options, all, &mut run)?;
    let with_color = sides[0].against.with_color;
    // Subtracting and adding the slack would not always restore the same number.
    let color = |found: f64| match with_color {
        true if found <= limit.color => within.color,
        true => found + COLOR_SLACK,
        false => 0.0,
    };
    let verdict = |side: &OneSidedProof<'_>, t: u32| {
        let Verdict { bound, attained, reach } =
            side.verdict_of_slot(side.mesh.slot_of_triangle[t as usize]).unwrap_or(Verdict::UNKNOWN);
        let bound = Deviation { shape: bound.shape.max(within.shape), color: color(bound.color) };
        Verdict { bound, attained, reach }
    };
    Ok((within, [0, 1].map(|i| asked[i].iter().map(|&t| verdict(&sides[i], t)).collect())))
}

/// Map triangles to sorted slots: neighbours follow each other, and each occurs once.
fn sorted_slots(surfaces: [&Surface; 2], asked: [&[u32]; 2]) -> [Vec<u32>; 2] {
    [0, 1].map(|i| {
        let mut slots: Vec<u32> =
            asked[i].iter().map(|&t| surfaces[i].slot_of_triangle[t as usize]).collect();
        slots.sort_unstable();
        slots.dedup();
        slots
    })
}

/// Reserve the error of single-precision colours.
fn subtract_color_slack(limit: Deviation) -> Deviation {
    Deviation { color: limit.color - COLOR_SLACK, ..limit }
}

/// Create both directions for the triangles in these slots. For the second one, `wanted` selects which
/// deviations are attributed to the result.
fn create_both_sides<'a>(
    result: &'a Surface,
    original: &'a Surface,
    [of_result, of_original]: [Vec<u32>; 2],
    options: &Options,
    wanted: AttributionMode,
) -> [OneSidedProof<'a>; 2] {
    let with_color = !result.colors.is_empty()
        && !original.colors.is_empty()
        && options.limit.is_none_or(|limit| limit.color < f64::INFINITY);
    let slack = compute_slack([result, original], options);
    let color_range = bound_color_range(result, original);
    let against =
        |target, wanted| BoundContext { target, slack, color_range, with_color, attribution: wanted };
    [
        OneSidedProof::new(result, of_result, against(original, AttributionMode::None)),
        OneSidedProof::new(original, of_original, against(result, wanted)),
    ]
}

/// Spend pieces on the triangles whose bounds exceed the largest measured deviation too much.
fn tighten(
    sides: &mut [OneSidedProof<'_>; 2],
    options: &Options,
    triangles: usize,
    run: &mut ProofRun<'_>,
) -> Result<(), KernelError> {
    let absolute = options.absolute_tolerance;
    let budget = run.pieces + (options.effort * (triangles + EXTRA_BUDGET_TRIANGLES) as f64) as u64;
    let first = if options.limit.is_some() { DECISION_PIECES } else { FIRST_ROUND_PIECES };
    let mut pieces = first;
    loop {
        let attained = sides[0].attained.max(sides[1].attained);
        let at_most = options.limit.unwrap_or_else(|| tolerance_bound(attained, options.tolerance, absolute));
        let decide = options.limit.is_some();
        // A triangle that did not use all its pieces cannot be bounded better. The first round stops earlier,
        // so it does not count.
        let settled = |outcome: &Outcome| {
            outcome.bound.is_within(at_most)
                || pieces > first && outcome.pieces < pieces
                || decide && !outcome.attained.is_within(at_most)
        };
        sides.iter_mut().for_each(|side| side.remove_finished(settled));
        let pending = (sides[0].pending.len() + sides[1].pending.len()) as u64;
        if pending == 0 {
            return Ok(());
        }
        let more = (pieces * PIECES_GROWTH).min((budget.saturating_sub(run.pieces) / pending) as usize);
        if more <= pieces {
            sides.iter_mut().for_each(|side| side.remove_finished(|_| true));
            return Ok(());
        }
        pieces = more;
        let goal = if decide {
            Goal::decision(at_most, pieces)
        } else {
            let tolerance = options.tolerance;
            let times_attained = 1.0 + tolerance.shape.min(tolerance.color);
            let above_attained = absolute;
            Goal { at_most, times_attained, above_attained, pieces, decide }
        };
        for side in sides.iter_mut() {
            side.tighten(&goal, run)?;
        }
    }
}

/// Compute the bound that is tight enough; the larger one of both tolerances applies.
fn tolerance_bound(attained: Deviation, share: Deviation, absolute: Deviation) -> Deviation {
    let one = |attained: f64, share: f64, absolute: f64| attained + (share * attained).max(absolute);
    Deviation {
        shape: one(attained.shape, share.shape, absolute.shape),
        color: one(attained.color, share.color, absolute.color),
    }
}

/// Compute the excess below which no single triangle is bounded more tightly.
fn unimportant_excess(attained: Deviation, absolute: Deviation) -> Deviation {
    Deviation {
        shape: (UNIMPORTANT_RATIO * attained.shape).max(absolute.shape),
        color: (UNIMPORTANT_RATIO * attained.color).max(absolute.color),
    }
}

/// Compute the slack in metres; `wanted` overrides the default.
///
/// Rounding vertices to single precision moves them by up to √3 · 2⁻²⁴ of the largest coordinate. A distance
/// changes by twice that, and a difference of distances by four times that. A single-precision search adds a
/// few rounding errors of the sizes it works with. `places` are corners of the surfaces, or of boxes around
/// them.
pub fn slack(places: impl Iterator<Item = Vec3>, wanted: Option<f64>) -> f64 {
    let [low, high] = bounding_box(places);
    let largest = (0..3).map(|i| low[i].abs().max(high[i].abs())).fold(0.0, f64::max);
    if largest == f64::INFINITY {
        return 0.0;
    }
    let diagonal = diagonal(&[low, high]);
    // Rounding error of double precision, which is the minimum.
    let least = 2f64.powi(-40) * largest;
    wanted.unwrap_or(2f64.powi(-21) * largest + 2f64.powi(-20) * diagonal).max(least)
}

/// Compute the slack for two surfaces.
fn compute_slack(surfaces: [&Surface; 2], options: &Options) -> f64 {
    slack(surfaces.iter().filter(|s| !s.is_empty()).flat_map(|s| s.bounds), options.slack)
}

/// Bound the difference between any two colours of the surfaces.
fn bound_color_range(a: &Surface, b: &Surface) -> f64 {
    if a.colors.is_empty() || b.colors.is_empty() {
        return 0.0;
    }
    let gap = |i: usize| {
        let ([low_a, high_a], [low_b, high_b]) = (a.color_bounds, b.color_bounds);
        (high_a[i] - low_b[i]).max(high_b[i] - low_a[i])
    };
    norm2(&[0, 1, 2].map(gap)).sqrt()
}

/// Create the certificate if at least one surface has no triangles.
fn empty_surface_certificate(sides: &[OneSidedProof<'_>; 2], slack: f64) -> Certificate {
    let all = |side: &OneSidedProof<'_>| vec![INFINITE_DEVIATION; side.mesh.len()];
    let bound =
        if sides.iter().all(|s| s.mesh.is_empty()) { Deviation::default() } else { INFINITE_DEVIATION };
    Certificate {
        result: all(&sides[0]),
        from_result: all(&sides[0]),
        original: all(&sides[1]),
        bound,
        attained: bound,
        slack,
        color_slack: COLOR_SLACK,
        pieces: 0,
    }
}

/// Create the certificate from the results of both directions.
fn assemble_certificate(
    sides: &[OneSidedProof<'_>; 2],
    attained: Deviation,
    slack: f64,
    limit: Option<Deviation>,
    pieces: u64,
) -> Certificate {
    let with_color = sides[0].against.with_color;
    // Triangles within the limit were not bounded more tightly.
    let least = limit.unwrap_or_default();
    let sure = |d: &Deviation| {
        let d = d.max(least);
        Deviation { shape: d.shape, color: if with_color { d.color + COLOR_SLACK } else { 0.0 } }
    };
    let in_order = |side: &OneSidedProof<'_>, of: &dyn Fn(usize) -> Deviation| -> Vec<Deviation> {
        side.mesh.slot_of_triangle.iter().map(|&slot| sure(&of(slot as usize))).collect()
    };
    let [own, other] = sides;
    let found = |side: &OneSidedProof, slot| side.verdict_of_slot(slot as u32).unwrap_or_default().bound;
    let all = own.verdicts.iter().chain(&other.verdicts);
    let bound = all.fold(Deviation::default(), |most, found| most.max(found.bound));
    Certificate {
        result: in_order(own, &|slot| found(own, slot).max(other.on_target(slot))),
        from_result: in_order(own, &|slot| found(own, slot)),
        original: in_order(other, &|slot| found(other, slot)),
        bound: sure(&bound),
        attained,
        slack,
        color_slack: COLOR_SLACK,
        pieces,
    }
}
