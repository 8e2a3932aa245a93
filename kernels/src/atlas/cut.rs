//! A surface cut into charts.

use super::absorb::absorb;
use super::charts::{Charts, grown};
use crate::base::errors::KernelError;
use crate::base::geometry::Vec3;
use crate::base::progress::Progress;

/// Charts of fewer texels than a square of so many paddings are taken up by others.
const SMALL: usize = 6;

/// Cut a surface into charts that fit into images of `side` × `side` with `padding` around each; `density` is the texels a
/// metre that each triangle should have.
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
