//! Remeshing of a mesh to a normal mesh.

use super::base_selection::{Trial, find_best_base};
use super::coarsening::coarsen;
use super::header::make_header;
use super::input::{Input, OriginalSurface};
use super::level::Level;
use super::normal_mesh::{NormalMesh, RefinementStep};
use super::quantization::QuantizationSteps;
use super::settings::Settings;
use super::vertex_attributes::VertexAttributes;
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, bounding_box, sub};
use crate::base::memory_reserve::Reserve;
use crate::base::progress::Progress;
use crate::mesh::triangle_mesh::Mesh;
use crate::snm::Writer;
use crate::subdivision::snm_contents::{self, Header};

/// Remesh a mesh and its vertex attributes to a normal mesh. If the mesh is `simplified` and gets no levels,
/// vertices are rounded to the grid points nearest to the original surface.
///
/// # Errors
/// Errors of [`Mesh::new`]; [`KernelError::Extent`] if the mesh is too small or too large for the number
/// range of a file; [`KernelError::Interrupted`].
pub fn remesh(
    points: &[Vec3],
    triangles: &[[u32; 3]],
    carried: &VertexAttributes,
    simplified: Option<OriginalSurface<'_>>,
    settings: &Settings,
    progress: &mut Progress,
) -> Result<NormalMesh, KernelError> {
    let mesh = Mesh::new(points.to_vec(), triangles)?;
    let used = || mesh.connectivity.vertices().map(|v| *mesh.point(v));
    let header = make_header(bounding_box(used()), carried, settings)?;
    let shift = header.origin.map(|k| k as f64 * f64::from(header.grid));
    let points: Vec<Vec3> = points.iter().map(|p| sub(p, &shift)).collect();
    let mesh = Mesh { points: points.clone(), ..mesh };
    // Drop triangles that repeat a vertex: they have no area, so no point maps to them.
    let proper: Vec<[u32; 3]> = mesh.triangle_source.iter().map(|&t| triangles[t as usize]).collect();
    let source = mesh.triangle_source.clone();
    let input = Input::new(points, &proper, carried, simplified, &shift, settings);
    let coarse = coarsen(mesh, &input.surface, settings.target, !settings.is_base_only(), progress)?;
    let Trial { base, normal_mesh: mut made, .. } =
        find_best_base(&input, &coarse, header, settings, progress)?;
    if let Some(origin) = &mut made.encoder_info {
        origin.vertex_triangles.iter_mut().for_each(|t| *t = source[*t as usize]);
    }
    (made.file, made.ends) = write_file(&made.header, &base.contents, &made.levels, &made.steps, progress)?;
    Ok(made)
}

/// Write the file; return its bytes and the end of each level.
fn write_file(
    header: &Header,
    base: &snm_contents::BaseContents,
    levels: &[Level],
    steps: &[RefinementStep],
    progress: &Progress,
) -> Result<(Vec<u8>, Vec<usize>), KernelError> {
    let mut writer = Writer::new(header, base)?;
    let mut ends = vec![writer.bytes().len()];
    for (number, (level, step)) in levels.iter().zip(steps).enumerate() {
        let _reserve = Reserve::for_rows(level.next_row_count())?;
        let expected =
            level.predict_offsets(header, &QuantizationSteps::for_level(header, number), &step.predicted);
        writer.write_level(&level.topology, &expected, &step.refinement)?;
        ends.push(writer.bytes().len());
        progress.check()?;
    }
    Ok((writer.finish(), ends))
}
