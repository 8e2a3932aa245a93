//! Refinement of one triangle: split into pieces until all are bounded tightly enough.
//!
//! A piece is cut along the outline of the triangle nearest to its centre. Inside the outline, the distance
//! to that triangle is nearly exact. If that cuts nothing, the piece is halved.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::facet::Facet;
use super::piece_bounds::{AttributionMode, BoundContext, Deviation, Piece, SlotDeviation};
use super::polygon::{Corner, MAX_CORNERS, Polygon};
use crate::base::errors::KernelError;
use crate::base::geometry::Vec3;
use crate::base::progress::Progress;

/// A polygon with more corners is halved, because three cuts along an outline may add three corners.
const MAX_CORNERS_TO_CUT: usize = MAX_CORNERS / 2;
/// Minimum thickness of a part that is cut off, relative to the radius of the piece.
const MIN_CUT_RATIO: f64 = 0.02;

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

    fn required_bound(&self, attained: Deviation) -> Deviation {
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
    pub slot_deviations: Vec<SlotDeviation>,
}

impl Outcome {
    /// Create a result for no points yet, with a known measured deviation.
    pub fn new(attained: Deviation) -> Self {
        Self { bound: Deviation::default(), reach: 0.0, attained, pieces: 0, slot_deviations: vec![] }
    }
}

/// Queue of pieces, and buffers that are reused from triangle to triangle.
#[derive(Default)]
pub struct Workspace {
    waiting: BinaryHeap<QueuedPiece>,
    shares: Vec<SlotDeviation>,
}

/// A piece in the queue, ordered by its excess over the goal.
struct QueuedPiece {
    excess: f64,
    number: usize,
    piece: Box<Piece>,
}

/// Bound one triangle; `attained` is the deviation known at some of its points.
///
/// # Errors
/// [`KernelError::Interrupted`] when the caller wants to stop.
pub fn refine(
    against: &BoundContext<'_>,
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
            progress.check_periodically()?;
            let so_far = outcome.attained;
            let wanted = |at_centre| goal.required_bound(so_far.max(at_centre));
            let (piece, at_centre) = against.bound_piece(polygon, near, parent, wanted, shares);
            *hint = piece.slot;
            outcome.attained = outcome.attained.max(at_centre);
            outcome.pieces += 1;
            let level = goal.required_bound(outcome.attained);
            // Splitting a piece smaller than the slack gains nothing.
            if piece.bound.is_within(level) || piece.radius < against.slack {
                finish_piece(against, &piece, shares, &mut outcome);
            } else {
                let excess = excess_ratio(piece.bound, level);
                waiting.push(QueuedPiece { excess, number: outcome.pieces, piece: Box::new(piece) });
            }
        }
        let passed = goal.decide && !outcome.attained.is_within(goal.at_most);
        if passed || outcome.pieces >= goal.pieces {
            break;
        }
        let Some(QueuedPiece { piece, .. }) = waiting.pop() else { break };
        let level = goal.required_bound(outcome.attained);
        if piece.bound.is_within(level) {
            finish_piece(against, &piece, shares, &mut outcome);
            continue;
        }
        let shape_first = piece.bound.shape > level.shape;
        let probe = &piece.worst[usize::from(!shape_first)];
        let found = against.target.nearest(&probe.at, piece.slot);
        outcome.attained = outcome.attained.max(against.measure_deviation(probe, found.slot, found.distance));
        parent = piece.bound;
        let wanted = if shape_first { (level.shape - against.slack).max(0.0) } else { 0.0 };
        parts.extend(split_piece(against, &piece, wanted).into_iter().map(|part| (part, piece.slot)));
    }
    for QueuedPiece { piece, .. } in waiting.drain() {
        finish_piece(against, &piece, shares, &mut outcome);
    }
    merge_by_slot(&mut outcome.slot_deviations);
    outcome.reach = outcome.bound.shape;
    Ok(outcome)
}

/// Compute the ratio of a bound to its goal; 0 if the goal is met.
fn excess_ratio(bound: Deviation, level: Deviation) -> f64 {
    let over = |bound: f64, level: f64| if bound <= level { 0.0 } else { bound / level };
    over(bound.shape, level.shape).max(over(bound.color, level.color))
}

/// Add the bounds and attributed deviations of a piece to the outcome.
fn finish_piece(against: &BoundContext<'_>, piece: &Piece, shares: &[SlotDeviation], outcome: &mut Outcome) {
    outcome.bound = outcome.bound.max(piece.bound);
    let wanted = match against.attribution {
        AttributionMode::None => false,
        AttributionMode::All => true,
        AttributionMode::Beyond(limit) => !piece.bound.is_within(limit),
    };
    if let Some((first, last)) = piece.shares {
        outcome.slot_deviations.extend_from_slice(&shares[first..last]);
    } else if wanted {
        against.attribute_deviations(piece, &mut outcome.slot_deviations);
    }
}

/// Sort deviations by slot, and keep the maximum of each slot.
fn merge_by_slot(shares: &mut Vec<SlotDeviation>) {
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
fn split_piece(against: &BoundContext<'_>, piece: &Piece, wanted: f64) -> Vec<Polygon> {
    let polygon = &piece.polygon;
    if polygon.len() <= MAX_CORNERS_TO_CUT
        && let Some(facet) = Facet::new(&against.target.corners(piece.slot))
    {
        let height = polygon.iter().map(|c| facet.height(&c.at).abs()).fold(0.0, f64::max);
        let margin = (wanted * wanted - height * height).max(0.0).sqrt();
        // An uncut remainder must still be within the margin.
        let sliver = MIN_CUT_RATIO * piece.radius;
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

impl Ord for QueuedPiece {
    /// Order by excess, largest first, then by age, so that runs are reproducible.
    fn cmp(&self, other: &Self) -> Ordering {
        self.excess.total_cmp(&other.excess).then(other.number.cmp(&self.number))
    }
}

impl PartialOrd for QueuedPiece {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for QueuedPiece {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for QueuedPiece {}
