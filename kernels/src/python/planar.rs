//! `scanloom.stages._kernels.simplify_planar` and `scanloom.stages._kernels.find_planar_patches`.

use std::collections::BTreeMap;

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{Attributes, MeshInputs, column_array, id_array, triangle_array, unsupported_attributes};
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use crate::base::parallel::resolve_thread_count;
use crate::mesh::triangle_mesh::{Mesh, VertexLock};
use crate::planar::{
    Options, Patches, PlanarMesh, compute_facets, segmentation, separation_reasons, simplify,
};

/// Near-planar patches of a mesh, largest area first.
#[pyclass(frozen, get_all, subclass)]
pub struct PlanarPatches {
    /// Patch of each input triangle; −1 for triangles with repeated vertices.
    input_patch: Py<PyArray1<i32>>,
    normals: Py<PyArray2<f64>>,
    origins: Py<PyArray2<f64>>,
    areas: Py<PyArray1<f64>>,
    thickness: Py<PyArray1<f64>>,
    faces: Py<PyArray1<i32>>,
    /// Number of neighbour tests during the growth of the patches.
    neighbour_tests: u64,
}

impl PlanarPatches {
    fn new<const D: usize>(
        py: Python<'_>,
        input_triangles: usize,
        mesh: &Mesh<D>,
        patches: &Patches,
    ) -> PyResult<Self> {
        let mut input_patch = vec![-1; input_triangles];
        for (&t, &patch) in mesh.triangle_source.iter().zip(&patches.patch_of_triangle) {
            input_patch[t as usize] = patch as i32;
        }
        let all = &patches.patches;
        let normals: Vec<[f64; 3]> = all.iter().map(|p| p.normal).collect();
        let origins: Vec<[f64; 3]> = all.iter().map(|p| p.origin).collect();
        Ok(Self {
            input_patch: PyArray1::from_vec(py, input_patch).unbind(),
            normals: column_array(py, &normals, 0..3)?,
            origins: column_array(py, &origins, 0..3)?,
            areas: PyArray1::from_vec(py, all.iter().map(|p| p.area).collect()).unbind(),
            thickness: PyArray1::from_vec(py, all.iter().map(|p| p.thickness()).collect()).unbind(),
            faces: id_array(py, all.iter().map(|p| p.faces)),
            neighbour_tests: patches.visited_faces,
        })
    }
}

/// Mesh simplified by near-planar patches.
#[pyclass(frozen, get_all, extends = PlanarPatches)]
pub struct PlanarResult {
    triangles: Py<PyArray2<i32>>,
    vertex_source: Py<PyArray1<i32>>,
    triangle_source: Py<PyArray1<i32>>,
    triangle_patch: Py<PyArray1<i32>>,
    /// True for each patch that kept all its triangles.
    kept_all_triangles: Py<PyArray1<bool>>,
    /// (k, 2): maximum deviation of each patch in shape and in colour.
    bounds: Py<PyArray2<f64>>,
    refused: BTreeMap<&'static str, u64>,
    rounds: usize,
    /// True if the caller stopped the run early.
    is_partial: bool,
}

fn planar_options(
    labels: &PyReadonlyArray1<'_, i32>,
    triangles: usize,
    cosines: (f64, f64, f64),
    bounds: (f64, f64),
    wanted_threads: usize,
) -> PyResult<Options> {
    let (fidelity, detail, noise) = cosines;
    let (max_distance, max_color) = bounds;
    if ![fidelity, detail, noise].iter().all(|c| *c >= 0.0) {
        return Err(PyValueError::new_err("cosines must not be negative"));
    }
    if !(max_distance > 0.0 && max_distance.is_finite() && max_color >= 0.0) {
        return Err(PyValueError::new_err(
            "the shape bound must be above 0 and finite, and the colour bound must not be negative",
        ));
    }
    let labels: Vec<u32> = labels.as_array().iter().map(|&label| label as u32).collect();
    if !labels.is_empty() && labels.len() != triangles {
        return Err(PyValueError::new_err("labels must have one value for each triangle, or be empty"));
    }
    Ok(Options {
        labels,
        fidelity,
        detail,
        noise,
        max_distance,
        max_color,
        threads: resolve_thread_count(wanted_threads),
    })
}

/// Build a mesh with locked vertices.
fn mesh_with_locks<const D: usize>(
    threads: usize,
    points: Vec<[f64; D]>,
    triangles: &[[u32; 3]],
    locked: &[bool],
) -> Result<Mesh<D>, crate::base::errors::KernelError> {
    let mut mesh = Mesh::<D>::new_on(threads, points, triangles)?;
    for (lock, _) in mesh.locks.iter_mut().zip(locked).filter(|(_, locked)| **locked) {
        *lock = VertexLock::Locked;
    }
    Ok(mesh)
}

/// Simplify a mesh by near-planar patches; a patch never mixes `labels` (m,), which may be empty. `cosines`
/// are (fidelity, detail, noise), `bounds` (shape, colour).
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, labels, locked, *, cosines, bounds, threads, partial, progress))]
#[allow(clippy::too_many_arguments)]
pub fn simplify_planar(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: Attributes<'_>,
    triangles: PyReadonlyArray2<'_, i32>,
    labels: PyReadonlyArray1<'_, i32>,
    locked: PyReadonlyArray1<'_, bool>,
    cosines: (f64, f64, f64),
    bounds: (f64, f64),
    threads: usize,
    partial: bool,
    progress: Py<PyAny>,
) -> PyResult<Py<PlanarResult>> {
    let inputs = MeshInputs { vertices, attributes, triangles };
    with_memory_reserve(inputs.row_count(), || {
        let locked = inputs.per_vertex("locked", &locked)?;
        let options = planar_options(&labels, inputs.triangles.as_array().nrows(), cosines, bounds, threads)?;
        match inputs.attribute_count() {
            0 => simplify_points::<3, 0>(py, &inputs, &locked, &options, partial, &progress),
            3 => simplify_points::<6, 3>(py, &inputs, &locked, &options, partial, &progress),
            k => Err(unsupported_attributes(k)),
        }
    })
}

fn simplify_points<const D: usize, const K: usize>(
    py: Python<'_>,
    inputs: &MeshInputs<'_>,
    locked: &[bool],
    options: &Options,
    partial: bool,
    progress: &Py<PyAny>,
) -> PyResult<Py<PlanarResult>> {
    let (points, triangles) = inputs.copy_mesh::<D>()?;
    let (mesh, result, is_partial): (Mesh<D>, PlanarMesh, bool) =
        run_detached(py, Some(progress), partial, |progress| {
            let mesh = mesh_with_locks(options.threads, points, &triangles, locked)?;
            let result = simplify::<D, K>(&mesh, options, progress)?;
            Ok((mesh, result, progress.is_stopping_early()))
        })?;
    let patches = PlanarPatches::new(py, triangles.len(), &mesh, &result.patches)?;
    let by_patches = PlanarResult {
        triangles: triangle_array(py, &result.triangles)?,
        vertex_source: id_array(py, result.vertex_source.iter().copied()),
        triangle_source: id_array(py, result.triangle_source.iter().copied()),
        triangle_patch: id_array(py, result.triangle_patch.iter().copied()),
        kept_all_triangles: PyArray1::from_vec(py, result.keeps_triangles).unbind(),
        bounds: PyArray2::from_vec2(py, &result.bounds.iter().map(|b| b.to_vec()).collect::<Vec<_>>())?
            .unbind(),
        refused: separation_reasons::REASONS.into_iter().zip(result.separation_counts).collect(),
        rounds: result.rounds,
        is_partial,
    };
    Py::new(py, PyClassInitializer::from(patches).add_subclass(by_patches))
}

/// Compute the near-planar patches that `simplify_planar` would use.
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, labels, *, cosines, bounds, threads, progress))]
#[allow(clippy::too_many_arguments)]
pub fn find_planar_patches(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: Attributes<'_>,
    triangles: PyReadonlyArray2<'_, i32>,
    labels: PyReadonlyArray1<'_, i32>,
    cosines: (f64, f64, f64),
    bounds: (f64, f64),
    threads: usize,
    progress: Py<PyAny>,
) -> PyResult<PlanarPatches> {
    let inputs = MeshInputs { vertices, attributes, triangles };
    with_memory_reserve(inputs.row_count(), || {
        let options = planar_options(&labels, inputs.triangles.as_array().nrows(), cosines, bounds, threads)?;
        match inputs.attribute_count() {
            0 => patches_of_points::<3, 0>(py, &inputs, &options, &progress),
            3 => patches_of_points::<6, 3>(py, &inputs, &options, &progress),
            k => Err(unsupported_attributes(k)),
        }
    })
}

fn patches_of_points<const D: usize, const K: usize>(
    py: Python<'_>,
    inputs: &MeshInputs<'_>,
    options: &Options,
    progress: &Py<PyAny>,
) -> PyResult<PlanarPatches> {
    let (points, triangles) = inputs.copy_mesh::<D>()?;
    let (mesh, patches) = run_detached(py, Some(progress), false, |progress| {
        let mesh = mesh_with_locks(options.threads, points, &triangles, &[])?;
        let patches = segmentation::segment_patches::<D, K>(
            &mesh,
            &compute_facets(&mesh, options.threads),
            options,
            progress,
        )?;
        Ok((mesh, patches))
    })?;
    PlanarPatches::new(py, triangles.len(), &mesh, &patches)
}
