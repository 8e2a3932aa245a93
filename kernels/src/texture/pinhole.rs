//! Cameras without distortion, where they stand, and what one sees of a mesh.

use crate::base::geometry::{Vec3, dot};

/// Camera axes are x right, y down, z forward; the centre of the first pixel is at (0, 0).
#[derive(Clone, Copy, Debug)]
pub struct Pinhole {
    pub focal: [f64; 2],
    pub centre: [f64; 2],
    pub width: usize,
    pub height: usize,
    /// Rows of the rotation that takes the world to the camera, and the shift after it.
    pub turn: [Vec3; 3],
    pub shift: Vec3,
}

impl Pinhole {
    /// A point of the world in camera axes.
    #[inline]
    pub fn in_camera(&self, p: &Vec3) -> Vec3 {
        [0, 1, 2].map(|i| dot(&self.turn[i], p) + self.shift[i])
    }

    /// The pixel at which a point in camera axes appears; it must be in front.
    #[inline]
    pub fn pixel(&self, p: &Vec3) -> [f64; 2] {
        [0, 1].map(|i| self.focal[i] * p[i] / p[2] + self.centre[i])
    }

    /// The point at a depth behind a pixel, in camera axes.
    #[inline]
    pub fn point(&self, x: usize, y: usize, depth: f64) -> Vec3 {
        let [u, v] = [0, 1].map(|i| ([x, y][i] as f64 - self.centre[i]) / self.focal[i]);
        [u * depth, v * depth, depth]
    }

    /// Where the camera stands in the world.
    pub fn place(&self) -> Vec3 {
        [0, 1, 2].map(|i| -(0..3).map(|k| self.turn[k][i] * self.shift[k]).sum::<f64>())
    }

    /// Whether a point in camera axes appears at the same pixel in another camera.
    pub fn is_same_but_for_its_place(&self, other: &Self) -> bool {
        let of = |camera: &Self| (camera.focal, camera.centre, camera.width, camera.height);
        of(self) == of(other)
    }

    /// The number of the pixel nearest to a place in the image; none beyond its edge.
    #[inline]
    pub fn nearest(&self, [x, y]: [f64; 2]) -> Option<usize> {
        let (x, y) = (x + 0.5, y + 0.5);
        if x < 0.0 || y < 0.0 || x >= self.width as f64 || y >= self.height as f64 {
            return None;
        }
        Some(y as usize * self.width + x as usize)
    }
}
