//! Proven bounds on how far two surfaces are apart, in shape and in colour, everywhere.
//!
//! Sampling (Cignoni, Rocchini and Scopigno, "Metro: measuring error on simplified surfaces", 1998) sees the samples
//! only. Here every triangle is covered by convex pieces, and each is bounded as a whole:
//!
//! * *shape*: the distance to one triangle is convex, and so at most its value at one of the piece's corners; and the
//!   distance to a surface grows no faster than one moves. Refining where the bound is greatest goes back to Tang, Lee
//!   and Kim, "Interactive Hausdorff distance computation for general polygonal models", 2009.
//! * *colour*: a piece is clipped against every triangle its nearest points may be on. Where they are on one
//!   face, side or corner they move linearly, and the difference of two linear colours is greatest at a corner;
//!   elsewhere the gradient bounds what is missing.
//!
//! Nothing is asked of the meshes: holes, several layers, triangles without area are all right. Where several points
//! are equally near, or within `slack` of it, the bound holds for each of them.

mod facet;
mod parallel;
mod piece;
mod polygon;
mod refine;
mod surface;

pub use piece::Deviation;
pub use surface::{NEEDLE, Surface};

use parallel::{for_chunks, thread_count};
use piece::{Against, Share, Wanted};
use polygon::Corner;
use refine::{Goal, Outcome, Workspace, refine};
use surface::around;

use crate::error::KernelError;
use crate::geometry::{norm2, sub};
use crate::progress::Progress;

/// Triangles a thread takes at a time.
const CHUNK: usize = 256;
/// Neighbouring slots whose vertices are searched for from one place.
const BLOCK: u32 = 64;
/// What colours lose on their way: measured, interpolated and compared in single precision.
pub const COLOR_SLACK: f64 = 1.0 / 512.0;
/// Pieces of one triangle before the greatest bound is known; most need fewer than ten.
const FIRST_PIECES: usize = 64;
/// The same for a decision: what fails is found early, and what does not would have to begin again.
const DECISION_PIECES: usize = 4096;
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
    /// Distance within which points count as equally near, metres; None for what single precision can tell.
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
    let slack = slack([result, original], options.slack);
    // A bound contains the slack, and what is attained does not.
    let least = Deviation { shape: 2.0 * slack, color: 0.0 };
    let limit = options.limit.map(without_slack);
    let options = &Options { absolute_tolerance: options.absolute_tolerance.max(least), limit, ..*options };
    let absolute = options.absolute_tolerance;
    let mut sides = both_sides(result, original, options, limit.map_or(Wanted::All, Wanted::Beyond));
    let mut run = Run { threads: thread_count(options.threads), progress, done: 0, total: 0, pieces: 0 };
    if result.is_empty() || original.is_empty() {
        return Ok(one_sided(&sides, slack));
    }
    let everything = sides.each_ref().map(|side| (0..side.mesh.len() as u32).collect::<Vec<u32>>());
    let all = result.len() + original.len();
    run.total = (2 * all) as u64;
    for (side, slots) in sides.iter_mut().zip(&everything) {
        side.look_at_vertices(slots, &mut run)?;
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
    for (side, slots) in sides.iter_mut().zip(&everything) {
        side.bound(slots, &first, keep, CHUNK, &mut run)?;
    }
    run.tighten(&mut sides, options, all)?;
    Ok(finished(&sides, attained(&sides), slack, limit, run.pieces))
}

/// What a decision found of one triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict {
    /// The limit itself where the triangle is proven to stay within it, and more where it is not.
    pub bound: Deviation,
    /// The greatest deviation at a point that was looked at.
    pub attained: Deviation,
}

/// Which of the triangles `asked` (of the result, of the original; numbers in the order of the input) stay within
/// `options.limit`, in the order asked. The cost follows the number asked, and each is decided as if asked alone.
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
    let within = options.limit.unwrap_or(EVERYTHING);
    let limit = without_slack(within);
    let options = &Options { limit: Some(limit), ..*options };
    if result.is_empty() || original.is_empty() {
        return Ok(asked.map(|asked| vec![Verdict { bound: EVERYTHING, attained: EVERYTHING }; asked.len()]));
    }
    let mut sides = both_sides(result, original, options, Wanted::None);
    let mut run = Run { threads: thread_count(options.threads), progress, done: 0, total: 0, pieces: 0 };
    let all = asked[0].len() + asked[1].len();
    run.total = (2 * all) as u64;
    // In the order of the slots neighbours follow each other, and each is looked at once.
    let slots = [0, 1].map(|i| {
        let mut slots: Vec<u32> = asked[i].iter().map(|&t| sides[i].mesh.slots[t as usize]).collect();
        slots.sort_unstable();
        slots.dedup();
        slots
    });
    for (side, slots) in sides.iter_mut().zip(&slots) {
        side.look_at_vertices(slots, &mut run)?;
        side.bound(slots, &Goal::decision(limit, DECISION_PIECES), limit, CHUNK, &mut run)?;
    }
    run.tighten(&mut sides, options, all)?;
    let with_color = sides[0].against.with_color;
    let verdict = |side: &Side<'_>, slot: u32| {
        let bound = side.bounds[slot as usize];
        let color = if with_color { bound.color + COLOR_SLACK } else { 0.0 };
        let color_within = if with_color { within.color } else { 0.0 };
        let bound = Deviation {
            shape: bound.shape.max(within.shape),
            color: if bound.color <= limit.color { color_within } else { color },
        };
        Verdict { bound, attained: side.attained_at[slot as usize] }
    };
    Ok([0, 1].map(|i| {
        let side = &sides[i];
        asked[i].iter().map(|&t| verdict(side, side.mesh.slots[t as usize])).collect()
    }))
}

/// What colours lose on their way is not left to the search.
fn without_slack(limit: Deviation) -> Deviation {
    Deviation { color: limit.color - COLOR_SLACK, ..limit }
}

/// The two directions; of the second it is `wanted` what falls on the result.
fn both_sides<'a>(
    result: &'a Surface,
    original: &'a Surface,
    options: &Options,
    wanted: Wanted,
) -> [Side<'a>; 2] {
    let with_color = !result.colors.is_empty()
        && !original.colors.is_empty()
        && options.limit.is_none_or(|limit| limit.color < f64::INFINITY);
    let slack = slack([result, original], options.slack);
    let color_range = color_range(result, original);
    let against = |target, wanted| Against { target, slack, color_range, with_color, wanted };
    [Side::new(result, against(original, Wanted::None)), Side::new(original, against(result, wanted))]
}

/// One direction: the triangles of `mesh` against the other surface. By slot of `mesh` unless said otherwise.
struct Side<'a> {
    mesh: &'a Surface,
    against: Against<'a>,
    /// By vertex: the nearest slot of the target, and the deviation there.
    vertices: Vec<(u32, Deviation)>,
    bounds: Vec<Deviation>,
    attained_at: Vec<Deviation>,
    /// By slot of the target: what falls on it.
    on_target: Vec<Deviation>,
    /// Triangles whose bound is not close enough yet.
    pending: Vec<(u32, Outcome)>,
    attained: Deviation,
}

struct Run<'a, 'b> {
    threads: usize,
    progress: &'a mut Progress<'b>,
    done: u64,
    total: u64,
    pieces: u64,
}

impl<'a> Side<'a> {
    fn new(mesh: &'a Surface, against: Against<'a>) -> Self {
        let on_target =
            vec![Deviation::default(); if against.wanted == Wanted::None { 0 } else { against.target.len() }];
        Self {
            mesh,
            against,
            vertices: vec![],
            bounds: vec![Deviation::default(); mesh.len()],
            attained_at: vec![Deviation::default(); mesh.len()],
            on_target,
            pending: vec![],
            attained: Deviation::default(),
        }
    }

    fn corners(&self, slot: u32) -> [Corner; 3] {
        let (at, colors) = (self.mesh.corners(slot), self.mesh.corner_colors(slot));
        [0, 1, 2].map(|i| Corner { at: at[i], color: colors[i], reach: f64::INFINITY })
    }

    /// Vertices are where simplified surfaces stray most; and the search for a triangle starts from a corner's end.
    fn look_at_vertices(&mut self, slots: &[u32], run: &mut Run<'_, '_>) -> Result<(), KernelError> {
        let mut first_use = vec![];
        let mut seen = vec![false; self.mesh.points.len()];
        for &slot in slots {
            for (i, &v) in self.mesh.vertices[slot as usize].iter().enumerate() {
                if !std::mem::replace(&mut seen[v as usize], true) {
                    first_use.push((slot, i as u8));
                }
            }
        }
        let this = &*self;
        let look = |chunk: usize| {
            let mut start = Start::default();
            let uses = &first_use[chunk * CHUNK..first_use.len().min((chunk + 1) * CHUNK)];
            let found = uses.iter().map(|&(slot, i)| {
                let corner = this.corners(slot)[usize::from(i)];
                let hint = start.near(this, slot);
                let found = this.against.target.nearest(&corner.at, hint);
                (found.slot, this.against.deviation(&corner, found.slot, found.distance))
            });
            found.collect::<Vec<_>>()
        };
        let found = run.chunks(first_use.len().div_ceil(CHUNK), CHUNK, || (), |chunk, (), _| look(chunk))?.0;
        self.vertices = vec![(0, Deviation::default()); self.mesh.points.len()];
        for (&(slot, i), found) in first_use.iter().zip(found.into_iter().flatten()) {
            self.vertices[self.mesh.vertices[slot as usize][usize::from(i)] as usize] = found;
            self.attained = self.attained.max(found.1);
        }
        Ok(())
    }

    /// Bound the triangles in `slots`; those not within `keep` are left pending.
    fn bound(
        &mut self,
        slots: &[u32],
        goal: &Goal,
        keep: Deviation,
        chunk_size: usize,
        run: &mut Run<'_, '_>,
    ) -> Result<(), KernelError> {
        let this = &*self;
        let state = || (Workspace::default(), vec![Deviation::default(); this.on_target.len()]);
        let work = |chunk: usize,
                    (workspace, on_target): &mut (Workspace, Vec<Deviation>),
                    go_on: parallel::GoOn<'_>| {
            let slots = &slots[chunk * chunk_size..slots.len().min((chunk + 1) * chunk_size)];
            let mut bounds = Vec::with_capacity(slots.len());
            let (mut pending, mut pieces, mut attained) = (vec![], 0, Deviation::default());
            for &slot in slots {
                let at_corners = this.mesh.vertices[slot as usize].map(|v| this.vertices[v as usize]);
                let mut hint = at_corners[0].0;
                let so_far = at_corners.iter().fold(Deviation::default(), |most, c| most.max(c.1));
                let outcome = refine(
                    &this.against,
                    this.corners(slot),
                    &mut hint,
                    so_far,
                    goal,
                    workspace,
                    &mut *go_on,
                );
                pieces += outcome.pieces as u64;
                attained = attained.max(outcome.attained);
                bounds.push((outcome.bound, outcome.attained));
                if outcome.bound.within(keep) {
                    receive(on_target, &outcome.shares);
                } else {
                    pending.push((slot, outcome));
                }
            }
            (bounds, pending, pieces, attained)
        };
        let (chunks, states) = run.chunks(slots.len().div_ceil(chunk_size), chunk_size, state, work)?;
        let mut at = slots.iter();
        for (bounds, pending, pieces, attained) in chunks {
            for ((bound, attained), &slot) in bounds.into_iter().zip(&mut at) {
                self.bounds[slot as usize] = bound;
                self.attained_at[slot as usize] = attained;
            }
            self.pending.extend(pending);
            run.pieces += pieces;
            self.attained = self.attained.max(attained);
        }
        for (_, on_target) in states {
            self.on_target.iter_mut().zip(on_target).for_each(|(a, b)| *a = a.max(b));
        }
        Ok(())
    }

    /// Look again at the pending triangles, with more pieces; what was proven before stays.
    fn tighten(&mut self, goal: &Goal, run: &mut Run<'_, '_>) -> Result<(), KernelError> {
        let mut before = std::mem::take(&mut self.pending);
        let slots: Vec<u32> = before.iter().map(|(slot, _)| *slot).collect();
        // Nothing is within this: all stay pending, and are told apart when the greatest deviation is known.
        let nothing = Deviation { shape: -1.0, color: -1.0 };
        self.bound(&slots, goal, nothing, 1, run)?;
        for ((slot, now), (_, before)) in self.pending.iter_mut().zip(&mut before) {
            now.bound = now.bound.min(before.bound);
            now.attained = now.attained.max(before.attained);
            now.shares = common(&now.shares, &before.shares);
            self.bounds[*slot as usize] = now.bound;
            self.attained_at[*slot as usize] = now.attained;
        }
        Ok(())
    }

    /// Let go of the pending triangles that `done` is true of.
    fn settle(&mut self, done: impl Fn(&Outcome) -> bool) {
        let on_target = &mut self.on_target;
        self.pending.retain(|(_, outcome)| {
            let done = done(outcome);
            if done {
                receive(on_target, &outcome.shares);
            }
            !done
        });
    }
}

/// Where the search for a vertex starts: near the block its slot is in. What is found then does not depend on which
/// others are asked for.
#[derive(Default)]
struct Start {
    /// A block, and the nearest slot of the target; none at first.
    block: Option<(u32, u32)>,
}

impl Start {
    fn near(&mut self, side: &Side<'_>, slot: u32) -> u32 {
        let block = slot / BLOCK;
        match self.block {
            Some((known, hint)) if known == block => hint,
            _ => {
                let first = side.mesh.corners(block * BLOCK)[0];
                let hint = side.against.target.nearest(&first, 0).slot;
                self.block = Some((block, hint));
                hint
            }
        }
    }
}

fn receive(on_target: &mut [Deviation], shares: &[Share]) {
    for share in shares {
        let there = &mut on_target[share.slot as usize];
        *there = there.max(share.deviation);
    }
}

/// Two proofs at once: what falls on a slot is bounded by both, and is nothing if one of them excludes it.
fn common(a: &[Share], b: &[Share]) -> Vec<Share> {
    let other = |share: &Share| b.binary_search_by_key(&share.slot, |s| s.slot).ok().map(|i| b[i].deviation);
    a.iter()
        .filter_map(|share| Some(Share { slot: share.slot, deviation: share.deviation.min(other(share)?) }))
        .collect()
}

impl Run<'_, '_> {
    fn chunks<S: Send, R: Send>(
        &mut self,
        chunks: usize,
        chunk_size: usize,
        state: impl Fn() -> S + Sync,
        work: impl Fn(usize, &mut S, parallel::GoOn<'_>) -> R + Sync,
    ) -> Result<(Vec<R>, Vec<S>), KernelError> {
        let so_far = (self.done, chunk_size as u64, self.total);
        let out = for_chunks(chunks, self.threads, state, work, self.progress, so_far)?;
        self.done += (chunks * chunk_size) as u64;
        Ok(out)
    }

    /// Spend pieces on the triangles that keep the greatest bound from the greatest deviation seen.
    fn tighten(
        &mut self,
        sides: &mut [Side<'_>; 2],
        options: &Options,
        triangles: usize,
    ) -> Result<(), KernelError> {
        let absolute = options.absolute_tolerance;
        let budget = self.pieces + (options.effort * (triangles + AT_LEAST) as f64) as u64;
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
            let more = (pieces * GROWTH).min((budget.saturating_sub(self.pieces) / pending) as usize);
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
                side.tighten(&goal, self)?;
            }
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

/// Vertices rounded to single precision move by half a step of the largest coordinate, and a search in single precision
/// is wrong by a few steps of the sizes it works with.
pub fn slack(surfaces: [&Surface; 2], wanted: Option<f64>) -> f64 {
    let [low, high] = around(surfaces.iter().filter(|s| !s.is_empty()).flat_map(|s| s.bounds));
    let largest = (0..3).map(|i| low[i].abs().max(high[i].abs())).fold(0.0, f64::max);
    if largest == f64::INFINITY {
        return 0.0;
    }
    let diagonal = norm2(&sub(&high, &low)).sqrt();
    // Double precision needs its share in any case.
    let least = 2f64.powi(-40) * largest;
    wanted.unwrap_or(2f64.powi(-22) * largest + 2f64.powi(-20) * diagonal).max(least)
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
    let in_order = |side: &Side<'_>, bounds: &mut dyn Iterator<Item = Deviation>| {
        let mut by_triangle = vec![Deviation::default(); side.mesh.len()];
        side.mesh.order.iter().zip(bounds).for_each(|(&t, bound)| by_triangle[t as usize] = bound);
        by_triangle
    };
    let [own, other] = sides;
    let bound = own.bounds.iter().chain(&other.bounds).fold(Deviation::default(), |most, b| most.max(*b));
    let both_ways = own.bounds.iter().zip(&other.on_target).map(|(a, b)| a.max(*b));
    Certificate {
        result: in_order(own, &mut both_ways.map(|d| sure(&d))),
        own: in_order(own, &mut own.bounds.iter().map(sure)),
        original: in_order(other, &mut other.bounds.iter().map(sure)),
        bound: sure(&bound),
        attained,
        slack,
        color_slack: COLOR_SLACK,
        pieces,
    }
}
