//! Refinement of one triangle: split into pieces until all are bounded tightly enough.
//!
//! A piece is cut along the outline of the triangle nearest to its centre. Inside the outline, the distance
//! to that triangle is nearly exact. If that cuts nothing, the piece is halved.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::facet::Facet;
use super::piece::{Against, Deviation, Piece, Share, Wanted};
use super::polygon::{Corner, MOST, Polygon};
use crate::base::errors::KernelError;
use crate::base::geometry::Vec3;
use crate::base::progress::Progress;

/// A polygon with more corners is halved, because three cuts along an outline may add three corners.
const MANY: usize = MOST / 2;
/// Minimum thickness of a part that is cut off, relative to the radius of the piece.
const SLIVER: f64 = 0.02;

/// Criteria for a bound that is tight enough; any one suffices.
#[derive(Clone, Copy, Debug)]
pub struct Goal {
    /// The bound is below this deviation.
    pub at_most: Deviation,
    /// The bound is below this multiple of the measured deviation of the triangle.
    pub times_attained: f64,
    /// The bound exceeds the measured deviation by at most this.
    pub above_attained: Deviation,
    /// Maximum number of pieces.
    pub pieces: usize,
    /// Stop as soon as a point exceeds the limit.
    pub decide: bool,
}

impl Goal {
    /// Create a goal that only decides if a triangle stays within `limit`.
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

/// Result for one triangle.
#[derive(Clone, Debug)]
pub struct Outcome {
    pub bound: Deviation,
    /// Upper bound on the distance of the other surface, including the slack. At most the bound on shape;
    /// less if a decision did not need the tighter bound.
    pub reach: f64,
    pub attained: Deviation,
    pub pieces: usize,
    /// Deviations by target slot, sorted, each slot once.
    pub shares: Vec<Share>,
}

impl Outcome {
    /// Create a result for no points yet, with a known measured deviation.
    pub fn new(attained: Deviation) -> Self {
        Self { bound: Deviation::default(), reach: 0.0, attained, pieces: 0, shares: vec![] }
    }
}

/// Queue of pieces, and buffers that are reused from triangle to triangle.
#[derive(Default)]
pub struct Workspace {
    waiting: BinaryHeap<Waiting>,
    shares: Vec<Share>,
}

/// A piece in the queue, ordered by its excess over the goal.
struct Waiting {
    excess: f64,
    number: usize,
    piece: Box<Piece>,
}

/// Bound one triangle; `attained` is the deviation known at some of its points.
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
            // Splitting a piece smaller than the slack gains nothing.
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

/// Compute the ratio of a bound to its goal; 0 if the goal is met.
fn excess(bound: Deviation, level: Deviation) -> f64 {
    let over = |bound: f64, level: f64| if bound <= level { 0.0 } else { bound / level };
    over(bound.shape, level.shape).max(over(bound.color, level.color))
}

/// Add the bounds and attributed deviations of a piece to the outcome.
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

/// Sort deviations by slot, and keep the maximum of each slot.
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

/// Split a piece along the nearest triangle's outline, or into halves.
///
/// The first part is within `wanted` of that triangle.
fn split(against: &Against<'_>, piece: &Piece, wanted: f64) -> Vec<Polygon> {
    let polygon = &piece.polygon;
    if polygon.len() <= MANY
        && let Some(facet) = Facet::new(&against.target.corners(piece.slot))
    {
        let height = polygon.iter().map(|c| facet.height(&c.at).abs()).fold(0.0, f64::max);
        let margin = (wanted * wanted - height * height).max(0.0).sqrt();
        // An uncut remainder must still be within the margin.
        let sliver = SLIVER * piece.radius;
        let least = if margin > 0.0 { sliver.min(0.5 * margin) } else { sliver };
        let parts = cut_along(polygon, &facet, (margin - least).max(0.0), least);
        if parts.len() > 1 {
            return parts;
        }
    }
    polygon.halves().into()
}

/// Cut along the outline of a facet, enlarged by `margin`: the inside first. One part if the outline cuts
/// nothing.
///
/// A cut leaves more than `least` on both sides; otherwise rounding could repeat it endlessly.
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
    /// Order by excess, largest first, then by age, so that runs are reproducible.
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
