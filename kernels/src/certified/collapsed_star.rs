//! Triangles around the new vertex of a collapse, prepared for nearest-point queries.

use super::input_surface::interpolate;
use crate::base::geometry::{Vec3, cross, dot, nearest_on_triangle, norm2, position_of, sub};
use crate::mesh::edge_star::EdgeStar;

/// One triangle of the fan.
struct FanTriangle<const D: usize> {
    /// Index in `EdgeStar::wings`.
    wing: u32,
    from: [f64; D],
    to: [f64; D],
    /// Unit normal; zero if the triangle has no area.
    normal: Vec3,
    /// Gradients of the barycentric coordinates of `from` and `to`.
    gradient_from: Vec3,
    gradient_to: Vec3,
    /// Squared heights of the tip, `from` and `to` above their opposite sides.
    heights2: [f64; 3],
    /// Squared norm of the cross product (four times the squared area), and squared longest side.
    area2: f64,
    longest2: f64,
}

/// The star of an edge after its collapse to one vertex.
#[derive(Default)]
pub struct CollapsedStar<const D: usize> {
    triangles: Vec<FanTriangle<D>>,
    tip: Option<[f64; D]>,
}

/// The point of a fan that is nearest to a query point.
#[derive(Clone, Copy, Debug)]
pub struct NearestFanPoint<const D: usize> {
    pub wing: u32,
    pub distance2: f64,
    pub point: [f64; D],
}

impl<const D: usize> CollapsedStar<D> {
    /// Build the fan that `star` becomes if both ends move to `tip`.
    pub fn rebuild(&mut self, star: &EdgeStar<D>, tip: &[f64; D]) {
        self.tip = Some(*tip);
        self.triangles.clear();
        let centre = position_of(tip);
        for (i, wing) in star.remaining.iter().enumerate() {
            let a = sub(&position_of(&wing.from_point), &centre);
            let b = sub(&position_of(&wing.to_point), &centre);
            let normal = cross(&a, &b);
            let area2 = norm2(&normal);
            let sides2 = [norm2(&sub(&b, &a)), norm2(&b), norm2(&a)];
            let (mut unit, mut at_from, mut at_to, mut heights2) = ([0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3]);
            if area2 > 0.0 {
                let length = area2.sqrt();
                unit = normal.map(|x| x / length);
                at_from = cross(&b, &normal).map(|x| x / area2);
                at_to = cross(&normal, &a).map(|x| x / area2);
                heights2 = sides2.map(|side2| area2 / side2);
            }
            self.triangles.push(FanTriangle {
                wing: i as u32,
                from: wing.from_point,
                to: wing.to_point,
                normal: unit,
                gradient_from: at_from,
                gradient_to: at_to,
                heights2,
                area2,
                longest2: sides2.into_iter().fold(0.0, f64::max),
            });
        }
    }

    /// Test if the collapse creates a needle: a triangle with twice its area ≤ `flatness` × longest side².
    ///
    /// Triangles that were needles before the collapse do not count.
    pub fn creates_needle(&self, star: &EdgeStar<D>, flatness: f64) -> bool {
        let is_needle = |area2: f64, longest2: f64| area2 <= (flatness * longest2).powi(2);
        self.triangles.iter().filter(|blade| is_needle(blade.area2, blade.longest2)).any(|blade| {
            let wing = &star.remaining[blade.wing as usize];
            let p = position_of(star.end_point(wing.end));
            let (pa, pb) = (sub(&position_of(&wing.from_point), &p), sub(&position_of(&wing.to_point), &p));
            let longest2 = norm2(&pa).max(norm2(&pb)).max(norm2(&sub(&pb, &pa)));
            !is_needle(norm2(&cross(&pa, &pb)), longest2)
        })
    }

    /// Project `p` onto the triangle of `wing`; `None` if the foot is outside the triangle.
    pub fn project_onto_wing(&self, p: &Vec3, wing: u32) -> Option<NearestFanPoint<D>> {
        let tip = self.tip.as_ref()?;
        let blade = &self.triangles[wing as usize];
        let q = sub(p, &position_of(tip));
        let (u, v) = (dot(&blade.gradient_from, &q), dot(&blade.gradient_to, &q));
        let is_inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0 && blade.heights2[0] > 0.0;
        is_inside.then(|| {
            let height = dot(&blade.normal, &q);
            let point = interpolate(&[1.0 - u - v, u, v], [tip, &blade.from, &blade.to]);
            NearestFanPoint { wing, distance2: height * height, point }
        })
    }

    /// Find the point of the fan that is nearest to `p`; `None` if the fan is empty.
    pub fn find_nearest(&self, p: &Vec3) -> Option<NearestFanPoint<D>> {
        let tip = self.tip.as_ref()?;
        let centre = position_of(tip);
        let q = sub(p, &centre);
        let mut best: Option<(f64, usize, [f64; 3])> = None;
        let mut least = f64::INFINITY;
        for (i, blade) in self.triangles.iter().enumerate() {
            let height = dot(&blade.normal, &q);
            let (u, v) = (dot(&blade.gradient_from, &q), dot(&blade.gradient_to, &q));
            let outside = [u + v - 1.0, -u, -v];
            // Squared distance from the foot to the lines of the sides it is outside of: a lower bound that
            // skips most triangles.
            let beyond2 = (0..3)
                .map(|k| if outside[k] > 0.0 { outside[k] * outside[k] * blade.heights2[k] } else { 0.0 })
                .fold(0.0, f64::max);
            let at_least = height * height + beyond2;
            if at_least >= least {
                continue;
            }
            let has_area = blade.heights2[0] > 0.0;
            let (at, distance2) = if has_area && outside.iter().all(|&x| x <= 0.0) {
                ([1.0 - u - v, u, v], height * height)
            } else {
                nearest_on_triangle(p, [&centre, &position_of(&blade.from), &position_of(&blade.to)])
            };
            if distance2 < least {
                least = distance2;
                best = Some((distance2, i, at));
            }
        }
        best.map(|(distance2, i, at)| {
            let blade = &self.triangles[i];
            NearestFanPoint {
                wing: blade.wing,
                distance2,
                point: interpolate(&at, [tip, &blade.from, &blade.to]),
            }
        })
    }
}
