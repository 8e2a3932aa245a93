//! Bounds for two surfaces, both ways: of every triangle, or only as close as a limit asks.

use super::piece::{Against, Deviation, Wanted};
use super::refine::{Goal, Outcome};
use super::side::{Run, Side, Verdict};
use super::surface::Surface;

use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, around, diagonal, norm2};
use crate::base::progress::Progress;

/// What colours lose on their way: measured, interpolated and compared in single precision.
pub const COLOR_SLACK: f64 = 1.0 / 512.0;
/// Pieces of one triangle before the greatest bound is known; most need fewer than ten.
const FIRST_PIECES: usize = 64;
/// The same for a decision: few that are not decided by then ever are.
const DECISION_PIECES: usize = super::decide::FIRST;
/// Small meshes may cost as much as one of so many triangles.
const AT_LEAST: usize = 4096;
/// Each round allows so many times the pieces of the one before.
const GROWTH: usize = 8;
/// Bounds of single triangles are this close to what they attain,
const TRIANGLE_EXCESS: f64 = 0.2;
/// or below this share of the greatest deviation: nobody looks there.
const UNIMPORTANT: f64 = 0.02;

/// Nothing is beyond this.
const EVERYTHING: Deviation = Deviation { shape: f64::INFINITY, color: f64::INFINITY };

#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// The greatest bound should pass the greatest deviation seen by no more than this share of it,
    pub tolerance: Deviation,
    /// or by no more than this, in metres and levels.
    pub absolute_tolerance: Deviation,
    /// Pieces a triangle, on average over both meshes, that may be spent on coming closer.
    pub effort: f64,
    /// Only find out which triangles stay within these; infinite for what does not matter.
    pub limit: Option<Deviation>,
    /// Triangles so much farther away than the nearest one count as well, and points so far around the nearest one on
    /// each, metres; None for what single precision can tell.
    pub slack: Option<f64>,
    /// 0 for all processors. The result is the same for any number.
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
    /// What no greatest bound needs to be closer than, given the greatest deviation seen.
    pub fn enough(&self, attained: Deviation) -> Deviation {
        worth_all(attained, self.tolerance, self.absolute_tolerance)
    }
}

/// Upper bounds by triangle, in the order of the input, and of everything.
#[derive(Clone, Debug)]
pub struct Certificate {
    /// For each triangle of the result, both ways: from its own points, and from all points of the original
    /// whose nearest point may be on it.
    pub result: Vec<Deviation>,
    /// For each triangle of the result, from its own points only.
    pub own: Vec<Deviation>,
    /// For each triangle of the original, from its points to the result.
    pub original: Vec<Deviation>,
    pub bound: Deviation,
    /// The greatest deviation at a point that was looked at: the bound cannot be less.
    pub attained: Deviation,
    pub slack: f64,
    pub color_slack: f64,
    /// Pieces that were bounded.
    pub pieces: u64,
}

/// Bound the deviation between `result` and `original`, both ways. Where one of them has no triangles, the other is
/// infinitely far from it.
///
/// With `options.limit` a triangle is left as soon as it is proven to stay within it, or a point of it does
/// not. Its bound then is the limit, or more than that.
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

/// The same for the triangles `asked` alone (of the result, of the original; numbers in the order of the input): nothing
/// is found of the others, but what falls on them from those asked.
///
/// # Errors
/// [`KernelError::Interrupted`] when the caller wants to stop.
pub fn certify_some(
    result: &Surface,
    original: &Surface,
    options: &Options,
    asked: [&[u32]; 2],
    progress: &mut Progress,
) -> Result<Certificate, KernelError> {
    certify_slots(result, original, options, slots_of([result, original], asked), progress)
}

fn certify_slots(
    result: &Surface,
    original: &Surface,
    options: &Options,
    slots: [Vec<u32>; 2],
    progress: &mut Progress,
) -> Result<Certificate, KernelError> {
    let slack = slack_of([result, original], options);
    // A bound contains the slack, and what is attained does not.
    let least = Deviation { shape: 2.0 * slack, color: 0.0 };
    let limit = options.limit.map(without_slack);
    let options = &Options { absolute_tolerance: options.absolute_tolerance.max(least), limit, ..*options };
    let absolute = options.absolute_tolerance;
    let wanted = limit.map_or(Wanted::All, Wanted::Beyond);
    let all = slots.iter().map(Vec::len).sum();
    let mut sides = both_sides(result, original, slots, options, wanted);
    if result.is_empty() || original.is_empty() {
        return Ok(one_sided(&sides, slack));
    }
    let mut run = Run::new(options.threads, all, progress);
    for side in &mut sides {
        side.look_at_vertices(&run)?;
    }
    let attained = |sides: &[Side; 2]| sides[0].attained.max(sides[1].attained);
    let first = options.limit.map_or_else(
        || Goal {
            at_most: Deviation::default(),
            times_attained: 1.0 + TRIANGLE_EXCESS,
            above_attained: unimportant(attained(&sides), absolute),
            pieces: FIRST_PIECES,
            decide: false,
        },
        |limit| Goal::decision(limit, DECISION_PIECES),
    );
    let keep = options.limit.unwrap_or_else(|| worth_all(attained(&sides), options.tolerance, absolute));
    for side in &mut sides {
        side.bound(&first, keep, &mut run)?;
    }
    tighten(&mut sides, options, all, &mut run)?;
    Ok(finished(&sides, attained(&sides), slack, limit, run.pieces))
}

/// The same for both surfaces as wholes, which takes a part of the time: no triangle is bounded more closely than the
/// greatest deviation of all asks for. `options.limit` is not used.
///
/// # Errors
/// [`KernelError::Interrupted`] when the caller wants to stop.
pub fn greatest(
    result: &Surface,
    original: &Surface,
    options: &Options,
    progress: &mut Progress,
) -> Result<Verdict, KernelError> {
    let surfaces = [result, original];
    if surfaces.iter().any(|surface| surface.is_empty()) {
        let none = surfaces.iter().all(|surface| surface.is_empty());
        let all = if none { Deviation::default() } else { EVERYTHING };
        return Ok(Verdict { bound: all, attained: all, reach: all.shape });
    }
    // A bound contains the slack, and what is attained does not.
    let least = Deviation { shape: 2.0 * slack_of(surfaces, options), color: 0.0 };
    let absolute_tolerance = options.absolute_tolerance.max(least);
    let options = &Options { absolute_tolerance, limit: None, ..*options };
    let slots = surfaces.map(|surface| (0..surface.len() as u32).collect());
    let mut sides = both_sides(result, original, slots, options, Wanted::None);
    let all = result.len() + original.len();
    let mut run = Run::new(options.threads, all, progress);
    for side in &mut sides {
        side.look_at_vertices(&run)?;
    }
    let attained = |sides: &[Side; 2]| sides[0].attained.max(sides[1].attained);
    // Most often vertices stray most, and the question is whether anything strays farther.
    let enough = worth_all(attained(&sides), options.tolerance, absolute_tolerance);
    for side in &mut sides {
        side.bound(&Goal::decision(enough, FIRST_PIECES), enough, &mut run)?;
    }
    tighten(&mut sides, options, all, &mut run)?;
    let found = sides.iter().flat_map(|side| &side.found);
    let mut bound = found.fold(Deviation::default(), |most, found| most.max(found.bound));
    bound.color = if sides[0].against.with_color { bound.color + COLOR_SLACK } else { 0.0 };
    Ok(Verdict { bound, attained: attained(&sides), reach: bound.shape })
}

/// Which of the triangles `asked` (of the result, of the original; numbers in the order of the input) stay within
/// `options.limit`, in the order asked. The cost follows the number asked. Without `options.effort` each is decided as if
/// asked alone.
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
    let limit = options.limit.unwrap_or(EVERYTHING);
    decide_within(result, original, options, asked, |_| limit, progress).map(|(_, verdicts)| verdicts)
}

/// The same with a limit that depends on the greatest deviation at the corners of the triangles asked for, which is
/// returned as well; `options.limit` is not used but for whether colours matter.
///
/// # Errors
/// [`KernelError::Interrupted`] when the caller wants to stop.
pub fn decide_within(
    result: &Surface,
    original: &Surface,
    options: &Options,
    asked: [&[u32]; 2],
    limit: impl FnOnce(Deviation) -> Deviation,
    progress: &mut Progress,
) -> Result<(Deviation, [Vec<Verdict>; 2]), KernelError> {
    if result.is_empty() || original.is_empty() {
        let verdicts =
            asked.map(|asked| vec![Verdict { attained: EVERYTHING, ..Verdict::UNKNOWN }; asked.len()]);
        return Ok((limit(EVERYTHING), verdicts));
    }
    let slots = slots_of([result, original], asked);
    let mut sides = both_sides(result, original, slots, options, Wanted::None);
    let all = asked[0].len() + asked[1].len();
    let mut run = Run::new(options.threads, all, progress);
    for side in &mut sides {
        side.look_at_vertices(&run)?;
    }
    let within = limit(sides[0].attained.max(sides[1].attained));
    let limit = without_slack(within);
    let options = &Options { limit: Some(limit), ..*options };
    for side in &mut sides {
        side.bound(&Goal::decision(limit, DECISION_PIECES), limit, &mut run)?;
    }
    tighten(&mut sides, options, all, &mut run)?;
    let with_color = sides[0].against.with_color;
    // Adding the slack to what it was taken from would not always give the same number.
    let color = |found: f64| match with_color {
        true if found <= limit.color => within.color,
        true => found + COLOR_SLACK,
        false => 0.0,
    };
    let verdict = |side: &Side<'_>, t: u32| {
        let Verdict { bound, attained, reach } =
            side.found_in(side.mesh.slots[t as usize]).unwrap_or(Verdict::UNKNOWN);
        let bound = Deviation { shape: bound.shape.max(within.shape), color: color(bound.color) };
        Verdict { bound, attained, reach }
    };
    Ok((within, [0, 1].map(|i| asked[i].iter().map(|&t| verdict(&sides[i], t)).collect())))
}

/// Slots of triangles. In their order neighbours follow each other, and each is looked at once.
fn slots_of(surfaces: [&Surface; 2], asked: [&[u32]; 2]) -> [Vec<u32>; 2] {
    [0, 1].map(|i| {
        let mut slots: Vec<u32> = asked[i].iter().map(|&t| surfaces[i].slots[t as usize]).collect();
        slots.sort_unstable();
        slots.dedup();
        slots
    })
}

/// What colours lose on their way is not left to the search.
fn without_slack(limit: Deviation) -> Deviation {
    Deviation { color: limit.color - COLOR_SLACK, ..limit }
}

/// The two directions, for the triangles in these slots; of the second it is `wanted` what falls on the result.
fn both_sides<'a>(
    result: &'a Surface,
    original: &'a Surface,
    [of_result, of_original]: [Vec<u32>; 2],
    options: &Options,
    wanted: Wanted,
) -> [Side<'a>; 2] {
    let with_color = !result.colors.is_empty()
        && !original.colors.is_empty()
        && options.limit.is_none_or(|limit| limit.color < f64::INFINITY);
    let slack = slack_of([result, original], options);
    let color_range = color_range(result, original);
    let against = |target, wanted| Against { target, slack, color_range, with_color, wanted };
    [
        Side::new(result, of_result, against(original, Wanted::None)),
        Side::new(original, of_original, against(result, wanted)),
    ]
}

/// Spend pieces on the triangles that keep the greatest bound from the greatest deviation seen.
fn tighten(
    sides: &mut [Side<'_>; 2],
    options: &Options,
    triangles: usize,
    run: &mut Run<'_>,
) -> Result<(), KernelError> {
    let absolute = options.absolute_tolerance;
    let budget = run.pieces + (options.effort * (triangles + AT_LEAST) as f64) as u64;
    let first = if options.limit.is_some() { DECISION_PIECES } else { FIRST_PIECES };
    let mut pieces = first;
    loop {
        let attained = sides[0].attained.max(sides[1].attained);
        let at_most = options.limit.unwrap_or_else(|| worth_all(attained, options.tolerance, absolute));
        let decide = options.limit.is_some();
        // One that did not use up its pieces cannot be bounded better; the first look was content with less.
        let settled = |outcome: &Outcome| {
            outcome.bound.within(at_most)
                || pieces > first && outcome.pieces < pieces
                || decide && !outcome.attained.within(at_most)
        };
        sides.iter_mut().for_each(|side| side.settle(settled));
        let pending = (sides[0].pending.len() + sides[1].pending.len()) as u64;
        if pending == 0 {
            return Ok(());
        }
        let more = (pieces * GROWTH).min((budget.saturating_sub(run.pieces) / pending) as usize);
        if more <= pieces {
            sides.iter_mut().for_each(|side| side.settle(|_| true));
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

fn worth_all(attained: Deviation, share: Deviation, absolute: Deviation) -> Deviation {
    let one = |attained: f64, share: f64, absolute: f64| attained + (share * attained).max(absolute);
    Deviation {
        shape: one(attained.shape, share.shape, absolute.shape),
        color: one(attained.color, share.color, absolute.color),
    }
}

/// What no single triangle needs to be bounded better than.
fn unimportant(attained: Deviation, absolute: Deviation) -> Deviation {
    Deviation {
        shape: (UNIMPORTANT * attained.shape).max(absolute.shape),
        color: (UNIMPORTANT * attained.color).max(absolute.color),
    }
}

/// Vertices rounded to single precision move by up to √3 · 2⁻²⁴ of the largest coordinate, so that a distance changes by
/// twice and the difference of two by four times that; and a search in single precision is wrong by a few steps of the
/// sizes it works with. `places` are corners of the surfaces, or of boxes around them.
pub fn slack(places: impl Iterator<Item = Vec3>, wanted: Option<f64>) -> f64 {
    let [low, high] = around(places);
    let largest = (0..3).map(|i| low[i].abs().max(high[i].abs())).fold(0.0, f64::max);
    if largest == f64::INFINITY {
        return 0.0;
    }
    let diagonal = diagonal(&[low, high]);
    // Double precision needs its share in any case.
    let least = 2f64.powi(-40) * largest;
    wanted.unwrap_or(2f64.powi(-21) * largest + 2f64.powi(-20) * diagonal).max(least)
}

fn slack_of(surfaces: [&Surface; 2], options: &Options) -> f64 {
    slack(surfaces.iter().filter(|s| !s.is_empty()).flat_map(|s| s.bounds), options.slack)
}

fn color_range(a: &Surface, b: &Surface) -> f64 {
    if a.colors.is_empty() || b.colors.is_empty() {
        return 0.0;
    }
    let gap = |i: usize| {
        let ([low_a, high_a], [low_b, high_b]) = (a.color_bounds, b.color_bounds);
        (high_a[i] - low_b[i]).max(high_b[i] - low_a[i])
    };
    norm2(&[0, 1, 2].map(gap)).sqrt()
}

fn one_sided(sides: &[Side<'_>; 2], slack: f64) -> Certificate {
    let all = |side: &Side<'_>| vec![EVERYTHING; side.mesh.len()];
    let bound = if sides.iter().all(|s| s.mesh.is_empty()) { Deviation::default() } else { EVERYTHING };
    Certificate {
        result: all(&sides[0]),
        own: all(&sides[0]),
        original: all(&sides[1]),
        bound,
        attained: bound,
        slack,
        color_slack: COLOR_SLACK,
        pieces: 0,
    }
}

fn finished(
    sides: &[Side<'_>; 2],
    attained: Deviation,
    slack: f64,
    limit: Option<Deviation>,
    pieces: u64,
) -> Certificate {
    let with_color = sides[0].against.with_color;
    // What is within the limit was not looked at more closely.
    let least = limit.unwrap_or_default();
    let sure = |d: &Deviation| {
        let d = d.max(least);
        Deviation { shape: d.shape, color: if with_color { d.color + COLOR_SLACK } else { 0.0 } }
    };
    let in_order = |side: &Side<'_>, of: &dyn Fn(usize) -> Deviation| -> Vec<Deviation> {
        side.mesh.slots.iter().map(|&slot| sure(&of(slot as usize))).collect()
    };
    let [own, other] = sides;
    let found = |side: &Side, slot| side.found_in(slot as u32).unwrap_or_default().bound;
    let all = own.found.iter().chain(&other.found);
    let bound = all.fold(Deviation::default(), |most, found| most.max(found.bound));
    Certificate {
        result: in_order(own, &|slot| found(own, slot).max(other.on_target(slot))),
        own: in_order(own, &|slot| found(own, slot)),
        original: in_order(other, &|slot| found(other, slot)),
        bound: sure(&bound),
        attained,
        slack,
        color_slack: COLOR_SLACK,
        pieces,
    }
}
