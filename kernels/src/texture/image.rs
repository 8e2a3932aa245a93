//! Points as they lie in an image.

use crate::base::errors::KernelError;

/// No point lies at a pixel.
pub const NONE: u32 = u32::MAX;

/// The point at each pixel (row × width + column) of an image, or [`NONE`]; and the image's height.
///
/// # Errors
/// [`KernelError::OutOfMemory`] if there is no room for it.
pub fn points_at(pixels: &[u32], width: usize) -> Result<(Vec<u32>, usize), KernelError> {
    let height = pixels.iter().max().map_or(0, |&last| last as usize / width + 1);
    let mut at = vec![];
    at.try_reserve_exact(width * height).map_err(|_| KernelError::OutOfMemory)?;
    at.resize(width * height, NONE);
    for (point, &pixel) in (0..).zip(pixels) {
        at[pixel as usize] = point;
    }
    Ok((at, height))
}
