//! `scanloom.stages._kernels.simplify`, and `compute_side_lengths` for its default resolution.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{Attributes, MeshInputs, column_array, id_array, triangle_array};
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use super::simplification_result::{RunSettings, SimplificationResult};
use crate::base::errors::KernelError;
use crate::base::geometry::distance2;
use crate::base::parallel::{fill, resolve_thread_count};
use crate::collapse::whole_mesh::WholeMesh;
use crate::jia01::{self, JiaRefusals, Limits, Options};
use crate::mesh::triangle_mesh::CompactMesh;

/// Mesh simplified with JIA01, with the largest accumulated changes.
#[pyclass(frozen, get_all, extends = SimplificationResult)]
pub struct Jia01Result {
    splits: u64,
    largest_shape_change: f64,
    largest_texture_change: f64,
    /// Input of the collapses after edge splitting, if collapses were recorded and edges were split.
    split: Option<SplitMesh>,
}

/// Vertices, attributes and triangles of a mesh, and the input vertex and input triangle of each.
type SplitMesh =
    (Py<PyArray2<f64>>, Py<PyArray2<f64>>, Py<PyArray2<i32>>, Py<PyArray1<i32>>, Py<PyArray1<i32>>);

/// Simplify a mesh with JIA01. Infinity disables a bound.
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, locked, *, bounds, scales, soft_length,
                    attribute_scale, paper_rule, triangle_limit, running, progress))]
#[allow(clippy::too_many_arguments)]
pub fn simplify(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: Attributes<'_>,
    triangles: PyReadonlyArray2<'_, i32>,
    locked: PyReadonlyArray1<'_, bool>,
    bounds: (f64, f64, f64),
    scales: (f64, f64, f64),
    soft_length: bool,
    attribute_scale: f64,
    paper_rule: bool,
    triangle_limit: usize,
    running: PyRef<'_, RunSettings>,
    progress: Py<PyAny>,
) -> PyResult<Py<Jia01Result>> {
    let limits = |(length, shape, texture)| Limits { length, shape, texture };
    let options = Options {
        bounds: limits(bounds),
        scales: limits(scales),
        soft_length,
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
            "bounds and attribute_scale must not be negative, and the length bound must be above 0",
        ));
    }
    let inputs = MeshInputs { vertices, attributes, triangles };
    with_memory_reserve(inputs.row_count(), || {
        let locked = inputs.per_vertex("locked", &locked)?;
        match inputs.attribute_count() {
            0 => simplify_points::<3>(py, &inputs, locked, &options, &running, &progress),
            1 => simplify_points::<4>(py, &inputs, locked, &options, &running, &progress),
            3 => simplify_points::<6>(py, &inputs, locked, &options, &running, &progress),
            k => Err(PyValueError::new_err(format!(
                "{k} attributes per vertex; 0, 1 (intensity) or 3 (RGB) are supported"
            ))),
        }
    })
}

fn simplify_points<const D: usize>(
    py: Python<'_>,
    inputs: &MeshInputs<'_>,
    locked: Vec<bool>,
    options: &Options,
    running: &RunSettings,
    progress: &Py<PyAny>,
) -> PyResult<Py<Jia01Result>> {
    let (points, triangles) = inputs.copy_mesh::<D>()?;
    let result = run_detached(py, Some(progress), running.partial, |progress| {
        jia01::simplify(WholeMesh::new(points, triangles, locked)?, options, &running.goal(), progress)
    })?;
    let JiaRefusals { length, shape, texture, topology, bridge, locked, fold } = result.refused;
    let refused = [
        ("length", length),
        ("shape", shape),
        ("texture", texture),
        ("topology", topology),
        ("bridge", bridge),
        ("locked", locked),
        ("fold", fold),
    ];
    let simplified = SimplificationResult::new(
        py,
        &result.mesh,
        result.stop,
        refused,
        result.collapses,
        result.attempts,
        &result.collapse_sequence,
    )?;
    let split = |mesh: CompactMesh<D>| -> PyResult<SplitMesh> {
        Ok((
            column_array(py, &mesh.points, 0..3)?,
            column_array(py, &mesh.points, 3..D)?,
            triangle_array(py, &mesh.triangles)?,
            id_array(py, mesh.vertex_source.into_iter()),
            id_array(py, mesh.triangle_source.into_iter()),
        ))
    };
    let sums = Jia01Result {
        splits: result.splits,
        largest_shape_change: result.largest_shape_change,
        largest_texture_change: result.largest_texture_change,
        split: result.split_mesh.map(split).transpose()?,
    };
    Py::new(py, PyClassInitializer::from(simplified).add_subclass(sums))
}

/// Compute the side lengths (m, 3) of triangles: entry k is the side from corner k − 1 to corner k. The
/// arrays are read in place, so the GIL is held for the few milliseconds this takes.
#[pyfunction]
#[pyo3(signature = (vertices, triangles, *, wanted_threads))]
pub fn compute_side_lengths(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
    wanted_threads: usize,
) -> PyResult<Py<PyArray2<f64>>> {
    let (vertices, triangles) = (vertices.as_array(), triangles.as_array());
    if vertices.ncols() != 3 || triangles.ncols() != 3 {
        return Err(PyValueError::new_err("vertices must be n × 3 and triangles m × 3"));
    }
    with_memory_reserve(vertices.nrows() + triangles.nrows(), || {
        let (count, vertices) = (vertices.nrows(), vertices.as_standard_layout());
        let (points, corners) = (vertices.as_slice().unwrap_or_default(), triangles.as_standard_layout());
        let corners = corners.as_slice().unwrap_or_default();
        if let Some(place) = corners.iter().position(|&v| v as u32 as usize >= count) {
            let (triangle, vertex) = (place / 3, corners[place].into());
            return Err(KernelError::IndexOutOfRange { triangle, vertex, vertices: count }.into());
        }
        let point = |corner: usize| -> [f64; 3] {
            let first = 3 * corners[corner] as usize;
            [points[first], points[first + 1], points[first + 2]]
        };
        let mut lengths = vec![[0.0; 3]; triangles.nrows()];
        fill(&mut lengths, resolve_thread_count(wanted_threads), |t| {
            let [a, b, c] = [0, 1, 2].map(|k| point(3 * t + k));
            [distance2(&a, &c), distance2(&b, &a), distance2(&c, &b)].map(f64::sqrt)
        });
        Ok(PyArray1::from_vec(py, lengths.into_flattened()).reshape([triangles.nrows(), 3])?.unbind())
    })
}
