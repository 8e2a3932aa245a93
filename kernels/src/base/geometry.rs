//! Small vector algebra, and distances to triangles and segments.

/// 3-D vector or point.
pub type Vec3 = [f64; 3];

/// Extract the position of a vertex (the first three coordinates).
#[inline]
pub fn position_of<const D: usize>(p: &[f64; D]) -> Vec3 {
    [p[0], p[1], p[2]]
}

/// Compute a − b.
#[inline]
pub fn sub<const D: usize>(a: &[f64; D], b: &[f64; D]) -> [f64; D] {
    std::array::from_fn(|i| a[i] - b[i])
}

/// Compute the bounding box [low, high] of points; [+∞, −∞] without points.
pub fn bounding_box(points: impl Iterator<Item = Vec3>) -> [Vec3; 2] {
    points.fold([[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]], |[low, high], p| {
        [[0, 1, 2].map(|i| low[i].min(p[i])), [0, 1, 2].map(|i| high[i].max(p[i]))]
    })
}

/// Compute the diagonal length of a box; 0 for an empty box.
pub fn diagonal([low, high]: &[Vec3; 2]) -> f64 {
    norm2(&sub(high, low).map(|side| side.max(0.0))).sqrt()
}

/// Grow a box on each side by `share` times its diagonal.
pub fn enlarge_box([low, high]: &[Vec3; 2], share: f64) -> [Vec3; 2] {
    let margin = share * diagonal(&[*low, *high]);
    [low.map(|x| x - margin), high.map(|x| x + margin)]
}

/// Compute a + t·b.
#[inline]
pub fn add_scaled<const D: usize>(a: &[f64; D], t: f64, b: &[f64; D]) -> [f64; D] {
    std::array::from_fn(|i| a[i] + t * b[i])
}

/// Compute the midpoint of a and b.
#[inline]
pub fn midpoint<const D: usize>(a: &[f64; D], b: &[f64; D]) -> [f64; D] {
    std::array::from_fn(|i| 0.5 * (a[i] + b[i]))
}

/// Compute the dot product.
#[inline]
pub fn dot(a: &Vec3, b: &Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Compute the cross product.
#[inline]
pub fn cross(a: &Vec3, b: &Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Compute the squared norm.
#[inline]
pub fn norm2(a: &Vec3) -> f64 {
    dot(a, a)
}

/// Normalise a vector to length 1; the zero vector stays zero.
#[inline]
pub fn normalize(v: &Vec3) -> Vec3 {
    let length = norm2(v).sqrt();
    if length > 0.0 { v.map(|x| x / length) } else { [0.0; 3] }
}

/// Compute the area of a triangle.
#[inline]
pub fn area([a, b, c]: [&Vec3; 3]) -> f64 {
    0.5 * norm2(&cross(&sub(b, a), &sub(c, a))).sqrt()
}

/// Compute the squared distance of the positions of two vertices (the first three coordinates).
#[inline]
pub fn distance2<const D: usize>(a: &[f64; D], b: &[f64; D]) -> f64 {
    norm2(&sub(&position_of(a), &position_of(b)))
}

/// Compute the squared distance from `p` to the segment `a`–`b`.
#[inline]
pub fn segment_distance2(p: &Vec3, a: &Vec3, b: &Vec3) -> f64 {
    let (along, to_p) = (sub(b, a), sub(p, a));
    let length2 = norm2(&along);
    // A segment of zero length degenerates to its end point.
    let t = if length2 > 0.0 { (dot(&to_p, &along) / length2).clamp(0.0, 1.0) } else { 0.0 };
    norm2(&sub(&to_p, &along.map(|x| t * x)))
}

/// Compute the squared distance from `p` to the triangle `a b c`, which may be degenerate.
#[inline]
pub fn triangle_distance2(p: &Vec3, [a, b, c]: [&Vec3; 3]) -> f64 {
    let (ab, ac, to_p) = (sub(b, a), sub(c, a), sub(p, a));
    let normal = cross(&ab, &ac);
    let area2 = norm2(&normal);
    // Below this ratio the normal is rounding error, and the triangle is treated as its three edges.
    if area2 > 1e-24 * norm2(&ab) * norm2(&ac) {
        // Barycentric coordinates of the perpendicular foot, times area2.
        let at_c = dot(&cross(&ab, &to_p), &normal);
        let at_b = dot(&cross(&to_p, &ac), &normal);
        if at_b >= 0.0 && at_c >= 0.0 && at_b + at_c <= area2 {
            let height = dot(&to_p, &normal);
            return height * height / area2;
        }
    }
    segment_distance2(p, a, b).min(segment_distance2(p, b, c)).min(segment_distance2(p, c, a))
}

/// Find the point of the triangle `a b c` nearest to `p`: its barycentric coordinates and squared distance.
#[inline]
pub fn nearest_on_triangle(p: &Vec3, [a, b, c]: [&Vec3; 3]) -> ([f64; 3], f64) {
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let along = |to_p: &Vec3| [dot(&ab, to_p), dot(&ac, to_p)];
    let at = nearest_weights(along(&ap), || along(&sub(p, b)), || along(&sub(p, c)));
    let off: Vec3 = std::array::from_fn(|i| ap[i] - at[1] * ab[i] - at[2] * ac[i]);
    (at, norm2(&off))
}

/// Find the barycentric coordinates of the nearest point of a triangle (Ericson, "Real-time collision
/// detection", 2005, section 5.1.5).
///
/// Each argument is the way from a corner to the point, multiplied by both sides at the first corner.
#[inline]
fn nearest_weights(
    [d1, d2]: [f64; 2],
    from_b: impl Fn() -> [f64; 2],
    from_c: impl Fn() -> [f64; 2],
) -> [f64; 3] {
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let [d3, d4] = from_b();
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let vc = d1 * d4 - d3 * d2;
    // An edge of zero length is skipped, because the other two edges cover its points.
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 && d1 > d3 {
        let t = d1 / (d1 - d3);
        return [1.0 - t, t, 0.0];
    }
    let [d5, d6] = from_c();
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 && d2 > d6 {
        let t = d2 / (d2 - d6);
        return [1.0 - t, 0.0, t];
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 && (d4 - d3) + (d5 - d6) > 0.0 {
        let t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return [0.0, 1.0 - t, t];
    }
    let sum = va + vb + vc;
    if sum <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let (v, w) = (vb / sum, vc / sum);
    [1.0 - v - w, v, w]
}

/// Triangle prepared for many searches of the nearest point, which then take half of the time.
pub struct SearchTriangle {
    corner: Vec3,
    sides: [Vec3; 2],
    /// Products of both sides with the first side and with the second one.
    products: [[f64; 2]; 2],
}

impl SearchTriangle {
    pub fn new([a, b, c]: [&Vec3; 3]) -> Self {
        let sides = [sub(b, a), sub(c, a)];
        let products = sides.each_ref().map(|side| sides.each_ref().map(|other| dot(other, side)));
        Self { corner: *a, sides, products }
    }

    /// As [`nearest_on_triangle`], up to rounding.
    #[inline]
    pub fn nearest(&self, p: &Vec3) -> ([f64; 3], f64) {
        let [ab, ac] = &self.sides;
        let to_p = sub(p, &self.corner);
        let from_a = [dot(ab, &to_p), dot(ac, &to_p)];
        let beyond = |i: usize| [from_a[0] - self.products[i][0], from_a[1] - self.products[i][1]];
        let at = nearest_weights(from_a, || beyond(0), || beyond(1));
        let off: Vec3 = std::array::from_fn(|i| to_p[i] - at[1] * ab[i] - at[2] * ac[i]);
        (at, norm2(&off))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: Vec3 = [0.0, 0.0, 0.0];
    const B: Vec3 = [2.0, 0.0, 0.0];
    const C: Vec3 = [0.0, 2.0, 0.0];

    #[test]
    fn prepared_triangle_gives_the_same_nearest_point() {
        let corners = [[0.3, -0.2, 0.1], [2.1, 0.4, -0.3], [0.6, 1.7, 0.9]];
        let prepared = SearchTriangle::new(corners.each_ref());
        for i in 0..9 * 9 * 5 {
            let p = [f64::from(i % 9) - 4.0, f64::from(i / 9 % 9) - 4.0, f64::from(i / 81) - 2.0];
            let ((at, distance2), (same, same2)) =
                (nearest_on_triangle(&p, corners.each_ref()), prepared.nearest(&p));
            assert!(
                (distance2 - same2).abs() < 1e-12 && at.iter().zip(&same).all(|(a, b)| (a - b).abs() < 1e-12)
            );
        }
    }

    #[test]
    fn distance_to_face_side_and_corner() {
        let d = |p: Vec3| triangle_distance2(&p, [&A, &B, &C]).sqrt();
        assert_eq!(d([0.5, 0.5, 3.0]), 3.0);
        assert_eq!(d([1.0, -1.0, 0.0]), 1.0);
        assert!((d([2.0, 2.0, 0.0]) - 2f64.sqrt()).abs() < 1e-15);
        assert_eq!(d([-3.0, -4.0, 0.0]), 5.0);
    }

    /// Welding can make two corners of a triangle coincide.
    #[test]
    fn nearest_on_a_triangle_with_equal_corners_is_on_its_side() {
        for (corners, expected) in
            [([&A, &A, &B], 4.0), ([&A, &B, &B], 4.0), ([&A, &B, &A], 4.0), ([&A, &A, &A], 5.0)]
        {
            let (at, found) = nearest_on_triangle(&[1.0, 2.0, 0.0], corners);
            assert!(at.iter().all(|x| (0.0..=1.0).contains(x)), "{at:?}");
            assert_eq!(found, expected);
        }
    }

    #[test]
    fn a_triangle_without_area_is_its_sides() {
        assert_eq!(triangle_distance2(&[1.0, 1.0, 0.0], [&A, &B, &[1.0, 0.0, 0.0]]), 1.0);
        assert_eq!(triangle_distance2(&[0.0, 3.0, 0.0], [&A, &A, &A]), 9.0);
    }
}
