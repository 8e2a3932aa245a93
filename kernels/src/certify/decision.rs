//! Decide if one triangle stays within a limit: by the fast proof for all of it or its parts, else by
//! `refinement`.

use super::coverage_proof::CoverageProof;
use super::piece_bounds::{AttributionMode, BoundContext, Deviation};
use super::polygon::Corner;
use super::refinement::{Goal, Outcome, Workspace, refine};
use crate::base::errors::KernelError;
use crate::base::geometry::{distance2, midpoint};
use crate::base::progress::Progress;

/// If this few target triangles are near a part, halving it helps no more than refining it.
const MIN_NEAR_TRIANGLES_TO_HALVE: usize = 8;
/// Maximum number of pieces in the first round.
pub const DECISION_FIRST_PIECES: usize = 128;
/// Maximum number of times one triangle is halved; without it, parts would shrink endlessly where the fast
/// proof fails.
const MAX_HALVINGS: usize = 1024;

/// Buffers that are reused from triangle to triangle.
#[derive(Default)]
pub struct Scratch {
    pub workspace: Workspace,
    cover: CoverageProof,
    parts: Vec<Part>,
}

/// Part of a triangle, the slots nearest to its corners, and in `reach` of each corner their distance.
#[derive(Clone, Copy)]
struct Part {
    corners: [Corner; 3],
    near: [u32; 3],
    /// Range in `CoverageProof::seen` of the triangle that contains it.
    parent_range: Option<[usize; 2]>,
}

impl Part {
    fn is_longer_than(&self, length: f64) -> bool {
        let [a, b, c] = self.corners.each_ref().map(|c| c.at);
        [(a, b), (b, c), (c, a)].iter().any(|(a, b)| distance2(a, b) > length * length)
    }
}

/// Decide if a triangle stays within the goal.
///
/// `near` are the slots nearest to the corners, `attained` is the deviation there.
pub fn decide(
    against: &BoundContext<'_>,
    corners: [Corner; 3],
    near: [u32; 3],
    attained: Deviation,
    goal: &Goal,
    scratch: &mut Scratch,
    progress: &mut Progress,
) -> Result<Outcome, KernelError> {
    let mut seen = Outcome::new(attained);
    if attained.is_within(goal.at_most)
        && prove_parts(
            against,
            Part { corners, near, parent_range: None },
            goal,
            &mut seen,
            scratch,
            progress,
        )?
    {
        return Ok(Outcome { bound: goal.at_most, ..seen });
    }
    if goal.pieces > DECISION_FIRST_PIECES
        && seen.pieces >= goal.pieces
        && against.attribution == AttributionMode::None
    {
        // One part has used up all pieces, so the whole would not succeed with as many; the result of the
        // previous round stays.
        let bound = Deviation { shape: f64::INFINITY, color: f64::INFINITY };
        return Ok(Outcome { bound, reach: f64::INFINITY, ..seen });
    }
    let mut hint = near[0];
    let Scratch { workspace, .. } = scratch;
    let whole = refine(against, corners, &mut hint, seen.attained, goal, workspace, progress)?;
    Ok(Outcome { pieces: whole.pieces + seen.pieces, ..whole })
}

/// Test if every part is proven to stay within the limit; `seen` collects the measured deviation.
fn prove_parts(
    against: &BoundContext<'_>,
    whole: Part,
    goal: &Goal,
    seen: &mut Outcome,
    Scratch { workspace, cover, parts }: &mut Scratch,
    progress: &mut Progress,
) -> Result<bool, KernelError> {
    parts.clear();
    parts.push(whole);
    let mut halved = 0;
    while let Some(part) = parts.pop() {
        progress.check_periodically()?;
        seen.pieces += 1;
        if cover.proves(against, &part.corners, part.near, goal.at_most, part.parent_range) {
            seen.reach = seen.reach.max(cover.reach + against.slack);
            continue;
        }
        if let Some(doubt) = cover.doubt {
            let found = against.target.nearest(&doubt.at, part.near[0]);
            seen.attained = seen.attained.max(against.measure_deviation(&doubt, found.slot, found.distance));
            if !seen.attained.is_within(goal.at_most) {
                return Ok(false);
            }
        }
        if cover.count_near() > MIN_NEAR_TRIANGLES_TO_HALVE
            && halved < MAX_HALVINGS
            && part.is_longer_than(goal.at_most.shape)
        {
            halved += 1;
            let of = Some(cover.find_for_parts(against, &part.corners, goal.at_most));
            parts.extend(bisect(against, &Part { parent_range: of, ..part }, seen));
        } else {
            let mut hint = part.near[0];
            let outcome = refine(against, part.corners, &mut hint, seen.attained, goal, workspace, progress)?;
            seen.pieces += outcome.pieces;
            seen.attained = outcome.attained;
            seen.reach = seen.reach.max(outcome.reach);
            if !outcome.bound.is_within(goal.at_most) {
                return Ok(false);
            }
        }
        if !seen.attained.is_within(goal.at_most) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Bisect the longest side.
fn bisect(against: &BoundContext<'_>, part: &Part, seen: &mut Outcome) -> [Part; 2] {
    let Part { corners, near, .. } = part;
    let length2 = |i: usize| distance2(&corners[i].at, &corners[(i + 1) % 3].at);
    let i = (0..3).max_by(|&i, &j| length2(i).total_cmp(&length2(j))).unwrap_or(0);
    let j = (i + 1) % 3;
    let mut middle = Corner {
        at: midpoint(&corners[i].at, &corners[j].at),
        color: midpoint(&corners[i].color, &corners[j].color),
        reach: f64::INFINITY,
    };
    let found = against.target.nearest(&middle.at, near[i]);
    middle.reach = found.distance;
    seen.attained = seen.attained.max(against.measure_deviation(&middle, found.slot, found.distance));
    [i, j].map(|moved| {
        let mut half = *part;
        (half.corners[moved], half.near[moved]) = (middle, found.slot);
        half
    })
}

#[cfg(test)]
mod tests {
    use super::super::surface::Surface;
    use super::*;
    use crate::base::progress::RunControl;

    /// Small target triangles below the corners and the middle of a large one: all probed points are near,
    /// the rest is not.
    #[test]
    fn an_unproven_part_leaves_the_whole_unproven() {
        let large = [[0.0, 0.0, 0.0], [12.0, 0.0, 0.0], [0.0, 12.0, 0.0]];
        let places = [large[0], large[1], large[2], [4.0, 4.0, 0.0]];
        let around = |[x, y, z]: [f64; 3]| [[x - 0.1, y - 0.1, z], [x + 0.1, y - 0.1, z], [x, y + 0.2, z]];
        let points: Vec<[f64; 3]> = places.into_iter().flat_map(around).collect();
        let triangles: Vec<[u32; 3]> = (0..4).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let target = Surface::new(&points, &triangles, 1).unwrap();
        let against = BoundContext {
            target: &target,
            slack: 1e-6,
            color_range: 0.0,
            with_color: false,
            attribution: AttributionMode::None,
        };
        let corners = large.map(|at| Corner { at, color: [0.0; 3], reach: 0.0 });
        let near = large.map(|at| target.nearest(&at, 0).slot);
        let limit = Deviation { shape: 0.5, color: f64::INFINITY };
        let found = |pieces| {
            let (goal, control) = (Goal::decision(limit, pieces), RunControl::default());
            let (scratch, progress) = (&mut Scratch::default(), &mut Progress::new(&control));
            decide(&against, corners, near, Deviation::default(), &goal, scratch, progress).unwrap()
        };
        let open = found(1);
        assert!(open.attained.is_within(limit) && !open.bound.is_within(limit), "{open:?}");
        assert!(!found(100).attained.is_within(limit));
    }
}
