//! Segmentation of a surface into charts.

use super::absorb::absorb;
use super::charts::{Charts, grown};
use crate::base::errors::KernelError;
use crate::base::geometry::Vec3;
use crate::base::progress::Progress;

/// Charts smaller than a square of this many paddings are dissolved into their neighbours.
const SMALL: usize = 6;

/// Cut a surface into charts that fit into images of `side` × `side` texels with `padding` texels around
/// each. `density` is the desired number of texels per metre of each triangle.
///
/// # Errors
/// As [`Progress::check`].
pub fn cut(
    points: &[Vec3],
    triangles: &[[u32; 3]],
    density: &[f32],
    side: usize,
    padding: usize,
    progress: &mut Progress,
) -> Result<Charts, KernelError> {
    let (mut charts, growth) = grown(points, triangles, density, side - 2 * padding - 1, progress)?;
    absorb(&mut charts, &growth, (SMALL * padding).pow(2) as f64, progress)?;
    Ok(charts)
}
