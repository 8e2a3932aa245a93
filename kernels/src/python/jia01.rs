//! `stages._kernels.simplify`.

use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{Inputs, unknown_attributes};
use super::detached::detached;
use super::simplified::{Running, Simplified};
use crate::jia01::{self, Limits, Options, Standing};
use crate::patch::Whole;

/// A mesh simplified with JIA01, and the sums that came up.
#[pyclass(frozen, get_all, extends = Simplified)]
pub struct BySums {
    splits: u64,
    largest_shape_change: f64,
    largest_texture_change: f64,
}

/// Simplify a mesh with JIA01. Bounds are infinite where there is none.
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, fixed, *, bounds, scales, attribute_scale, paper_rule,
                    triangle_limit, running, progress))]
#[allow(clippy::too_many_arguments)]
pub fn simplify(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
    fixed: PyReadonlyArray1<'_, bool>,
    bounds: (f64, f64, f64),
    scales: (f64, f64, f64),
    attribute_scale: f64,
    paper_rule: bool,
    triangle_limit: usize,
    running: PyRef<'_, Running>,
    progress: Py<PyAny>,
) -> PyResult<Py<BySums>> {
    let limits = |(length, shape, texture)| Limits { length, shape, texture };
    let options = Options {
        bounds: limits(bounds),
        scales: limits(scales),
        attribute_scale,
        paper_rule,
        triangle_limit,
    };
    let positive = |x: &f64| *x > 0.0 && x.is_finite();
    if ![scales.0, scales.1, scales.2].iter().all(positive) {
        return Err(PyValueError::new_err("scales must be positive and finite"));
    }
    if ![bounds.0, bounds.1, bounds.2, attribute_scale].iter().all(|x| *x >= 0.0) || bounds.0 == 0.0 {
        return Err(PyValueError::new_err(
            "bounds and attribute_scale must not be negative, nor the length 0",
        ));
    }
    let inputs = Inputs { vertices, attributes, triangles };
    let fixed = inputs.by_vertex("fixed", &fixed)?;
    match inputs.attribute_count() {
        0 => simplify_points::<3>(py, &inputs, fixed, &options, &running, &progress),
        1 => simplify_points::<4>(py, &inputs, fixed, &options, &running, &progress),
        3 => simplify_points::<6>(py, &inputs, fixed, &options, &running, &progress),
        k => Err(unknown_attributes(k)),
    }
}

fn simplify_points<const D: usize>(
    py: Python<'_>,
    inputs: &Inputs<'_>,
    fixed: Vec<bool>,
    options: &Options,
    running: &Running,
    progress: &Py<PyAny>,
) -> PyResult<Py<BySums>> {
    let (points, triangles) = inputs.copied::<D>()?;
    let result = detached(py, progress, running.partial, |progress| {
        jia01::simplify(Whole::new(points, triangles, fixed)?, options, &running.goal(), progress)
    })?;
    let Standing { length, shape, texture, topology, bridge, pinned, fold } = result.standing;
    let standing = [
        ("length", length),
        ("shape", shape),
        ("texture", texture),
        ("topology", topology),
        ("bridge", bridge),
        ("pinned", pinned),
        ("fold", fold),
    ];
    let simplified =
        Simplified::new(py, &result.mesh, result.stop, standing, result.collapses, result.attempts)?;
    let sums = BySums {
        splits: result.splits,
        largest_shape_change: result.largest_shape_change,
        largest_texture_change: result.largest_texture_change,
    };
    Py::new(py, PyClassInitializer::from(simplified).add_subclass(sums))
}
