//! `scanloom.stages._kernels.color_weight`.

use numpy::PyReadonlyArray2;
use pyo3::prelude::*;

use super::arrays::{Attributes, Inputs, unknown_attributes};
use super::detached::detached;
use super::guarded::guarded;
use crate::base::parallel::threads;
use crate::mesh::connect::check_indices;
use crate::mesh::triangle_mesh::check_points;
use crate::quadric::balance::balanced;
use crate::quadric::trial::affordable;

/// Compute the length in metres that is equivalent to one attribute level in a result of `target` triangles.
/// The weight is balanced; with `tried`, it is reduced by a trial simplification to what the triangle count
/// affords.
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, *, target, tried, wanted_threads))]
pub fn color_weight(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: Attributes<'_>,
    triangles: PyReadonlyArray2<'_, i32>,
    target: usize,
    tried: bool,
    wanted_threads: usize,
) -> PyResult<f64> {
    let inputs = Inputs { vertices, attributes, triangles };
    guarded(inputs.rows(), || match inputs.attribute_count() {
        0 => Ok(0.0),
        1 => weight_of_points::<4, 1>(py, &inputs, target, tried, wanted_threads),
        3 => weight_of_points::<6, 3>(py, &inputs, target, tried, wanted_threads),
        k => Err(unknown_attributes(k)),
    })
}

fn weight_of_points<const D: usize, const K: usize>(
    py: Python<'_>,
    inputs: &Inputs<'_>,
    target: usize,
    tried: bool,
    wanted_threads: usize,
) -> PyResult<f64> {
    let (points, triangles) = inputs.copied::<D>()?;
    let threads = threads(wanted_threads);
    detached(py, None, false, |progress| {
        check_points(&points)?;
        check_indices(points.len(), &triangles)?;
        let weight = balanced(&points, &triangles, target, threads);
        if tried {
            affordable::<D, K>(&points, &triangles, target, weight, threads, progress)
        } else {
            Ok(weight)
        }
    })
}
