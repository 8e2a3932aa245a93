//! Convex part of a triangle, clipped by half-spaces.
//!
//! Each corner carries the colour and an upper bound on the distance of the other surface (`reach`). Over the
//! polygon the colour is linear, and every convex function, such as a distance, is largest at a corner.

use std::ops::Deref;

use crate::base::geometry::{Vec3, dot, norm2, sub};

/// Maximum number of corners. Each cut of a convex polygon adds at most one.
pub const MAX_CORNERS: usize = 16;

/// Corner of a polygon: position, colour, and upper bound on the distance of the other surface.
#[derive(Clone, Copy, Debug)]
pub struct Corner {
    pub at: Vec3,
    pub color: Vec3,
    pub reach: f64,
}

/// Convex polygon with a fixed maximum number of corners.
#[derive(Clone, Copy, Debug)]
pub struct Polygon {
    corners: [Corner; MAX_CORNERS],
    count: usize,
}

impl Deref for Polygon {
    type Target = [Corner];

    fn deref(&self) -> &[Corner] {
        &self.corners[..self.count]
    }
}

impl Polygon {
    pub fn new(corners: [Corner; 3]) -> Self {
        let mut all = [corners[0]; MAX_CORNERS];
        all[..3].copy_from_slice(&corners);
        Self { corners: all, count: 3 }
    }

    /// Compute the mean of the corners, and the largest distance of a corner from it.
    pub fn centre(&self) -> (Corner, f64) {
        let share = 1.0 / self.len() as f64;
        let mean =
            |of: fn(&Corner) -> &Vec3| [0, 1, 2].map(|i| share * self.iter().map(|c| of(c)[i]).sum::<f64>());
        let centre = Corner { at: mean(|c| &c.at), color: mean(|c| &c.color), reach: f64::INFINITY };
        let radius2 = self.iter().map(|c| norm2(&sub(&c.at, &centre.at))).fold(0.0, f64::max);
        (centre, radius2.sqrt())
    }

    /// Find the two corners that are farthest apart.
    pub fn diameter(&self) -> [Vec3; 2] {
        let mut farthest = ([self[0].at; 2], 0.0);
        for (i, a) in self.iter().enumerate() {
            for b in &self[i + 1..] {
                let distance2 = norm2(&sub(&a.at, &b.at));
                if distance2 > farthest.1 {
                    farthest = ([a.at, b.at], distance2);
                }
            }
        }
        farthest.0
    }

    /// Cut in two by the plane through the centre, perpendicular to the diameter.
    pub fn halves(&self) -> [Self; 2] {
        let [a, b] = self.diameter();
        let (along, middle) = (sub(&b, &a), self.centre().0.at);
        let level = |p: &Vec3| dot(&along, &sub(p, &middle));
        [self.clipped(level), self.clipped(|p| -level(p))]
    }

    /// Recompute `reach` at all corners.
    pub fn set_reach(&mut self, reach: impl Fn(&Vec3) -> f64) {
        for corner in &mut self.corners[..self.count] {
            corner.reach = reach(&corner.at);
        }
    }

    pub fn bounding_box(&self) -> [Vec3; 2] {
        let side = |pick: fn(f64, f64) -> f64, start| {
            [0, 1, 2].map(|i| self.iter().map(|c| c.at[i]).fold(start, pick))
        };
        [side(f64::min, f64::INFINITY), side(f64::max, f64::NEG_INFINITY)]
    }

    /// Clip to the half-space in which a linear function is not negative (Sutherland & Hodgman 1974).
    ///
    /// If the result would have too many corners because of rounding, the polygon stays whole.
    pub fn clip(&mut self, level: impl Fn(&Vec3) -> f64) {
        self.clip_convex(|corner| level(&corner.at));
    }

    /// Return a copy after [`Self::clip`].
    pub fn clipped(&self, level: impl Fn(&Vec3) -> f64) -> Self {
        let mut part = *self;
        part.clip(level);
        part
    }

    /// As [`Self::clip`] for a convex function; the result contains all points at which it is not negative.
    pub fn clip_convex(&mut self, level: impl Fn(&Corner) -> f64) {
        let mut levels = [0.0; MAX_CORNERS];
        let (mut inside, mut crossings) = (0, 0);
        let count = self.count;
        for (here, corner) in levels.iter_mut().zip(self.iter()) {
            *here = level(corner);
            inside += usize::from(*here >= 0.0);
        }
        // Most polygons are not cut, and need no copy.
        if inside == count {
            return;
        }
        if inside == 0 {
            self.count = 0;
            return;
        }
        let before = |i: usize| if i == 0 { count - 1 } else { i - 1 };
        let is_crossed = |i: usize| {
            let (a, b) = (levels[before(i)], levels[i]);
            (a < 0.0) != (b < 0.0) && a != 0.0 && b != 0.0
        };
        (0..count).for_each(|i| crossings += usize::from(is_crossed(i)));
        if inside + crossings > MAX_CORNERS {
            return;
        }
        let whole = self.corners;
        self.count = 0;
        for i in 0..count {
            if is_crossed(i) {
                let (a, b) = (levels[before(i)], levels[i]);
                self.push(interpolate_corners(&whole[before(i)], &whole[i], a / (a - b)));
            }
            if levels[i] >= 0.0 {
                self.push(whole[i]);
            }
        }
    }

    fn push(&mut self, corner: Corner) {
        self.corners[self.count] = corner;
        self.count += 1;
    }
}

/// Interpolate between two corners. A convex `reach` is at most its linear interpolation.
fn interpolate_corners(a: &Corner, b: &Corner, t: f64) -> Corner {
    let mix = |x: f64, y: f64| x + t * (y - x);
    Corner {
        at: [0, 1, 2].map(|i| mix(a.at[i], b.at[i])),
        color: [0, 1, 2].map(|i| mix(a.color[i], b.color[i])),
        reach: mix(a.reach, b.reach),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle() -> Polygon {
        let corner = |x: f64, y: f64| Corner { at: [x, y, 0.0], color: [x, 2.0 * y, x + y], reach: x };
        Polygon::new([corner(0.0, 0.0), corner(4.0, 0.0), corner(0.0, 4.0)])
    }

    fn area(polygon: &Polygon) -> f64 {
        let next = polygon.iter().cycle().skip(1);
        0.5 * polygon.iter().zip(next).map(|(a, b)| a.at[0] * b.at[1] - b.at[0] * a.at[1]).sum::<f64>()
    }

    #[test]
    fn a_cut_gives_two_parts_and_the_values_on_it_are_linear() {
        let level = |p: &Vec3| p[0] - 1.0;
        let (right, left) = (triangle().clipped(level), triangle().clipped(|p| -level(p)));
        assert_eq!((area(&right), area(&left)), (4.5, 3.5));
        for c in right.iter().chain(left.iter()) {
            assert_eq!(c.color, [c.at[0], 2.0 * c.at[1], c.at[0] + c.at[1]]);
            assert_eq!(c.reach, c.at[0]);
        }
    }

    #[test]
    fn clipping_keeps_all_or_nothing_off_the_line() {
        assert!(triangle().clipped(|p| -1.0 - p[0]).is_empty());
        assert_eq!(area(&triangle().clipped(|p| p[0] + 1.0)), 8.0);
        // The line only touches a corner.
        assert_eq!(triangle().clipped(|p| p[0] - 4.0).len(), 1);
    }
}
