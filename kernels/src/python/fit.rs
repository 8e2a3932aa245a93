//! `scanloom.stages._kernels.fit`.

use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{Attributes, MeshInputs, column_array, unsupported_attributes};
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use crate::base::ids::VertexId;
use crate::base::parallel::resolve_thread_count;
use crate::collapse::whole_mesh::WholeMesh;
use crate::fitting::least_squares::FitInput;
use crate::mesh::connectivity_builder::check_indices;
use crate::mesh::triangle_mesh::check_points;

/// Vertices and attributes.
type Points = (Py<PyArray2<f64>>, Py<PyArray2<f64>>);

/// Fit a simplified mesh to its input by least squares. `became` is the result vertex that each input vertex
/// was merged into, −1 for none. Returns the vertices and attributes of the result.
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, locked, original_vertices, original_attributes,
                    original_triangles, became, *, threads, progress))]
#[allow(clippy::too_many_arguments)]
pub fn fit(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: Attributes<'_>,
    triangles: PyReadonlyArray2<'_, i32>,
    locked: PyReadonlyArray1<'_, bool>,
    original_vertices: PyReadonlyArray2<'_, f64>,
    original_attributes: Attributes<'_>,
    original_triangles: PyReadonlyArray2<'_, i32>,
    became: PyReadonlyArray1<'_, i32>,
    threads: usize,
    progress: Py<PyAny>,
) -> PyResult<Points> {
    let result = MeshInputs { vertices, attributes, triangles };
    let original = MeshInputs {
        vertices: original_vertices,
        attributes: original_attributes,
        triangles: original_triangles,
    };
    with_memory_reserve(result.row_count() + original.row_count(), || {
        let locked = result.per_vertex("locked", &locked)?;
        match result.attribute_count() {
            0 => fit_points::<3>(py, &result, locked, &original, &became, threads, &progress),
            3 => fit_points::<6>(py, &result, locked, &original, &became, threads, &progress),
            k => Err(unsupported_attributes(k)),
        }
    })
}

fn fit_points<const D: usize>(
    py: Python<'_>,
    result: &MeshInputs<'_>,
    locked: Vec<bool>,
    original: &MeshInputs<'_>,
    became: &PyReadonlyArray1<'_, i32>,
    wanted_threads: usize,
    progress: &Py<PyAny>,
) -> PyResult<Points> {
    let (points, triangles) = result.copy_mesh::<D>()?;
    let (original_points, original_triangles) = original.copy_mesh::<D>()?;
    let vertices = points.len();
    let became: Vec<VertexId> = became
        .as_array()
        .iter()
        .map(|&v| if (0..vertices as i64).contains(&v.into()) { VertexId(v as u32) } else { VertexId::NONE })
        .collect();
    if became.len() != original_points.len() {
        return Err(PyValueError::new_err("became must have one value for each original vertex"));
    }
    let points = run_detached(py, Some(progress), false, |progress| {
        let whole = WholeMesh::<D, ()>::new(points, triangles, locked)?;
        check_points(&original_points)?;
        check_indices(original_points.len(), &original_triangles)?;
        let mut mesh = whole.into_connected()?;
        let input =
            FitInput { points: &original_points, triangles: &original_triangles, vertex_map: &became };
        crate::fitting::least_squares::fit(
            &mut mesh,
            &input,
            resolve_thread_count(wanted_threads),
            progress,
        )?;
        Ok(mesh.points)
    })?;
    Ok((column_array(py, &points, 0..3)?, column_array(py, &points, 3..D)?))
}
