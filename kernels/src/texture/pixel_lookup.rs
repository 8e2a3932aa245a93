//! Lookup from texture pixels to surface points.

use crate::base::errors::KernelError;

/// Marker for a pixel without a point.
pub const NO_POINT: u32 = u32::MAX;

/// Compute the point at each pixel (row × width + column) of an image, or [`NO_POINT`]; and the image height.
///
/// # Errors
/// [`KernelError::OutOfMemory`] if the image does not fit in memory.
pub fn build_pixel_lookup(pixels: &[u32], width: usize) -> Result<(Vec<u32>, usize), KernelError> {
    let height = pixels.iter().max().map_or(0, |&last| last as usize / width + 1);
    let mut at = vec![];
    at.try_reserve_exact(width * height).map_err(|_| KernelError::OutOfMemory)?;
    at.resize(width * height, NO_POINT);
    for (point, &pixel) in (0..).zip(pixels) {
        at[pixel as usize] = point;
    }
    Ok((at, height))
}
