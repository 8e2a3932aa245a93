//! Noise estimate of a mesh from its vertices.
//!
//! A vertex is offset from the mean of its neighbours by its noise and by curvature. Curvature offsets
//! neighbouring vertices about equally, so subtracting their mean offset removes it. The median of the
//! magnitudes ignores edges and corners, and scales to the standard deviation of independent vertex noise.
//! Noise that neighbours share is underestimated. If triangles are large relative to the curvature, curvature
//! is mistaken for noise.

use crate::base::geometry::{Vec3, add_scaled, dot, sub};

/// Ratio of the standard deviation to the median magnitude of a normal distribution.
const SIGMA_PER_MEDIAN: f64 = 1.4826;
/// Gain of the filter for independent noise if every vertex has six neighbours. It is the root of the sum of
/// squared weights: 7/6 for the vertex itself, −5/18 six times, 1/18 six times and 1/36 six times.
const FILTER_GAIN: f64 = 1.359;

/// Estimate the standard deviation of the noise, in mesh units. `normals` are unit vertex normals.
pub fn estimate_noise(points: &[Vec3], triangles: &[[u32; 3]], normals: &[Vec3]) -> f64 {
    let middles =
        compute_neighbour_means(points, triangles, |sum, p, weight| add_scaled(&sum, weight, p), [0.0; 3]);
    let off = |v: usize| middles[v].map(|middle| dot(&sub(&middle, &points[v]), &normals[v]));
    let offs: Vec<f64> = (0..points.len()).map(|v| off(v).unwrap_or(0.0)).collect();
    let means = compute_neighbour_means(&offs, triangles, |sum, off, weight| sum + weight * off, 0.0);
    let mut left: Vec<f64> =
        means.iter().zip(&offs).filter_map(|(mean, off)| Some((off - (*mean)?).abs())).collect();
    let half = left.len() / 2;
    if left.is_empty() {
        return 0.0;
    }
    let (_, median, _) = left.select_nth_unstable_by(half, f64::total_cmp);
    SIGMA_PER_MEDIAN / FILTER_GAIN * *median
}

/// Compute the mean of a value over the neighbours of each vertex. None for vertices without triangles.
fn compute_neighbour_means<T: Copy>(
    values: &[T],
    triangles: &[[u32; 3]],
    add: impl Fn(T, &T, f64) -> T,
    zero: T,
) -> Vec<Option<T>> {
    let mut counts = vec![0u32; values.len()];
    triangles.iter().flatten().for_each(|&v| counts[v as usize] += 2);
    let mut means: Vec<Option<T>> = counts.iter().map(|&count| (count > 0).then_some(zero)).collect();
    for corners in triangles {
        for i in 0..3 {
            let v = corners[i] as usize;
            let share = 1.0 / f64::from(counts[v]);
            for other in [corners[(i + 1) % 3], corners[(i + 2) % 3]] {
                means[v] = means[v].map(|mean| add(mean, &values[other as usize], share));
            }
        }
    }
    means
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::normal::surface::compute_vertex_normals;

    /// Build a height field of n × n squares over the unit square.
    fn sheet(n: u32, height: impl Fn(f64, f64) -> f64) -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let side = n + 1;
        let at = |k: u32| [f64::from(k / side) / f64::from(n), f64::from(k % side) / f64::from(n)];
        let points = (0..side * side).map(at).map(|[x, y]| [x, y, height(x, y)]).collect();
        let corner = |i: u32, j: u32| i * side + j;
        let square = |k: u32| {
            let (i, j) = (k / n, k % n);
            let [a, b, c, d] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
            [[a, b, c], [a, c, d]]
        };
        (points, (0..n * n).flat_map(square).collect())
    }

    fn of((points, triangles): (Vec<Vec3>, Vec<[u32; 3]>)) -> f64 {
        estimate_noise(&points, &triangles, &compute_vertex_normals(&points, &triangles))
    }

    #[test]
    fn independent_noise_is_found_on_a_curved_sheet() {
        let sigma = 1e-4;
        let random = |x: f64, y: f64| {
            // The sum of twelve uniform numbers minus six is nearly standard normal.
            let mut state = (x.to_bits() ^ y.to_bits().rotate_left(31)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            let mut sum = -6.0;
            for _ in 0..12 {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                sum += (state >> 11) as f64 / (1u64 << 53) as f64;
            }
            sum
        };
        let found = of(sheet(120, |x, y| 0.1 * (4.0 * x).sin() * y + sigma * random(x, y)));
        assert!((0.8..1.25).contains(&(found / sigma)), "{found}");
    }

    #[test]
    fn a_smooth_sheet_has_next_to_none_and_a_flat_one_none() {
        assert!(of(sheet(120, |x, y| 0.1 * (4.0 * x).sin() * y)) < 1e-6);
        assert!(of(sheet(20, |x, y| 0.5 * x - y)) < 1e-15);
        assert_eq!(estimate_noise(&[], &[], &[]), 0.0);
    }
}
