//! `scanloom.stages._kernels.lay_out_atlas` and `rasterize_texels`.

use numpy::ndarray::{Array2, Array3};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{copy_triangles, rows};
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use crate::atlas::packing::pack_charts;
use crate::atlas::segmentation::segment_surface;
use crate::atlas::texels as under;
use crate::atlas::triangle_adjacency::NO_TRIANGLE;

/// Pixel indices of texels, their triangles, and barycentric weights.
type TexelArrays = (Py<PyArray1<u32>>, Py<PyArray1<u32>>, Py<PyArray2<f32>>);

/// Surface flattened into atlas images.
#[pyclass(frozen, get_all, module = "scanloom.stages._kernels")]
pub struct AtlasLayout {
    charts: Py<PyArray1<i32>>,
    pages: Py<PyArray1<i32>>,
    corners: Py<PyArray3<f64>>,
    heights: Vec<usize>,
}

/// Lay a surface out in images of `side` × `side` texels; `density` is the number of texels per metre of each
/// triangle.
#[pyfunction]
#[pyo3(signature = (vertices, triangles, density, *, side, padding, progress))]
pub fn lay_out_atlas(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
    density: PyReadonlyArray1<'_, f32>,
    side: usize,
    padding: usize,
    progress: Py<PyAny>,
) -> PyResult<AtlasLayout> {
    if side <= 2 * padding + 1 {
        return Err(PyValueError::new_err(
            "side is too small for the padding; it must be above 2 × padding + 1 texels",
        ));
    }
    let count = vertices.as_array().nrows() + triangles.as_array().nrows();
    with_memory_reserve(count + side * side / 64, || {
        let points = rows::<f64, 3>(&vertices)?;
        let triangles = copy_triangles(&triangles, points.len())?;
        let density = density.as_array().to_vec();
        if density.len() != triangles.len() {
            return Err(PyValueError::new_err("density must have one value for each triangle"));
        }
        let (charts, packed) = run_detached(py, Some(&progress), false, |progress| {
            crate::mesh::connectivity_builder::check_indices(points.len(), &triangles)?;
            let charts = segment_surface(&points, &triangles, &density, side, padding, progress)?;
            let packed = pack_charts(&charts, side, padding, progress)?;
            Ok((charts, packed))
        })?;
        let numbers = |values: Vec<i32>| PyArray1::from_vec(py, values).unbind();
        let corners = packed.corners.into_flattened().into_flattened();
        let corners = Array3::from_shape_vec((triangles.len(), 3, 2), corners).map_err(shape_error)?;
        Ok(AtlasLayout {
            charts: numbers(
                charts
                    .chart_of_triangle
                    .iter()
                    .map(|&c| if c == NO_TRIANGLE { -1 } else { c as i32 })
                    .collect(),
            ),
            pages: numbers(
                packed.page_of_triangle.iter().map(|&p| if p == u16::MAX { -1 } else { p.into() }).collect(),
            ),
            corners: corners.into_pyarray(py).unbind(),
            heights: packed.heights,
        })
    })
}

/// Find the texels of the triangles of one image, and the texels next to their charts.
#[pyfunction]
#[pyo3(signature = (corners, pages, *, page, width, height))]
pub fn rasterize_texels(
    py: Python<'_>,
    corners: PyReadonlyArray3<'_, f64>,
    pages: PyReadonlyArray1<'_, i32>,
    page: i32,
    width: usize,
    height: usize,
) -> PyResult<TexelArrays> {
    with_memory_reserve(width * height, || {
        let corners = copy_corners(&corners)?;
        let pages = pages.as_array().to_vec();
        if pages.len() != corners.len() {
            return Err(PyValueError::new_err("pages must have one value for each triangle"));
        }
        let found = py.detach(|| under::rasterize_texels(&corners, |t| pages[t] == page, width, height));
        let count = found.pixels.len();
        let shares =
            Array2::from_shape_vec((count, 3), found.weights.into_flattened()).map_err(shape_error)?;
        Ok((
            PyArray1::from_vec(py, found.pixels).unbind(),
            PyArray1::from_vec(py, found.triangles).unbind(),
            shares.into_pyarray(py).unbind(),
        ))
    })
}

/// Copy 2-D triangle corners, m × 3 × 2.
pub fn copy_corners(corners: &PyReadonlyArray3<'_, f64>) -> PyResult<Vec<[[f64; 2]; 3]>> {
    let corners = corners.as_array();
    if corners.shape()[1..] != [3, 2] {
        return Err(PyValueError::new_err(format!(
            "corners have shape {:?}; m × 3 × 2 is expected",
            corners.shape()
        )));
    }
    let value = |t: usize, c: usize, k: usize| corners[[t, c, k]];
    Ok((0..corners.shape()[0]).map(|t| [0, 1, 2].map(|c| [0, 1].map(|k| value(t, c, k)))).collect())
}

/// Convert a shape error to ValueError.
pub fn shape_error(error: numpy::ndarray::ShapeError) -> PyErr {
    PyValueError::new_err(error.to_string())
}
