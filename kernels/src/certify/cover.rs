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
use super::piece::{Against, Deviation};
use super::polygon::{Corner, Polygon};
use super::surface::{combine, difference};
use super::view::{Box, ROUNDING, Seen, View, area_and_length, extent, is_needle, needle_height};
use crate::base::geometry::{Vec3, around};

/// Maximum number of cuts of one cell for one target triangle.
const CUTS: usize = 16;

/// Maximum height of covering triangles, relative to the distance bound from a single triangle.
const HIGHER: f64 = 2.0;

/// Barycentric coordinates of the point of T whose layers are counted. Irrational ratios, because few meshes
/// have a side or a corner there.
const PLACE: Vec3 = [0.381_966_011_250_105, 0.351_407_320_124_931, 0.266_626_668_624_964];

/// A target triangle whose projection covers part of the viewed triangle: its index in `seen`, its maximum
/// height, and its bounding box.
struct Hiding {
    seen: usize,
    height: f64,
    around: Box,
}

/// A part of the viewed triangle, and its bounding box.
struct Cell {
    polygon: Polygon,
    around: Box,
}

/// State of the fast proof; its buffers are reused from triangle to triangle.
#[derive(Default)]
pub struct Cover {
    /// Projected target triangles: from `first` on for the triangle viewed last, before that for the
    /// triangles it is part of.
    seen: Vec<Seen>,
    first: usize,
    /// Distance up to which `seen` is complete.
    looked: f64,
    /// View of the triangle that is not part of another one.
    view: Option<View>,
    /// Sides that may cross the triangle: sorted vertices and direction, see [`side_of`].
    sides: Vec<u64>,
    /// Target triangles whose projections cover the viewed triangle together.
    hiding: Vec<Hiding>,
    /// Parts that cover the viewed triangle, each with a distance bound from one target triangle.
    cells: Vec<Cell>,
    parts: Vec<Polygon>,
    /// Upper bound on the distance of the other surface from the triangle proven last.
    pub reach: f64,
    /// A point at which the colour may differ too much.
    pub doubt: Option<Corner>,
}

impl Cover {
    /// Test if all of `triangle` is proven to be within `limit`.
    ///
    /// `near` are the slots nearest to its corners, and `reach` of each corner is the distance there.
    /// `part_of` is the range that [`Self::seen_for_parts`] returned for the triangle that contains this one.
    pub fn proves(
        &mut self,
        against: &Against<'_>,
        triangle: &[Corner; 3],
        near: [u32; 3],
        limit: Deviation,
        part_of: Option<[usize; 2]>,
    ) -> bool {
        let most = limit.shape - against.slack;
        let by_one = one_triangle(against, triangle, near, most);
        if let Some((_, reach)) = by_one
            && !against.with_color
        {
            self.reach = reach;
            return true;
        }
        self.first = part_of.map_or(0, |[_, end]| end);
        self.seen.truncate(self.first);
        self.doubt = None;
        let Some(view) = self.viewed(triangle, part_of.is_some()) else { return false };
        if let Some(part_of) = part_of {
            self.look_again(&view, limit.shape, part_of);
        } else if let Some((_, reach)) = by_one {
            let close = |node, branch| against.target.colors_apart(node, branch, &view.colors) <= limit.color;
            self.look(against, triangle, &view, reach + against.slack, close);
        }
        if let Some((_, reach)) = by_one
            && self.color_soon_within(against, triangle, &view, reach, limit.color)
        {
            self.reach = reach;
            return true;
        }
        // Several triangles together may be nearer than any single one, although higher along the normal. A
        // small height leaves fewer triangles whose colours matter.
        let most = by_one.map_or(most, |(_, reach)| most.min(HIGHER * reach));
        if part_of.is_none() {
            self.look(against, triangle, &view, most + against.slack, |_, _| false);
        }
        let hidden = self.hidden(against, triangle, &view, most);
        if hidden.is_none() {
            self.hiding.clear();
        }
        let found = [hidden, by_one.map(|(_, reach)| reach)].into_iter().flatten();
        let Some(reach) = found.reduce(f64::min) else { return false };
        self.reach = reach;
        !against.with_color
            || self.color_within(against, triangle, &view, by_one.map(|(slot, _)| slot), reach, limit.color)
    }

    /// Number of target triangles near the triangle viewed last.
    pub fn crowd(&self) -> usize {
        self.seen.len() - self.first
    }

    /// Find all target triangles near the triangle viewed last, for its parts. Returns their range in `seen`.
    pub fn seen_for_parts(
        &mut self,
        against: &Against<'_>,
        triangle: &[Corner; 3],
        limit: Deviation,
    ) -> [usize; 2] {
        if self.first == 0
            && self.looked < limit.shape
            && let Some(view) = self.view
        {
            self.look(against, triangle, &view, limit.shape, |_, _| false);
        }
        [self.first, self.seen.len()]
    }

    /// Create the view of a triangle, or of a part of the previous one.
    fn viewed(&mut self, triangle: &[Corner; 3], is_part: bool) -> Option<View> {
        match &self.view {
            Some(whole) if is_part => whole.part(triangle),
            _ => {
                self.view = View::new(triangle);
                self.view
            }
        }
    }

    /// Find every target triangle that may be within `reach` of the viewed one.
    ///
    /// Branches of the tree that `skip` accepts are left out.
    fn look(
        &mut self,
        against: &Against<'_>,
        triangle: &[Corner; 3],
        view: &View,
        reach: f64,
        skip: impl Fn(u32, usize) -> bool,
    ) {
        let [low, high] = around(triangle.iter().map(|c| c.at));
        let (low, high) = (low.map(|x| x - reach), high.map(|x| x + reach));
        (self.first, self.looked) = (0, reach);
        let seen = &mut self.seen;
        seen.clear();
        against.target.bvh.meeting(&low, &high, skip, |slot| {
            seen.extend(view.seen(slot, &against.target.corners(slot), reach));
            true
        });
    }

    /// As [`Self::look`] for a part, among the triangles found for the whole.
    fn look_again(&mut self, view: &View, reach: f64, [start, end]: [usize; 2]) {
        for i in start..end {
            if !view.apart(&self.seen[i].at, reach) {
                self.seen.push(self.seen[i]);
            }
        }
    }

    /// Find triangles that cover the viewed one together; returns their maximum height if it is ≤ `most`.
    fn hidden(
        &mut self,
        against: &Against<'_>,
        triangle: &[Corner; 3],
        view: &View,
        most: f64,
    ) -> Option<f64> {
        self.sides.clear();
        self.hiding.clear();
        let place = [0, 1].map(|i| (0..3).map(|k| PLACE[k] * view.corners[k][i]).sum());
        let (mut layers, mut highest) = (0, 0.0f64);
        for (i, seen) in self.seen.iter().enumerate().skip(self.first) {
            let outside = seen.at.map(|p| view.outside(&p));
            if outside[0] & outside[1] & outside[2] != 0 {
                continue;
            }
            // A triangle that is too high is not part of the cover; its neighbours have borders there.
            let mut height = seen.height();
            // Only the part over the viewed triangle counts.
            if height > highest && outside != [0; 3] {
                height = view.height_over(&seen.at);
            }
            height += needle_height(&seen.at);
            if height > most {
                continue;
            }
            highest = highest.max(height);
            self.hiding.push(Hiding { seen: i, height, around: seen.around() });
            layers += turns(&seen.at, &place)?;
            let vertices = against.target.vertices[seen.slot as usize];
            for (i, j) in [(0, 1), (1, 2), (2, 0)] {
                if outside[i] & outside[j] == 0 {
                    self.sides.push(side_of(vertices[i], vertices[j]));
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
                let ends = ends_of(same[0]).map(|v| &against.target.points[v as usize]);
                view.passed_by(triangle, ends)
            }
        });
        all_closed.then_some(highest)
    }

    /// Test if the colours of the triangle are proven to be within `level`.
    ///
    /// Each point is compared with all target points that may be nearest to it; nearest points are within
    /// `reach`.
    fn color_within(
        &mut self,
        against: &Against<'_>,
        triangle: &[Corner; 3],
        view: &View,
        one: Option<u32>,
        reach: f64,
        level: f64,
    ) -> bool {
        let around = reach + against.slack;
        self.cells.clear();
        for seen in self.seen[self.first..].iter().filter(|seen| !view.apart(&seen.at, around)) {
            if soon_within(against, triangle, view, seen, around, level) {
                continue;
            }
            // Near this target triangle, the cover may be closer than its farthest part.
            let Some(around) = self.around(seen, around, against.slack) else { continue };
            if view.apart(&seen.at, around) || soon_within(against, triangle, view, seen, around, level) {
                continue;
            }
            let facet = Facet::new(&against.target.corners(seen.slot));
            let all = Polygon::new(triangle.map(|c| Corner { reach: around - against.slack, ..c }));
            let within = |polygon, cuts, parts: &mut Vec<Polygon>| {
                against.share_within(polygon, seen.slot, facet.as_ref(), level, cuts, parts)
            };
            if within(&all, 0, &mut self.parts).is_ok() {
                continue;
            }
            // Most triangles are proven before this; cells are only cut for the rest.
            if self.cells.is_empty() {
                let hiding = self.hiding.iter().map(|hiding| &self.seen[hiding.seen]);
                cut(&mut self.cells, against, triangle, view, one, hiding);
            }
            let here = &seen.around();
            debug_assert!(!self.cells.is_empty(), "cells cover the triangle");
            for cell in self.cells.iter().filter(|cell| meet(here, &cell.around, around)) {
                if let Err(worst) = within(&cell.polygon, CUTS, &mut self.parts) {
                    self.doubt = Some(worst);
                    return false;
                }
            }
        }
        true
    }

    /// Bound the distance of a target triangle from points it is nearest to.
    ///
    /// Starts from the bound `around`; points within the slack of the nearest ones count. `None` if there are
    /// no such points.
    fn around(&self, seen: &Seen, around: f64, slack: f64) -> Option<f64> {
        if self.hiding.is_empty() {
            return Some(around);
        }
        let (here, mut around) = (seen.around(), around);
        for _ in 0..2 {
            let is_over = |hiding: &&Hiding| meet(&here, &hiding.around, around);
            let over = self.hiding.iter().filter(is_over);
            around = around.min(over.map(|hiding| hiding.height).reduce(f64::max)? + slack);
        }
        Some(around)
    }

    /// As [`Self::color_within`], by the cheap tests only.
    fn color_soon_within(
        &self,
        against: &Against<'_>,
        triangle: &[Corner; 3],
        view: &View,
        reach: f64,
        level: f64,
    ) -> bool {
        let around = reach + against.slack;
        let mut near = self.seen[self.first..].iter().filter(|seen| !view.apart(&seen.at, around));
        near.all(|seen| soon_within(against, triangle, view, seen, around, level))
    }
}

/// Test cheaply if the colour of a target triangle is within `level`.
#[inline]
fn soon_within(
    against: &Against<'_>,
    triangle: &[Corner; 3],
    view: &View,
    seen: &Seen,
    around: f64,
    level: f64,
) -> bool {
    if against.target.color_range(seen.slot, &view.colors) <= level {
        return true;
    }
    let most = if extent(&seen.around()) < view.size {
        Some(view.smaller_differs(against, seen, around))
    } else {
        larger_differs(against, triangle, seen.slot, around)
    };
    most.is_some_and(|most| most <= level)
}

/// Cut the viewed triangle into cells, one below each covering triangle.
///
/// If nothing covers it, the only cell is all of it, bounded by `one` triangle.
fn cut<'s>(
    cells: &mut Vec<Cell>,
    against: &Against<'_>,
    triangle: &[Corner; 3],
    view: &View,
    one: Option<u32>,
    hiding: impl ExactSizeIterator<Item = &'s Seen>,
) {
    let mut cell = |mut polygon: Polygon, slot: u32| {
        polygon.set_reach(against.target.reach(slot));
        if !polygon.is_empty() {
            cells.push(Cell { around: around(polygon.iter().map(|c| view.at(&c.at))), polygon });
        }
    };
    if hiding.len() == 0 {
        one.into_iter().for_each(|slot| cell(Polygon::new(*triangle), slot));
    }
    for Seen { slot, at, .. } in hiding {
        let turn = ((at[1][0] - at[0][0]) * (at[2][1] - at[0][1])
            - (at[1][1] - at[0][1]) * (at[2][0] - at[0][0]))
            .signum();
        let mut inside = Polygon::new(*triangle);
        for (i, j) in [(0, 1), (1, 2), (2, 0)] {
            let (from, to) = (&at[i], &at[j]);
            let (x, y) = (turn * (from[1] - to[1]), turn * (to[0] - from[0]));
            let length = x.abs() + y.abs();
            inside.clip(|p| {
                let p = view.at(p);
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
fn side_of(a: u32, b: u32) -> u64 {
    u64::from(a.min(b)) << 32 | u64::from(a.max(b)) << 1 | u64::from(a < b)
}

#[inline]
fn ends_of(side: u64) -> [u32; 2] {
    [(side >> 32) as u32, side as u32 >> 1]
}

/// Test if two boxes are within `margin` of each other in the plane.
#[inline]
fn meet(a: &Box, b: &Box, margin: f64) -> bool {
    (0..2).all(|i| a[0][i] <= b[1][i] + margin && b[0][i] <= a[1][i] + margin)
}

/// Find a single target triangle that all corners are near: its slot, and the largest distance.
///
/// The distance to one triangle is convex, so no point between the corners is farther.
fn one_triangle(
    against: &Against<'_>,
    triangle: &[Corner; 3],
    near: [u32; 3],
    most: f64,
) -> Option<(u32, f64)> {
    (0..3).filter(|&i| !near[..i].contains(&near[i])).find_map(|i| {
        if near == [near[0]; 3] && !is_needle(area_and_length(&against.target.corners(near[0]))) {
            let far = triangle.iter().map(|c| c.reach).fold(0.0, f64::max);
            return (far <= most).then_some((near[0], far));
        }
        let reach = against.target.reach(near[i]);
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
fn larger_differs(against: &Against<'_>, triangle: &[Corner; 3], slot: u32, around: f64) -> Option<f64> {
    let facet = Facet::new(&against.target.corners(slot))?;
    let colors = against.target.corner_colors(slot);
    let (mut most, mut beside) = (0.0f64, false);
    for corner in triangle {
        let weights = facet.weights(&corner.at);
        beside |= weights.iter().any(|&w| w < 0.0);
        most = most.max(difference(&corner.color, &combine(&weights, &colors)));
    }
    let moved = if beside { around } else { 0.0 };
    Some(most + facet.slope(&colors) * (moved + against.slack))
}

/// Compute the winding number of a projected triangle around a point: 1, 0 or −1.
///
/// `None` if rounding makes it uncertain.
#[inline]
fn turns(corners: &[Vec3; 3], place: &[f64; 2]) -> Option<i32> {
    let to = corners.map(|p| [p[0] - place[0], p[1] - place[1]]);
    let mut side = [0; 3];
    for (i, j) in [(0, 1), (1, 2), (2, 0)] {
        let (a, b) = (to[i], to[j]);
        let turn = a[0] * b[1] - a[1] * b[0];
        let margin = ROUNDING * (a[0].abs() + a[1].abs()) * (b[0].abs() + b[1].abs());
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
