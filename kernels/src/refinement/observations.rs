//! Comparison of a mesh with the depth maps it was fused from: for each vertex the mean distance of the
//! measurements from the surface, and their number.
//!
//! Fusion interpolates between voxels and averages on both sides of a curved surface, so that its surface lies
//! a little inside of convex shapes. The depth maps have no such bias.

use super::depth_frame::DepthFrame;
use super::votes::{Sight, Votes};
use crate::base::geometry::Vec3;
use crate::base::parallel::update;

/// Minimum cosine between the normal and the direction to the camera. Beyond it depth says nothing about the
/// position along the normal.
const MIN_COSINE: f64 = 0.05;

/// Sums over the measurements of one vertex.
#[derive(Clone, Copy, Debug, Default)]
pub struct Observation {
    /// Sum of the weights, 1 / variance, in 1/m².
    pub weight: f64,
    /// Weighted sum of the signed distances from the vertex, along its normal.
    pub distance: f64,
    /// Number of frames in these sums.
    pub frames: u32,
    /// Largest cosine between the normal and the direction to a camera that measured the surface, also at the border of
    /// measured depth, where the distance is not reliable. 0 without any.
    pub best_cosine: f64,
    pub votes: Votes,
}

/// Add the measurements of a frame to the observations of each vertex. Measurements up to `reach` metres from the
/// surface may belong to it whatever the noise.
pub fn observe(
    frame: DepthFrame<'_>,
    reach: f64,
    points: &[Vec3],
    normals: &[Vec3],
    observations: &mut [Observation],
    threads: usize,
) {
    update(observations, threads, |v, observation| {
        add_measurement(frame, reach, &points[v], &normals[v], observation);
    });
}

fn add_measurement(
    frame: DepthFrame<'_>,
    reach: f64,
    point: &Vec3,
    normal: &Vec3,
    observation: &mut Observation,
) {
    let Some(sight) = Sight::new(frame, point, normal) else { return };
    observation.votes.add_sight(frame, reach, &sight);
    let Sight { z, along, cosine, .. } = sight;
    if cosine <= MIN_COSINE {
        return;
    }
    let Some((pixels, offsets)) = read_pixels(frame, sight.pixel) else { return };
    let (noise, limit) = (sight.noise(frame), sight.limit(frame, reach));
    // Measured points are taken to be on the ray through the vertex.
    let distance_of = |depth: f64| (depth / z - 1.0) * along;
    if pixels.iter().all(|&depth| depth > 0.0) {
        let distance = distance_of(interpolate_depth(pixels, offsets));
        if distance.abs() >= limit {
            return;
        }
        let weight = cosine / (noise * noise);
        observation.weight += weight;
        observation.distance += weight * distance;
        observation.frames += 1;
    } else if !pixels.iter().any(|&depth| depth > 0.0 && distance_of(depth).abs() < limit) {
        return;
    }
    observation.best_cosine = observation.best_cosine.max(cosine);
}

/// Read the four pixels around a position, and its offsets from the first of them. None outside the image.
fn read_pixels(frame: DepthFrame<'_>, [u, v]: [f64; 2]) -> Option<([f64; 4], [f64; 2])> {
    let (width, height) = (frame.camera.width, frame.camera.height);
    if !(u >= 0.0 && v >= 0.0 && u < (width - 1) as f64 && v < (height - 1) as f64) {
        return None;
    }
    let (column, line) = (u as usize, v as usize);
    let first = line * width + column;
    let pixels = [first, first + 1, first + width, first + width + 1].map(|i| f64::from(frame.depth[i]));
    Some((pixels, [u - column as f64, v - line as f64]))
}

/// Interpolate inverse depth between four pixels, which is exact on planes.
fn interpolate_depth(pixels: [f64; 4], [right, below]: [f64; 2]) -> f64 {
    let [a, b, c, d] = pixels.map(|depth| 1.0 / depth);
    let (above, under) = (a + right * (b - a), c + right * (d - c));
    1.0 / (above + below * (under - above))
}
