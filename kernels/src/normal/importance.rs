//! Which parts of the input deserve base triangles: those where a trial stays far from it.
//!
//! Quadrics know how far the base is from the input, not how far its levels will be: with every level, errors fall to
//! a quarter where the surface is smooth, but only to a half along a crease, and hardly at all in a pocket that no line
//! meets. A trial tells. The root of what a base triangle contributes to its squared error, against the mean, is by how
//! much the quadrics there count more in the next one.

use super::base_mesh::Base;
use crate::base::geometry::{Vec3, area};

/// How much more or less a part may count after one trial.
const MOST: f64 = 16.0;

/// How much more a part counts where triangles turned over.
const INSISTENCE: f64 = 16.0;

/// Make vertices of the input count more on base triangles that could not be refined soundly.
pub fn insist(importance: &mut [f64], base: &Base, faulty: impl Iterator<Item = usize>) {
    let mut is_faulty = vec![false; base.triangles.len()];
    faulty.for_each(|t| is_faulty[t] = true);
    for (weight, parameter) in importance.iter_mut().zip(&base.parameters) {
        if is_faulty.get(parameter.triangle as usize).copied().unwrap_or(false) {
            *weight *= INSISTENCE;
        }
    }
}

/// Multiply the importance of the input's vertices by what a trial with this base says. `error2` are the mean squares of
/// the distance of the input's triangles from its finest level.
pub fn weigh(importance: &mut [f64], points: &[Vec3], triangles: &[[u32; 3]], base: &Base, error2: &[f64]) {
    let of = |v: u32| base.parameters[v as usize].triangle as usize;
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
        let factor: Vec<f64> = share.iter().map(|s| (s / mean).sqrt().clamp(1.0 / MOST, MOST)).collect();
        for (weight, parameter) in importance.iter_mut().zip(&base.parameters) {
            *weight *= factor.get(parameter.triangle as usize).copied().unwrap_or(1.0);
        }
    }
}
