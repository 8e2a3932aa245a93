//! Base mesh in coder order, with quantised vertices.

use super::base_mesh::Base;
use super::grid::{in_units, on_grid};
use super::header::GRID_ALONE;
use super::input::Input;
use super::rounding::Rounding;
use super::settings::Settings;
use crate::base::errors::KernelError;
use crate::base::geometry::Vec3;
use crate::base::reserve::Reserve;
use crate::snm::{Canonical, canonical, canonical_rounded};
use crate::subdivision::contents::{self, Header};
use crate::subdivision::topology::Topology;

/// Rounding passes if no levels follow. From the second pass on, every vertex sees the rounded positions of
/// all others.
const ROUNDS: usize = 3;

/// Base mesh in coder order, with its quantised contents.
pub struct Ordered {
    pub base: Base,
    pub contents: contents::Base,
}

/// Sort a base into coder order and quantise its vertices and channels.
///
/// # Errors
/// Errors of the coder; [`KernelError::OutOfMemory`].
pub fn in_order(
    base: Base,
    input: &Input<'_>,
    header: &Header,
    settings: &Settings,
) -> Result<Ordered, KernelError> {
    let positions = base.vertex_source.iter().map(|&v| on_grid(&input.points[v as usize], header)).collect();
    let channels = if header.channels == 0 {
        vec![]
    } else {
        let places = base.vertex_source.iter().map(|&v| &input.places[v as usize]);
        let channels = places.map(|place| input.carried.at(&input.surface, place));
        channels.map(|c| in_units(&c, &[0.0; 4], header)).collect()
    };
    let contents = contents::Base { positions, triangles: base.triangles.clone(), channels };
    let ordered = if settings.is_alone() {
        rounded_order(&contents, &base.vertex_source, input, header, settings.threads)?
    } else {
        canonical(&contents).map_err(KernelError::from)?
    };
    let base = base.reordered(&ordered.vertex_source, &ordered.triangle_source, &ordered.base.triangles);
    Ok(Ordered { base, contents: ordered.base })
}

/// Order a mesh without levels, rounding each vertex to the grid point that best fits the surface.
fn rounded_order(
    contents: &contents::Base,
    vertex_source: &[u32],
    input: &Input<'_>,
    header: &Header,
    threads: usize,
) -> Result<Canonical, KernelError> {
    let grid = f64::from(header.grid);
    let exact: Vec<Vec3> =
        vertex_source.iter().map(|&v| input.points[v as usize].map(|x| x / grid)).collect();
    let topology = Topology::new(exact.len(), contents.triangles.clone())?;
    let _reserve = Reserve::for_rows(input.samples.len())?;
    let samples = input.samples.scaled(1.0 / grid);
    let tolerance = if input.is_light { None } else { Some(1.0 / GRID_ALONE) };
    let (mut points, mut ordered) = (exact.clone(), Canonical::default());
    for _ in 0..ROUNDS {
        let mut rounding = Rounding::new(&topology, &exact, points, &samples, tolerance, threads);
        ordered =
            canonical_rounded(contents, &mut |v, bits| rounding.round(v, bits)).map_err(KernelError::from)?;
        points = rounding.into_points();
    }
    Ok(ordered)
}
