//! Neighbouring texels as one photo shows both: by how much they differ without any border.

use super::image::{NONE, points_at};
use super::surface_points::SurfacePoints;
use crate::base::errors::KernelError;
use crate::base::progress::Progress;

/// Pairs of points, and the colours of both in the photo that counts most at one of them.
#[derive(Debug, Default)]
pub struct Neighbours {
    pub pairs: Vec<[u32; 2]>,
    pub shown: Vec<[[u8; 3]; 2]>,
}

/// Points beside each other in an image, in every so many of its rows, and of these with the next row; where the photo that
/// counts most at the first, or else that of the second, shows both.
///
/// # Errors
/// As [`points_at`] and [`Progress::check`].
pub fn neighbours(
    points: &SurfacePoints,
    labels: &[i32],
    pixels: &[u32],
    width: usize,
    every: usize,
    progress: &Progress,
) -> Result<Neighbours, KernelError> {
    let (at, height) = points_at(pixels, width)?;
    let mut found = Neighbours::default();
    for row in (0..height).step_by(every) {
        progress.check()?;
        for column in 0..width {
            let point = at[row * width + column];
            if point == NONE {
                continue;
            }
            let right = if column + 1 < width { at[row * width + column + 1] } else { NONE };
            let below = if row + 1 < height { at[(row + 1) * width + column] } else { NONE };
            for other in [right, below] {
                if other != NONE
                    && let Some(shown) = shown(points, labels, point, other)
                {
                    found.pairs.push([point, other]);
                    found.shown.push(shown);
                }
            }
        }
    }
    Ok(found)
}

fn shown(points: &SurfacePoints, labels: &[i32], a: u32, b: u32) -> Option<[[u8; 3]; 2]> {
    let (one, other) = (points.samples(a as usize), points.samples(b as usize));
    [a, b].into_iter().find_map(|of| {
        let label = labels[of as usize];
        let place = |views: &[u16]| views.iter().position(|&view| i32::from(view) == label);
        let (i, j) = (place(one.views)?, place(other.views)?);
        Some([one.colors[i][0], other.colors[j][0]])
    })
}
