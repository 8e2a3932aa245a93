//! Attribute quadrics: the error of a merged vertex in shape and colour.
//!
//! Garland and Heckbert, "Surface simplification using quadric error metrics", 1997; Hoppe, "New quadric
//! metric for simplifying meshes with appearance attributes", 1999. The error of a vertex at p with
//! attributes s is an integral over the triangles of the quadric. One term is the squared distance of p to
//! the plane of each triangle. The other is the squared difference of s to the linear attributes of the
//! triangle at p:
//!
//! ```text
//! Q(p, s) = Σ area · [ (n·p + d)² + w² Σ_j (g_j·p + d_j − s_j)² ]
//! ```
//!
//! For any p, the best s is the mean of the predictions. So only a system of three equations has to be
//! solved, for any number of attributes.

use crate::base::geometry::{Vec3, add_scaled, cross, dot, norm2, sub};
use crate::quadrics::lanes::{self, LaneVec3, Lanes};

/// Symmetric 3 × 3 matrix: xx, xy, xz, yy, yz, zz.
pub type SymmetricMatrix = [f64; 6];

/// Add w · v vᵀ.
#[inline]
fn add_outer(m: &mut SymmetricMatrix, w: f64, v: &Vec3) {
    m[0] += w * v[0] * v[0];
    m[1] += w * v[0] * v[1];
    m[2] += w * v[0] * v[2];
    m[3] += w * v[1] * v[1];
    m[4] += w * v[1] * v[2];
    m[5] += w * v[2] * v[2];
}

/// Multiply a symmetric matrix by a vector.
#[inline]
fn times(m: &SymmetricMatrix, v: &Vec3) -> Vec3 {
    [
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[1] * v[0] + m[3] * v[1] + m[4] * v[2],
        m[2] * v[0] + m[4] * v[1] + m[5] * v[2],
    ]
}

/// Solve M x = r for a positive definite M, by Cramer's rule.
#[inline]
fn solve(m: &SymmetricMatrix, r: &Vec3) -> Option<Vec3> {
    let c0 = m[3] * m[5] - m[4] * m[4];
    let c1 = m[2] * m[4] - m[1] * m[5];
    let c2 = m[1] * m[4] - m[2] * m[3];
    let determinant = m[0] * c0 + m[1] * c1 + m[2] * c2;
    let c3 = m[0] * m[5] - m[2] * m[2];
    let c4 = m[1] * m[2] - m[0] * m[4];
    let c5 = m[0] * m[3] - m[1] * m[1];
    // The determinant may overflow.
    let solvable = determinant > 0.0 && determinant.is_finite();
    solvable.then(|| times(&[c0, c1, c2, c3, c4, c5], r).map(|x| x / determinant))
}

/// Quadratic form Q with K attributes, each multiplied by w.
#[derive(Clone, Copy, Debug)]
pub struct Quadric<const K: usize> {
    /// Σ area · n nᵀ, plus Σ area · g gᵀ of the attributes
    shape: SymmetricMatrix,
    /// Σ area · d n, plus the same sum for the attributes
    linear: Vec3,
    /// Σ area · d², plus the same sum for the attributes
    constant: f64,
    /// Σ area
    pub area: f64,
    /// Σ area · (g_j, d_j)
    attributes: [[f64; 4]; K],
}

impl<const K: usize> Default for Quadric<K> {
    fn default() -> Self {
        Self { shape: [0.0; 6], linear: [0.0; 3], constant: 0.0, area: 0.0, attributes: [[0.0; 4]; K] }
    }
}

impl<const K: usize> Quadric<K> {
    /// Compute the quadric of one triangle, whose attributes follow its coordinates; zero if it has no area.
    #[inline]
    pub fn of_triangle<const D: usize>(corners: [&[f64; D]; 3], weight: f64) -> Self {
        let [quadric] = Self::of_triangles([corners], weight);
        quadric
    }

    /// Compute the quadrics of several triangles in SIMD lanes: two take little longer than one.
    #[inline]
    pub fn of_triangles<const D: usize, const N: usize>(
        corners: [[&[f64; D]; 3]; N],
        weight: f64,
    ) -> [Self; N] {
        const { assert!(D == K + 3) };
        let value = |corner: usize, j: usize| Lanes(std::array::from_fn(|lane| corners[lane][corner][j]));
        let [origin, q, r] = [0, 1, 2].map(|corner| [0, 1, 2].map(|i| value(corner, i)));
        let (u, v) = (lanes::sub(&q, &origin), lanes::sub(&r, &origin));
        let normal = lanes::cross(&u, &v);
        let norm2 = lanes::dot(&normal, &normal);
        let length = norm2.map(f64::sqrt);
        let area = Lanes::all(0.5) * length;
        let unit = normal.map(|x| x / length);
        let mut shape = [Lanes::ZERO; 6];
        let mut linear = [Lanes::ZERO; 3];
        let mut constant = Lanes::ZERO;
        let mut add = |gradient: &LaneVec3<N>, offset: Lanes<N>| {
            let [x, y, z] = gradient.map(|x| area * x);
            let [gx, gy, gz] = *gradient;
            let products = [x * gx, x * gy, x * gz, y * gy, y * gz, z * gz];
            (0..6).for_each(|i| shape[i] += products[i]);
            let scale = area * offset;
            (0..3).for_each(|i| linear[i] += scale * gradient[i]);
            constant += scale * offset;
            [x, y, z, scale]
        };
        add(&unit, -lanes::dot(&unit, &origin));
        // Gradients of the two barycentric coordinates that grow along u and v.
        let along_u = lanes::cross(&v, &normal).map(|x| x / norm2);
        let along_v = lanes::cross(&normal, &u).map(|x| x / norm2);
        let weight = Lanes::all(weight);
        let attributes: [[Lanes<N>; 4]; K] = std::array::from_fn(|j| {
            let [p, q, r] = [0, 1, 2].map(|corner| value(corner, 3 + j));
            let (du, dv) = (q - p, r - p);
            let gradient: LaneVec3<N> = [0, 1, 2].map(|i| weight * (du * along_u[i] + dv * along_v[i]));
            let offset = weight * p - lanes::dot(&gradient, &origin);
            add(&gradient, offset)
        });
        std::array::from_fn(|lane| {
            if norm2.0[lane] <= 0.0 {
                return Self::default();
            }
            Self {
                shape: shape.map(|x| x.0[lane]),
                linear: linear.map(|x| x.0[lane]),
                constant: constant.0[lane],
                area: area.0[lane],
                attributes: attributes.map(|a| a.map(|x| x.0[lane])),
            }
        })
    }

    /// Add the squared distance to a plane.
    #[inline]
    pub fn add_plane(&mut self, weight: f64, normal: &Vec3, offset: f64) {
        add_outer(&mut self.shape, weight, normal);
        self.linear = add_scaled(&self.linear, weight * offset, normal);
        self.constant += weight * offset * offset;
    }

    /// Add the squared distance to the wall through side a–b of a triangle.
    ///
    /// The wall is perpendicular to the triangle. `weight` is multiplied by the squared length of the side.
    #[inline]
    pub fn add_wall(&mut self, weight: f64, [a, b, c]: [&Vec3; 3]) {
        let along = sub(b, a);
        let outwards = cross(&along, &cross(&along, &sub(c, a)));
        let length = norm2(&outwards).sqrt();
        if length > 0.0 {
            let normal = outwards.map(|x| x / length);
            self.add_plane(weight * norm2(&along), &normal, -dot(&normal, a));
        }
    }

    /// Multiply the error by a factor.
    pub fn scale(&mut self, factor: f64) {
        self.shape.iter_mut().for_each(|x| *x *= factor);
        self.linear.iter_mut().for_each(|x| *x *= factor);
        self.constant *= factor;
        self.area *= factor;
        self.attributes.iter_mut().flatten().for_each(|x| *x *= factor);
    }

    /// Add another quadric.
    #[inline]
    pub fn add(&mut self, other: &Self) {
        (0..6).for_each(|i| self.shape[i] += other.shape[i]);
        (0..3).for_each(|i| self.linear[i] += other.linear[i]);
        self.constant += other.constant;
        self.area += other.area;
        for j in 0..K {
            (0..4).for_each(|i| self.attributes[j][i] += other.attributes[j][i]);
        }
    }

    /// Subtract another quadric.
    #[inline]
    pub fn subtract(&mut self, other: &Self) {
        self.add(&Self::default().difference(other));
    }

    /// Return the difference to another quadric.
    #[inline]
    pub fn difference(&self, other: &Self) -> Self {
        Self {
            shape: sub(&self.shape, &other.shape),
            linear: sub(&self.linear, &other.linear),
            constant: self.constant - other.constant,
            area: self.area - other.area,
            attributes: std::array::from_fn(|j| sub(&self.attributes[j], &other.attributes[j])),
        }
    }

    /// Return the sum with another quadric.
    #[inline]
    pub fn sum(&self, other: &Self) -> Self {
        let mut sum = *self;
        sum.add(other);
        sum
    }

    /// Reduce Q to a function of the position, with optimal attributes.
    #[inline]
    fn reduce_to_position(&self) -> (SymmetricMatrix, Vec3, f64) {
        let (mut shape, mut linear, mut constant) = (self.shape, self.linear, self.constant);
        if self.area > 0.0 {
            let minus = -1.0 / self.area;
            for j in 0..K {
                let [x, y, z, d] = self.attributes[j];
                let gradient = [x, y, z];
                add_outer(&mut shape, minus, &gradient);
                linear = add_scaled(&linear, minus * d, &gradient);
                constant += minus * d * d;
            }
        }
        (shape, linear, constant)
    }

    /// Find the position of minimum error; also returns the error, including the spring.
    ///
    /// A spring to `anchor` has strength `tether`, relative to the area of the quadric.
    #[inline]
    pub fn minimum(&self, anchor: &Vec3, tether: f64) -> (Vec3, f64) {
        let (mut shape, linear, constant) = self.reduce_to_position();
        let residual = times(&shape, anchor);
        let slope: Vec3 = std::array::from_fn(|i| residual[i] + linear[i]);
        let at_anchor = dot(anchor, &residual) + 2.0 * dot(anchor, &linear) + constant;
        let spring = tether * self.area;
        shape[0] += spring;
        shape[3] += spring;
        shape[5] += spring;
        match solve(&shape, &slope) {
            Some(step) => (sub(anchor, &step), (at_anchor - dot(&slope, &step)).max(0.0)),
            None => (*anchor, at_anchor.max(0.0)),
        }
    }

    /// Compute the error at `p` with the best attributes.
    #[inline]
    pub fn error(&self, p: &Vec3) -> f64 {
        let (shape, linear, constant) = self.reduce_to_position();
        (dot(p, &times(&shape, p)) + 2.0 * dot(p, &linear) + constant).max(0.0)
    }

    /// Compute the error at `p` with attributes `s`, already multiplied by the weight.
    #[inline]
    pub fn error_with(&self, p: &Vec3, s: &[f64; K]) -> f64 {
        let mut error = dot(p, &times(&self.shape, p)) + 2.0 * dot(p, &self.linear) + self.constant;
        for (s, [x, y, z, d]) in s.iter().zip(&self.attributes) {
            error += s * (s * self.area - 2.0 * (dot(p, &[*x, *y, *z]) + d));
        }
        error.max(0.0)
    }

    /// Compute the best attributes at `p`; `fallback` if the quadric has no area.
    #[inline]
    pub fn attributes_at(&self, p: &Vec3, fallback: &[f64; K]) -> [f64; K] {
        if self.area <= 0.0 {
            return *fallback;
        }
        self.attributes.map(|[x, y, z, d]| (dot(p, &[x, y, z]) + d) / self.area)
    }

    /// Append the best attributes to `p`; `fallback` if the quadric has no area.
    #[inline]
    pub fn with_attributes<const D: usize>(&self, p: &Vec3, weight: f64, fallback: &[f64; D]) -> [f64; D] {
        if self.area <= 0.0 || weight <= 0.0 {
            return std::array::from_fn(|i| if i < 3 { p[i] } else { fallback[i] });
        }
        std::array::from_fn(|i| {
            if i < 3 {
                return p[i];
            }
            let [x, y, z, d] = self.attributes[i - 3];
            (dot(p, &[x, y, z]) + d) / (self.area * weight)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A triangle without area must not affect the other lanes.
    #[test]
    fn lanes_equal_single_triangles_bit_for_bit() {
        let points: [[f64; 4]; 5] = [
            [0.1, 0.2, 0.3, 10.0],
            [1.3, 0.1, 0.7, 200.0],
            [0.4, 1.9, 0.2, 31.0],
            [0.9, 0.3, 1.7, 77.0],
            [2.5, 0.0, 1.1, 0.0],
        ];
        let corners = [[0, 1, 2], [2, 2, 4], [3, 0, 4]].map(|t| t.map(|v: usize| &points[v]));
        let together = Quadric::<1>::of_triangles(corners, 0.37);
        for (own, quadric) in corners.into_iter().zip(&together) {
            let alone = Quadric::<1>::of_triangle(own, 0.37);
            assert_eq!(bits(&alone), bits(quadric));
        }
        assert_eq!(bits(&together[1]), bits(&Quadric::<1>::default()));
        assert!(together[0].area > 0.0 && together[2].area > 0.0);
    }

    #[test]
    fn adding_a_difference_replaces_a_quadric() {
        let triangle = |x: f64| {
            let corners = [[0.0, 0.0, x, 1.0], [2.0, x, 0.0, 5.0], [0.0, 3.0, 1.0, x]];
            Quadric::<1>::of_triangle(corners.each_ref(), 0.5)
        };
        let (rest, old, new) = (triangle(0.25), triangle(1.0), triangle(2.0));
        let mut replaced = rest.sum(&old);
        replaced.add(&new.difference(&old));
        let at = [0.3, 0.7, 0.1];
        assert!((replaced.error(&at) - rest.sum(&new).error(&at)).abs() < 1e-12);
    }

    fn bits<const K: usize>(q: &Quadric<K>) -> Vec<u64> {
        let of_attributes = q.attributes.iter().flatten();
        let all = q.shape.iter().chain(&q.linear).chain([&q.constant, &q.area]).chain(of_attributes);
        all.map(|x| x.to_bits()).collect()
    }
}
