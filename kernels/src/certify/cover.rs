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
use super::surface::{NEEDLE, combine, difference};
use crate::base::geometry::{Vec3, add_scaled, around, cross, dot, norm2, sub};

/// Share of the lengths in it that the position in a view may be wrong by: far more than rounding makes it.
const ROUNDING: f64 = 1e-12;

/// Times that a part is cut to find what of it a triangle is nearest to.
const CUTS: usize = 16;

/// Times the distance from one triangle that several may be above the plane.
const HIGHER: f64 = 2.0;

/// What of T is looked at to count the layers over it: a point where few meshes have a side or a corner.
const PLACE: Vec3 = [0.381_966_011_250_105, 0.351_407_320_124_931, 0.266_626_668_624_964];

/// The plane of a triangle: coordinates in it, and height. For a part of that triangle they are the same.
#[derive(Clone, Copy)]
struct View {
    origin: Vec3,
    axes: [Vec3; 3],
    /// Corners of the triangle.
    corners: [[f64; 2]; 3],
    /// Inward normal of each side, and its distance from the origin.
    sides: [[f64; 3]; 3],
    size: f64,
    /// That of the triangle this one is part of.
    whole: f64,
    /// Colour at the origin, and what it changes along both axes.
    color: [Vec3; 3],
    slope: f64,
    /// The box around all colours.
    colors: [Vec3; 2],
}

/// A triangle of the other surface, as seen.
#[derive(Clone, Copy)]
struct Seen {
    slot: u32,
    /// Two coordinates and the height of each corner, and the box around them.
    at: [Vec3; 3],
    around: Box,
    /// As [`needle_height`].
    thin: f64,
}

/// Lowest and highest coordinates.
type Box = [Vec3; 2];

/// A triangle of the other surface that hides some of the one viewed, by its place in what was seen, and its greatest height
/// over that.
struct Hiding {
    seen: usize,
    height: f64,
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
            let corners = against.target.corners(slot);
            let heights = corners.map(|p| view.height(&p));
            // Most are out of reach by their height alone.
            if heights.iter().all(|&h| h > reach) || heights.iter().all(|&h| h < -reach) {
                return true;
            }
            let at = corners.map(|p| view.at(&p));
            if !view.apart(&at, reach) {
                seen.push(Seen::new(slot, at));
            }
            true
        });
    }

    /// The same of a part, among what was seen of the triangle it is part of.
    fn look_again(&mut self, view: &View, reach: f64, [start, end]: [usize; 2]) {
        for i in start..end {
            if !view.misses(&self.seen[i], reach) {
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
            height += seen.thin;
            if height > most {
                continue;
            }
            highest = highest.max(height);
            self.hiding.push(Hiding { seen: i, height });
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
        for seen in self.seen[self.first..].iter().filter(|seen| !view.misses(seen, around)) {
            if soon_within(against, triangle, view, seen, around, level) {
                continue;
            }
            // Not all of the triangle is as far from what hides it as the farthest part.
            let Some(around) = self.around(seen, around, against.slack) else { continue };
            if view.misses(seen, around) || soon_within(against, triangle, view, seen, around, level) {
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
            let here = &seen.around;
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
        let mut around = around;
        for _ in 0..2 {
            let is_over = |hiding: &&Hiding| meet(&seen.around, &self.seen[hiding.seen].around, around);
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
        let mut near = self.seen[self.first..].iter().filter(|seen| !view.misses(seen, around));
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
    let most = if extent(&seen.around) < view.size {
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
        let inside = |polygon: Polygon, (i, j): (usize, usize)| {
            let (from, to) = (&at[i], &at[j]);
            let (x, y) = (turn * (from[1] - to[1]), turn * (to[0] - from[0]));
            let length = x.abs() + y.abs();
            polygon.clipped(|p| {
                let p = view.at(p);
                x * (p[0] - from[0])
                    + y * (p[1] - from[1])
                    + length * (view.rounding(&p) + view.rounding(from))
            })
        };
        cell([(0, 1), (1, 2), (2, 0)].into_iter().fold(Polygon::new(*triangle), inside), *slot);
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

impl Seen {
    #[inline]
    fn new(slot: u32, at: [Vec3; 3]) -> Self {
        Self { slot, at, around: around(at.into_iter()), thin: needle_height(&at) }
    }

    /// The greatest height of a corner, above or below.
    #[inline]
    fn height(&self) -> f64 {
        self.around[1][2].max(-self.around[0][2])
    }
}

impl View {
    /// None for a needle, whose normal has too few digits.
    fn new(triangle: &[Corner; 3]) -> Option<Self> {
        let [a, b, c] = triangle.map(|c| c.at);
        if is_needle(area_and_length(&[a, b, c])) {
            return None;
        }
        let unit = |v: Vec3| {
            let length = norm2(&v).sqrt();
            v.map(|x| x / length)
        };
        let (ab, ac) = (sub(&b, &a), sub(&c, &a));
        let x = unit(ab);
        let normal = unit(cross(&ab, &ac));
        let axes = [x, cross(&normal, &x), normal];
        let flat = |v: &Vec3| [dot(&axes[0], v), dot(&axes[1], v)];
        let corners = [[0.0; 2], flat(&ab), flat(&ac)];
        let sides = sides_of(&corners);
        let [base, to_b, to_c] = [0, 1, 2]
            .map(|i| if i == 0 { triangle[0].color } else { sub(&triangle[i].color, &triangle[0].color) });
        // Corner b is on the first axis.
        let along = to_b.map(|x| x / corners[1][0]);
        let across = add_scaled(&to_c, -corners[2][0], &along).map(|x| x / corners[2][1]);
        let slope = (norm2(&along) + norm2(&across)).sqrt();
        let size = size_of(triangle);
        let (color, colors) = ([base, along, across], around(triangle.iter().map(|c| c.color)));
        Some(Self { origin: a, axes, corners, sides, size, whole: size, color, slope, colors })
    }

    /// That of a part of the triangle, on the same plane.
    fn part(&self, triangle: &[Corner; 3]) -> Option<Self> {
        if is_needle(area_and_length(&triangle.map(|c| c.at))) {
            return None;
        }
        let corners = triangle.map(|c| {
            let [x, y, _] = self.at(&c.at);
            [x, y]
        });
        let (sides, colors) = (sides_of(&corners), around(triangle.iter().map(|c| c.color)));
        Some(Self { corners, sides, size: size_of(triangle), colors, ..*self })
    }

    #[inline]
    fn at(&self, p: &Vec3) -> Vec3 {
        let to_p = sub(p, &self.origin);
        [0, 1, 2].map(|i| dot(&self.axes[i], &to_p))
    }

    /// The colour at a place in the plane, continued beyond the triangle.
    #[inline]
    fn color_at(&self, [x, y]: &[f64; 2]) -> Vec3 {
        add_scaled(&add_scaled(&self.color[0], *x, &self.color[1]), *y, &self.color[2])
    }

    /// How far inside a side; negative outside.
    #[inline]
    fn depth(&self, side: usize, p: &Vec3) -> f64 {
        let [x, y, offset] = self.sides[side];
        x * p[0] + y * p[1] + offset
    }

    #[inline]
    fn height(&self, p: &Vec3) -> f64 {
        dot(&self.axes[2], &sub(p, &self.origin))
    }

    /// Whether no point of this triangle is within `reach`, which contains the slack, of the other one.
    #[inline]
    fn apart(&self, other: &[Vec3; 3], reach: f64) -> bool {
        other.iter().all(|p| p[2] > reach)
            || other.iter().all(|p| p[2] < -reach)
            || (0..3).any(|side| other.iter().all(|p| self.depth(side, p) < -reach))
    }

    /// The same for what was seen.
    #[inline]
    fn misses(&self, Seen { at, around: [low, high], .. }: &Seen, reach: f64) -> bool {
        low[2] > reach
            || high[2] < -reach
            || (0..3).any(|side| at.iter().all(|p| self.depth(side, p) < -reach))
    }

    #[inline]
    fn rounding(&self, p: &Vec3) -> f64 {
        ROUNDING * (self.whole + p[0].abs() + p[1].abs())
    }

    /// Bit i is set where the point is outside of side i, and not by rounding.
    #[inline]
    fn outside(&self, p: &Vec3) -> u8 {
        let margin = self.rounding(p);
        (0..3).map(|side| u8::from(self.depth(side, p) < -margin) << side).sum()
    }

    /// The greatest height that another triangle has over this one.
    fn height_over(&self, other: &[Vec3; 3]) -> f64 {
        let margin = other.iter().map(|p| self.rounding(p)).fold(0.0, f64::max);
        // Convex: three cuts add a corner each.
        let (mut part, mut count) = ([other[0]; 6], 3);
        part[..3].copy_from_slice(other);
        for side in 0..3 {
            let (before, last) = (part, std::mem::take(&mut count));
            let levels = before.map(|p| self.depth(side, &p) + margin);
            for i in 0..last {
                let j = if i + 1 < last { i + 1 } else { 0 };
                let crossing = || {
                    let t = levels[i] / (levels[i] - levels[j]);
                    [0, 1, 2].map(|k| before[i][k] + t * (before[j][k] - before[i][k]))
                };
                let both = [
                    (levels[i] >= 0.0).then_some(before[i]),
                    ((levels[i] < 0.0) != (levels[j] < 0.0)).then(crossing),
                ];
                for place in both.into_iter().flatten() {
                    if count == part.len() {
                        return other.iter().map(|p| p[2].abs()).fold(0.0, f64::max);
                    }
                    part[count] = place;
                    count += 1;
                }
            }
        }
        part[..count].iter().map(|p| p[2].abs()).fold(0.0, f64::max)
    }

    /// Whether a side does not cross the inside of this triangle, whose corners are those of `triangle`. A border that was kept
    /// runs along its sides, or ends at its corners: that is told by the places themselves, which no rounding has changed.
    fn passed_by(&self, triangle: &[Corner; 3], ends: [&Vec3; 2]) -> bool {
        let [a, b] = ends.map(|p| self.at(p));
        // A line from a corner that ends outside of one of the two sides there is outside of it all the way.
        let leaves = |corner: usize, end: &Vec3| self.outside(end) & !(1 << corner) != 0;
        self.beside(&[a, b])
            || match ends.map(|p| triangle.iter().position(|c| c.at == *p)) {
                [Some(_), Some(_)] => true,
                [Some(corner), None] => leaves(corner, &b),
                [None, Some(corner)] => leaves(corner, &a),
                [None, None] => false,
            }
    }

    /// Whether a side passes beside this triangle.
    fn beside(&self, [a, b]: &[Vec3; 2]) -> bool {
        let along = [b[0] - a[0], b[1] - a[1]];
        let length = along[0].abs() + along[1].abs();
        let margin = length * (self.rounding(a) + self.rounding(b));
        let turn = self.corners.map(|c| along[0] * (c[1] - a[1]) - along[1] * (c[0] - a[0]));
        turn.iter().all(|&t| t > margin) || turn.iter().all(|&t| t < -margin)
    }

    /// As `larger_differs`, with the colour of this triangle continued to the feet of the points of the other one:
    /// those nearest to a point here, and those within the slack of them.
    fn smaller_differs(&self, against: &Against<'_>, seen: &Seen, around: f64) -> f64 {
        let colors = against.target.corner_colors(seen.slot);
        let most2 = [0, 1, 2].map(|k| {
            let [x, y, _] = seen.at[k];
            norm2(&sub(&self.color_at(&[x, y]), &colors[k]))
        });
        // Where heights are above zero all over the triangle, less is left for the way along the plane.
        let [low, high] = seen.around.map(|corner| corner[2]);
        let nearest = low.max(-high).max(0.0).min(around);
        let moved = (around * around - nearest * nearest).sqrt();
        let most = most2.iter().fold(0.0f64, |m, &d| m.max(d)).sqrt();
        most + self.slope * (moved + against.slack)
    }
}

/// Inward normal of each side of a triangle, and its distance from the origin.
fn sides_of(corners: &[[f64; 2]; 3]) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|opposite| {
        let (from, to) = (corners[(opposite + 1) % 3], corners[(opposite + 2) % 3]);
        let (along, across) = (to[0] - from[0], to[1] - from[1]);
        let length = (along * along + across * across).sqrt();
        let inward = [-across / length, along / length];
        [inward[0], inward[1], -(inward[0] * from[0] + inward[1] * from[1])]
    })
}

/// The length of the longest side.
fn size_of(triangle: &[Corner; 3]) -> f64 {
    area_and_length(&triangle.map(|c| c.at)).1.sqrt()
}

/// Four times the squared area, and the squared length of the longest side.
#[inline]
fn area_and_length([a, b, c]: &[Vec3; 3]) -> (f64, f64) {
    let (ab, ac) = (sub(b, a), sub(c, a));
    let longest = norm2(&ab).max(norm2(&ac)).max(norm2(&sub(c, b)));
    (norm2(&cross(&ab, &ac)), longest)
}

/// Of a needle only the longest side counts, which is no farther from any of its points than this.
#[inline]
fn needle_height(corners: &[Vec3; 3]) -> f64 {
    let (area2, longest2) = area_and_length(corners);
    if is_needle((area2, longest2)) && longest2 > 0.0 { (area2 / longest2).sqrt() } else { 0.0 }
}

#[inline]
fn is_needle((area2, longest2): (f64, f64)) -> bool {
    area2 <= (NEEDLE * longest2).powi(2)
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

/// A length that no side of a triangle in this box is much longer than.
#[inline]
fn extent([low, high]: &Box) -> f64 {
    (0..3).map(|i| high[i] - low[i]).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests;
