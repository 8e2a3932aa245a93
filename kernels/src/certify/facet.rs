//! One triangle of the other surface: nearest points on it, and the region in which it can be the nearest
//! triangle.

use super::polygon::Polygon;
use crate::base::geometry::{Vec3, add_scaled, cross, dot, norm2, sub};

/// Minimum ratio of squared height to squared length. Below it the normal has lost more than half of its
/// digits, and the triangle is treated as its three sides; they are within 1e-8 × length of all its points.
const MIN_FLATNESS2: f64 = 1e-16;

/// Nearest point of a triangle: barycentric coordinates and squared distance.
#[derive(Clone, Copy, Debug)]
pub struct NearestWeights {
    pub distance2: f64,
    pub weights: Vec3,
    /// Bit i is set if corner i has a weight above 0: identifies the corner, side or face.
    pub feature: u8,
}

/// Foot of a point that projects into a triangle.
struct FootInside {
    /// Barycentric coordinates of b and c, scaled by the squared normal `area2`, and height, scaled by its
    /// root.
    at_b: f64,
    at_c: f64,
    height: f64,
    area2: f64,
}

/// Project `p` onto triangle `corners`.
///
/// If the foot is outside, returns the sides (by their opposite corners) that separate it from the triangle.
#[inline]
fn project_inside(p: &Vec3, [a, b, c]: &[Vec3; 3]) -> Result<FootInside, [bool; 3]> {
    let (ab, ac, to_p) = (sub(b, a), sub(c, a), sub(p, a));
    let normal = cross(&ab, &ac);
    let area2 = norm2(&normal);
    if area2 <= MIN_FLATNESS2 * norm2(&ab) * norm2(&ac) {
        return Err([true; 3]);
    }
    let at_b = dot(&cross(&to_p, &ac), &normal);
    let at_c = dot(&cross(&ab, &to_p), &normal);
    let outside = [at_b + at_c > area2, at_b < 0.0, at_c < 0.0];
    if outside == [false; 3] {
        Ok(FootInside { at_b, at_c, height: dot(&to_p, &normal), area2 })
    } else {
        Err(outside)
    }
}

/// Find the nearest point of a side: parameter along it, and squared distance.
#[inline]
fn nearest_on_side(p: &Vec3, from: &Vec3, to: &Vec3) -> (f64, f64) {
    let (along, to_p) = (sub(to, from), sub(p, from));
    let length2 = norm2(&along);
    let t = if length2 > 0.0 { (dot(&to_p, &along) / length2).clamp(0.0, 1.0) } else { 0.0 };
    (t, norm2(&add_scaled(&to_p, -t, &along)))
}

/// Find the point of triangle `corners` that is nearest to `p`.
#[inline]
pub fn nearest_point(p: &Vec3, corners: &[Vec3; 3]) -> NearestWeights {
    let outside = match project_inside(p, corners) {
        Ok(FootInside { at_b, at_c, height, area2 }) => {
            let height = height / area2.sqrt();
            let (v, w) = (at_b / area2, at_c / area2);
            return NearestWeights { distance2: height * height, weights: [1.0 - v - w, v, w], feature: 7 };
        }
        Err(outside) => outside,
    };
    // Only a side whose line separates the foot from the triangle can be nearest.
    let mut best = NearestWeights { distance2: f64::INFINITY, weights: [1.0, 0.0, 0.0], feature: 1 };
    for (opposite, _) in outside.iter().enumerate().filter(|(_, outside)| **outside) {
        let (i, j) = ((opposite + 1) % 3, (opposite + 2) % 3);
        let (t, distance2) = nearest_on_side(p, &corners[i], &corners[j]);
        if distance2 < best.distance2 {
            let mut weights = [0.0; 3];
            (weights[i], weights[j]) = (1.0 - t, t);
            let feature = [i, j].iter().filter(|&&k| weights[k] > 0.0).map(|k| 1 << k).sum();
            best = NearestWeights { distance2, weights, feature };
        }
    }
    best
}

/// As [`nearest_point`], but computes only the squared distance, which is cheaper.
#[inline]
pub fn distance2(p: &Vec3, corners: &[Vec3; 3]) -> f64 {
    match project_inside(p, corners) {
        Ok(FootInside { height, area2, .. }) => height * height / area2,
        Err(outside) => {
            (0..3).filter(|&opposite| outside[opposite]).fold(f64::INFINITY, |least, opposite| {
                least.min(nearest_on_side(p, &corners[(opposite + 1) % 3], &corners[(opposite + 2) % 3]).1)
            })
        }
    }
}

/// Plane of a triangle and its barycentric coordinates, as linear functions in space.
#[derive(Clone, Copy, Debug)]
pub struct Facet {
    origin: Vec3,
    normal: Vec3,
    /// Gradients of the barycentric coordinates, and their norms (1 / height).
    gradients: [Vec3; 3],
    steepness: Vec3,
}

impl Facet {
    /// Create a facet; `None` for a triangle that is too flat, see [`MIN_FLATNESS2`].
    pub fn new([a, b, c]: &[Vec3; 3]) -> Option<Self> {
        let (ab, ac) = (sub(b, a), sub(c, a));
        let normal = cross(&ab, &ac);
        let area2 = norm2(&normal);
        if area2 <= MIN_FLATNESS2 * norm2(&ab) * norm2(&ac) {
            return None;
        }
        let unit = |v: Vec3, by: f64| v.map(|x| x / by);
        let (of_b, of_c) = (unit(cross(&ac, &normal), area2), unit(cross(&normal, &ab), area2));
        let gradients = [[0, 1, 2].map(|i| -of_b[i] - of_c[i]), of_b, of_c];
        let steepness = gradients.map(|g| norm2(&g).sqrt());
        Some(Self { origin: *a, normal: unit(normal, area2.sqrt()), gradients, steepness })
    }

    /// Compute the signed distance from the plane.
    #[inline]
    pub fn height(&self, p: &Vec3) -> f64 {
        dot(&self.normal, &sub(p, &self.origin))
    }

    /// Compute the distance of the foot of `p` from a side; negative outside.
    ///
    /// The side is given by the opposite corner.
    #[inline]
    pub fn depth(&self, p: &Vec3, opposite: usize) -> f64 {
        let start = if opposite == 0 { 1.0 } else { 0.0 };
        (start + dot(&self.gradients[opposite], &sub(p, &self.origin))) / self.steepness[opposite]
    }

    /// Compute the barycentric coordinates of the foot of `p`; negative outside.
    #[inline]
    pub fn weights(&self, p: &Vec3) -> Vec3 {
        let to_p = sub(p, &self.origin);
        let (v, w) = (dot(&self.gradients[1], &to_p), dot(&self.gradients[2], &to_p));
        [1.0 - v - w, v, w]
    }

    /// Compute the norm of the gradient of a linear function with values `corners`.
    ///
    /// This is the Frobenius norm over the channels.
    pub fn gradient_norm(&self, corners: &[Vec3; 3]) -> f64 {
        let [to_b, to_c] = [1, 2].map(|i| sub(&corners[i], &corners[0]));
        let [of_b, of_c] = [self.gradients[1], self.gradients[2]];
        let square = norm2(&to_b) * norm2(&of_b)
            + norm2(&to_c) * norm2(&of_c)
            + 2.0 * dot(&to_b, &to_c) * dot(&of_b, &of_c);
        square.max(0.0).sqrt()
    }

    /// Clip `clip_to_nearest` to the region whose nearest point can be on this triangle.
    ///
    /// Returns the maximum distance of feet outside the triangle; `None` if the region is empty.
    ///
    /// Let the foot be at distance o from the triangle, and the plane at height h. Then h² + o² ≤ (reach +
    /// slack)², so o² ≤ (reach + slack − |h|)(reach + slack + |h|). Both factors have convex upper bounds,
    /// whose maxima are at corners. Clipping the region farther outside lowers the bound, so the steps are
    /// repeated a few times.
    pub fn clip_to_nearest(&self, part: &mut Polygon, slack: f64) -> Option<f64> {
        let side = part.iter().map(|c| self.height(&c.at)).sum::<f64>().signum();
        let mut outside = f64::INFINITY;
        for _ in 0..3 {
            let (mut less, mut more) = (f64::NEG_INFINITY, 0.0f64);
            for corner in part.iter() {
                let (height, reach) = (self.height(&corner.at), corner.reach + slack);
                less = less.max(reach - side * height);
                more = more.max(reach + height.abs());
            }
            // The plane alone is farther away than the surface.
            if less < 0.0 {
                return None;
            }
            let nearer = (less * more).sqrt();
            if nearer >= 0.7 * outside {
                outside = outside.min(nearer);
                break;
            }
            outside = nearer;
            for opposite in 0..3 {
                part.clip(|p| self.depth(p, opposite) + outside);
                if part.is_empty() {
                    return None;
                }
            }
        }
        Some(outside)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::triangle_distance2;

    const CORNERS: [Vec3; 3] = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [-1.0, 2.0, 0.0]];

    #[test]
    fn the_nearest_point_is_on_the_feature_it_names() {
        for (p, feature) in [
            ([0.5, 0.5, 2.0], 0b111),
            ([1.0, -1.0, 1.0], 0b011),
            ([-2.0, 1.0, 0.0], 0b101),
            ([3.0, 3.0, 0.0], 0b110),
            ([9.0, -1.0, 0.0], 0b010),
            ([-3.0, 9.0, 0.0], 0b100),
            ([-0.1, -1.0, 0.0], 0b001),
        ] {
            let found = nearest_point(&p, &CORNERS);
            assert_eq!(found.feature, feature, "{p:?}");
            let [a, b, c] = &CORNERS;
            assert!((found.distance2 - triangle_distance2(&p, [a, b, c])).abs() < 1e-12);
            let at: Vec3 = [0, 1, 2].map(|i| (0..3).map(|k| found.weights[k] * CORNERS[k][i]).sum());
            assert!((norm2(&sub(&p, &at)) - found.distance2).abs() < 1e-12);
            assert!((distance2(&p, &CORNERS) - found.distance2).abs() < 1e-12);
        }
    }

    #[test]
    fn plane_computes_heights_depths_and_gradients() {
        let facet = Facet::new(&CORNERS).unwrap();
        assert_eq!(facet.height(&[1.0, 1.0, 3.0]).abs(), 3.0);
        assert!((facet.depth(&[1.0, -0.5, 9.0], 2) + 0.5).abs() < 1e-15);
        let weights = facet.weights(&[1.5, 1.0, 7.0]);
        assert!(sub(&weights, &[0.0, 0.5, 0.5]).iter().all(|x| x.abs() < 1e-15), "{weights:?}");
        // One channel is 3x, another 4x.
        let colors = CORNERS.map(|p| [3.0 * p[0], 4.0 * p[0], 0.0]);
        assert!((facet.gradient_norm(&colors) - 5.0).abs() < 1e-14);
        assert!(Facet::new(&[CORNERS[0], CORNERS[1], [2.0, 1e-9, 0.0]]).is_none());
    }
}
