//! A triangle as what it is looked at from: places in its plane and heights over it, and how others lie there.

use super::piece::Against;
use super::polygon::Corner;
use super::surface::NEEDLE;
use crate::base::geometry::{Vec3, add_scaled, around, cross, dot, norm2, sub};

/// Share of the lengths in it that the position in a view may be wrong by: far more than rounding makes it.
pub(super) const ROUNDING: f64 = 1e-12;

/// The plane of a triangle: coordinates in it, and height. For a part of that triangle they are the same.
#[derive(Clone, Copy)]
pub(super) struct View {
    pub(super) origin: Vec3,
    pub(super) axes: [Vec3; 3],
    /// Corners of the triangle.
    pub(super) corners: [[f64; 2]; 3],
    /// Inward normal of each side, and its distance from the origin.
    pub(super) sides: [[f64; 3]; 3],
    pub(super) size: f64,
    /// That of the triangle this one is part of.
    pub(super) whole: f64,
    /// Colour at the origin, and what it changes along both axes.
    pub(super) color: [Vec3; 3],
    pub(super) slope: f64,
    /// The box around all colours.
    pub(super) colors: [Vec3; 2],
}

/// A triangle of the other surface, as seen.
#[derive(Clone, Copy)]
pub(super) struct Seen {
    pub(super) slot: u32,
    /// Two coordinates and the height of each corner.
    pub(super) at: [Vec3; 3],
}

/// Lowest and highest coordinates.
pub(super) type Box = [Vec3; 2];

impl Seen {
    /// The box around the corners.
    #[inline]
    pub(super) fn around(&self) -> Box {
        around(self.at.into_iter())
    }

    /// The greatest height of a corner, above or below.
    #[inline]
    pub(super) fn height(&self) -> f64 {
        self.at.iter().fold(0.0, |most, p| p[2].abs().max(most))
    }
}

impl View {
    /// None for a needle, whose normal has too few digits.
    pub(super) fn new(triangle: &[Corner; 3]) -> Option<Self> {
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
    pub(super) fn part(&self, triangle: &[Corner; 3]) -> Option<Self> {
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
    pub(super) fn at(&self, p: &Vec3) -> Vec3 {
        let to_p = sub(p, &self.origin);
        [0, 1, 2].map(|i| dot(&self.axes[i], &to_p))
    }

    /// The colour at a place in the plane, continued beyond the triangle.
    #[inline]
    pub(super) fn color_at(&self, [x, y]: &[f64; 2]) -> Vec3 {
        add_scaled(&add_scaled(&self.color[0], *x, &self.color[1]), *y, &self.color[2])
    }

    /// How far inside a side; negative outside.
    #[inline]
    pub(super) fn depth(&self, side: usize, p: &Vec3) -> f64 {
        let [x, y, offset] = self.sides[side];
        x * p[0] + y * p[1] + offset
    }

    /// A triangle as it is seen, unless it is clearly out of reach.
    #[inline]
    pub(super) fn seen(&self, slot: u32, corners: &[Vec3; 3], reach: f64) -> Option<Seen> {
        let to = corners.each_ref().map(|p| sub(p, &self.origin));
        let heights = to.each_ref().map(|p| dot(&self.axes[2], p));
        // Most are out of reach by their height alone.
        if heights.iter().all(|&h| h > reach) || heights.iter().all(|&h| h < -reach) {
            return None;
        }
        let at = [0, 1, 2].map(|k| [dot(&self.axes[0], &to[k]), dot(&self.axes[1], &to[k]), heights[k]]);
        (!self.apart(&at, reach)).then_some(Seen { slot, at })
    }

    /// Whether no point of this triangle is within `reach`, which contains the slack, of the other one.
    #[inline]
    pub(super) fn apart(&self, other: &[Vec3; 3], reach: f64) -> bool {
        other.iter().all(|p| p[2] > reach)
            || other.iter().all(|p| p[2] < -reach)
            || (0..3).any(|side| other.iter().all(|p| self.depth(side, p) < -reach))
    }

    #[inline]
    pub(super) fn rounding(&self, p: &Vec3) -> f64 {
        ROUNDING * (self.whole + p[0].abs() + p[1].abs())
    }

    /// Bit i is set where the point is outside of side i, and not by rounding.
    #[inline]
    pub(super) fn outside(&self, p: &Vec3) -> u8 {
        let margin = self.rounding(p);
        (0..3).map(|side| u8::from(self.depth(side, p) < -margin) << side).sum()
    }

    /// The greatest height that another triangle has over this one.
    pub(super) fn height_over(&self, other: &[Vec3; 3]) -> f64 {
        let margin = other.iter().map(|p| self.rounding(p)).fold(0.0, f64::max);
        // Convex: three cuts add a corner each.
        let (mut part, mut count) = ([other[0]; 6], 3);
        part[..3].copy_from_slice(other);
        for side in 0..3 {
            let mut levels = [0.0; 6];
            let mut is_cut = false;
            for (level, p) in levels.iter_mut().zip(&part[..count]) {
                *level = self.depth(side, p) + margin;
                is_cut |= *level < 0.0;
            }
            if !is_cut {
                continue;
            }
            let (before, last) = (part, std::mem::take(&mut count));
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
    pub(super) fn passed_by(&self, triangle: &[Corner; 3], ends: [&Vec3; 2]) -> bool {
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
    pub(super) fn beside(&self, [a, b]: &[Vec3; 2]) -> bool {
        let along = [b[0] - a[0], b[1] - a[1]];
        let length = along[0].abs() + along[1].abs();
        let margin = length * (self.rounding(a) + self.rounding(b));
        let turn = self.corners.map(|c| along[0] * (c[1] - a[1]) - along[1] * (c[0] - a[0]));
        turn.iter().all(|&t| t > margin) || turn.iter().all(|&t| t < -margin)
    }

    /// As `larger_differs`, with the colour of this triangle continued to the feet of the points of the other one:
    /// those nearest to a point here, and those within the slack of them.
    pub(super) fn smaller_differs(&self, against: &Against<'_>, seen: &Seen, around: f64) -> f64 {
        let colors = against.target.corner_colors(seen.slot);
        let most2 = [0, 1, 2].map(|k| {
            let [x, y, _] = seen.at[k];
            norm2(&sub(&self.color_at(&[x, y]), &colors[k]))
        });
        // Where heights are above zero all over the triangle, less is left for the way along the plane.
        let [low, high] = seen.around().map(|corner| corner[2]);
        let nearest = low.max(-high).max(0.0).min(around);
        let moved = (around * around - nearest * nearest).sqrt();
        let most = most2.iter().fold(0.0f64, |m, &d| m.max(d)).sqrt();
        most + self.slope * (moved + against.slack)
    }
}

/// Inward normal of each side of a triangle, and its distance from the origin.
pub(super) fn sides_of(corners: &[[f64; 2]; 3]) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|opposite| {
        let (from, to) = (corners[(opposite + 1) % 3], corners[(opposite + 2) % 3]);
        let (along, across) = (to[0] - from[0], to[1] - from[1]);
        let length = (along * along + across * across).sqrt();
        let inward = [-across / length, along / length];
        [inward[0], inward[1], -(inward[0] * from[0] + inward[1] * from[1])]
    })
}

/// The length of the longest side.
pub(super) fn size_of(triangle: &[Corner; 3]) -> f64 {
    area_and_length(&triangle.map(|c| c.at)).1.sqrt()
}

/// Four times the squared area, and the squared length of the longest side.
#[inline]
pub(super) fn area_and_length([a, b, c]: &[Vec3; 3]) -> (f64, f64) {
    let (ab, ac) = (sub(b, a), sub(c, a));
    let longest = norm2(&ab).max(norm2(&ac)).max(norm2(&sub(c, b)));
    (norm2(&cross(&ab, &ac)), longest)
}

/// Of a needle only the longest side counts, which is no farther from any of its points than this.
#[inline]
pub(super) fn needle_height(corners: &[Vec3; 3]) -> f64 {
    let (area2, longest2) = area_and_length(corners);
    if is_needle((area2, longest2)) && longest2 > 0.0 { (area2 / longest2).sqrt() } else { 0.0 }
}

#[inline]
pub(super) fn is_needle((area2, longest2): (f64, f64)) -> bool {
    area2 <= (NEEDLE * longest2).powi(2)
}

/// A length that no side of a triangle in this box is much longer than.
#[inline]
pub(super) fn extent([low, high]: &Box) -> f64 {
    (0..3).map(|i| high[i] - low[i]).fold(0.0, f64::max)
}
