//! `scanloom.stages._kernels.choose_color_weight`.

use numpy::PyReadonlyArray2;
use pyo3::prelude::*;

use super::arrays::{Attributes, MeshInputs, unsupported_attributes};
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use crate::base::parallel::resolve_thread_count;
use crate::mesh::connectivity_builder::check_indices;
use crate::mesh::triangle_mesh::check_points;
use crate::quadric::color_weight::estimate_color_weight;
use crate::quadric::weight_trial::find_max_color_weight;

/// Compute the length in metres that is equivalent to one attribute level in a result of `target` triangles.
/// The weight is balanced; with `run_trial`, it is reduced by a trial simplification to what the triangle
/// count affords.
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, *, target, run_trial, wanted_threads))]
pub fn choose_color_weight(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: Attributes<'_>,
    triangles: PyReadonlyArray2<'_, i32>,
    target: usize,
    run_trial: bool,
    wanted_threads: usize,
) -> PyResult<f64> {
    let inputs = MeshInputs { vertices, attributes, triangles };
    with_memory_reserve(inputs.row_count(), || match inputs.attribute_count() {
        0 => Ok(0.0),
        3 => weight_of_points::<6, 3>(py, &inputs, target, run_trial, wanted_threads),
        k => Err(unsupported_attributes(k)),
    })
}

fn weight_of_points<const D: usize, const K: usize>(
    py: Python<'_>,
    inputs: &MeshInputs<'_>,
    target: usize,
    run_trial: bool,
    wanted_threads: usize,
) -> PyResult<f64> {
    let (points, triangles) = inputs.copy_mesh::<D>()?;
    let threads = resolve_thread_count(wanted_threads);
    run_detached(py, None, false, |progress| {
        check_points(&points)?;
        check_indices(points.len(), &triangles)?;
        let weight = estimate_color_weight(&points, &triangles, target, threads);
        if run_trial {
            find_max_color_weight::<D, K>(&points, &triangles, target, weight, threads, progress)
        } else {
            Ok(weight)
        }
    })
}
