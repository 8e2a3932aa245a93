//! Pinhole cameras without distortion.

use crate::base::geometry::{Vec3, dot};

/// Pinhole camera with its pose. Camera axes are x right, y down, z forward; the centre of the first pixel is
/// at (0, 0).
#[derive(Clone, Copy, Debug)]
pub struct PinholeCamera {
    pub focal: [f64; 2],
    pub centre: [f64; 2],
    pub width: usize,
    pub height: usize,
    /// World-to-camera rotation (rows) and translation.
    pub rotation: [Vec3; 3],
    pub translation: Vec3,
}

impl PinholeCamera {
    /// Transform a world point to camera axes.
    #[inline]
    pub fn to_camera(&self, p: &Vec3) -> Vec3 {
        [0, 1, 2].map(|i| dot(&self.rotation[i], p) + self.translation[i])
    }

    /// Project a point in camera axes to a pixel; the point must be in front of the camera.
    #[inline]
    pub fn project(&self, p: &Vec3) -> [f64; 2] {
        [0, 1].map(|i| self.focal[i] * p[i] / p[2] + self.centre[i])
    }

    /// Unproject a pixel with a depth to a point in camera axes.
    #[inline]
    pub fn unproject(&self, x: usize, y: usize, depth: f64) -> Vec3 {
        let [u, v] = [0, 1].map(|i| ([x, y][i] as f64 - self.centre[i]) / self.focal[i]);
        [u * depth, v * depth, depth]
    }

    /// Return the camera centre in world coordinates.
    pub fn camera_center(&self) -> Vec3 {
        [0, 1, 2].map(|i| -(0..3).map(|k| self.rotation[k][i] * self.translation[k]).sum::<f64>())
    }

    /// Check whether two cameras have the same intrinsics and image size.
    pub fn has_same_intrinsics(&self, other: &Self) -> bool {
        let of = |camera: &Self| (camera.focal, camera.centre, camera.width, camera.height);
        of(self) == of(other)
    }

    /// Return the index of the pixel nearest to an image position; None outside the image.
    #[inline]
    pub fn nearest_pixel(&self, [x, y]: [f64; 2]) -> Option<usize> {
        let (x, y) = (x + 0.5, y + 0.5);
        if x < 0.0 || y < 0.0 || x >= self.width as f64 || y >= self.height as f64 {
            return None;
        }
        Some(y as usize * self.width + x as usize)
    }
}
