//! Python bindings, imported as `scanloom.stages._kernels`; one file per kernel.
//!
//! Arrays are checked and copied while the GIL is held; the work runs without it (see [`background_work`]).

mod arrays;
mod atlas;
mod background_work;
mod certified;
mod certify;
mod color_weight;
mod components;
mod compression;
mod fit;
mod fusion;
mod intersections;
mod irregular;
mod jia01;
mod lod;
mod memory;
mod memory_guard;
mod nearest;
mod normal_mesh;
mod order;
mod planar;
mod quadric;
mod recognition;
mod refinement;
mod seams;
mod simplification_result;
mod stereo;
mod texel_sources;
mod texture;

use pyo3::create_exception;
use pyo3::exceptions::{PyMemoryError, PyOverflowError, PyValueError};
use pyo3::prelude::*;

use crate::base::errors::KernelError;
use crate::base::memory_reserve::{Allocator, Reserve};

#[global_allocator]
static ALLOCATOR: Allocator = Allocator;

/// Bytes reserved for the lifetime of the module, for exceptions and the like.
const MODULE_RESERVE_BYTES: usize = 1 << 20;

create_exception!(
    scanloom.stages._kernels,
    InvalidMeshError,
    PyValueError,
    "The mesh violates a requirement of the kernels; the message lists the elements."
);
create_exception!(
    scanloom.stages._kernels,
    LimitError,
    PyOverflowError,
    "The result would exceed the given limit."
);

impl From<KernelError> for PyErr {
    fn from(error: KernelError) -> Self {
        match error {
            KernelError::OutOfMemory => PyMemoryError::new_err(error.to_string()),
            KernelError::TooManyTriangles { .. }
            | KernelError::TooManyBlocks { .. }
            | KernelError::OutOfBlockRange { .. } => LimitError::new_err(error.to_string()),
            _ => InvalidMeshError::new_err(error.to_string()),
        }
    }
}

#[pymodule(gil_used = false)]
fn _kernels(module: &Bound<'_, PyModule>) -> PyResult<()> {
    std::mem::forget(Reserve::new(MODULE_RESERVE_BYTES)?);
    compression::set_allocator();
    module.add("InvalidMeshError", module.py().get_type::<InvalidMeshError>())?;
    module.add("LimitError", module.py().get_type::<LimitError>())?;
    module.add("NEEDLE", crate::certify::NEEDLE_RATIO)?;
    module.add_class::<simplification_result::RunSettings>()?;
    module.add_class::<simplification_result::SimplificationResult>()?;
    module.add_class::<quadric::QuadricResult>()?;
    module.add_function(wrap_pyfunction!(quadric::simplify_by_quadrics, module)?)?;
    module.add_class::<seams::SeamResult>()?;
    module.add_class::<seams::SeamWeights>()?;
    module.add_class::<seams::SeamLog>()?;
    module.add_class::<seams::WeldedSheets>()?;
    module.add_function(wrap_pyfunction!(seams::simplify_seams, module)?)?;
    module.add_function(wrap_pyfunction!(seams::weld_sheets, module)?)?;
    module.add_function(wrap_pyfunction!(color_weight::choose_color_weight, module)?)?;
    module.add_function(wrap_pyfunction!(recognition::match_descriptors, module)?)?;
    module.add_function(wrap_pyfunction!(stereo::match_pair, module)?)?;
    module.add_function(wrap_pyfunction!(stereo::sweep_planes, module)?)?;
    module.add_function(wrap_pyfunction!(stereo::count_supporting_views, module)?)?;
    module.add_function(wrap_pyfunction!(stereo::is_inside_all_masks, module)?)?;
    module.add_function(wrap_pyfunction!(stereo::refine_inverse_depth, module)?)?;
    module.add_function(wrap_pyfunction!(stereo::fuse_depth_maps, module)?)?;
    module.add_function(wrap_pyfunction!(stereo::find_hull_entry, module)?)?;
    module.add_function(wrap_pyfunction!(stereo::compute_weighted_medians, module)?)?;
    module.add_function(wrap_pyfunction!(fit::fit, module)?)?;
    module.add_function(wrap_pyfunction!(order::compute_spatial_order, module)?)?;
    module.add_function(wrap_pyfunction!(components::label_components, module)?)?;
    module.add_function(wrap_pyfunction!(memory::release_free_memory, module)?)?;
    module.add_class::<atlas::AtlasLayout>()?;
    module.add_function(wrap_pyfunction!(atlas::lay_out_atlas, module)?)?;
    module.add_function(wrap_pyfunction!(atlas::rasterize_texels, module)?)?;
    module.add_class::<nearest::NearestSurface>()?;
    module.add_function(wrap_pyfunction!(texel_sources::draw_sources, module)?)?;
    module.add_function(wrap_pyfunction!(texel_sources::locate_texels, module)?)?;
    module.add_function(wrap_pyfunction!(texel_sources::sample_points, module)?)?;
    module.add_function(wrap_pyfunction!(texel_sources::sample_texels, module)?)?;
    module.add_class::<texture::MeshRenderer>()?;
    module.add_class::<texture::Photo>()?;
    module.add_class::<texture::View>()?;
    module.add_class::<texture::SurfacePoints>()?;
    module.add_class::<texture::TexturedSurface>()?;
    module.add_class::<certified::CertifiedResult>()?;
    module.add_function(wrap_pyfunction!(certified::simplify_certified, module)?)?;
    module.add_class::<jia01::Jia01Result>()?;
    module.add_function(wrap_pyfunction!(jia01::simplify, module)?)?;
    module.add_function(wrap_pyfunction!(jia01::compute_side_lengths, module)?)?;
    module.add_function(wrap_pyfunction!(intersections::find_intersecting_triangles, module)?)?;
    module.add_function(wrap_pyfunction!(irregular::find_irregular_elements, module)?)?;
    module.add_class::<normal_mesh::NormalMesh>()?;
    module.add("SnmError", module.py().get_type::<normal_mesh::SnmError>())?;
    module.add_function(wrap_pyfunction!(normal_mesh::remesh, module)?)?;
    module.add_function(wrap_pyfunction!(normal_mesh::decode_normal_mesh, module)?)?;
    module.add_class::<planar::PlanarPatches>()?;
    module.add_class::<planar::PlanarResult>()?;
    module.add_function(wrap_pyfunction!(planar::simplify_planar, module)?)?;
    module.add_function(wrap_pyfunction!(planar::find_planar_patches, module)?)?;
    module.add_class::<refinement::BoundaryAligner>()?;
    module.add_class::<refinement::SurfaceRefiner>()?;
    module.add_function(wrap_pyfunction!(refinement::smooth_boundaries, module)?)?;
    module.add_class::<fusion::Volume>()?;
    module.add_function(wrap_pyfunction!(fusion::filter_depth, module)?)?;
    module.add_function(wrap_pyfunction!(fusion::find_touched_blocks, module)?)?;
    module.add_class::<lod::LevelHierarchy>()?;
    module.add_class::<lod::FrontMesh>()?;
    module.add_function(wrap_pyfunction!(lod::build_levels, module)?)?;
    module.add_function(wrap_pyfunction!(lod::assemble_front, module)?)?;
    module.add_function(wrap_pyfunction!(compression::optimize_strip_order, module)?)?;
    module.add_function(wrap_pyfunction!(compression::decode_indices, module)?)?;
    module.add_function(wrap_pyfunction!(compression::decode_rows, module)?)?;
    module.add_function(wrap_pyfunction!(compression::encode_rows, module)?)?;
    module.add_function(wrap_pyfunction!(compression::encode_triangles, module)?)?;
    module.add_class::<certify::CertifyResult>()?;
    module.add_function(wrap_pyfunction!(certify::certify, module)?)
}
