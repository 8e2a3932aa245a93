//! `scanloom.stages._kernels.certify`.

use numpy::{PyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{Attributes, copy_points, copy_triangles};
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use crate::certify::{Certificate, Deviation, Options, Surface};

/// Result of `certify`.
#[pyclass(frozen, get_all)]
pub struct CertifyResult {
    shape_bound: Py<PyArray1<f64>>,
    color_bound: Py<PyArray1<f64>>,
    original_shape_bound: Py<PyArray1<f64>>,
    original_color_bound: Py<PyArray1<f64>>,
    bound: (f64, f64),
    attained: (f64, f64),
    slack: f64,
    color_slack: f64,
    pieces: u64,
}

type TriangleSoup<'py> = (PyReadonlyArray2<'py, f64>, Attributes<'py>, PyReadonlyArray2<'py, i32>);

/// Bound the distance between two meshes (vertices, attributes, triangles).
#[pyfunction]
#[pyo3(signature = (result, original, *, tolerance, absolute_tolerance, limit, effort, slack, threads, progress))]
#[allow(clippy::too_many_arguments)]
pub fn certify(
    py: Python<'_>,
    result: TriangleSoup<'_>,
    original: TriangleSoup<'_>,
    tolerance: (f64, f64),
    absolute_tolerance: (f64, f64),
    limit: Option<(f64, f64)>,
    effort: f64,
    slack: Option<f64>,
    threads: usize,
    progress: Py<PyAny>,
) -> PyResult<CertifyResult> {
    let pair = |(shape, color): (f64, f64)| Deviation { shape, color };
    let all = [tolerance, absolute_tolerance, limit.unwrap_or_default(), (effort, slack.unwrap_or_default())];
    if !all.iter().all(|&(a, b)| a >= 0.0 && b >= 0.0) {
        return Err(PyValueError::new_err("tolerances, limits, effort and slack must not be negative"));
    }
    let options = Options {
        tolerance: pair(tolerance),
        absolute_tolerance: pair(absolute_tolerance),
        limit: limit.map(pair),
        effort,
        slack,
        threads,
    };
    let rows = |soup: &TriangleSoup<'_>| soup.0.as_array().nrows() + soup.2.as_array().nrows();
    with_memory_reserve(rows(&result) + rows(&original), || {
        match (result.1.shape()[1], original.1.shape()[1]) {
            (0, 0) => certify_points::<3>(py, &result, &original, &options, &progress),
            (3, 3) => certify_points::<6>(py, &result, &original, &options, &progress),
            (a, b) => Err(PyValueError::new_err(format!(
                "{a} and {b} attributes per vertex; 0 or 3 (RGB) in both meshes are supported"
            ))),
        }
    })
}

fn certify_points<const D: usize>(
    py: Python<'_>,
    result: &TriangleSoup<'_>,
    original: &TriangleSoup<'_>,
    options: &Options,
    progress: &Py<PyAny>,
) -> PyResult<CertifyResult> {
    let soup = |(vertices, attributes, triangles): &TriangleSoup<'_>| {
        let points = copy_points::<D>(vertices, attributes)?;
        let triangles = copy_triangles(triangles, points.len())?;
        PyResult::Ok((points, triangles))
    };
    let (result, original) = (soup(result)?, soup(original)?);
    let certificate = run_detached(py, Some(progress), false, |progress| {
        let surface = |(points, triangles): (Vec<[f64; D]>, Vec<[u32; 3]>)| {
            Surface::new(&points, &triangles, options.threads)
        };
        crate::certify::certify(&surface(result)?, &surface(original)?, options, progress)
    })?;
    let Certificate { result, from_result: _, original, bound, attained, slack, color_slack, pieces } =
        certificate;
    let array = |bounds: &[Deviation], of: fn(&Deviation) -> f64| {
        PyArray1::from_vec(py, bounds.iter().map(of).collect()).unbind()
    };
    Ok(CertifyResult {
        shape_bound: array(&result, |d| d.shape),
        color_bound: array(&result, |d| d.color),
        original_shape_bound: array(&original, |d| d.shape),
        original_color_bound: array(&original, |d| d.color),
        bound: (bound.shape, bound.color),
        attained: (attained.shape, attained.color),
        slack,
        color_slack,
        pieces,
    })
}
