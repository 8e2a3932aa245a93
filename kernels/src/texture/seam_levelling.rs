//! Seam levelling: removal of brightness steps between regions that were blended from different photos.
//!
//! The set of contributing photos changes from texel to texel. Photos are never equally bright, so the
//! blended colours have a visible step where the set changes. Photos that show both texels give their true
//! difference. A correction that fades to both sides brings the colours to this difference, like the local
//! adjustment of Waechter et al. 2014 ("Let there be color!") at a seam of two photos.

use super::pixel_lookup::{NO_POINT, build_pixel_lookup};
use super::screened_poisson::{ChannelValues, PoissonGrid};
use super::surface_points::SurfacePoints;
use crate::base::errors::KernelError;
use crate::base::parallel::map;
use crate::base::progress::Progress;

/// Side in texels of the tiles that are levelled at once, and the margin around them in multiples of the
/// reach; influence from farther away is negligible.
const TILE_TEXELS: usize = 512;
const MARGIN_REACHES: f32 = 3.0;
/// Photos that differ from the blended colour by more levels are ignored, because they show another surface.
const MAX_PHOTO_DIFFERENCE: f32 = 40.0;
/// Corrections are stored in this fraction of a level.
const CORRECTION_STEPS: f32 = 64.0;

/// Texture image with the surface point of each pixel.
struct LevelledImage<'a> {
    points: &'a SurfacePoints,
    colors: &'a [[f32; 3]],
    width: usize,
    height: usize,
    /// Point at each pixel, or [`NONE`].
    at: Vec<u32>,
}

/// Level the colours of points at the given pixels (row × width + column) of an image.
///
/// # Errors
/// [`KernelError::OutOfMemory`] if the image does not fit in memory; as [`Progress::check`].
pub fn level_seams(
    points: &SurfacePoints,
    colors: &mut [[f32; 3]],
    pixels: &[u32],
    width: usize,
    reach: f32,
    threads: usize,
    progress: &Progress,
) -> Result<(), KernelError> {
    let (at, height) = build_pixel_lookup(pixels, width)?;
    let image = LevelledImage { points, colors, width, height, at };
    let across = width.div_ceil(TILE_TEXELS);
    let tiles = across * height.div_ceil(TILE_TEXELS);
    let start = |tile: usize| [tile % across * TILE_TEXELS, tile / across * TILE_TEXELS];
    let corrections = map(tiles, threads, || (), |(), tile| image.compute_corrections(start(tile), reach));
    let at = image.at;
    for (tile, corrections) in corrections.into_iter().enumerate() {
        let mut corrections = corrections.into_iter();
        let [x, y] = start(tile);
        for row in y..(y + TILE_TEXELS).min(height) {
            for &point in &at[row * width..][x..(x + TILE_TEXELS).min(width)] {
                if point != NO_POINT
                    && let Some(correction) = corrections.next()
                {
                    for (level, part) in colors[point as usize].iter_mut().zip(correction) {
                        *level = (*level + f32::from(part) / CORRECTION_STEPS).clamp(0.0, 255.0);
                    }
                }
            }
        }
    }
    progress.check()
}

impl LevelledImage<'_> {
    /// Compute the corrections of the points of a tile, row by row; empty if nothing is to be corrected.
    fn compute_corrections(&self, start: [usize; 2], reach: f32) -> Vec<[i16; 3]> {
        let around = (MARGIN_REACHES * reach).ceil() as usize;
        let [left, top] = start.map(|s| s.saturating_sub(around));
        let right = (start[0] + TILE_TEXELS + around).min(self.width);
        let bottom = (start[1] + TILE_TEXELS + around).min(self.height);
        let mut grid = PoissonGrid::new(right - left, bottom - top);
        let mut is_any_wanted = false;
        for y in top..bottom {
            for x in left..right {
                let point = self.at[y * self.width + x];
                if point == NO_POINT {
                    continue;
                }
                let cell = grid.cell(x - left, y - top);
                grid.set_screening(cell, 1.0 / (reach * reach));
                if x + 1 < right
                    && let Some(difference) = self.missing_difference(point, self.at[y * self.width + x + 1])
                {
                    is_any_wanted |= difference != [0.0; 4];
                    grid.prescribe_right(cell, &difference);
                }
                if y + 1 < bottom
                    && let Some(difference) =
                        self.missing_difference(point, self.at[(y + 1) * self.width + x])
                {
                    is_any_wanted |= difference != [0.0; 4];
                    grid.prescribe_down(cell, &difference);
                }
            }
        }
        if !is_any_wanted {
            return vec![];
        }
        let field = grid.solve(reach);
        let mut found = vec![];
        for y in start[1]..(start[1] + TILE_TEXELS).min(bottom) {
            for x in start[0]..(start[0] + TILE_TEXELS).min(right) {
                if self.at[y * self.width + x] != NO_POINT {
                    let [red, green, blue, _] = field[grid.cell(x - left, y - top)];
                    found.push([red, green, blue].map(|value| (value * CORRECTION_STEPS) as i16));
                }
            }
        }
        found
    }

    /// Compute the missing difference between two texels. None if no photo shows both; zero if both have the
    /// same photos.
    #[inline]
    fn missing_difference(&self, a: u32, b: u32) -> Option<ChannelValues> {
        if b == NO_POINT {
            return None;
        }
        let (a, b) = (a as usize, b as usize);
        let (one, other) = (self.points.samples(a), self.points.samples(b));
        if one.views == other.views && !one.is_empty() {
            return Some([0.0; 4]);
        }
        let (mut sum, mut weights, mut common) = ([0.0; 3], 0.0, 0);
        for (i, view) in one.views.iter().enumerate() {
            let Some(j) = other.views.iter().position(|other| other == view) else { continue };
            common += 1;
            let (here, there) = (one.colors[i][0], other.colors[j][0]);
            if is_other_surface(here, &self.colors[a]) || is_other_surface(there, &self.colors[b]) {
                continue;
            }
            let weight = one.scores[i].min(other.scores[j]);
            for k in 0..3 {
                sum[k] += weight * (f32::from(here[k]) - f32::from(there[k]));
            }
            weights += weight;
        }
        if common == one.len() && common == other.len() && common > 0 {
            return Some([0.0; 4]);
        }
        (weights > 0.0).then(|| {
            let wanted = [0, 1, 2].map(|k| sum[k] / weights - (self.colors[a][k] - self.colors[b][k]));
            [wanted[0], wanted[1], wanted[2], 0.0]
        })
    }
}

#[inline]
fn is_other_surface(photo: [u8; 3], color: &[f32; 3]) -> bool {
    (0..3).any(|k| (f32::from(photo[k]) - color[k]).abs() > MAX_PHOTO_DIFFERENCE)
}
