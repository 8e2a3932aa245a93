//! Fast sufficient proof that one triangle stays within a limit, against all nearby triangles at once.
//!
//! Shape: project the other surface along the normal of triangle T. All its triangles over T are within some
//! height of T. If their projections cover T, every point of T has a point of the other surface within that
//! height. They cover T if one point of T is covered and no border of the projections crosses T. This holds
//! because the signed number of layers over a point changes only across a border. A side between two
//! consistently oriented triangles is no border.
//!
//! Colour: a point x of T and the nearest point y of another triangle are no farther apart than that height.
//! Continue the colour of T over its plane and evaluate it at the foot of y. The result is linear on the
//! other triangle, and so is the colour difference. Between the foot and x the colour of T changes by at most
//! gradient × distance. If the other triangle is the larger one, the roles are exchanged. Either way the
//! slack is added to the distance.
//!
//! If that does not suffice, T is cut into cells, one below each covering triangle. The distance of a cell to
//! the other surface is at most its distance to that triangle, so fewer other triangles can be nearest to it.
//! A cell whose colour may still differ too much is cut further: by a plane beyond which another triangle is
//! nearer, or in two.

use super::facet::Facet;
use super::piece_bounds::{BoundContext, Deviation};
use super::polygon::{Corner, Polygon};
use super::surface::{difference, weighted_sum};
use super::triangle_frame::{
    Bounds, ProjectedTriangle, ROUNDING_RATIO, TriangleFrame, is_needle, longest_edge, needle_height,
    squared_area_and_length,
};
use crate::base::geometry::{Vec3, bounding_box};

/// Maximum number of cuts of one cell for one target triangle.
const MAX_CUTS_PER_CELL: usize = 16;

/// Maximum height of covering triangles, relative to the distance bound from a single triangle.
const MAX_HEIGHT_RATIO: f64 = 2.0;

/// Barycentric coordinates of the point of T whose layers are counted. Irrational ratios, because few meshes
/// have a side or a corner there.
const PROBE_WEIGHTS: Vec3 = [0.381_966_011_250_105, 0.351_407_320_124_931, 0.266_626_668_624_964];

/// A target triangle whose projection covers part of the viewed triangle: its index in `projected`, its maximum
/// height, and its bounding box.
struct CoveringTriangle {
    index: usize,
    height: f64,
    bounds: Bounds,
}

/// A part of the viewed triangle, and its bounding box.
struct Cell {
    polygon: Polygon,
    bounds: Bounds,
}

/// State of the fast proof; its buffers are reused from triangle to triangle.
#[derive(Default)]
pub struct CoverageProof {
    /// Projected target triangles: from `first` on for the triangle viewed last, before that for the
    /// triangles it is part of.
    projected: Vec<ProjectedTriangle>,
    first: usize,
    /// Distance up to which `projected` is complete.
    complete_distance: f64,
    /// View of the triangle that is not part of another one.
    view: Option<TriangleFrame>,
    /// Sides that may cross the triangle: sorted vertices and direction, see [`encode_side`].
    sides: Vec<u64>,
    /// Target triangles whose projections cover the viewed triangle together.
    covering: Vec<CoveringTriangle>,
    /// Parts that cover the viewed triangle, each with a distance bound from one target triangle.
    cells: Vec<Cell>,
    parts: Vec<Polygon>,
    /// Upper bound on the distance of the other surface from the triangle proven last.
    pub reach: f64,
    /// A point at which the colour may differ too much.
    pub doubt: Option<Corner>,
}

impl CoverageProof {
    /// Test if all of `triangle` is proven to be within `limit`.
    ///
    /// `near` are the slots nearest to its corners, and `reach` of each corner is the distance there.
    /// `part_of` is the range that [`Self::find_for_parts`] returned for the triangle that contains this one.
    pub fn proves(
        &mut self,
        against: &BoundContext<'_>,
        triangle: &[Corner; 3],
        near: [u32; 3],
        limit: Deviation,
        part_of: Option<[usize; 2]>,
    ) -> bool {
        let most = limit.shape - against.slack;
        let by_one = find_single_near_triangle(against, triangle, near, most);
        if let Some((_, reach)) = by_one
            && !against.with_color
        {
            self.reach = reach;
            return true;
        }
        self.first = part_of.map_or(0, |[_, end]| end);
        self.projected.truncate(self.first);
        self.doubt = None;
        let Some(view) = self.create_view(triangle, part_of.is_some()) else { return false };
        if let Some(part_of) = part_of {
            self.find_near_part(&view, limit.shape, part_of);
        } else if let Some((_, reach)) = by_one {
            let close = |node, branch| {
                against.target.bound_color_difference_below(node, branch, &view.colors) <= limit.color
            };
            self.find_near(against, triangle, &view, reach + against.slack, close);
        }
        if let Some((_, reach)) = by_one
            && self.proves_color_cheaply(against, triangle, &view, reach, limit.color)
        {
            self.reach = reach;
            return true;
        }
        // Several triangles together may be nearer than any single one, although higher along the normal. A
        // small height leaves fewer triangles whose colours matter.
        let most = by_one.map_or(most, |(_, reach)| most.min(MAX_HEIGHT_RATIO * reach));
        if part_of.is_none() {
            self.find_near(against, triangle, &view, most + against.slack, |_, _| false);
        }
        let hidden = self.find_cover(against, triangle, &view, most);
        if hidden.is_none() {
            self.covering.clear();
        }
        let found = [hidden, by_one.map(|(_, reach)| reach)].into_iter().flatten();
        let Some(reach) = found.reduce(f64::min) else { return false };
        self.reach = reach;
        !against.with_color
            || self.proves_color(against, triangle, &view, by_one.map(|(slot, _)| slot), reach, limit.color)
    }

    /// Number of target triangles near the triangle viewed last.
    pub fn count_near(&self) -> usize {
        self.projected.len() - self.first
    }

    /// Find all target triangles near the triangle viewed last, for its parts. Returns their range in `projected`.
    pub fn find_for_parts(
        &mut self,
        against: &BoundContext<'_>,
        triangle: &[Corner; 3],
        limit: Deviation,
    ) -> [usize; 2] {
        if self.first == 0
            && self.complete_distance < limit.shape
            && let Some(view) = self.view
        {
            self.find_near(against, triangle, &view, limit.shape, |_, _| false);
        }
        [self.first, self.projected.len()]
    }

    /// Create the view of a triangle, or of a part of the previous one.
    fn create_view(&mut self, triangle: &[Corner; 3], is_part: bool) -> Option<TriangleFrame> {
        match &self.view {
            Some(whole) if is_part => whole.for_part(triangle),
            _ => {
                self.view = TriangleFrame::new(triangle);
                self.view
            }
        }
    }

    /// Find every target triangle that may be within `reach` of the viewed one.
    ///
    /// Branches of the tree that `skip` accepts are left out.
    fn find_near(
        &mut self,
        against: &BoundContext<'_>,
        triangle: &[Corner; 3],
        view: &TriangleFrame,
        reach: f64,
        skip: impl Fn(u32, usize) -> bool,
    ) {
        let [low, high] = bounding_box(triangle.iter().map(|c| c.at));
        let (low, high) = (low.map(|x| x - reach), high.map(|x| x + reach));
        (self.first, self.complete_distance) = (0, reach);
        let seen = &mut self.projected;
        seen.clear();
        against.target.bvh.visit_overlapping(&low, &high, skip, |slot| {
            seen.extend(view.project_triangle(slot, &against.target.corners(slot), reach));
            true
        });
    }

    /// As [`Self::find_near`] for a part, among the triangles found for the whole.
    fn find_near_part(&mut self, view: &TriangleFrame, reach: f64, [start, end]: [usize; 2]) {
        for i in start..end {
            if !view.is_farther_than(&self.projected[i].points, reach) {
                self.projected.push(self.projected[i]);
            }
        }
    }

    /// Find triangles that cover the viewed one together; returns their maximum height if it is ≤ `most`.
    fn find_cover(
        &mut self,
        against: &BoundContext<'_>,
        triangle: &[Corner; 3],
        view: &TriangleFrame,
        most: f64,
    ) -> Option<f64> {
        self.sides.clear();
        self.covering.clear();
        let place = [0, 1].map(|i| (0..3).map(|k| PROBE_WEIGHTS[k] * view.corners[k][i]).sum());
        let (mut layers, mut highest) = (0, 0.0f64);
        for (i, seen) in self.projected.iter().enumerate().skip(self.first) {
            let outside = seen.points.map(|p| view.outside_mask(&p));
            if outside[0] & outside[1] & outside[2] != 0 {
                continue;
            }
            // A triangle that is too high is not part of the cover; its neighbours have borders there.
            let mut height = seen.max_height();
            // Only the part over the viewed triangle counts.
            if height > highest && outside != [0; 3] {
                height = view.max_height_over(&seen.points);
            }
            height += needle_height(&seen.points);
            if height > most {
                continue;
            }
            highest = highest.max(height);
            self.covering.push(CoveringTriangle { index: i, height, bounds: seen.bounds() });
            layers += winding_number(&seen.points, &place)?;
            let vertices = against.target.vertices[seen.slot as usize];
            for (i, j) in [(0, 1), (1, 2), (2, 0)] {
                if outside[i] & outside[j] == 0 {
                    self.sides.push(encode_side(vertices[i], vertices[j]));
                }
            }
        }
        if layers == 0 {
            return None;
        }
        self.sides.sort_unstable();
        let all_closed = self.sides.chunk_by(|a, b| a | 1 == b | 1).all(|same| {
            let forward = same.iter().filter(|side| *side & 1 == 1).count();
            2 * forward == same.len() || {
                let ends = decode_side(same[0]).map(|v| &against.target.points[v as usize]);
                view.is_not_crossed_by(triangle, ends)
            }
        });
        all_closed.then_some(highest)
    }

    /// Test if the colours of the triangle are proven to be within `level`.
    ///
    /// Each point is compared with all target points that may be nearest to it; nearest points are within
    /// `reach`.
    fn proves_color(
        &mut self,
        against: &BoundContext<'_>,
        triangle: &[Corner; 3],
        view: &TriangleFrame,
        one: Option<u32>,
        reach: f64,
        level: f64,
    ) -> bool {
        let around = reach + against.slack;
        self.cells.clear();
        for seen in
            self.projected[self.first..].iter().filter(|seen| !view.is_farther_than(&seen.points, around))
        {
            if proves_slot_cheaply(against, triangle, view, seen, around, level) {
                continue;
            }
            // Near this target triangle, the cover may be closer than its farthest part.
            let Some(around) = self.bound_distance(seen, around, against.slack) else { continue };
            if view.is_farther_than(&seen.points, around)
                || proves_slot_cheaply(against, triangle, view, seen, around, level)
            {
                continue;
            }
            let facet = Facet::new(&against.target.corners(seen.slot));
            let all = Polygon::new(triangle.map(|c| Corner { reach: around - against.slack, ..c }));
            let within = |polygon, cuts, parts: &mut Vec<Polygon>| {
                against.proves_slot_color(polygon, seen.slot, facet.as_ref(), level, cuts, parts)
            };
            if within(&all, 0, &mut self.parts).is_ok() {
                continue;
            }
            // Most triangles are proven before this; cells are only cut for the rest.
            if self.cells.is_empty() {
                let hiding = self.covering.iter().map(|hiding| &self.projected[hiding.index]);
                cut_cells(&mut self.cells, against, triangle, view, one, hiding);
            }
            let here = &seen.bounds();
            debug_assert!(!self.cells.is_empty(), "cells cover the triangle");
            for cell in self.cells.iter().filter(|cell| boxes_meet(here, &cell.bounds, around)) {
                if let Err(worst) = within(&cell.polygon, MAX_CUTS_PER_CELL, &mut self.parts) {
                    self.doubt = Some(worst);
                    return false;
                }
            }
        }
        true
    }

    /// Bound the distance of a target triangle from points it is nearest to.
    ///
    /// Starts from the bound `bound_distance`; points within the slack of the nearest ones count. `None` if there are
    /// no such points.
    fn bound_distance(&self, seen: &ProjectedTriangle, around: f64, slack: f64) -> Option<f64> {
        if self.covering.is_empty() {
            return Some(around);
        }
        let (here, mut around) = (seen.bounds(), around);
        for _ in 0..2 {
            let is_over = |hiding: &&CoveringTriangle| boxes_meet(&here, &hiding.bounds, around);
            let over = self.covering.iter().filter(is_over);
            around = around.min(over.map(|hiding| hiding.height).reduce(f64::max)? + slack);
        }
        Some(around)
    }

    /// As [`Self::proves_color`], by the cheap tests only.
    fn proves_color_cheaply(
        &self,
        against: &BoundContext<'_>,
        triangle: &[Corner; 3],
        view: &TriangleFrame,
        reach: f64,
        level: f64,
    ) -> bool {
        let around = reach + against.slack;
        let mut near =
            self.projected[self.first..].iter().filter(|seen| !view.is_farther_than(&seen.points, around));
        near.all(|seen| proves_slot_cheaply(against, triangle, view, seen, around, level))
    }
}

/// Test cheaply if the colour of a target triangle is within `level`.
#[inline]
fn proves_slot_cheaply(
    against: &BoundContext<'_>,
    triangle: &[Corner; 3],
    view: &TriangleFrame,
    seen: &ProjectedTriangle,
    around: f64,
    level: f64,
) -> bool {
    if against.target.bound_color_difference(seen.slot, &view.colors) <= level {
        return true;
    }
    let most = if longest_edge(&seen.bounds()) < view.size {
        Some(view.bound_color_to_smaller(against, seen, around))
    } else {
        bound_color_to_larger(against, triangle, seen.slot, around)
    };
    most.is_some_and(|most| most <= level)
}

/// Cut the viewed triangle into cells, one below each covering triangle.
///
/// If nothing covers it, the only cell is all of it, bounded by `one` triangle.
fn cut_cells<'s>(
    cells: &mut Vec<Cell>,
    against: &BoundContext<'_>,
    triangle: &[Corner; 3],
    view: &TriangleFrame,
    one: Option<u32>,
    hiding: impl ExactSizeIterator<Item = &'s ProjectedTriangle>,
) {
    let mut cell = |mut polygon: Polygon, slot: u32| {
        polygon.set_reach(against.target.distance_bound(slot));
        if !polygon.is_empty() {
            cells.push(Cell { bounds: bounding_box(polygon.iter().map(|c| view.project(&c.at))), polygon });
        }
    };
    if hiding.len() == 0 {
        one.into_iter().for_each(|slot| cell(Polygon::new(*triangle), slot));
    }
    for ProjectedTriangle { slot, points: at, .. } in hiding {
        let turn = ((at[1][0] - at[0][0]) * (at[2][1] - at[0][1])
            - (at[1][1] - at[0][1]) * (at[2][0] - at[0][0]))
            .signum();
        let mut inside = Polygon::new(*triangle);
        for (i, j) in [(0, 1), (1, 2), (2, 0)] {
            let (from, to) = (&at[i], &at[j]);
            let (x, y) = (turn * (from[1] - to[1]), turn * (to[0] - from[0]));
            let length = x.abs() + y.abs();
            inside.clip(|p| {
                let p = view.project(p);
                x * (p[0] - from[0])
                    + y * (p[1] - from[1])
                    + length * (view.rounding(&p) + view.rounding(from))
            });
        }
        cell(inside, *slot);
    }
}

/// Encode a directed side: sorted vertices, then the direction in the lowest bit.
#[inline]
fn encode_side(a: u32, b: u32) -> u64 {
    u64::from(a.min(b)) << 32 | u64::from(a.max(b)) << 1 | u64::from(a < b)
}

#[inline]
fn decode_side(side: u64) -> [u32; 2] {
    [(side >> 32) as u32, side as u32 >> 1]
}

/// Test if two boxes are within `margin` of each other in the plane.
#[inline]
fn boxes_meet(a: &Bounds, b: &Bounds, margin: f64) -> bool {
    (0..2).all(|i| a[0][i] <= b[1][i] + margin && b[0][i] <= a[1][i] + margin)
}

/// Find a single target triangle that all corners are near: its slot, and the largest distance.
///
/// The distance to one triangle is convex, so no point between the corners is farther.
fn find_single_near_triangle(
    against: &BoundContext<'_>,
    triangle: &[Corner; 3],
    near: [u32; 3],
    most: f64,
) -> Option<(u32, f64)> {
    (0..3).filter(|&i| !near[..i].contains(&near[i])).find_map(|i| {
        if near == [near[0]; 3] && !is_needle(squared_area_and_length(&against.target.corners(near[0]))) {
            let far = triangle.iter().map(|c| c.reach).fold(0.0, f64::max);
            return (far <= most).then_some((near[0], far));
        }
        let reach = against.target.distance_bound(near[i]);
        // Test the corner this triangle is nearest to last: it is the least likely to be too far.
        let far = [(i + 1) % 3, (i + 2) % 3, i].into_iter().try_fold(0.0f64, |far, k| {
            let far = far.max(reach(&triangle[k].at));
            (far <= most).then_some(far)
        });
        far.map(|far| (near[i], far))
    })
}

/// Bound the colour difference between a triangle and a larger target triangle.
///
/// The larger triangle is compared at its nearest points, with its colour continued over its plane. `None` if
/// it has no plane.
fn bound_color_to_larger(
    against: &BoundContext<'_>,
    triangle: &[Corner; 3],
    slot: u32,
    around: f64,
) -> Option<f64> {
    let facet = Facet::new(&against.target.corners(slot))?;
    let colors = against.target.corner_colors(slot);
    let (mut most, mut beside) = (0.0f64, false);
    for corner in triangle {
        let weights = facet.weights(&corner.at);
        beside |= weights.iter().any(|&w| w < 0.0);
        most = most.max(difference(&corner.color, &weighted_sum(&weights, &colors)));
    }
    let moved = if beside { around } else { 0.0 };
    Some(most + facet.gradient_norm(&colors) * (moved + against.slack))
}

/// Compute the winding number of a projected triangle around a point: 1, 0 or −1.
///
/// `None` if rounding makes it uncertain.
#[inline]
fn winding_number(corners: &[Vec3; 3], place: &[f64; 2]) -> Option<i32> {
    let to = corners.map(|p| [p[0] - place[0], p[1] - place[1]]);
    let mut side = [0; 3];
    for (i, j) in [(0, 1), (1, 2), (2, 0)] {
        let (a, b) = (to[i], to[j]);
        let turn = a[0] * b[1] - a[1] * b[0];
        let margin = ROUNDING_RATIO * (a[0].abs() + a[1].abs()) * (b[0].abs() + b[1].abs());
        side[i] = if turn > margin {
            1
        } else if turn < -margin {
            -1
        } else {
            0
        };
    }
    if side.contains(&1) && side.contains(&-1) {
        return Some(0);
    }
    let beyond = (0..2).any(|i| to.iter().all(|p| p[i] > 0.0) || to.iter().all(|p| p[i] < 0.0));
    match side {
        _ if beyond => Some(0),
        [1, 1, 1] => Some(1),
        [-1, -1, -1] => Some(-1),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
