//! The thin layer that Python sees as `stages._kernels`.
//!
//! Arrays are checked and copied while the GIL is held; the work runs without it, on another thread, while this
//! one looks for Ctrl-C and calls the progress function about ten times a second.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::create_exception;
use pyo3::exceptions::{PyOverflowError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBool;

use crate::balance;
use crate::connect::check_indices;
use crate::engine::{Merge, Refusal, Stop};
use crate::error::KernelError;
use crate::fit::Input;
use crate::geometry::distance2;
use crate::ids::VertexId;
use crate::jia01::{self, Limits, Options, Standing};
use crate::legality::Illegal;
use crate::mesh::check_points;
use crate::parallel::{fill, threads};
use crate::patch::Whole;
use crate::progress::{Control, Progress};
use crate::qem::QemRecords;
use crate::rounds::{Goal, PATCH, collapse};

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

/// A simplified mesh and how it came about.
#[pyclass(frozen, get_all)]
struct Simplified {
    vertices: Py<PyArray2<f64>>,
    attributes: Py<PyArray2<f64>>,
    triangles: Py<PyArray2<i32>>,
    vertex_source: Py<PyArray1<i32>>,
    triangle_source: Py<PyArray1<i32>>,
    stopped_by: &'static str,
    standing: BTreeMap<&'static str, usize>,
    collapses: u64,
    attempts: u64,
    splits: u64,
    split_triangles: usize,
    largest_shape_change: f64,
    largest_texture_change: f64,
    /// For each vertex of the input the vertex of the result it became part of, −1 for none; empty after splits.
    became: Py<PyArray1<i32>>,
    /// For each collapse, if that was asked for: the vertex that vanished, the one it became part of, and where
    /// that went.
    removed: Py<PyArray1<i32>>,
    survivor: Py<PyArray1<i32>>,
    path: Py<PyArray2<f64>>,
}

/// How every simplifier runs: up to how many triangles, on how many threads (0 for all cores), in patches of how many
/// triangles, whether to record the path of the collapses, and whether Ctrl-C gives out what there is.
#[pyclass(frozen, get_all)]
struct Running {
    target_triangles: usize,
    threads: usize,
    patch_triangles: usize,
    record: bool,
    partial: bool,
}

#[pymethods]
impl Running {
    #[new]
    #[pyo3(signature = (*, target_triangles = 0, threads = 0, patch_triangles = PATCH, record = false, partial = false))]
    fn new(
        target_triangles: usize,
        threads: usize,
        patch_triangles: usize,
        record: bool,
        partial: bool,
    ) -> Self {
        Self { target_triangles, threads, patch_triangles, record, partial }
    }
}

impl Running {
    fn goal(&self) -> Goal {
        Goal {
            triangles: self.target_triangles,
            threads: threads(self.threads),
            patch: self.patch_triangles.max(1),
            record: self.record,
        }
    }
}

/// Simplify a mesh with JIA01. Bounds are infinite where there is none.
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, fixed, *, bounds, scales, attribute_scale, paper_rule,
                    triangle_limit, running, progress))]
#[allow(clippy::too_many_arguments)]
fn simplify(
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
) -> PyResult<Simplified> {
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
    let inputs = Inputs { vertices, attributes, triangles, fixed };
    match inputs.attributes.as_array().ncols() {
        0 => simplify_points::<3>(py, &inputs, &options, &running, &progress),
        1 => simplify_points::<4>(py, &inputs, &options, &running, &progress),
        3 => simplify_points::<6>(py, &inputs, &options, &running, &progress),
        k => Err(unknown_attributes(k)),
    }
}

fn simplify_points<const D: usize>(
    py: Python<'_>,
    inputs: &Inputs<'_>,
    options: &Options,
    running: &Running,
    progress: &Py<PyAny>,
) -> PyResult<Simplified> {
    let (points, triangles, fixed) = inputs.copied::<D>()?;
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
    let mesh = &result.mesh;
    Ok(Simplified {
        vertices: array(py, mesh.points.iter().flat_map(|p| &p[..3]).copied(), [mesh.points.len(), 3])?,
        attributes: array(py, mesh.points.iter().flat_map(|p| &p[3..]).copied(), [mesh.points.len(), D - 3])?,
        triangles: array(py, mesh.triangles.iter().flatten().map(|&v| v as i32), [mesh.triangles.len(), 3])?,
        vertex_source: sources(py, mesh.vertex_source.iter().copied()),
        triangle_source: sources(py, mesh.triangle_source.iter().copied()),
        stopped_by: name(result.stop),
        standing: standing.into(),
        collapses: result.collapses,
        attempts: result.attempts,
        splits: result.splits,
        split_triangles: result.split_triangles,
        largest_shape_change: result.largest_shape_change,
        largest_texture_change: result.largest_texture_change,
        became: sources(py, [].into_iter()),
        removed: sources(py, [].into_iter()),
        survivor: sources(py, [].into_iter()),
        path: array(py, [].into_iter(), [0, D])?,
    })
}

fn name(stop: Stop) -> &'static str {
    match stop {
        Stop::Exhausted => "bounds",
        Stop::Target => "triangles",
        Stop::Enough => "request",
    }
}

fn unknown_attributes(k: usize) -> PyErr {
    PyValueError::new_err(format!("{k} attributes a vertex; 0, 1 (intensity) or 3 (RGB) are known"))
}

/// Simplify a mesh by attribute quadrics to a number of triangles. `weight` is the length that counts as much as one
/// level of an attribute; `importance` multiplies the error around a vertex (empty for 1 everywhere).
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, fixed, importance, *, weight, running, progress))]
#[allow(clippy::too_many_arguments)]
fn simplify_by_quadrics(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
    fixed: PyReadonlyArray1<'_, bool>,
    importance: PyReadonlyArray1<'_, f64>,
    weight: f64,
    running: PyRef<'_, Running>,
    progress: Py<PyAny>,
) -> PyResult<Simplified> {
    if !(weight >= 0.0 && weight.is_finite()) {
        return Err(PyValueError::new_err("the weight must not be negative"));
    }
    let importance = importance.as_array().to_vec();
    if !(importance.is_empty() || importance.len() == vertices.as_array().nrows()) {
        return Err(PyValueError::new_err("importance needs one value a vertex"));
    }
    let inputs = Inputs { vertices, attributes, triangles, fixed };
    match inputs.attributes.as_array().ncols() {
        0 => quadric_points::<3, 0>(py, &inputs, weight, importance, &running, &progress),
        1 => quadric_points::<4, 1>(py, &inputs, weight, importance, &running, &progress),
        3 => quadric_points::<6, 3>(py, &inputs, weight, importance, &running, &progress),
        k => Err(unknown_attributes(k)),
    }
}

fn quadric_points<const D: usize, const K: usize>(
    py: Python<'_>,
    inputs: &Inputs<'_>,
    weight: f64,
    importance: Vec<f64>,
    running: &Running,
    progress: &Py<PyAny>,
) -> PyResult<Simplified> {
    let (points, triangles, fixed) = inputs.copied::<D>()?;
    let vertices = points.len();
    let split_triangles = triangles.len();
    let (mesh, standing, stop, merges, path, attempts) =
        detached(py, progress, running.partial, |progress| {
            let whole = Whole::new(points, triangles, fixed)?;
            let records = QemRecords::<K> { weight, importance };
            let outcome = collapse(whole, records, &running.goal(), progress)?;
            let held = outcome.mesh.held_edges();
            let count = |wanted| held.iter().filter(|r| **r == Refusal::Illegal(wanted)).count();
            let standing = [
                ("topology", count(Illegal::Topology)),
                ("bridge", count(Illegal::Bridge)),
                ("pinned", count(Illegal::Pinned)),
                ("fold", count(Illegal::Fold)),
            ];
            let mesh = outcome.mesh.into_compact();
            Ok((mesh, standing, outcome.stop, outcome.merges, outcome.path, outcome.attempts))
        })?;
    let became = follow(vertices, &mesh.vertex_source, &merges);
    Ok(Simplified {
        vertices: array(py, mesh.points.iter().flat_map(|p| &p[..3]).copied(), [mesh.points.len(), 3])?,
        attributes: array(py, mesh.points.iter().flat_map(|p| &p[3..]).copied(), [mesh.points.len(), D - 3])?,
        triangles: array(py, mesh.triangles.iter().flatten().map(|&v| v as i32), [mesh.triangles.len(), 3])?,
        vertex_source: sources(py, mesh.vertex_source.iter().copied()),
        triangle_source: sources(py, mesh.triangle_source.iter().copied()),
        stopped_by: name(stop),
        standing: standing.into(),
        collapses: merges.len() as u64,
        attempts,
        splits: 0,
        split_triangles,
        largest_shape_change: 0.0,
        largest_texture_change: 0.0,
        became: PyArray1::from_vec(py, became).unbind(),
        removed: sources(py, merges.iter().take(path.len()).map(|m| m.removed.0)),
        survivor: sources(py, merges.iter().take(path.len()).map(|m| m.survivor.0)),
        path: array(py, path.iter().flatten().copied(), [path.len(), D])?,
    })
}

/// Errors of shape and of the attributes that a result of `target` triangles has to be expected to make; None where
/// the mesh is too small to tell or has no attributes.
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, *, target, wanted_threads))]
fn residuals(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
    target: usize,
    wanted_threads: usize,
) -> PyResult<Option<(f64, f64)>> {
    let fixed = PyArray1::from_vec(py, vec![]).readonly();
    let inputs = Inputs { vertices, attributes, triangles, fixed };
    match inputs.attributes.as_array().ncols() {
        0 => Ok(None),
        1 => residuals_of_points::<4>(py, &inputs, target, wanted_threads),
        3 => residuals_of_points::<6>(py, &inputs, target, wanted_threads),
        k => Err(unknown_attributes(k)),
    }
}

fn residuals_of_points<const D: usize>(
    py: Python<'_>,
    inputs: &Inputs<'_>,
    target: usize,
    wanted_threads: usize,
) -> PyResult<Option<(f64, f64)>> {
    let (points, triangles, _) = inputs.copied::<D>()?;
    check_points(&points)?;
    check_indices(points.len(), &triangles)?;
    Ok(py.detach(|| balance::residuals(&points, &triangles, target, threads(wanted_threads))))
}

/// Lengths (m, 3) of the sides of triangles: entry k is the side from corner k − 1 to corner k. The arrays are read where
/// they are, and so the GIL stays held for the few milliseconds this takes.
#[pyfunction]
#[pyo3(signature = (vertices, triangles, *, wanted_threads))]
fn side_lengths(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
    wanted_threads: usize,
) -> PyResult<Py<PyArray2<f64>>> {
    let (vertices, triangles) = (vertices.as_array(), triangles.as_array());
    if vertices.ncols() != 3 || triangles.ncols() != 3 {
        return Err(PyValueError::new_err("vertices are n × 3 and triangles m × 3"));
    }
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
    fill(&mut lengths, threads(wanted_threads), |t| {
        let [a, b, c] = [0, 1, 2].map(|k| point(3 * t + k));
        [distance2(&a, &c), distance2(&b, &a), distance2(&c, &b)].map(f64::sqrt)
    });
    Ok(PyArray1::from_vec(py, lengths.into_flattened()).reshape([triangles.nrows(), 3])?.unbind())
}

type Rows = Py<PyArray1<u32>>;

/// Vertices (n,) and triangles (m,) in an order in which neighbours in space are neighbours in memory.
#[pyfunction]
fn spatial_order(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
) -> PyResult<(Rows, Rows)> {
    let none = PyArray2::zeros(py, [vertices.as_array().nrows(), 0], false).readonly();
    let points = points_from::<3>(&vertices, &none)?;
    let triangles = triangles_from(&triangles, points.len())?;
    check_points(&points)?;
    check_indices(points.len(), &triangles)?;
    let (vertices, triangles) = py.detach(|| crate::spatial::spatial_order(&points, &triangles));
    Ok((PyArray1::from_vec(py, vertices).unbind(), PyArray1::from_vec(py, triangles).unbind()))
}

/// Follow the merges backwards: what became of a vertex is what became of the one it was merged into.
fn follow(vertices: usize, left: &[u32], merges: &[Merge]) -> Vec<i32> {
    let mut became = vec![-1; vertices];
    for (new, &v) in left.iter().enumerate() {
        became[v as usize] = new as i32;
    }
    for merge in merges.iter().rev() {
        became[merge.removed.index()] = became[merge.survivor.index()];
    }
    became
}

/// Vertices and attributes.
type Points = (Py<PyArray2<f64>>, Py<PyArray2<f64>>);

/// Fit a simplified mesh to its input: `became` holds the vertex of the result that each vertex of the input
/// became part of, −1 for none. Returns vertices and attributes of the result.
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, fixed, original_vertices, original_attributes,
                    original_triangles, became, *, threads, progress))]
#[allow(clippy::too_many_arguments)]
fn fit(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
    fixed: PyReadonlyArray1<'_, bool>,
    original_vertices: PyReadonlyArray2<'_, f64>,
    original_attributes: PyReadonlyArray2<'_, f64>,
    original_triangles: PyReadonlyArray2<'_, i32>,
    became: PyReadonlyArray1<'_, i32>,
    threads: usize,
    progress: Py<PyAny>,
) -> PyResult<Points> {
    let k = attributes.as_array().ncols();
    let result = Inputs { vertices, attributes, triangles, fixed };
    let none = PyArray1::from_vec(py, vec![]).readonly();
    let original = Inputs {
        vertices: original_vertices,
        attributes: original_attributes,
        triangles: original_triangles,
        fixed: none,
    };
    match k {
        0 => fit_points::<3>(py, &result, &original, &became, threads, &progress),
        1 => fit_points::<4>(py, &result, &original, &became, threads, &progress),
        3 => fit_points::<6>(py, &result, &original, &became, threads, &progress),
        k => Err(unknown_attributes(k)),
    }
}

fn fit_points<const D: usize>(
    py: Python<'_>,
    result: &Inputs<'_>,
    original: &Inputs<'_>,
    became: &PyReadonlyArray1<'_, i32>,
    wanted_threads: usize,
    progress: &Py<PyAny>,
) -> PyResult<Points> {
    let (points, triangles, fixed) = result.copied::<D>()?;
    let (original_points, original_triangles, _) = original.copied::<D>()?;
    let vertices = points.len();
    let became: Vec<VertexId> = became
        .as_array()
        .iter()
        .map(|&v| if (0..vertices as i64).contains(&v.into()) { VertexId(v as u32) } else { VertexId::NONE })
        .collect();
    if became.len() != original_points.len() {
        return Err(PyValueError::new_err("became needs one value for each original vertex"));
    }
    let points = detached(py, progress, false, |progress| {
        let whole = Whole::<D, ()>::new(points, triangles, fixed)?;
        check_points(&original_points)?;
        check_indices(original_points.len(), &original_triangles)?;
        let mut mesh = whole.connected()?;
        let input = Input { points: &original_points, triangles: &original_triangles, became: &became };
        crate::fit::fit(&mut mesh, &input, threads(wanted_threads), progress)?;
        Ok(mesh.points)
    })?;
    Ok((
        array(py, points.iter().flat_map(|p| &p[..3]).copied(), [vertices, 3])?,
        array(py, points.iter().flat_map(|p| &p[3..]).copied(), [vertices, D - 3])?,
    ))
}

/// The arrays of a mesh as Python gives them.
struct Inputs<'py> {
    vertices: PyReadonlyArray2<'py, f64>,
    attributes: PyReadonlyArray2<'py, f64>,
    triangles: PyReadonlyArray2<'py, i32>,
    fixed: PyReadonlyArray1<'py, bool>,
}

type Copied<const D: usize> = (Vec<[f64; D]>, Vec<[u32; 3]>, Vec<bool>);

impl Inputs<'_> {
    fn copied<const D: usize>(&self) -> PyResult<Copied<D>> {
        let points = points_from::<D>(&self.vertices, &self.attributes)?;
        let triangles = triangles_from(&self.triangles, points.len())?;
        let fixed = self.fixed.as_array().to_vec();
        if !(fixed.is_empty() || fixed.len() == points.len()) {
            return Err(PyValueError::new_err("fixed needs one value a vertex"));
        }
        Ok((points, triangles, fixed))
    }
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
    let (vertices, attributes) = (vertices.as_standard_layout(), attributes.as_standard_layout());
    let places = vertices.as_slice().unwrap_or_default().chunks_exact(3);
    let k = D - 3;
    let values = attributes.as_slice().unwrap_or_default();
    let point = |(v, place): (usize, &[f64])| {
        std::array::from_fn(|i| if i < 3 { place[i] } else { values[k * v + i - 3] })
    };
    Ok(places.enumerate().map(point).collect())
}

pub fn triangles_from(triangles: &PyReadonlyArray2<'_, i32>, vertices: usize) -> PyResult<Vec<[u32; 3]>> {
    let triangles = triangles.as_array();
    if triangles.ncols() != 3 {
        return Err(PyValueError::new_err(format!(
            "triangles are {:?}; m × 3 is expected",
            triangles.shape()
        )));
    }
    let triangles = triangles.as_standard_layout();
    let values = triangles.as_slice().unwrap_or_default();
    if let Some(place) = values.iter().position(|&v| v < 0) {
        let (triangle, vertex) = (place / 3, values[place].into());
        return Err(KernelError::IndexOutOfRange { triangle, vertex, vertices }.into());
    }
    Ok(values.chunks_exact(3).map(|t| [t[0] as u32, t[1] as u32, t[2] as u32]).collect())
}

/// How often the waiting thread looks for Ctrl-C, and every how many looks it reports progress.
const LOOK: Duration = Duration::from_millis(40);
const LOOKS_A_REPORT: u32 = 3;

/// Run `work` without the GIL on a thread of its own, while this one waits. Progress reaches the Python function
/// `progress(done, total)`. An exception there, or Ctrl-C, stops the work and comes back from here; so does False,
/// with what there is. With `partial`, Ctrl-C does the same as False. A panic becomes a RuntimeError.
pub fn detached<R: Send>(
    py: Python<'_>,
    progress: &Py<PyAny>,
    partial: bool,
    work: impl FnOnce(&mut Progress) -> Result<R, KernelError> + Send,
) -> PyResult<R> {
    let control = Control::default();
    let mut raised: Option<PyErr> = None;
    let outcome = py.detach(|| {
        std::thread::scope(|scope| {
            let (ended, end) = std::sync::mpsc::channel();
            let control = &control;
            let worker = scope.spawn(move || {
                let outcome = catch_unwind(AssertUnwindSafe(|| work(&mut Progress::new(control))));
                // Nobody waits any more once an exception was raised.
                let _ = ended.send(());
                outcome
            });
            let mut looks = 0;
            while end.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
                looks += 1;
                let looked = Python::attach(|py| {
                    if let Err(interrupt) = py.check_signals() {
                        if !partial {
                            return Err(interrupt);
                        }
                        control.enough();
                    }
                    if looks % LOOKS_A_REPORT == 0 {
                        let (done, total) = control.done();
                        if progress.call1(py, (done, total))?.bind(py).is(PyBool::new(py, false)) {
                            control.enough();
                        }
                    }
                    Ok(())
                });
                if let Err(error) = looked {
                    raised = Some(error);
                    control.abort();
                    break;
                }
            }
            worker.join()
        })
    });
    if let Some(error) = raised {
        return Err(error);
    }
    match outcome {
        Ok(Ok(result)) => result.map_err(PyErr::from),
        _ => Err(PyRuntimeError::new_err("the mesh kernels failed; please report the mesh that shows it")),
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

fn sources(py: Python<'_>, sources: impl Iterator<Item = u32>) -> Py<PyArray1<i32>> {
    PyArray1::from_vec(py, sources.map(|s| s as i32).collect()).unbind()
}

#[pymodule(gil_used = false)]
fn _kernels(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Running>()?;
    module.add_class::<Simplified>()?;
    module.add_class::<crate::python_certify::Certified>()?;
    module.add_function(wrap_pyfunction!(crate::python_certify::certify, module)?)?;
    module.add_class::<crate::python_certified::Proven>()?;
    module.add_function(wrap_pyfunction!(crate::python_certified::simplify_certified, module)?)?;
    module.add("InvalidMeshError", module.py().get_type::<InvalidMeshError>())?;
    module.add("LimitError", module.py().get_type::<LimitError>())?;
    module.add_function(wrap_pyfunction!(simplify_by_quadrics, module)?)?;
    module.add_function(wrap_pyfunction!(fit, module)?)?;
    module.add_function(wrap_pyfunction!(residuals, module)?)?;
    module.add_function(wrap_pyfunction!(side_lengths, module)?)?;
    module.add_function(wrap_pyfunction!(spatial_order, module)?)?;
    module.add_function(wrap_pyfunction!(simplify, module)?)
}
