//! File header: grid of the base, quantisation steps and number of levels.

use super::quantization::MAX_ROUNDING_ERROR;
use super::settings::Settings;
use super::tolerance::{FINEST_TOLERANCE, MAX_DOUBLINGS};
use super::vertex_attributes::VertexAttributes;
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, diagonal};
use crate::subdivision::snm_contents::Header;

/// Maximum number of levels if the caller gives none.
pub const MAX_LEVELS: u8 = 4;
/// Step of a level relative to the next finer level. Coarse levels get finer steps, because their errors
/// spread.
const STEP_RATIO: f32 = 0.625;
/// Mantissa bits kept in steps. Round numbers shorten the file.
const MANTISSA_BITS: u32 = 3;
/// Grid spacing in tolerances if no levels follow. Rounding chooses among several grid points, one of which
/// is near enough.
pub const GRID_PER_TOLERANCE: f64 = 2.0;
/// A mesh farther from the origin than this many diagonals gets an offset origin.
const FAR_DIAGONALS: f64 = 4.0;
/// Maximum grid coordinate; leaves headroom in 32 bits for the coder's predictions.
const MAX_GRID_COORDINATE: f64 = (1u32 << 29) as f64;

/// Build the header for a mesh within `bounds`, with the requested tolerance or else the finest one.
///
/// # Errors
/// [`KernelError::Extent`] if the mesh is too small or too large for the number range of a file.
pub fn make_header(
    bounds: [Vec3; 2],
    carried: &VertexAttributes,
    settings: &Settings,
) -> Result<Header, KernelError> {
    let size = diagonal(&bounds);
    let tolerance = settings.tolerance.unwrap_or(FINEST_TOLERANCE);
    let step = round_down(tolerance * size / MAX_ROUNDING_ERROR);
    let grid =
        if settings.is_base_only() { round_down(GRID_PER_TOLERANCE * tolerance * size) } else { 0.5 * step };
    if !grid.is_normal() || !step.is_normal() || size / f64::from(grid) > MAX_GRID_COORDINATE {
        return Err(KernelError::UnrepresentableExtent { diagonal: size });
    }
    let farthest = bounds.iter().flatten().fold(0.0f64, |most, x| most.max(x.abs()));
    let far = farthest > FAR_DIAGONALS * size || farthest / f64::from(grid) > MAX_GRID_COORDINATE;
    // The origin must be a point of the coarsest grid that the tolerance search may select.
    let cells = if settings.tolerance.is_some() { 1 } else { 1i64 << MAX_DOUBLINGS };
    let near = |x: f64| cells * (x / f64::from(grid) / cells as f64).round() as i64;
    let origin = if far { bounds[0].map(near) } else { [0; 3] };
    Ok(Header {
        scheme: settings.scheme,
        relaxations: settings.relaxations,
        origin,
        grid,
        step,
        step_ratio: STEP_RATIO,
        channels: carried.channel_count(),
        units: carried.channel_units(settings.color_tolerance),
        levels: settings.levels.unwrap_or(MAX_LEVELS),
        up: settings.up,
    })
}

/// Compute the number of levels after which a base has about the wanted number of triangles.
pub fn choose_level_count(base: usize, triangles: usize) -> u8 {
    let growth = triangles as f64 / base.max(1) as f64;
    (1..MAX_LEVELS).find(|&level| growth < 2.0 * 4f64.powi(level.into())).unwrap_or(MAX_LEVELS)
}

/// Round down to a number with a short mantissa.
fn round_down(x: f64) -> f32 {
    let near = x as f32;
    let below = if f64::from(near) > x { near.next_down() } else { near };
    f32::from_bits(below.to_bits() >> (23 - MANTISSA_BITS) << (23 - MANTISSA_BITS))
}

/// Double the grid and steps `doublings` times, keeping the origin in place.
pub fn coarsen_steps(header: &Header, doublings: u32) -> Header {
    let factor = (1u32 << doublings) as f32;
    Header {
        origin: header.origin.map(|k| k >> doublings),
        grid: factor * header.grid,
        step: factor * header.step,
        ..*header
    }
}
