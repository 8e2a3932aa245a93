//! `scanloom.stages._kernels.find_intersecting_triangles`.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;

use super::arrays::{Attributes, MeshInputs};
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use crate::base::parallel::resolve_thread_count;
use crate::mesh::connectivity_builder::check_indices;
use crate::mesh::self_intersections::find_intersecting;
use crate::mesh::triangle_mesh::check_points;

/// Find for each triangle (m,) one that it intersects beyond their shared vertices; 2³² − 1 for none.
#[pyfunction]
#[pyo3(signature = (vertices, triangles, *, wanted_threads, progress))]
pub fn find_intersecting_triangles(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
    wanted_threads: usize,
    progress: Option<Py<PyAny>>,
) -> PyResult<Py<PyArray1<u32>>> {
    let attributes =
        Attributes::Levels(PyArray2::zeros(py, [vertices.as_array().nrows(), 0], false).readonly());
    let inputs = MeshInputs { vertices, attributes, triangles };
    with_memory_reserve(inputs.row_count(), || {
        let (points, triangles) = inputs.copy_mesh::<3>()?;
        let met = run_detached(py, progress.as_ref(), false, |progress| {
            check_points(&points)?;
            check_indices(points.len(), &triangles)?;
            find_intersecting(&points, &triangles, resolve_thread_count(wanted_threads), progress)
        })?;
        Ok(PyArray1::from_vec(py, met).unbind())
    })
}
