//! Base mesh in coder order, with quantised vertices.

use super::base_mesh::Base;
use super::header::GRID_PER_TOLERANCE;
use super::input::Input;
use super::quantization::{quantize_channels, to_grid};
use super::rounding::Rounding;
use super::settings::Settings;
use crate::base::errors::KernelError;
use crate::base::geometry::Vec3;
use crate::base::memory_reserve::Reserve;
use crate::snm::{CanonicalBase, to_canonical, to_canonical_rounded};
use crate::subdivision::snm_contents::{self, Header};
use crate::subdivision::topology::Topology;

/// Rounding passes if no levels follow. From the second pass on, every vertex sees the rounded positions of
/// all others.
const ROUNDING_PASSES: usize = 3;

/// Base mesh in coder order, with its quantised contents.
pub struct OrderedBase {
    pub base: Base,
    pub contents: snm_contents::BaseContents,
}

/// Sort a base into coder order and quantise its vertices and channels.
///
/// # Errors
/// Errors of the coder; [`KernelError::OutOfMemory`].
pub fn order_base(
    base: Base,
    input: &Input<'_>,
    header: &Header,
    settings: &Settings,
) -> Result<OrderedBase, KernelError> {
    let positions = base.vertex_source.iter().map(|&v| to_grid(&input.points[v as usize], header)).collect();
    let channels = if header.channels == 0 {
        vec![]
    } else {
        let places = base.vertex_source.iter().map(|&v| &input.surface_points[v as usize]);
        let channels = places.map(|place| input.attributes.interpolate_channels(&input.surface, place));
        channels.map(|c| quantize_channels(&c, &[0.0; 4], header)).collect()
    };
    let contents = snm_contents::BaseContents { positions, triangles: base.triangles.clone(), channels };
    let ordered = if settings.is_base_only() {
        round_and_order(&contents, &base.vertex_source, input, header, settings.threads)?
    } else {
        to_canonical(&contents).map_err(KernelError::from)?
    };
    let base = base.renumber(&ordered.vertex_source, &ordered.triangle_source, &ordered.base.triangles);
    Ok(OrderedBase { base, contents: ordered.base })
}

/// Order a mesh without levels, rounding each vertex to the grid point that best fits the surface.
fn round_and_order(
    contents: &snm_contents::BaseContents,
    vertex_source: &[u32],
    input: &Input<'_>,
    header: &Header,
    threads: usize,
) -> Result<CanonicalBase, KernelError> {
    let grid = f64::from(header.grid);
    let exact: Vec<Vec3> =
        vertex_source.iter().map(|&v| input.points[v as usize].map(|x| x / grid)).collect();
    let topology = Topology::new(exact.len(), contents.triangles.clone())?;
    let _reserve = Reserve::for_rows(input.samples.len())?;
    let samples = input.samples.to_scale(1.0 / grid);
    let tolerance = if input.is_simplified { None } else { Some(1.0 / GRID_PER_TOLERANCE) };
    let (mut points, mut ordered) = (exact.clone(), CanonicalBase::default());
    for _ in 0..ROUNDING_PASSES {
        let mut rounding = Rounding::new(&topology, &exact, points, &samples, tolerance, threads);
        ordered = to_canonical_rounded(contents, &mut |v, bits| rounding.round_vertex(v, bits))
            .map_err(KernelError::from)?;
        points = rounding.into_points();
    }
    Ok(ordered)
}
