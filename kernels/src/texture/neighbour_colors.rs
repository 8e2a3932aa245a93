//! Differences of adjacent texels within one photo, as a reference without seams.

use super::pixel_lookup::{NO_POINT, build_pixel_lookup};
use super::surface_points::SurfacePoints;
use crate::base::errors::KernelError;
use crate::base::progress::Progress;

/// Pairs of adjacent points, and the colours of both in the photo with the highest weight at one of them.
#[derive(Debug, Default)]
pub struct NeighbourColors {
    pub pairs: Vec<[u32; 2]>,
    pub shown: Vec<[[u8; 3]; 2]>,
}

/// Collect pairs of horizontally and vertically adjacent points, in every `every`-th row of an image. The
/// colours are from the photo with the highest weight at the first point, or else at the second; pairs that
/// this photo does not show are skipped.
pub fn collect_neighbours(
    points: &SurfacePoints,
    labels: &[i32],
    pixels: &[u32],
    width: usize,
    every: usize,
    progress: &Progress,
) -> Result<NeighbourColors, KernelError> {
    let (at, height) = build_pixel_lookup(pixels, width)?;
    let mut found = NeighbourColors::default();
    for row in (0..height).step_by(every) {
        progress.check()?;
        for column in 0..width {
            let point = at[row * width + column];
            if point == NO_POINT {
                continue;
            }
            let right = if column + 1 < width { at[row * width + column + 1] } else { NO_POINT };
            let below = if row + 1 < height { at[(row + 1) * width + column] } else { NO_POINT };
            for other in [right, below] {
                if other != NO_POINT
                    && let Some(shown) = colors_in_one_photo(points, labels, point, other)
                {
                    found.pairs.push([point, other]);
                    found.shown.push(shown);
                }
            }
        }
    }
    Ok(found)
}

fn colors_in_one_photo(points: &SurfacePoints, labels: &[i32], a: u32, b: u32) -> Option<[[u8; 3]; 2]> {
    let (one, other) = (points.samples(a as usize), points.samples(b as usize));
    [a, b].into_iter().find_map(|of| {
        let label = labels[of as usize];
        let place = |views: &[u16]| views.iter().position(|&view| i32::from(view) == label);
        let (i, j) = (place(one.views)?, place(other.views)?);
        Some([one.colors[i][0], other.colors[j][0]])
    })
}
