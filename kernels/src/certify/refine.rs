//! One triangle against the other surface: split into pieces until all are bounded well enough.
//!
//! A piece is cut along the outline of the triangle nearest to its middle, where the distance to that triangle is as
//! good as exact; or in two, where that cuts nothing.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::facet::Facet;
use super::piece::{Against, Deviation, Piece, Share, Wanted};
use super::polygon::{Corner, MOST, Polygon};
use crate::base::errors::KernelError;
use crate::base::geometry::Vec3;
use crate::base::progress::Progress;

/// A polygon with more corners is halved, not cut along an outline: three cuts may add three.
const MANY: usize = MOST / 2;
/// Share of a piece's radius that is too thin to be cut off.
const SLIVER: f64 = 0.02;

/// When a bound is good enough.
#[derive(Clone, Copy, Debug)]
pub struct Goal {
    /// Below this in any case;
    pub at_most: Deviation,
    /// or below this multiple of what some point of the triangle attains,
    pub times_attained: f64,
    /// or no more than so much above that.
    pub above_attained: Deviation,
    /// No more than this many pieces.
    pub pieces: usize,
    /// Stop where a point passes `at_most`: the question is only whether one does.
    pub decide: bool,
}

impl Goal {
    /// Which triangles stay within `limit`? Nothing that passes it is good enough.
    pub fn decision(limit: Deviation, pieces: usize) -> Self {
        let above_attained = Deviation { shape: f64::NEG_INFINITY, color: f64::NEG_INFINITY };
        Self { at_most: limit, times_attained: 0.0, above_attained, pieces, decide: true }
    }

    fn level(&self, attained: Deviation) -> Deviation {
        let one = |at_most: f64, above: f64, attained: f64| {
            at_most.max(self.times_attained * attained).max(above + attained)
        };
        Deviation {
            shape: one(self.at_most.shape, self.above_attained.shape, attained.shape),
            color: one(self.at_most.color, self.above_attained.color, attained.color),
        }
    }
}

/// What is proven of one triangle.
#[derive(Clone, Debug)]
pub struct Outcome {
    pub bound: Deviation,
    /// No point is farther from the other surface, with the slack: the bound on shape, or less where that was not asked for.
    pub reach: f64,
    pub attained: Deviation,
    pub pieces: usize,
    /// Slots the nearest points may be on, each once, in order; the bound of what falls on them.
    pub shares: Vec<Share>,
}

impl Outcome {
    /// Of no points so far, of which some are known to attain so much.
    pub fn new(attained: Deviation) -> Self {
        Self { bound: Deviation::default(), reach: 0.0, attained, pieces: 0, shares: vec![] }
    }
}

/// Pieces still to be looked at, and memory that the next triangle can use again.
#[derive(Default)]
pub struct Workspace {
    waiting: BinaryHeap<Waiting>,
    shares: Vec<Share>,
}

struct Waiting {
    excess: f64,
    number: usize,
    piece: Box<Piece>,
}

/// Bound one triangle, of which some points are known to attain `attained`.
///
/// # Errors
/// [`KernelError::Interrupted`] when the caller wants to stop.
pub fn refine(
    against: &Against<'_>,
    triangle: [Corner; 3],
    hint: &mut u32,
    attained: Deviation,
    goal: &Goal,
    workspace: &mut Workspace,
    progress: &mut Progress,
) -> Result<Outcome, KernelError> {
    let Workspace { waiting, shares } = workspace;
    waiting.clear();
    shares.clear();
    let color = if against.with_color { against.color_range } else { 0.0 };
    let everything = Deviation { shape: f64::INFINITY, color };
    let mut outcome = Outcome::new(attained);
    let mut parts = vec![(Polygon::new(triangle), *hint)];
    let mut parent = everything;
    loop {
        for (polygon, near) in parts.drain(..) {
            progress.check_now_and_then()?;
            let so_far = outcome.attained;
            let wanted = |at_centre| goal.level(so_far.max(at_centre));
            let (piece, at_centre) = against.piece(polygon, near, parent, wanted, shares);
            *hint = piece.slot;
            outcome.attained = outcome.attained.max(at_centre);
            outcome.pieces += 1;
            let level = goal.level(outcome.attained);
            // What is smaller than the slack would gain nothing from being split.
            if piece.bound.within(level) || piece.radius < against.slack {
                finish(against, &piece, shares, &mut outcome);
            } else {
                let excess = excess(piece.bound, level);
                waiting.push(Waiting { excess, number: outcome.pieces, piece: Box::new(piece) });
            }
        }
        let passed = goal.decide && !outcome.attained.within(goal.at_most);
        if passed || outcome.pieces >= goal.pieces {
            break;
        }
        let Some(Waiting { piece, .. }) = waiting.pop() else { break };
        let level = goal.level(outcome.attained);
        if piece.bound.within(level) {
            finish(against, &piece, shares, &mut outcome);
            continue;
        }
        let shape_first = piece.bound.shape > level.shape;
        let probe = &piece.worst[usize::from(!shape_first)];
        let found = against.target.nearest(&probe.at, piece.slot);
        outcome.attained = outcome.attained.max(against.deviation(probe, found.slot, found.distance));
        parent = piece.bound;
        let wanted = if shape_first { (level.shape - against.slack).max(0.0) } else { 0.0 };
        parts.extend(split(against, &piece, wanted).into_iter().map(|part| (part, piece.slot)));
    }
    for Waiting { piece, .. } in waiting.drain() {
        finish(against, &piece, shares, &mut outcome);
    }
    merge(&mut outcome.shares);
    outcome.reach = outcome.bound.shape;
    Ok(outcome)
}

fn excess(bound: Deviation, level: Deviation) -> f64 {
    let over = |bound: f64, level: f64| if bound <= level { 0.0 } else { bound / level };
    over(bound.shape, level.shape).max(over(bound.color, level.color))
}

fn finish(against: &Against<'_>, piece: &Piece, shares: &[Share], outcome: &mut Outcome) {
    outcome.bound = outcome.bound.max(piece.bound);
    let wanted = match against.wanted {
        Wanted::None => false,
        Wanted::All => true,
        Wanted::Beyond(limit) => !piece.bound.within(limit),
    };
    if let Some((first, last)) = piece.shares {
        outcome.shares.extend_from_slice(&shares[first..last]);
    } else if wanted {
        against.shares(piece, &mut outcome.shares);
    }
}

fn merge(shares: &mut Vec<Share>) {
    shares.sort_unstable_by_key(|share| share.slot);
    shares.dedup_by(|next, kept| {
        let same = next.slot == kept.slot;
        if same {
            kept.deviation = kept.deviation.max(next.deviation);
        }
        same
    });
}

/// Parts that cover the piece: what is within `wanted` of the nearest triangle's face and what is not, or halves.
fn split(against: &Against<'_>, piece: &Piece, wanted: f64) -> Vec<Polygon> {
    let polygon = &piece.polygon;
    if polygon.len() <= MANY
        && let Some(facet) = Facet::new(&against.target.corners(piece.slot))
    {
        let height = polygon.iter().map(|c| facet.height(&c.at).abs()).fold(0.0, f64::max);
        let margin = (wanted * wanted - height * height).max(0.0).sqrt();
        // What may be left uncut must still be within the margin, if there is one.
        let sliver = SLIVER * piece.radius;
        let least = if margin > 0.0 { sliver.min(0.5 * margin) } else { sliver };
        let parts = cut_along(polygon, &facet, (margin - least).max(0.0), least);
        if parts.len() > 1 {
            return parts;
        }
    }
    polygon.halves().into()
}

/// The part inside the outline moved out by `margin`, then those outside; one if the outline cuts nothing. A cut leaves
/// more than `least` on either side: rounding could else cut off nothing, again and again.
fn cut_along(polygon: &Polygon, facet: &Facet, margin: f64, least: f64) -> Vec<Polygon> {
    let mut inside = *polygon;
    let mut parts = vec![];
    for opposite in 0..3 {
        let level = |p: &Vec3| facet.depth(p, opposite) + margin;
        if inside.iter().all(|c| level(&c.at) >= -least) {
            continue;
        }
        if inside.iter().all(|c| level(&c.at) <= least) {
            return vec![];
        }
        parts.push(inside.clipped(|p| -level(p)));
        inside.clip(level);
    }
    parts.insert(0, inside);
    parts
}

impl Ord for Waiting {
    /// The worst first, then the oldest: the same order in every run.
    fn cmp(&self, other: &Self) -> Ordering {
        self.excess.total_cmp(&other.excess).then(other.number.cmp(&self.number))
    }
}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Waiting {}
