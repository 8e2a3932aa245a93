//! `scanloom.stages._kernels.fit`.

use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{Attributes, Inputs, columns, unknown_attributes};
use super::detached::detached;
use super::guarded::guarded;
use crate::base::ids::VertexId;
use crate::base::parallel::threads;
use crate::collapse::whole::Whole;
use crate::fitting::fit::Input;
use crate::mesh::connect::check_indices;
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
    let result = Inputs { vertices, attributes, triangles };
    let original = Inputs {
        vertices: original_vertices,
        attributes: original_attributes,
        triangles: original_triangles,
    };
    guarded(result.rows() + original.rows(), || {
        let locked = result.by_vertex("locked", &locked)?;
        match result.attribute_count() {
            0 => fit_points::<3>(py, &result, locked, &original, &became, threads, &progress),
            1 => fit_points::<4>(py, &result, locked, &original, &became, threads, &progress),
            3 => fit_points::<6>(py, &result, locked, &original, &became, threads, &progress),
            k => Err(unknown_attributes(k)),
        }
    })
}

fn fit_points<const D: usize>(
    py: Python<'_>,
    result: &Inputs<'_>,
    locked: Vec<bool>,
    original: &Inputs<'_>,
    became: &PyReadonlyArray1<'_, i32>,
    wanted_threads: usize,
    progress: &Py<PyAny>,
) -> PyResult<Points> {
    let (points, triangles) = result.copied::<D>()?;
    let (original_points, original_triangles) = original.copied::<D>()?;
    let vertices = points.len();
    let became: Vec<VertexId> = became
        .as_array()
        .iter()
        .map(|&v| if (0..vertices as i64).contains(&v.into()) { VertexId(v as u32) } else { VertexId::NONE })
        .collect();
    if became.len() != original_points.len() {
        return Err(PyValueError::new_err("became must have one value for each original vertex"));
    }
    let points = detached(py, Some(progress), false, |progress| {
        let whole = Whole::<D, ()>::new(points, triangles, locked)?;
        check_points(&original_points)?;
        check_indices(original_points.len(), &original_triangles)?;
        let mut mesh = whole.connected()?;
        let input = Input { points: &original_points, triangles: &original_triangles, became: &became };
        crate::fitting::fit::fit(&mut mesh, &input, threads(wanted_threads), progress)?;
        Ok(mesh.points)
    })?;
    Ok((columns(py, &points, 0..3)?, columns(py, &points, 3..D)?))
}
