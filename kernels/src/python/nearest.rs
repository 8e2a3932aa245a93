//! `scanloom.stages._kernels.NearestSurface`.

use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{copy_triangles, rows};
use super::atlas::shape_error;
use super::memory_guard::with_memory_reserve;
use crate::base::geometry::Vec3;
use crate::base::parallel::resolve_thread_count;
use crate::texture::nearest_points::{SearchableSurface, SurfacePoint};

/// Triangles, barycentric weights, and distances or flags of replaced points.
type NearestArrays<T> = (Py<PyArray1<i32>>, Py<PyArray2<f64>>, Py<PyArray1<T>>);

/// Surface with a search tree for nearest-point queries.
#[pyclass(frozen, module = "scanloom.stages._kernels")]
pub struct NearestSurface(SearchableSurface);

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
        with_memory_reserve(vertices.as_array().nrows() + triangles.as_array().nrows(), || {
            let points = copy_positions(&vertices)?;
            let triangles = copy_triangles(&triangles, points.len())?;
            crate::mesh::connectivity_builder::check_indices(points.len(), &triangles)?;
            if triangles.is_empty() {
                return Err(PyValueError::new_err("a surface needs a triangle"));
            }
            Ok(Self(py.detach(|| {
                SearchableSurface::new(&points, &triangles, resolve_thread_count(wanted_threads))
            })))
        })
    }

    /// Find the nearest points to points (n, 3): triangles (n,), barycentric weights (n, 3) and distances
    /// (n,).
    #[pyo3(signature = (points, *, wanted_threads))]
    fn find_nearest(
        &self,
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f64>,
        wanted_threads: usize,
    ) -> PyResult<NearestArrays<f64>> {
        with_memory_reserve(points.as_array().nrows(), || {
            let points = copy_positions(&points)?;
            let found =
                py.detach(|| self.0.find_nearest_points(&points, resolve_thread_count(wanted_threads)));
            to_arrays(py, &found, |one| one.distance)
        })
    }

    /// Find the nearest points to points with unit normals (n, 3) of another surface. A nearest point whose
    /// triangle faces away is replaced by one along the normal, within `reach`, that does not. Returns flags
    /// of replaced points instead of distances.
    #[pyo3(signature = (points, normals, *, reach, wanted_threads))]
    fn find_nearest_facing(
        &self,
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f64>,
        normals: PyReadonlyArray2<'_, f64>,
        reach: f64,
        wanted_threads: usize,
    ) -> PyResult<NearestArrays<bool>> {
        with_memory_reserve(points.as_array().nrows(), || {
            let (points, normals) = (copy_positions(&points)?, copy_positions(&normals)?);
            if points.len() != normals.len() {
                return Err(PyValueError::new_err("normals must have one row for each point"));
            }
            let found = py.detach(|| {
                self.0.find_facing_points(&points, &normals, reach, resolve_thread_count(wanted_threads))
            });
            to_arrays(py, &found, |one| one.replaced)
        })
    }
}

fn copy_positions(array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<Vec3>> {
    let found = rows::<f64, 3>(array)?;
    if !found.iter().flatten().all(|x| x.is_finite()) {
        return Err(PyValueError::new_err("an array has values that are not finite"));
    }
    Ok(found)
}

fn to_arrays<T: numpy::Element>(
    py: Python<'_>,
    found: &[SurfacePoint],
    value: impl Fn(&SurfacePoint) -> T,
) -> PyResult<NearestArrays<T>> {
    let weights: Vec<f64> = found.iter().flat_map(|one| one.weights).collect();
    Ok((
        PyArray1::from_iter(py, found.iter().map(|one| one.triangle as i32)).unbind(),
        Array2::from_shape_vec((found.len(), 3), weights).map_err(shape_error)?.into_pyarray(py).unbind(),
        PyArray1::from_iter(py, found.iter().map(value)).unbind(),
    ))
}
