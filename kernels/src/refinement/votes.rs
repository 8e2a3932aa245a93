//! Votes of depth maps for and against surface at a point.
//!
//! A frame votes for a surface that it measures at the point. It votes against it if its ray passes through the
//! point, from either side, to a surface clearly behind.

use super::depth_frame::DepthFrame;
use crate::base::geometry::{Vec3, dot, norm2, sub};

/// Measurements farther from the surface than this many standard deviations belong to another surface.
const MAX_DEVIATIONS: f64 = 3.0;

/// Minimum cosine between the normal and the line of sight of a frame that votes. At smaller angles, an error of
/// a pixel decides whether a ray passes or not.
const MIN_VOTING_COSINE: f64 = 0.4;

/// Sums of the votes on one point. A vote counts as much as the surface of the point that a pixel covers is small.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Votes {
    pub surface: f32,
    pub free_space: f32,
}

impl Votes {
    /// Return true if most votes are for free space.
    pub fn is_contradicted(&self) -> bool {
        self.free_space > self.surface
    }

    /// Add the vote of a frame.
    pub fn add(&mut self, frame: DepthFrame<'_>, reach: f64, point: &Vec3, normal: &Vec3) {
        if let Some(sight) = Sight::new(frame, point, normal) {
            self.add_sight(frame, reach, &sight);
        }
    }

    /// Add the vote of a frame from its line of sight to the point.
    pub fn add_sight(&mut self, frame: DepthFrame<'_>, reach: f64, sight: &Sight) {
        let cosine = sight.cosine.abs();
        if cosine < MIN_VOTING_COSINE {
            return;
        }
        let Some(depth) = read_nearest(frame, sight.pixel).filter(|&depth| depth > 0.0) else { return };
        // Distance of the measurement in front of the surface, along the normal on the side of the camera.
        let front = (1.0 - depth / sight.z) * sight.along.abs();
        let limit = sight.limit(frame, reach);
        let weight = (cosine / (sight.z * sight.z)) as f32;
        if front < -limit {
            self.free_space += weight;
        } else if front < limit && sight.cosine > 0.0 {
            self.surface += weight;
        }
    }
}

/// Line of sight from a camera to a point of a surface.
#[derive(Clone, Copy, Debug)]
pub struct Sight {
    /// Depth of the point in metres, and its position in the image.
    pub z: f64,
    pub pixel: [f64; 2],
    /// Component along the normal of the vector from the camera to the point, in metres.
    pub along: f64,
    /// Cosine between the normal and the direction to the camera.
    pub cosine: f64,
}

impl Sight {
    /// Project a point; None behind the camera and outside the image, where most points are.
    pub fn new(frame: DepthFrame<'_>, point: &Vec3, normal: &Vec3) -> Option<Self> {
        let camera = frame.camera;
        let row = |i: usize| {
            let own = &camera.inverse[i];
            own[0] * point[0] + own[1] * point[1] + own[2] * point[2] + own[3]
        };
        let z = row(2);
        if z <= 0.0 {
            return None;
        }
        let pixel = [0, 1].map(|i| row(i) / z * camera.focal[i] + camera.centre[i]);
        let [right, below] = [camera.width, camera.height].map(|size| (size - 1) as f64);
        if !(pixel[0] >= 0.0 && pixel[1] >= 0.0 && pixel[0] < right && pixel[1] < below) {
            return None;
        }
        let centre = [0, 1, 2].map(|i| camera.pose[i][3]);
        let to_point = sub(point, &centre);
        let along = dot(&to_point, normal);
        Some(Self { z, pixel, along, cosine: -along / norm2(&to_point).sqrt() })
    }

    /// Distance from the surface, in metres, up to which a measurement may belong to it.
    pub fn limit(&self, frame: DepthFrame<'_>, reach: f64) -> f64 {
        (MAX_DEVIATIONS * self.noise(frame)).max(reach)
    }

    /// Standard deviation of a measurement of the point, in metres.
    pub fn noise(&self, frame: DepthFrame<'_>) -> f64 {
        f64::from(frame.noise.constant) + f64::from(frame.noise.quadratic) * self.z * self.z
    }
}

/// Read the nearest pixel; None outside the image and on its border, where depth is incomplete.
fn read_nearest(frame: DepthFrame<'_>, [u, v]: [f64; 2]) -> Option<f64> {
    let (width, height) = (frame.camera.width, frame.camera.height);
    if !(u >= 0.5 && v >= 0.5 && u < width as f64 - 1.5 && v < height as f64 - 1.5) {
        return None;
    }
    let (column, line) = ((u + 0.5) as usize, (v + 0.5) as usize);
    Some(f64::from(frame.depth[line * width + column]))
}
