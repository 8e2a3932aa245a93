//! `scanloom.stages._kernels.compute_spatial_order`.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;

use super::arrays::{Attributes, MeshInputs};
use super::memory_guard::with_memory_reserve;
use crate::mesh::connectivity_builder::check_indices;
use crate::mesh::triangle_mesh::check_points;

type OrderArray = Py<PyArray1<u32>>;

/// Compute a Z-order of vertices (n,) and triangles (m,), so that neighbours in space are close in memory.
#[pyfunction]
pub fn compute_spatial_order(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
) -> PyResult<(OrderArray, OrderArray)> {
    let attributes =
        Attributes::Levels(PyArray2::zeros(py, [vertices.as_array().nrows(), 0], false).readonly());
    let inputs = MeshInputs { vertices, attributes, triangles };
    with_memory_reserve(inputs.row_count(), || {
        let (points, triangles) = inputs.copy_mesh::<3>()?;
        check_points(&points)?;
        check_indices(points.len(), &triangles)?;
        let (vertices, triangles) =
            py.detach(|| crate::mesh::spatial_order::compute_spatial_order(&points, &triangles));
        Ok((PyArray1::from_vec(py, vertices).unbind(), PyArray1::from_vec(py, triangles).unbind()))
    })
}
