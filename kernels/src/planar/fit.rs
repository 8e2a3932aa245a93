//! Plane and linear colour function of a patch, fitted from incrementally updated moments.

use crate::base::geometry::{Vec3, cross, dot, norm2, normalize, sub};

/// Moments of the vertices and triangles of a patch; positions are relative to `origin`.
#[derive(Clone, Debug)]
pub struct Moments<const D: usize, const K: usize> {
    origin: Vec3,
    count: f64,
    position_sum: Vec3,
    position_products: [Vec3; 3],
    color_sum: [f64; K],
    color_products: [Vec3; K],
    /// Sum of area-weighted normals.
    normal_sum: Vec3,
}

impl<const D: usize, const K: usize> Moments<D, K> {
    /// Create empty moments relative to `origin`.
    pub fn new(origin: Vec3) -> Self {
        Self {
            origin,
            count: 0.0,
            position_sum: [0.0; 3],
            position_products: [[0.0; 3]; 3],
            color_sum: [0.0; K],
            color_products: [[0.0; 3]; K],
            normal_sum: [0.0; 3],
        }
    }

    /// Add the area-weighted normal of a triangle.
    #[inline]
    pub fn add_normal(&mut self, (normal, area): &(Vec3, f64)) {
        (0..3).for_each(|i| self.normal_sum[i] += normal[i] * area);
    }

    /// Add the position and colour of a vertex.
    #[inline]
    pub fn add_vertex(&mut self, p: &[f64; D]) {
        let at: Vec3 = [p[0] - self.origin[0], p[1] - self.origin[1], p[2] - self.origin[2]];
        self.count += 1.0;
        for i in 0..3 {
            self.position_sum[i] += at[i];
            if K > 0 {
                (0..3).for_each(|j| self.position_products[i][j] += at[i] * at[j]);
            }
        }
        for k in 0..K {
            self.color_sum[k] += p[3 + k];
            (0..3).for_each(|i| self.color_products[k][i] += at[i] * p[3 + k]);
        }
    }

    /// Number of added vertices, including the corners of the seed.
    pub fn count(&self) -> f64 {
        self.count
    }

    /// Fit the plane through the vertex centroid with the mean normal, and the colour function on it.
    pub fn fit(&self) -> Fit<K> {
        let normal = normalize(&self.normal_sum);
        let middle = self.position_sum.map(|x| x / self.count);
        let mut fit = Fit {
            normal,
            origin: std::array::from_fn(|i| self.origin[i] + middle[i]),
            mean_color: self.color_sum.map(|c| c / self.count),
            gradients: [[0.0; 3]; K],
        };
        if K > 0 {
            self.fit_gradients(&middle, &mut fit);
        }
        fit
    }

    fn fit_gradients(&self, middle: &Vec3, fit: &mut Fit<K>) {
        let [e, f] = complete_frame(&fit.normal);
        let covariance: [Vec3; 3] = std::array::from_fn(|i| {
            std::array::from_fn(|j| self.position_products[i][j] / self.count - middle[i] * middle[j])
        });
        let form = |a: &Vec3, b: &Vec3| dot(a, &[0, 1, 2].map(|i| dot(&covariance[i], b)));
        let (ee, ef, ff) = (form(&e, &e), form(&e, &f), form(&f, &f));
        let determinant = ee * ff - ef * ef;
        if determinant <= 1e-12 * (ee + ff) * (ee + ff) {
            return;
        }
        for k in 0..K {
            let along: Vec3 = std::array::from_fn(|i| {
                self.color_products[k][i] / self.count - fit.mean_color[k] * middle[i]
            });
            let (u, v) = (dot(&along, &e), dot(&along, &f));
            let (a, b) = ((u * ff - v * ef) / determinant, (v * ee - u * ef) / determinant);
            fit.gradients[k] = std::array::from_fn(|i| a * e[i] + b * f[i]);
        }
    }
}

/// Plane with a linear colour function.
#[derive(Clone, Debug)]
pub struct Fit<const K: usize> {
    pub normal: Vec3,
    pub origin: Vec3,
    mean_color: [f64; K],
    gradients: [Vec3; K],
}

impl<const K: usize> Fit<K> {
    /// Compute the signed height of a vertex over the plane.
    #[inline]
    pub fn height<const D: usize>(&self, p: &[f64; D]) -> f64 {
        dot(&self.normal, &self.relative_to_origin(p))
    }

    #[inline]
    fn relative_to_origin<const D: usize>(&self, p: &[f64; D]) -> Vec3 {
        [p[0] - self.origin[0], p[1] - self.origin[1], p[2] - self.origin[2]]
    }

    /// Compute the squared difference between a vertex colour and the linear function.
    #[inline]
    pub fn residual2<const D: usize>(&self, p: &[f64; D]) -> f64 {
        let at = self.relative_to_origin(p);
        (0..K)
            .map(|k| {
                let off = p[3 + k] - self.mean_color[k] - dot(&self.gradients[k], &at);
                off * off
            })
            .sum()
    }

    /// Compute the squared difference between a vertex colour and the mean colour.
    #[inline]
    pub fn mean_residual2<const D: usize>(&self, p: &[f64; D]) -> f64 {
        (0..K).map(|k| (p[3 + k] - self.mean_color[k]).powi(2)).sum()
    }

    /// Frobenius norm of the gradients, an upper bound of the colour change per length.
    pub fn gradient_norm(&self) -> f64 {
        self.gradients.iter().map(norm2).sum::<f64>().sqrt()
    }
}

/// Complete a unit normal to a right-handed frame; returns the two tangents.
pub fn complete_frame(normal: &Vec3) -> [Vec3; 2] {
    // The axis least aligned with the normal gives the most stable projection.
    let axis = (0..3).fold(0, |least, i| if normal[i].abs() < normal[least].abs() { i } else { least });
    let mut across = [0.0; 3];
    across[axis] = 1.0;
    let along = dot(normal, &across);
    let e = normalize(&sub(&across, &normal.map(|x| x * along)));
    [e, cross(normal, &e)]
}
