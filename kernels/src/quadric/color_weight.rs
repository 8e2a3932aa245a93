//! Default weight of colour against shape, from the detail that a mesh of the target size cannot represent.
//!
//! Patches are as large as one triangle of the result. The distance of the input from the best plane of a
//! patch estimates the expected shape error. The difference of its colours from their best linear fit
//! estimates the expected colour error. A weight that makes both equal adapts to the data, unlike one
//! relative to the extent of the mesh.

use crate::base::geometry::{Vec3, bounding_box, cross, diagonal, norm2, position_of, sub};
use crate::base::parallel::fill;

/// Minimum number of triangles for which a plane and a linear fit are meaningful.
const MIN_CELL_TRIANGLES: usize = 12;

/// Minimum ratio of the summed normal to the area; below it, a cell contains several sheets.
const MIN_NORMAL_AGREEMENT: f64 = 0.7;

/// Number of triangles to sample; more would not change the mean.
const SAMPLED_TRIANGLES: usize = 1 << 15;

/// Rounding error of the input colours, in levels.
const MIN_COLOR_LEVELS: f64 = 0.5;

/// Factor on the balanced weight. With it, the shape error of two scans and a globe is at most a sixth larger
/// than without colours (`benches/simplify.py`, default against default × 0).
const WEIGHT_FACTOR: f64 = 0.4;

/// Minimum weight relative to the diagonal. On a flat mesh, any weight above rounding lets colours decide.
const MIN_WEIGHT_RATIO: f64 = 1e-7;

/// Weight relative to the diagonal if the mesh is too small for an estimate.
const DEFAULT_WEIGHT_RATIO: f64 = 1e-4;

/// Estimate the length that should count as much as one colour level.
///
/// In a result of `target` triangles, shape and colour then count about equally, with some preference for
/// shape.
pub fn estimate_color_weight<const D: usize>(
    points: &[[f64; D]],
    triangles: &[[u32; 3]],
    target: usize,
    threads: usize,
) -> f64 {
    let bounds = bounding_box(points.iter().map(position_of));
    let diagonal = diagonal(&bounds);
    match estimate_residuals(points, triangles, &bounds[0], target, threads) {
        Some((shape, colour)) => (WEIGHT_FACTOR * shape / colour).max(MIN_WEIGHT_RATIO * diagonal),
        None => DEFAULT_WEIGHT_RATIO * diagonal,
    }
}

/// Compute the typical distance to a local plane, and colour difference to a linear fit.
///
/// Both are root mean squares. Patches are as large as a triangle of a result with `target` triangles. `low`
/// is the lower corner of the bounding box. `None` if no patch has enough triangles or the mesh has no
/// colours.
fn estimate_residuals<const D: usize>(
    points: &[[f64; D]],
    triangles: &[[u32; 3]],
    low: &Vec3,
    target: usize,
    threads: usize,
) -> Option<(f64, f64)> {
    if D == 3 || triangles.is_empty() {
        return None;
    }
    let corner = |t: &[u32; 3]| t.map(|v| &points[v as usize]);
    let normal = |t: &[u32; 3]| -> Vec3 {
        let [a, b, c] = corner(t).map(position_of);
        cross(&sub(&b, &a), &sub(&c, &a)).map(|x| 0.5 * x)
    };
    // Sums in triangle order do not depend on the number of threads.
    let mut areas = vec![0.0; triangles.len()];
    fill(&mut areas, threads, |t| norm2(&normal(&triangles[t])).sqrt());
    let area: f64 = areas.into_iter().sum();
    let pieces = target.clamp(1, (triangles.len() / MIN_CELL_TRIANGLES).max(1));
    let side = (area / pieces as f64).sqrt();
    if side <= 0.0 {
        return None;
    }
    let stride = (triangles.len() / SAMPLED_TRIANGLES).max(1) as u64;
    let mut cells = vec![0; triangles.len()];
    fill(&mut cells, threads, |t| grid_cell(corner(&triangles[t]), low, side));
    let mut chosen: Vec<(u64, u32)> =
        cells.into_iter().zip(0..).filter(|(cell, _)| hash_cell(*cell).is_multiple_of(stride)).collect();
    chosen.sort_unstable();
    let (mut areas, mut shape, mut colour) = (0.0, 0.0, 0.0);
    for cell in chosen.chunk_by(|a, b| a.0 == b.0).filter(|cell| cell.len() >= MIN_CELL_TRIANGLES) {
        let mut moments = Moments::<D>::default();
        for &(_, t) in cell {
            let t = &triangles[t as usize];
            let [a, b, c] = corner(t);
            let centre: [f64; D] =
                std::array::from_fn(|i| (a[i] + b[i] + c[i]) / 3.0 - if i < 3 { low[i] } else { 0.0 });
            moments.add(&centre, &normal(t));
        }
        if norm2(&moments.normal).sqrt() < MIN_NORMAL_AGREEMENT * moments.area {
            continue;
        }
        let (off_plane, off_fit) = moments.residuals();
        areas += moments.area;
        shape += moments.area * off_plane;
        colour += moments.area * off_fit;
    }
    (areas > 0.0).then(|| ((shape / areas).sqrt(), (colour / areas).sqrt().max(MIN_COLOR_LEVELS)))
}

/// Compute the grid cell of the centre of a triangle, as one integer.
pub fn grid_cell<const D: usize>(corners: [&[f64; D]; 3], low: &Vec3, side: f64) -> u64 {
    (0..3).fold(0, |key, i| {
        let centre = corners.iter().map(|p| p[i]).sum::<f64>() / 3.0;
        key << 21 | (((centre - low[i]) / side) as u64 & 0x1f_ffff)
    })
}

/// Hash a cell index (Fibonacci hashing), to spread sampled cells over the mesh.
pub fn hash_cell(cell: u64) -> u64 {
    cell.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32
}

/// Area-weighted sums over a patch.
struct Moments<const D: usize> {
    area: f64,
    normal: Vec3,
    first: [f64; D],
    /// Products of each value with the three coordinates, and of each value with itself.
    products: [Vec3; D],
    square: [f64; D],
}

impl<const D: usize> Default for Moments<D> {
    fn default() -> Self {
        Self { area: 0.0, normal: [0.0; 3], first: [0.0; D], products: [[0.0; 3]; D], square: [0.0; D] }
    }
}

impl<const D: usize> Moments<D> {
    fn add(&mut self, at: &[f64; D], normal: &Vec3) {
        let area = norm2(normal).sqrt();
        self.area += area;
        (0..3).for_each(|i| self.normal[i] += normal[i]);
        for j in 0..D {
            self.first[j] += area * at[j];
            (0..3).for_each(|i| self.products[j][i] += area * at[j] * at[i]);
            self.square[j] += area * at[j] * at[j];
        }
    }

    /// Compute the mean squared distance to the plane, and the residual of the attributes.
    ///
    /// The plane passes through the mean, perpendicular to the mean normal. The residual is the mean squared
    /// difference to a linear fit on the plane.
    fn residuals(&self) -> (f64, f64) {
        let mean = self.first.map(|x| x / self.area);
        let covariance = |j: usize, i: usize| self.products[j][i] / self.area - mean[j] * mean[i];
        let length = norm2(&self.normal).sqrt();
        let n = self.normal.map(|x| x / length);
        let smallest = (0..3).fold(0, |s, i| if n[i].abs() < n[s].abs() { i } else { s });
        let across = cross(&n, &std::array::from_fn(|i| f64::from(u8::from(i == smallest))));
        let u = across.map(|x| x / norm2(&across).sqrt());
        let v = cross(&n, &u);
        let along = |j: usize, axis: &Vec3| (0..3).map(|i| covariance(j, i) * axis[i]).sum::<f64>();
        let quadratic = |a: &Vec3, b: &Vec3| (0..3).map(|j| a[j] * along(j, b)).sum::<f64>();
        let off_plane = quadratic(&n, &n).max(0.0);
        let (uu, uv, vv) = (quadratic(&u, &u), quadratic(&u, &v), quadratic(&v, &v));
        let determinant = uu * vv - uv * uv;
        let mut off_fit = 0.0;
        for (j, mean) in mean.iter().enumerate().skip(3) {
            let variance = self.square[j] / self.area - mean * mean;
            let (cu, cv) = (along(j, &u), along(j, &v));
            let explained = if determinant > 1e-12 * uu * vv {
                (cu * cu * vv - 2.0 * cu * cv * uv + cv * cv * uu) / determinant
            } else {
                0.0
            };
            off_fit += (variance - explained).max(0.0);
        }
        (off_plane, off_fit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOW: Vec3 = [0.0, 0.0, -1.0];

    fn ramp(bump: f64, stripes: f64) -> (Vec<[f64; 6]>, Vec<[u32; 3]>) {
        let n = 60;
        let wave = |x: u32| if x.is_multiple_of(2) { 1.0 } else { -1.0 };
        let point = |x: u32, y: u32| {
            [f64::from(x), f64::from(y), bump * wave(x), 2.0 * f64::from(x) + stripes * wave(y), 0.0, 0.0]
        };
        let points = (0..=n).flat_map(|y| (0..=n).map(move |x| point(x, y))).collect();
        let square = |x, y| {
            let a = y * (n + 1) + x;
            [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]
        };
        (points, (0..n).flat_map(|y| (0..n).flat_map(move |x| square(x, y))).collect())
    }

    #[test]
    fn planes_and_ramps_have_no_residual() {
        let (points, triangles) = ramp(0.0, 0.0);
        let (shape, colour) = estimate_residuals(&points, &triangles, &LOW, 72, 1).unwrap();
        assert!(shape < 1e-6 && colour == MIN_COLOR_LEVELS, "{shape} {colour}");
    }

    #[test]
    fn each_residual_grows_with_its_own_cause() {
        let of = |bump, stripes| {
            let (points, triangles) = ramp(bump, stripes);
            estimate_residuals(&points, &triangles, &LOW, 72, 1).unwrap()
        };
        let (shape, colour) = of(0.01, 30.0);
        let (higher, same) = of(0.02, 30.0);
        assert!((higher / shape - 2.0).abs() < 0.05 && (same / colour - 1.0).abs() < 0.05);
        let (same, stronger) = of(0.01, 60.0);
        assert!((same / shape - 1.0).abs() < 0.05 && (stronger / colour - 2.0).abs() < 0.05);
    }

    #[test]
    fn no_estimate_without_patches_or_colors() {
        let (points, triangles) = ramp(0.1, 10.0);
        assert_eq!(estimate_residuals(&points, &triangles[..5], &LOW, 1, 1), None);
        let bare: Vec<[f64; 3]> = points.iter().map(|p| [p[0], p[1], p[2]]).collect();
        assert_eq!(estimate_residuals(&bare, &triangles, &LOW, 72, 1), None);
    }
}
