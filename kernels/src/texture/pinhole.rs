//! Pinhole cameras without distortion.

use crate::base::geometry::{Vec3, dot};

/// Pinhole camera with its pose. Camera axes are x right, y down, z forward; the centre of the first pixel is
/// at (0, 0).
#[derive(Clone, Copy, Debug)]
pub struct Pinhole {
    pub focal: [f64; 2],
    pub centre: [f64; 2],
    pub width: usize,
    pub height: usize,
    /// World-to-camera rotation (rows) and translation.
    pub turn: [Vec3; 3],
    pub shift: Vec3,
}

impl Pinhole {
    /// Transform a world point to camera axes.
    #[inline]
    pub fn in_camera(&self, p: &Vec3) -> Vec3 {
        [0, 1, 2].map(|i| dot(&self.turn[i], p) + self.shift[i])
    }

    /// Project a point in camera axes to a pixel; the point must be in front of the camera.
    #[inline]
    pub fn pixel(&self, p: &Vec3) -> [f64; 2] {
        [0, 1].map(|i| self.focal[i] * p[i] / p[2] + self.centre[i])
    }

    /// Unproject a pixel with a depth to a point in camera axes.
    #[inline]
    pub fn point(&self, x: usize, y: usize, depth: f64) -> Vec3 {
        let [u, v] = [0, 1].map(|i| ([x, y][i] as f64 - self.centre[i]) / self.focal[i]);
        [u * depth, v * depth, depth]
    }

    /// Return the camera centre in world coordinates.
    pub fn place(&self) -> Vec3 {
        [0, 1, 2].map(|i| -(0..3).map(|k| self.turn[k][i] * self.shift[k]).sum::<f64>())
    }

    /// Check whether two cameras have the same intrinsics and image size.
    pub fn is_same_but_for_its_place(&self, other: &Self) -> bool {
        let of = |camera: &Self| (camera.focal, camera.centre, camera.width, camera.height);
        of(self) == of(other)
    }

    /// Return the index of the pixel nearest to an image position; None outside the image.
    #[inline]
    pub fn nearest(&self, [x, y]: [f64; 2]) -> Option<usize> {
        let (x, y) = (x + 0.5, y + 0.5);
        if x < 0.0 || y < 0.0 || x >= self.width as f64 || y >= self.height as f64 {
            return None;
        }
        Some(y as usize * self.width + x as usize)
    }
}
