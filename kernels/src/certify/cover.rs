//! One triangle against everything near it at once: the quick proof that it stays within a limit.
//!
//! Look at triangle T along its normal. The other surface's triangles over it are within some height of it. Where they
//! hide all of T, every point of T has one of them as near as that. They do if a single point of T is hidden and no
//! border of theirs crosses T: the number of layers over a point, those turned up less those turned down, changes
//! nowhere but at a border, and at a side of two triangles that follow each other there is none.
//!
//! Colour: a point x of T and the nearest point y of another triangle are no farther apart than that. Continued over
//! the plane, the colour of T at the foot of y is linear on the other triangle, and so is the difference there;
//! between foot and x it changes by no more than its gradient. Where the other triangle is the larger one,
//! it is the other way round. Either way the slack comes to what the gradient is multiplied by.
//!
//! Where that is not enough, T is cut into what each triangle over it hides: no point of such a cell is farther from the
//! surface than from that triangle, and so fewer others can be nearest to it. What remains is cut on, where a colour may
//! differ too much: by the plane beyond which another triangle is nearer, or in two.

use super::facet::Facet;
use super::piece::{Against, Deviation};
use super::polygon::{Corner, Polygon};
use super::surface::{combine, difference};
use super::view::{Box, ROUNDING, Seen, View, area_and_length, extent, is_needle, needle_height};
use crate::base::geometry::{Vec3, around};

/// Times that a part is cut to find what of it a triangle is nearest to.
const CUTS: usize = 16;

/// Times the distance from one triangle that several may be above the plane.
const HIGHER: f64 = 2.0;

/// What of T is looked at to count the layers over it: a point where few meshes have a side or a corner.
const PLACE: Vec3 = [0.381_966_011_250_105, 0.351_407_320_124_931, 0.266_626_668_624_964];

/// A triangle of the other surface that hides some of the one viewed, by its place in what was seen, and its greatest height
/// over that.
struct Hiding {
    seen: usize,
    height: f64,
    around: Box,
}

/// A part of the triangle viewed, and the box around it.
struct Cell {
    polygon: Polygon,
    around: Box,
}

/// Memory that the next triangle can use again.
#[derive(Default)]
pub struct Cover {
    /// What was seen of the triangle that was looked at last, from `first` on; before that of those it is part of.
    seen: Vec<Seen>,
    first: usize,
    /// How far that is all there is.
    looked: f64,
    /// Of the triangle that is not part of another.
    view: Option<View>,
    /// Sides that may cross the triangle: both vertices in order, and in which direction they are run through.
    sides: Vec<u64>,
    /// What hides all of the triangle.
    hiding: Vec<Hiding>,
    /// Parts of the triangle that cover it, each with how far one triangle of the other surface is.
    cells: Vec<Cell>,
    parts: Vec<Polygon>,
    /// How far the other surface is at most from what was proven last.
    pub reach: f64,
    /// Where a colour differs too much, as far as the proof can tell.
    pub doubt: Option<Corner>,
}

impl Cover {
    /// Whether all of `triangle` is proven to be within `limit`. `near` are slots nearest to its corners, and
    /// their `reach` is the distance there. What it is a part of has been seen before: [`Self::seen_for_parts`].
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
        // Several triangles may be nearer than one is, though higher up along the normal: fewer then have a colour that
        // matters.
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

    /// How many triangles were near the one looked at last.
    pub fn crowd(&self) -> usize {
        self.seen.len() - self.first
    }

    /// Where all is that may be near the triangle looked at last, for the parts that it is cut into.
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

    /// The view of a triangle, or of a part of the one viewed before.
    fn viewed(&mut self, triangle: &[Corner; 3], is_part: bool) -> Option<View> {
        match &self.view {
            Some(whole) if is_part => whole.part(triangle),
            _ => {
                self.view = View::new(triangle);
                self.view
            }
        }
    }

    /// Find every triangle that may be within `reach` of the one viewed, but for those in branches to `skip`.
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

    /// The same of a part, among what was seen of the triangle it is part of.
    fn look_again(&mut self, view: &View, reach: f64, [start, end]: [usize; 2]) {
        for i in start..end {
            if !view.apart(&self.seen[i].at, reach) {
                self.seen.push(self.seen[i]);
            }
        }
    }

    /// The greatest height of what hides all of the triangle, if that is at most `most`.
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
            // Not part of the cover: where others end at it there is a border then.
            let mut height = seen.height();
            // Beside the triangle it may be as high as it likes.
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

    /// Whether no point of the triangle differs in colour by more than `level` from any point that may be nearest to it,
    /// where those are not farther than `reach`.
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
            // Not all of the triangle is as far from what hides it as the farthest part.
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
            // Soon found for most: only what is left is worth the cells.
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

    /// How far what was seen, or another triangle no more than the slack nearer, can be from points it is nearest to; no
    /// farther than `around`. None if there are no such points.
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

    /// The same by what is found at once.
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

/// Whether the colour of what was seen is soon found to be within `level`.
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

/// Parts that cover the triangle: what each of those that hide it does, or all of it where `one` triangle is near all.
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

/// The vertices of a side in order, and in which direction it is run through.
#[inline]
fn side_of(a: u32, b: u32) -> u64 {
    u64::from(a.min(b)) << 32 | u64::from(a.max(b)) << 1 | u64::from(a < b)
}

#[inline]
fn ends_of(side: u64) -> [u32; 2] {
    [(side >> 32) as u32, side as u32 >> 1]
}

/// Whether two boxes are no farther apart than `margin` along both axes of the plane.
#[inline]
fn meet(a: &Box, b: &Box, margin: f64) -> bool {
    (0..2).all(|i| a[0][i] <= b[1][i] + margin && b[0][i] <= a[1][i] + margin)
}

/// A triangle and the greatest distance of the corners from it, which no point between them passes.
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
        // The corner this triangle is nearest to is the last one to be too far from it.
        let far = [(i + 1) % 3, (i + 2) % 3, i].into_iter().try_fold(0.0f64, |far, k| {
            let far = far.max(reach(&triangle[k].at));
            (far <= most).then_some(far)
        });
        far.map(|far| (near[i], far))
    })
}

/// The greatest difference between the colours of a triangle and of the nearest points on a larger one, if that
/// has a plane. The colour of the larger one is continued to the feet of points beside it.
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

/// How many times a triangle goes around a place, as seen: 1, 0 or −1. None where that is too close to call.
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
