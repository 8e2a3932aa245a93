//! The thin layer that Python sees as `stages._kernels`.
//!
//! Arrays are checked and copied while the GIL is held; the work runs without it and takes it back about
//! ten times a second, to see Ctrl-C and to call the progress function.

use std::panic::{AssertUnwindSafe, catch_unwind};

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, ToPyArray};
use pyo3::create_exception;
use pyo3::exceptions::{PyOverflowError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;

use crate::engine::Stop;
use crate::error::KernelError;
use crate::jia01::{self, Limits, Options, Standing};
use crate::mesh::Mesh;
use crate::progress::Progress;

create_exception!(
    stages._kernels,
    InvalidMeshError,
    PyValueError,
    "The mesh breaks a rule the kernels need; the message names the elements."
);
create_exception!(
    stages._kernels,
    LimitError,
    PyOverflowError,
    "The result would be larger than the stated limit."
);

impl From<KernelError> for PyErr {
    fn from(error: KernelError) -> Self {
        match error {
            KernelError::TooManyTriangles { .. } => LimitError::new_err(error.to_string()),
            _ => InvalidMeshError::new_err(error.to_string()),
        }
    }
}

/// What `simplify` returns.
#[pyclass(frozen, get_all)]
struct Simplified {
    vertices: Py<PyArray2<f64>>,
    attributes: Py<PyArray2<f64>>,
    triangles: Py<PyArray2<i32>>,
    vertex_source: Py<PyArray1<i32>>,
    triangle_source: Py<PyArray1<i32>>,
    stopped_by: &'static str,
    standing_length: usize,
    standing_shape: usize,
    standing_texture: usize,
    standing_topology: usize,
    standing_bridge: usize,
    standing_fold: usize,
    splits: u64,
    split_triangles: usize,
    collapses: u64,
    attempts: u64,
    largest_shape_change: f64,
    largest_texture_change: f64,
}

/// Simplify a mesh with JIA01. Bounds are infinite where there is none.
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, *, bounds, scales, attribute_scale, paper_rule,
                    target_triangles, triangle_limit, progress))]
#[allow(clippy::too_many_arguments)]
fn simplify(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
    bounds: (f64, f64, f64),
    scales: (f64, f64, f64),
    attribute_scale: f64,
    paper_rule: bool,
    target_triangles: usize,
    triangle_limit: usize,
    progress: Py<PyAny>,
) -> PyResult<Simplified> {
    let limits = |(length, shape, texture)| Limits { length, shape, texture };
    let options = Options {
        bounds: limits(bounds),
        scales: limits(scales),
        attribute_scale,
        paper_rule,
        target_triangles,
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
    let inputs = (&vertices, &attributes, &triangles);
    match attributes.as_array().ncols() {
        0 => simplify_points::<3>(py, inputs, &options, &progress),
        1 => simplify_points::<4>(py, inputs, &options, &progress),
        3 => simplify_points::<6>(py, inputs, &options, &progress),
        k => Err(PyValueError::new_err(format!(
            "{k} attributes a vertex; 0, 1 (intensity) or 3 (RGB) are known"
        ))),
    }
}

type Inputs<'a, 'py> =
    (&'a PyReadonlyArray2<'py, f64>, &'a PyReadonlyArray2<'py, f64>, &'a PyReadonlyArray2<'py, i32>);

fn simplify_points<const D: usize>(
    py: Python<'_>,
    (vertices, attributes, triangles): Inputs<'_, '_>,
    options: &Options,
    progress: &Py<PyAny>,
) -> PyResult<Simplified> {
    let points = points_from::<D>(vertices, attributes)?;
    let triangles = triangles_from(triangles, points.len())?;
    let result = detached(py, progress, |progress| {
        let mesh = Mesh::new(points, &triangles)?;
        drop(triangles);
        jia01::simplify(mesh, options, progress)
    })?;
    let Standing { length, shape, texture, topology, bridge, fold } = result.standing;
    let mesh = &result.mesh;
    Ok(Simplified {
        vertices: array(py, mesh.points.iter().flat_map(|p| &p[..3]).copied(), [mesh.points.len(), 3])?,
        attributes: array(py, mesh.points.iter().flat_map(|p| &p[3..]).copied(), [mesh.points.len(), D - 3])?,
        triangles: array(py, mesh.triangles.iter().flatten().map(|&v| v as i32), [mesh.triangles.len(), 3])?,
        vertex_source: sources(py, &mesh.vertex_source),
        triangle_source: sources(py, &mesh.triangle_source),
        stopped_by: match result.stop {
            Stop::Exhausted => "bounds",
            Stop::Target => "triangles",
        },
        standing_length: length,
        standing_shape: shape,
        standing_texture: texture,
        standing_topology: topology,
        standing_bridge: bridge,
        standing_fold: fold,
        splits: result.splits,
        split_triangles: result.split_triangles,
        collapses: result.collapses,
        attempts: result.attempts,
        largest_shape_change: result.largest_shape_change,
        largest_texture_change: result.largest_texture_change,
    })
}

pub fn points_from<const D: usize>(
    vertices: &PyReadonlyArray2<'_, f64>,
    attributes: &PyReadonlyArray2<'_, f64>,
) -> PyResult<Vec<[f64; D]>> {
    let (vertices, attributes) = (vertices.as_array(), attributes.as_array());
    if vertices.ncols() != 3 || attributes.nrows() != vertices.nrows() {
        return Err(PyValueError::new_err(format!(
            "vertices are {:?} and attributes {:?}; n × 3 and n × k are expected",
            vertices.shape(),
            attributes.shape()
        )));
    }
    let point =
        |v: usize| std::array::from_fn(|i| if i < 3 { vertices[[v, i]] } else { attributes[[v, i - 3]] });
    Ok((0..vertices.nrows()).map(point).collect())
}

pub fn triangles_from(triangles: &PyReadonlyArray2<'_, i32>, vertices: usize) -> PyResult<Vec<[u32; 3]>> {
    let triangles = triangles.as_array();
    if triangles.ncols() != 3 {
        return Err(PyValueError::new_err(format!(
            "triangles are {:?}; m × 3 is expected",
            triangles.shape()
        )));
    }
    let corners = |(triangle, row): (usize, numpy::ndarray::ArrayView1<'_, i32>)| {
        if let Some(&vertex) = row.iter().find(|&&v| v < 0) {
            return Err(KernelError::IndexOutOfRange { triangle, vertex: vertex.into(), vertices }.into());
        }
        Ok([row[0] as u32, row[1] as u32, row[2] as u32])
    };
    triangles.outer_iter().enumerate().map(corners).collect()
}

/// Run `work` without the GIL. Its progress reaches the Python function `progress(done, total)`; an exception
/// there, or Ctrl-C, stops the work and comes back from here. A panic becomes a RuntimeError.
pub fn detached<R: Send>(
    py: Python<'_>,
    progress: &Py<PyAny>,
    work: impl FnOnce(&mut Progress) -> Result<R, KernelError> + Send,
) -> PyResult<R> {
    let mut raised: Option<PyErr> = None;
    let outcome = py.detach(|| {
        let mut go_on = |done: u64, total: u64| {
            let called = Python::attach(|py| {
                py.check_signals()?;
                progress.call1(py, (done, total)).map(drop)
            });
            raised = called.err();
            raised.is_none()
        };
        let mut progress = Progress::new(&mut go_on);
        catch_unwind(AssertUnwindSafe(|| work(&mut progress)))
    });
    if let Some(error) = raised {
        return Err(error);
    }
    match outcome {
        Ok(result) => result.map_err(PyErr::from),
        Err(_) => {
            Err(PyRuntimeError::new_err("the mesh kernels failed; please report the mesh that shows it"))
        }
    }
}

fn array<T: numpy::Element>(
    py: Python<'_>,
    values: impl Iterator<Item = T>,
    shape: [usize; 2],
) -> PyResult<Py<PyArray2<T>>> {
    let values: Vec<T> = values.collect();
    Ok(PyArray1::from_vec(py, values).reshape(shape)?.unbind())
}

fn sources(py: Python<'_>, sources: &[u32]) -> Py<PyArray1<i32>> {
    let sources: Vec<i32> = sources.iter().map(|&s| s as i32).collect();
    sources.to_pyarray(py).unbind()
}

#[pymodule(gil_used = false)]
fn _kernels(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Simplified>()?;
    module.add_class::<crate::python_certify::Certified>()?;
    module.add_function(wrap_pyfunction!(crate::python_certify::certify, module)?)?;
    module.add("InvalidMeshError", module.py().get_type::<InvalidMeshError>())?;
    module.add("LimitError", module.py().get_type::<LimitError>())?;
    module.add_function(wrap_pyfunction!(simplify, module)?)
}
