//! Coordinate frame of a triangle: positions in its plane, heights, and the projections of other triangles.

use super::piece_bounds::BoundContext;
use super::polygon::Corner;
use super::surface::NEEDLE_RATIO;
use crate::base::geometry::{Vec3, add_scaled, bounding_box, cross, dot, norm2, sub};

/// Relative error assumed for projected positions, far above the rounding error.
pub(super) const ROUNDING_RATIO: f64 = 1e-12;

/// Plane of a triangle, its axes and its colour. A part of a triangle uses the same plane.
#[derive(Clone, Copy)]
pub(super) struct TriangleFrame {
    pub(super) origin: Vec3,
    pub(super) axes: [Vec3; 3],
    /// Corners of the triangle.
    pub(super) corners: [[f64; 2]; 3],
    /// Inward normal of each side, and offset.
    pub(super) sides: [[f64; 3]; 3],
    pub(super) size: f64,
    /// Longest side of the whole triangle that this one is part of.
    pub(super) whole_size: f64,
    /// Colour at the origin, and its derivatives along both axes.
    pub(super) color: [Vec3; 3],
    pub(super) slope: f64,
    /// Bounding box of the corner colours.
    pub(super) colors: [Vec3; 2],
}

/// A target triangle in the coordinates of a view.
#[derive(Clone, Copy)]
pub(super) struct ProjectedTriangle {
    pub(super) slot: u32,
    /// Two coordinates in the plane and the height of each corner.
    pub(super) points: [Vec3; 3],
}

/// Lowest and highest corner.
pub(super) type Bounds = [Vec3; 2];

impl ProjectedTriangle {
    /// Compute the bounding box of the corners.
    #[inline]
    pub(super) fn bounds(&self) -> Bounds {
        bounding_box(self.points.into_iter())
    }

    /// Compute the largest absolute height of a corner.
    #[inline]
    pub(super) fn max_height(&self) -> f64 {
        self.points.iter().fold(0.0, |most, p| p[2].abs().max(most))
    }
}

impl TriangleFrame {
    /// Create a view; `None` for a needle, because its normal is too inaccurate.
    pub(super) fn new(triangle: &[Corner; 3]) -> Option<Self> {
        let [a, b, c] = triangle.map(|c| c.at);
        if is_needle(squared_area_and_length(&[a, b, c])) {
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
        let size = longest_side(triangle);
        let (color, colors) = ([base, along, across], bounding_box(triangle.iter().map(|c| c.color)));
        Some(Self { origin: a, axes, corners, sides, size, whole_size: size, color, slope, colors })
    }

    /// Create the view of a part of the triangle, in the same plane.
    pub(super) fn for_part(&self, triangle: &[Corner; 3]) -> Option<Self> {
        if is_needle(squared_area_and_length(&triangle.map(|c| c.at))) {
            return None;
        }
        let corners = triangle.map(|c| {
            let [x, y, _] = self.project(&c.at);
            [x, y]
        });
        let (sides, colors) = (sides_of(&corners), bounding_box(triangle.iter().map(|c| c.color)));
        Some(Self { corners, sides, size: longest_side(triangle), colors, ..*self })
    }

    /// Convert a point to the coordinates of the view: two in the plane, and the height.
    #[inline]
    pub(super) fn project(&self, p: &Vec3) -> Vec3 {
        let to_p = sub(p, &self.origin);
        [0, 1, 2].map(|i| dot(&self.axes[i], &to_p))
    }

    /// Compute the colour at a position in the plane, continued beyond the triangle.
    #[inline]
    pub(super) fn color_at(&self, [x, y]: &[f64; 2]) -> Vec3 {
        add_scaled(&add_scaled(&self.color[0], *x, &self.color[1]), *y, &self.color[2])
    }

    /// Compute the distance of the foot from a side; negative outside.
    #[inline]
    pub(super) fn depth(&self, side: usize, p: &Vec3) -> f64 {
        let [x, y, offset] = self.sides[side];
        x * p[0] + y * p[1] + offset
    }

    /// Project a triangle, unless it is clearly out of reach.
    #[inline]
    pub(super) fn project_triangle(
        &self,
        slot: u32,
        corners: &[Vec3; 3],
        reach: f64,
    ) -> Option<ProjectedTriangle> {
        let to = corners.each_ref().map(|p| sub(p, &self.origin));
        let heights = to.each_ref().map(|p| dot(&self.axes[2], p));
        // The height alone excludes most triangles.
        if heights.iter().all(|&h| h > reach) || heights.iter().all(|&h| h < -reach) {
            return None;
        }
        let at = [0, 1, 2].map(|k| [dot(&self.axes[0], &to[k]), dot(&self.axes[1], &to[k]), heights[k]]);
        (!self.is_farther_than(&at, reach)).then_some(ProjectedTriangle { slot, points: at })
    }

    /// Test if a triangle is farther than `reach` (including the slack) from this one.
    #[inline]
    pub(super) fn is_farther_than(&self, other: &[Vec3; 3], reach: f64) -> bool {
        other.iter().all(|p| p[2] > reach)
            || other.iter().all(|p| p[2] < -reach)
            || (0..3).any(|side| other.iter().all(|p| self.depth(side, p) < -reach))
    }

    /// Bound the rounding error of a projected position.
    #[inline]
    pub(super) fn rounding(&self, p: &Vec3) -> f64 {
        ROUNDING_RATIO * (self.whole_size + p[0].abs() + p[1].abs())
    }

    /// Find the sides that a point is outside of by more than rounding: bit i for side i.
    #[inline]
    pub(super) fn outside_mask(&self, p: &Vec3) -> u8 {
        let margin = self.rounding(p);
        (0..3).map(|side| u8::from(self.depth(side, p) < -margin) << side).sum()
    }

    /// Compute the largest absolute height of another triangle over this one.
    pub(super) fn max_height_over(&self, other: &[Vec3; 3]) -> f64 {
        let margin = other.iter().map(|p| self.rounding(p)).fold(0.0, f64::max);
        // Three cuts of a triangle add at most three corners.
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

    /// Test if a side does not cross the interior of this triangle; `triangle` are the unprojected corners.
    ///
    /// A locked border runs along the sides or ends at the corners. Such a side is recognised by equal
    /// positions, which no rounding has changed.
    pub(super) fn is_not_crossed_by(&self, triangle: &[Corner; 3], ends: [&Vec3; 2]) -> bool {
        let [a, b] = ends.map(|p| self.project(p));
        // A line from a corner to a point outside one of the two adjacent sides does not enter the triangle.
        let leaves = |corner: usize, end: &Vec3| self.outside_mask(end) & !(1 << corner) != 0;
        self.passes_by(&[a, b])
            || match ends.map(|p| triangle.iter().position(|c| c.at == *p)) {
                [Some(_), Some(_)] => true,
                [Some(corner), None] => leaves(corner, &b),
                [None, Some(corner)] => leaves(corner, &a),
                [None, None] => false,
            }
    }

    /// Test if a line passes the triangle on one side.
    pub(super) fn passes_by(&self, [a, b]: &[Vec3; 2]) -> bool {
        let along = [b[0] - a[0], b[1] - a[1]];
        let length = along[0].abs() + along[1].abs();
        let margin = length * (self.rounding(a) + self.rounding(b));
        let turn = self.corners.map(|c| along[0] * (c[1] - a[1]) - along[1] * (c[0] - a[0]));
        turn.iter().all(|&t| t > margin) || turn.iter().all(|&t| t < -margin)
    }

    /// As `bound_color_to_larger`, for a target triangle smaller than this one.
    ///
    /// The colour of this triangle is continued to the feet of the points of the target: those nearest to a
    /// point of this triangle, and those within the slack of them.
    pub(super) fn bound_color_to_smaller(
        &self,
        against: &BoundContext<'_>,
        seen: &ProjectedTriangle,
        around: f64,
    ) -> f64 {
        let colors = against.target.corner_colors(seen.slot);
        let most2 = [0, 1, 2].map(|k| {
            let [x, y, _] = seen.points[k];
            norm2(&sub(&self.color_at(&[x, y]), &colors[k]))
        });
        // A height above zero over all of the target triangle leaves less distance along the plane.
        let [low, high] = seen.bounds().map(|corner| corner[2]);
        let nearest = low.max(-high).max(0.0).min(around);
        let moved = (around * around - nearest * nearest).sqrt();
        let most = most2.iter().fold(0.0f64, |m, &d| m.max(d)).sqrt();
        most + self.slope * (moved + against.slack)
    }
}

/// Compute the inward normal and offset of each side of a triangle.
pub(super) fn sides_of(corners: &[[f64; 2]; 3]) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|opposite| {
        let (from, to) = (corners[(opposite + 1) % 3], corners[(opposite + 2) % 3]);
        let (along, across) = (to[0] - from[0], to[1] - from[1]);
        let length = (along * along + across * across).sqrt();
        let inward = [-across / length, along / length];
        [inward[0], inward[1], -(inward[0] * from[0] + inward[1] * from[1])]
    })
}

/// Compute the length of the longest side.
pub(super) fn longest_side(triangle: &[Corner; 3]) -> f64 {
    squared_area_and_length(&triangle.map(|c| c.at)).1.sqrt()
}

/// Compute four times the squared area, and the squared length of the longest side.
#[inline]
pub(super) fn squared_area_and_length([a, b, c]: &[Vec3; 3]) -> (f64, f64) {
    let (ab, ac) = (sub(b, a), sub(c, a));
    let longest = norm2(&ab).max(norm2(&ac)).max(norm2(&sub(c, b)));
    (norm2(&cross(&ab, &ac)), longest)
}

/// Compute the height of a needle over its longest side; 0 for other triangles.
///
/// Only the longest side of a needle counts, and all its points are within this distance of it.
#[inline]
pub(super) fn needle_height(corners: &[Vec3; 3]) -> f64 {
    let (area2, longest2) = squared_area_and_length(corners);
    if is_needle((area2, longest2)) && longest2 > 0.0 { (area2 / longest2).sqrt() } else { 0.0 }
}

/// Test if a triangle is a needle, given the result of [`squared_area_and_length`].
#[inline]
pub(super) fn is_needle((area2, longest2): (f64, f64)) -> bool {
    area2 <= (NEEDLE_RATIO * longest2).powi(2)
}

/// Compute the longest edge of a box, an estimate of the size of the triangle in it.
#[inline]
pub(super) fn longest_edge([low, high]: &Bounds) -> f64 {
    (0..3).map(|i| high[i] - low[i]).fold(0.0, f64::max)
}
