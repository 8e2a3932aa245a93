//! `scanloom.stages._kernels.intersecting_triangles`.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;

use super::arrays::{Attributes, Inputs};
use super::detached::detached;
use super::guarded::guarded;
use crate::base::parallel::threads;
use crate::mesh::connect::check_indices;
use crate::mesh::intersections::intersecting;
use crate::mesh::triangle_mesh::check_points;

/// Find for each triangle (m,) one that it intersects beyond their shared vertices; 2³² − 1 for none.
#[pyfunction]
#[pyo3(signature = (vertices, triangles, *, wanted_threads, progress))]
pub fn intersecting_triangles(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
    wanted_threads: usize,
    progress: Option<Py<PyAny>>,
) -> PyResult<Py<PyArray1<u32>>> {
    let attributes =
        Attributes::Levels(PyArray2::zeros(py, [vertices.as_array().nrows(), 0], false).readonly());
    let inputs = Inputs { vertices, attributes, triangles };
    guarded(inputs.rows(), || {
        let (points, triangles) = inputs.copied::<3>()?;
        let met = detached(py, progress.as_ref(), false, |progress| {
            check_points(&points)?;
            check_indices(points.len(), &triangles)?;
            intersecting(&points, &triangles, threads(wanted_threads), progress)
        })?;
        Ok(PyArray1::from_vec(py, met).unbind())
    })
}
