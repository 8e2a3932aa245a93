//! Segmentation of a surface into charts.

use super::chart_merging::merge_small_charts;
use super::charts::{Charts, grow_charts};
use crate::base::errors::KernelError;
use crate::base::geometry::Vec3;
use crate::base::progress::Progress;

/// Charts smaller than a square of this many paddings are dissolved into their neighbours.
const MIN_CHART_PADDINGS: usize = 6;

/// Cut a surface into charts that fit into images of `side` × `side` texels with `padding` texels around
/// each. `density` is the desired number of texels per metre of each triangle.
///
/// # Errors
/// As [`Progress::check`].
pub fn segment_surface(
    points: &[Vec3],
    triangles: &[[u32; 3]],
    density: &[f32],
    side: usize,
    padding: usize,
    progress: &mut Progress,
) -> Result<Charts, KernelError> {
    let (mut charts, growth) = grow_charts(points, triangles, density, side - 2 * padding - 1, progress)?;
    merge_small_charts(&mut charts, &growth, (MIN_CHART_PADDINGS * padding).pow(2) as f64, progress)?;
    Ok(charts)
}
