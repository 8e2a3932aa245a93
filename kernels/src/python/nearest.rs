//! `scanloom.stages._kernels.NearestSurface`.

use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{rows, triangles_from};
use super::atlas::shape;
use super::guarded::guarded;
use crate::base::geometry::Vec3;
use crate::base::parallel::threads;
use crate::texture::nearest::{Located, Surface};

/// Triangles, barycentric weights, and distances or flags of replaced points.
type Found<T> = (Py<PyArray1<i32>>, Py<PyArray2<f64>>, Py<PyArray1<T>>);

/// Surface with a search tree for nearest-point queries.
#[pyclass(frozen, module = "scanloom.stages._kernels")]
pub struct NearestSurface(Surface);

#[pymethods]
impl NearestSurface {
    #[new]
    #[pyo3(signature = (vertices, triangles, *, wanted_threads))]
    fn new(
        py: Python<'_>,
        vertices: PyReadonlyArray2<'_, f64>,
        triangles: PyReadonlyArray2<'_, i32>,
        wanted_threads: usize,
    ) -> PyResult<Self> {
        guarded(vertices.as_array().nrows() + triangles.as_array().nrows(), || {
            let points = positions(&vertices)?;
            let triangles = triangles_from(&triangles, points.len())?;
            crate::mesh::connect::check_indices(points.len(), &triangles)?;
            if triangles.is_empty() {
                return Err(PyValueError::new_err("a surface needs a triangle"));
            }
            Ok(Self(py.detach(|| Surface::new(&points, &triangles, threads(wanted_threads)))))
        })
    }

    /// Find the nearest points to points (n, 3): triangles (n,), barycentric weights (n, 3) and distances
    /// (n,).
    #[pyo3(signature = (points, *, wanted_threads))]
    fn closest(
        &self,
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f64>,
        wanted_threads: usize,
    ) -> PyResult<Found<f64>> {
        guarded(points.as_array().nrows(), || {
            let points = positions(&points)?;
            let found = py.detach(|| self.0.closest(&points, threads(wanted_threads)));
            arrays(py, &found, |one| one.distance)
        })
    }

    /// Find the nearest points to points with unit normals (n, 3) of another surface. A nearest point whose
    /// triangle faces away is replaced by one along the normal, within `reach`, that does not. Returns flags
    /// of replaced points instead of distances.
    #[pyo3(signature = (points, normals, *, reach, wanted_threads))]
    fn facing(
        &self,
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f64>,
        normals: PyReadonlyArray2<'_, f64>,
        reach: f64,
        wanted_threads: usize,
    ) -> PyResult<Found<bool>> {
        guarded(points.as_array().nrows(), || {
            let (points, normals) = (positions(&points)?, positions(&normals)?);
            if points.len() != normals.len() {
                return Err(PyValueError::new_err("normals must have one row for each point"));
            }
            let found = py.detach(|| self.0.facing(&points, &normals, reach, threads(wanted_threads)));
            arrays(py, &found, |one| one.is_turned)
        })
    }
}

fn positions(array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<Vec3>> {
    let found = rows::<f64, 3>(array)?;
    if !found.iter().flatten().all(|x| x.is_finite()) {
        return Err(PyValueError::new_err("an array has values that are not finite"));
    }
    Ok(found)
}

fn arrays<T: numpy::Element>(
    py: Python<'_>,
    found: &[Located],
    value: impl Fn(&Located) -> T,
) -> PyResult<Found<T>> {
    let weights: Vec<f64> = found.iter().flat_map(|one| one.weights).collect();
    Ok((
        PyArray1::from_iter(py, found.iter().map(|one| one.triangle as i32)).unbind(),
        Array2::from_shape_vec((found.len(), 3), weights).map_err(shape)?.into_pyarray(py).unbind(),
        PyArray1::from_iter(py, found.iter().map(value)).unbind(),
    ))
}
