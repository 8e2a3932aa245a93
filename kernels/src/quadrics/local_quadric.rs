//! Quadric over the current triangles of a vertex, with the vertex and its attributes as the origin.
//!
//! All triangles contain the vertex, so the quadric has neither a linear term nor a constant. With three
//! attributes in single precision it fills one cache line. See [`crate::quadrics::quadric`] for the error that
//! it measures.

use crate::quadrics::lanes::{self, LaneVec3, Lanes};

/// Factor of the length term that orders collapses without error.
const LENGTH_COST_FACTOR: f32 = 1e-6;

/// Strength of the spring to the middle of the edge, which determines the position where the error is
/// constant. Above the rounding errors of single precision.
const TETHER_STRENGTH: f32 = 1e-5;

/// Quadric over the current triangles of a vertex, with the vertex and its attributes as the origin.
#[derive(Clone, Copy)]
pub struct LocalQuadric<const K: usize> {
    /// Σ area · n nᵀ, plus Σ area · g gᵀ of the attributes: xx, xy, xz, yy, yz, zz.
    shape: [f32; 6],
    /// Σ area; negative for a vertex that must not change.
    pub area: f32,
    /// Σ area · g of each attribute.
    attributes: [[f32; 3]; K],
}

impl<const K: usize> LocalQuadric<K> {
    /// Quadric of a vertex that must not change.
    pub const UNUSABLE: Self = Self { shape: [0.0; 6], area: -1.0, attributes: [[0.0; 3]; K] };

    pub const ZERO: Self = Self { shape: [0.0; 6], area: 0.0, attributes: [[0.0; 3]; K] };

    #[inline]
    pub fn is_usable(&self) -> bool {
        self.area >= 0.0
    }

    /// Add the squared distance to the wall through the boundary edge to `end`.
    ///
    /// The wall is perpendicular to the triangle with the third corner `across`. `weight` is multiplied by the
    /// squared length of the edge.
    pub fn add_wall(&mut self, weight: f32, end: [f32; 3], across: [f32; 3]) {
        let [end, across] = [end, across].map(|corner| corner.map(|x| Lanes::<1, f32>([x])));
        let [x, y, z] = lanes::cross(&end, &lanes::cross(&end, &across)).map(|x| x.0[0]);
        let length2 = x * x + y * y + z * z;
        if length2 > 0.0 {
            let factor = weight * lanes::dot(&end, &end).0[0] / length2;
            let products = [x * x, x * y, x * z, y * y, y * z, z * z];
            (0..6).for_each(|i| self.shape[i] += factor * products[i]);
        }
    }

    /// Add another quadric with the same origin.
    #[inline]
    pub fn add(&mut self, other: &Self) {
        (0..6).for_each(|i| self.shape[i] += other.shape[i]);
        self.area += other.area;
        for j in 0..K {
            (0..3).for_each(|i| self.attributes[j][i] += other.attributes[j][i]);
        }
    }
}

/// N quadrics, side by side.
pub struct LaneQuadric<const N: usize, const K: usize> {
    shape: [Lanes<N, f32>; 6],
    area: Lanes<N, f32>,
    attributes: [[Lanes<N, f32>; 3]; K],
}

impl<const N: usize, const K: usize> LaneQuadric<N, K> {
    pub const ZERO: Self =
        Self { shape: [Lanes([0.0; N]); 6], area: Lanes([0.0; N]), attributes: [[Lanes([0.0; N]); 3]; K] };

    /// Compute the quadrics of triangles from two sides that start at the same corner.
    ///
    /// `half` is half of the importance.
    #[inline]
    pub fn of_triangles<const D: usize>(
        u: &[Lanes<N, f32>; D],
        v: &[Lanes<N, f32>; D],
        half: Lanes<N, f32>,
    ) -> Self {
        let mut quadric = Self::ZERO;
        let [side, other] = [u, v].map(|side| [side[0], side[1], side[2]]);
        let normal = lanes::cross(&side, &other);
        // Without an area, the triangle has no error.
        let norm2 = lanes::dot(&normal, &normal).map(|x| if x > 0.0 { x } else { f32::INFINITY });
        let inverse = norm2.map(|x| 1.0 / x);
        quadric.area = half * norm2.map(|x| if x < f32::INFINITY { x.sqrt() } else { 0.0 });
        let unit_factor = inverse.map(f32::sqrt);
        quadric.add_gradient(&normal.map(|x| x * unit_factor));
        let along_u = lanes::cross(&other, &normal).map(|x| x * inverse);
        let along_v = lanes::cross(&normal, &side).map(|x| x * inverse);
        for j in 0..K {
            let gradient = [0, 1, 2].map(|i| u[3 + j] * along_u[i] + v[3 + j] * along_v[i]);
            quadric.attributes[j] = quadric.add_gradient(&gradient);
        }
        quadric
    }

    /// Add the squared distance along a gradient; returns the gradient times the area.
    #[inline]
    fn add_gradient(&mut self, gradient: &LaneVec3<N, f32>) -> LaneVec3<N, f32> {
        let [x, y, z] = gradient.map(|x| self.area * x);
        let [gx, gy, gz] = *gradient;
        let products = [x * gx, x * gy, x * gz, y * gy, y * gz, z * gz];
        (0..6).for_each(|i| self.shape[i] += products[i]);
        [x, y, z]
    }

    /// Add other quadrics, lane by lane.
    #[inline]
    pub fn add(&mut self, other: &Self) {
        (0..6).for_each(|i| self.shape[i] += other.shape[i]);
        self.area += other.area;
        for j in 0..K {
            (0..3).for_each(|i| self.attributes[j][i] += other.attributes[j][i]);
        }
    }

    /// Return the quadric of one lane.
    #[inline]
    pub fn lane(&self, lane: usize) -> LocalQuadric<K> {
        LocalQuadric {
            shape: self.shape.map(|x| x.0[lane]),
            area: self.area.0[lane],
            attributes: self.attributes.map(|gradient| gradient.map(|x| x.0[lane])),
        }
    }
}

/// Minimum of the quadrics of both ends of an edge, relative to its first end.
pub struct EdgeMinimum<const N: usize, const K: usize> {
    pub position: LaneVec3<N, f32>,
    pub attributes: [Lanes<N, f32>; K],
    pub error: Lanes<N, f32>,
}

/// Gather the values of each coordinate.
#[inline]
pub fn transpose<const N: usize, const D: usize>(ways: &[[f32; D]; N]) -> [Lanes<N, f32>; D] {
    std::array::from_fn(|j| Lanes(std::array::from_fn(|lane| ways[lane][j])))
}

#[inline]
fn times<const N: usize>(m: &[Lanes<N, f32>; 6], v: &LaneVec3<N, f32>) -> LaneVec3<N, f32> {
    [
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[1] * v[0] + m[3] * v[1] + m[4] * v[2],
        m[2] * v[0] + m[4] * v[1] + m[5] * v[2],
    ]
}

/// Minimise the quadrics of both ends of N edges with a common end.
///
/// `own` is the quadric of the common end, `way` leads from it to the other ends.
#[inline]
pub fn find_minimum<const N: usize, const D: usize, const K: usize>(
    own: &LocalQuadric<K>,
    others: [&LocalQuadric<K>; N],
    way: &[Lanes<N, f32>; D],
) -> EdgeMinimum<N, K> {
    let load = |value: &dyn Fn(&LocalQuadric<K>) -> f32| Lanes::<N, f32>(others.map(value));
    let d = [way[0], way[1], way[2]];
    let other_shape: [Lanes<N, f32>; 6] = std::array::from_fn(|i| load(&|other| other.shape[i]));
    let other_area = load(&|other| other.area);
    let area = Lanes::all(own.area) + other_area;
    let inverse_area = area.map(|x| if x > 0.0 { 1.0 / x } else { 0.0 });
    let mut shape: [Lanes<N, f32>; 6] = std::array::from_fn(|i| Lanes::all(own.shape[i]) + other_shape[i]);
    // Error at x: xᵀ shape x + 2 linear·x + constant, with the best attributes for x.
    let pull = times(&other_shape, &d);
    let mut linear = pull.map(|x| -x);
    let mut constant = lanes::dot(&d, &pull);
    let mut gradients = [[Lanes::all(0.0); 3]; K];
    let mut offsets = [Lanes::all(0.0); K];
    for j in 0..K {
        let difference = way[3 + j];
        let other: LaneVec3<N, f32> = std::array::from_fn(|i| load(&|other| other.attributes[j][i]));
        let gradient: LaneVec3<N, f32> = std::array::from_fn(|i| Lanes::all(own.attributes[j][i]) + other[i]);
        let along = lanes::dot(&other, &d);
        let offset = difference * other_area - along;
        let [x, y, z] = gradient.map(|x| x * inverse_area);
        let [gx, gy, gz] = gradient;
        let products = [x * gx, x * gy, x * gz, y * gy, y * gz, z * gz];
        (0..6).for_each(|i| shape[i] = shape[i] - products[i]);
        let mean = [x, y, z];
        (0..3).for_each(|i| linear[i] = linear[i] + difference * other[i] - offset * mean[i]);
        constant += difference * (difference * other_area - along - along) - offset * offset * inverse_area;
        (gradients[j], offsets[j]) = (gradient, offset);
    }
    let middle = d.map(|x| x * Lanes::all(0.5));
    let residual = times(&shape, &middle);
    let slope: LaneVec3<N, f32> = std::array::from_fn(|i| residual[i] + linear[i]);
    let at_middle =
        lanes::dot(&middle, &residual) + lanes::dot(&middle, &linear) * Lanes::all(2.0) + constant;
    let spring = area * Lanes::all(TETHER_STRENGTH);
    let step = solve(&shape, &spring, &slope);
    let error = at_middle - lanes::dot(&slope, &step);
    let position: LaneVec3<N, f32> = std::array::from_fn(|i| middle[i] - step[i]);
    let attributes =
        std::array::from_fn(|j| (lanes::dot(&gradients[j], &position) + offsets[j]) * inverse_area);
    let length_cost = area * lanes::dot(&d, &d) * Lanes::all(LENGTH_COST_FACTOR);
    let error =
        (error.map(|x| x.max(0.0)) + length_cost).map(|x| if x.is_finite() { x } else { f32::INFINITY });
    EdgeMinimum { position, attributes, error }
}

/// Solve (M + spring · I) x = r for a positive semidefinite M, by its LDLᵀ decomposition.
///
/// Rounding errors do not make a pivot smaller than the spring.
#[inline]
fn solve<const N: usize>(
    m: &[Lanes<N, f32>; 6],
    spring: &Lanes<N, f32>,
    r: &LaneVec3<N, f32>,
) -> LaneVec3<N, f32> {
    let pivot = |x: Lanes<N, f32>| {
        Lanes(std::array::from_fn(|i| {
            let least = spring.0[i].max(f32::MIN_POSITIVE);
            1.0 / (x.0[i] + spring.0[i]).max(least)
        }))
    };
    let d0 = pivot(m[0]);
    let (l10, l20) = (m[1] * d0, m[2] * d0);
    let d1 = pivot(m[3] - l10 * m[1]);
    let m21 = m[4] - l10 * m[2];
    let l21 = m21 * d1;
    let d2 = pivot(m[5] - l20 * m[2] - l21 * m21);
    let y1 = r[1] - l10 * r[0];
    let y2 = r[2] - l20 * r[0] - l21 * y1;
    let z = y2 * d2;
    let y = y1 * d1 - l21 * z;
    let x = r[0] * d0 - l10 * y - l20 * z;
    [x, y, z]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::{Vec3, distance2};
    use crate::quadrics::quadric::Quadric;

    /// Positions from −1 to 1 and attributes from 0 to 200 that look random.
    fn point(i: u32) -> [f64; 6] {
        std::array::from_fn(|j| {
            let x = f64::from((i * 48_271 + (j as u32 + 3) * 7_919 * (i + 11)) % 2001);
            if j < 3 { x / 1000.0 - 1.0 } else { x / 10.0 }
        })
    }

    const WEIGHT: f64 = 1e-2;

    fn way(from: &[f64; 6], to: &[f64; 6]) -> [f32; 6] {
        std::array::from_fn(|j| ((to[j] - from[j]) * if j < 3 { 1.0 } else { WEIGHT }) as f32)
    }

    /// Fans of both ends of an edge, which share two triangles.
    fn fans() -> [Vec<[[f64; 6]; 3]>; 2] {
        let ends = [[0.0, 0.0, 0.1, 20.0, 90.0, 150.0], [1.0, 0.1, 0.0, 60.0, 50.0, 10.0]];
        let rings = [
            [ends[1], point(3), point(4), point(5), point(6)],
            [ends[0], point(6), point(8), point(9), point(3)],
        ];
        [0, 1].map(|end| (0..5).map(|i| [ends[end], rings[end][i], rings[end][(i + 1) % 5]]).collect())
    }

    fn local(fan: &[[[f64; 6]; 3]]) -> LocalQuadric<3> {
        let mut sum = LocalQuadric::ZERO;
        for [centre, a, b] in fan {
            let [u, v] = [a, b].map(|corner| transpose(&[way(centre, corner)]));
            sum.add(&LaneQuadric::<1, 3>::of_triangles(&u, &v, Lanes([0.5])).lane(0));
        }
        sum.add_wall(
            1.0,
            way(&fan[0][0], &fan[0][1])[..3].try_into().unwrap(),
            way(&fan[0][0], &fan[0][2])[..3].try_into().unwrap(),
        );
        sum
    }

    fn reference(fan: &[[[f64; 6]; 3]]) -> Quadric<3> {
        let mut sum = Quadric::default();
        fan.iter().for_each(|corners| sum.add(&Quadric::of_triangle(corners.each_ref(), WEIGHT)));
        let [a, b, c] = fan[0].map(|p| -> Vec3 { [p[0], p[1], p[2]] });
        sum.add_wall(1.0, [&a, &b, &c]);
        sum
    }

    #[test]
    fn minimum_equals_the_one_in_double_precision() {
        let fans = fans();
        let [first, second] = [fans[0][0][0], fans[1][0][0]];
        let quadrics = fans.each_ref().map(|fan| local(fan));
        let minimum =
            find_minimum::<2, 6, 3>(&quadrics[0], [&quadrics[1]; 2], &transpose(&[way(&first, &second); 2]));
        let sum = reference(&fans[0]).sum(&reference(&fans[1]));
        let middle: Vec3 = std::array::from_fn(|i| 0.5 * (first[i] + second[i]));
        let (place, error) = sum.minimum(&middle, f64::from(TETHER_STRENGTH));
        let attributes = sum.with_attributes(&place, WEIGHT, &first);
        for lane in 0..2 {
            let found: Vec3 = std::array::from_fn(|i| first[i] + f64::from(minimum.position[i].0[lane]));
            assert!(distance2(&found, &place).sqrt() < 1e-4, "{found:?} {place:?}");
            assert!((f64::from(minimum.error.0[lane]) / error - 1.0).abs() < 1e-3);
            for j in 0..3 {
                let level = first[3 + j] + f64::from(minimum.attributes[j].0[lane]) / WEIGHT;
                assert!((level - attributes[3 + j]).abs() < 0.01, "{level} {attributes:?}");
            }
        }
    }

    #[test]
    fn flat_surroundings_place_the_vertex_at_the_middle() {
        let corners = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, -1.0, 0.0]];
        let mut quadric = LocalQuadric::<0>::ZERO;
        for i in 0..3 {
            let [u, v] = [corners[i], corners[(i + 1) % 3]].map(|corner| transpose::<1, 3>(&[corner]));
            quadric.add(&LaneQuadric::of_triangles(&u, &v, Lanes([0.5])).lane(0));
        }
        let minimum = find_minimum::<1, 3, 0>(&quadric, [&quadric], &transpose(&[[1.0, 0.0, 0.0]]));
        let place = minimum.position.map(|x| x.0[0]);
        assert!((place[0] - 0.5).abs() + place[1].abs() + place[2].abs() < 1e-6, "{place:?}");
        assert!(minimum.error.0[0] < 1e-5);
    }

    /// A triangle without area must not affect the other lanes.
    #[test]
    fn triangle_without_area_has_no_error() {
        let u = transpose(&[[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]);
        let v = transpose(&[[2.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        let quadrics = LaneQuadric::<2, 0>::of_triangles(&u, &v, Lanes([0.5; 2]));
        assert_eq!(quadrics.lane(0).shape, [0.0; 6]);
        assert_eq!((quadrics.lane(0).area, quadrics.lane(1).area), (0.0, 0.5));
    }
}
