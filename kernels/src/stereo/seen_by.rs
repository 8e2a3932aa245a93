//! Where other views see the places that a view's depth map names, and what they say of them.

use super::volume::Size;
use crate::base::parallel::collect;

/// From pixels to another view: (u z, v z, z, 1) is mapped to the other's pixel times its depth, and that depth.
pub type Matrix = [[f64; 4]; 3];

/// Another view's map.
pub struct Other<T> {
    pub from_pixels: Matrix,
    pub size: Size,
    pub map: Vec<T>,
}

impl<T: Copy> Other<T> {
    /// What the map has where the other view sees pixel (u, v) of depth z, and how far that is from it; none where the
    /// place lies behind it or beyond its image.
    fn at(&self, u: usize, v: usize, z: f64) -> Option<(T, f64)> {
        let place = [u as f64 * z, v as f64 * z, z];
        let [x, y, ahead] =
            self.from_pixels.map(|row| row[0] * place[0] + row[1] * place[1] + row[2] * place[2] + row[3]);
        let (x, y) = (x / ahead, y / ahead);
        let (right, down) = ((self.size.width - 1) as f64, (self.size.height - 1) as f64);
        let holds = ahead > 0.0 && x >= 0.0 && y >= 0.0 && x <= right && y <= down;
        holds.then(|| (self.map[(y + 0.5) as usize * self.size.width + (x + 0.5) as usize], ahead))
    }
}

/// How many of the others have the same depth: as near as the first tolerance, and as the second, shares of depth. None
/// where there is no depth.
pub fn agreeing(
    depth: &[f32],
    size: Size,
    others: &[Other<f32>],
    tolerances: [f64; 2],
    threads: usize,
) -> Vec<[u8; 2]> {
    collect(size.pixels(), threads, |i| {
        let mut count = [0u8; 2];
        if depth[i] > 0.0 {
            for other in others {
                if let Some((there, ahead)) = other.at(i % size.width, i / size.width, depth[i].into()) {
                    let off = (f64::from(there) - ahead).abs();
                    for (count, tolerance) in count.iter_mut().zip(tolerances) {
                        *count = count.saturating_add(u8::from(there > 0.0 && off <= tolerance * ahead));
                    }
                }
            }
        }
        count
    })
}

/// Whether all others that see the place have it in their masks.
pub fn inside_all(depth: &[f32], size: Size, masks: &[Other<bool>], threads: usize) -> Vec<bool> {
    collect(size.pixels(), threads, |i| {
        let z = f64::from(depth[i]);
        masks.iter().all(|one| one.at(i % size.width, i / size.width, z).is_none_or(|(inside, _)| inside))
    })
}
