//! Importance of input vertices, from the error of a trial.
//!
//! Quadrics measure the distance of the base from the input, not the distance of its later levels. Each level
//! cuts the error to a quarter on smooth surfaces, but only to a half along creases. Pockets that no line
//! reaches hardly improve. A trial measures the final error. The next trial weights quadrics by the root of
//! each base triangle's share of that squared error, relative to the mean.

use super::base_mesh::Base;
use crate::base::geometry::{Vec3, area};

/// Maximum factor by which one trial raises or lowers the importance.
const MAX_FACTOR: f64 = 16.0;

/// Factor for vertices on base triangles with flipped descendants.
const FOLD_FACTOR: f64 = 16.0;

/// Raise the importance of input vertices on base triangles that were refined into folds.
pub fn raise_at_folds(importance: &mut [f64], base: &Base, faulty: impl Iterator<Item = usize>) {
    let mut is_faulty = vec![false; base.triangles.len()];
    faulty.for_each(|t| is_faulty[t] = true);
    for (weight, parameter) in importance.iter_mut().zip(&base.base_points) {
        if is_faulty.get(parameter.triangle as usize).copied().unwrap_or(false) {
            *weight *= FOLD_FACTOR;
        }
    }
}

/// Multiply the importance of input vertices by the relative error of a trial with this base. `error2` holds
/// the squared distance of each input triangle from the trial's finest level.
pub fn weight_by_error(
    importance: &mut [f64],
    points: &[Vec3],
    triangles: &[[u32; 3]],
    base: &Base,
    error2: &[f64],
) {
    let of = |v: u32| base.base_points[v as usize].triangle as usize;
    let mut share = vec![0.0; base.triangles.len()];
    for (t, error2) in triangles.iter().zip(error2) {
        let area = area(t.map(|v| &points[v as usize]));
        for &v in t {
            if let Some(sum) = share.get_mut(of(v)) {
                *sum += area / 3.0 * error2;
            }
        }
    }
    let total = share.iter().sum::<f64>();
    let mean = total / share.len().max(1) as f64;
    if mean > 0.0 {
        let factor: Vec<f64> =
            share.iter().map(|s| (s / mean).sqrt().clamp(1.0 / MAX_FACTOR, MAX_FACTOR)).collect();
        for (weight, parameter) in importance.iter_mut().zip(&base.base_points) {
            *weight *= factor.get(parameter.triangle as usize).copied().unwrap_or(1.0);
        }
    }
}
