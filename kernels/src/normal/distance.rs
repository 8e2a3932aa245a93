//! Sampled distance between a level and the input, in both directions.

use super::level::Level;
use super::surface::Surface;
use crate::base::geometry::{Vec3, area};
use crate::base::parallel::fill;

/// A level with the slot of the input triangle under each vertex. The slots are start values that speed up
/// nearest-triangle queries.
pub struct LocatedLevel<'a> {
    pub level: &'a Level,
    pub slots: &'a [u32],
}

/// Mean squared distances.
#[derive(Clone, Debug, PartialEq)]
pub struct Distance {
    /// Area-weighted mean squared distance; the larger of both directions.
    pub mean_square: f64,
    /// Squared distance from each input triangle's centroid to the level.
    pub input_distances2: Vec<f64>,
}

/// Maximum number of samples along a triangle side; limits the time on very large triangles.
const MAX_SIDE_SAMPLES: usize = 24;

impl LocatedLevel<'_> {
    fn corners(&self, t: usize) -> [Vec3; 3] {
        self.level.topology.triangles[t].map(|v| self.level.points[v as usize])
    }

    fn distance2_from(&self, t: usize, p: &Vec3, surface: &Surface) -> f64 {
        surface.find_nearest_slot(p, self.level.topology.triangles[t].map(|v| self.slots[v as usize])).1
    }
}

/// Compute the mean squared distance, sampled at the centroids of all triangles of the input and of the
/// level.
pub fn measure_mean_square(
    points: &[Vec3],
    triangles: &[[u32; 3]],
    surface: &Surface,
    fine: &LocatedLevel<'_>,
    threads: usize,
) -> Distance {
    let own = &fine.level.topology.triangles;
    let level = Surface::new(&fine.level.points, own, threads);
    let corners = |t: usize| triangles[t].map(|v| points[v as usize]);
    let mut from_input = vec![0.0; triangles.len()];
    fill(&mut from_input, threads, |t| level.find_nearest_slot(&centroid(&corners(t)), []).1);
    let mut from_level = vec![0.0; own.len()];
    fill(&mut from_level, threads, |t| fine.distance2_from(t, &centroid(&fine.corners(t)), surface));
    let there = mean(&from_input, corners);
    Distance { mean_square: there.max(mean(&from_level, |t| fine.corners(t))), input_distances2: from_input }
}

/// Compute the maximum distance between the input and the level. Samples are all used vertices of the input
/// and about as many points of the level, evenly spaced on each of its triangles.
pub fn measure_maximum(
    points: &[Vec3],
    triangles: &[[u32; 3]],
    surface: &Surface,
    fine: &LocatedLevel<'_>,
    threads: usize,
) -> f64 {
    let own = &fine.level.topology.triangles;
    let level = Surface::new(&fine.level.points, own, threads);
    let mut from_input = vec![0.0; points.len()];
    fill(&mut from_input, threads, |v| level.find_nearest_slot(&points[v], []).1);
    let side = ((triangles.len() as f64 / own.len().max(1) as f64).sqrt().ceil() as usize)
        .clamp(2, MAX_SIDE_SAMPLES);
    let mut from_level = vec![0.0; own.len()];
    fill(&mut from_level, threads, |t| {
        let corners = fine.corners(t);
        let mut largest = 0.0f64;
        // Centroids of the sub-triangles oriented like their parent, with each side split into `side` parts.
        for i in 0..side {
            for j in 0..side - i {
                let [u, v] = [i, j].map(|k| (k as f64 + 1.0 / 3.0) / side as f64);
                let weights = [u, v, 1.0 - u - v];
                let p: Vec3 = std::array::from_fn(|x| (0..3).map(|k| weights[k] * corners[k][x]).sum());
                largest = largest.max(fine.distance2_from(t, &p, surface));
            }
        }
        largest
    });
    let used = triangles.iter().flatten().map(|&v| from_input[v as usize]);
    used.chain(from_level).fold(0.0, f64::max).sqrt()
}

/// Compute the centroid of a triangle.
pub fn centroid([a, b, c]: &[Vec3; 3]) -> Vec3 {
    std::array::from_fn(|i| (a[i] + b[i] + c[i]) / 3.0)
}

/// Compute the area-weighted mean of one value per triangle.
fn mean(values: &[f64], corners: impl Fn(usize) -> [Vec3; 3]) -> f64 {
    let (mut sum, mut whole) = (0.0, 0.0);
    for (t, value) in values.iter().enumerate() {
        let area = area(corners(t).each_ref());
        sum += area * value;
        whole += area;
    }
    if whole > 0.0 { sum / whole } else { 0.0 }
}
