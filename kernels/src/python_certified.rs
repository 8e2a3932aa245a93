//! `stages._kernels.simplify_certified`.

use std::collections::BTreeMap;

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::certified::{Options, simplify};
use crate::certify::{self, Deviation};
use crate::engine::{Refusal, Stop};
use crate::legality::Illegal;
use crate::parallel::threads;
use crate::python::{detached, points_from, triangles_from};
use crate::rounds::Goal;
use crate::tracked::Bound;

/// A simplified mesh and what is proven of it. Pairs are (shape in metres, colour in levels).
#[pyclass(frozen, get_all)]
pub struct Proven {
    vertices: Py<PyArray2<f64>>,
    attributes: Py<PyArray2<f64>>,
    triangles: Py<PyArray2<i32>>,
    vertex_source: Py<PyArray1<i32>>,
    triangle_source: Py<PyArray1<i32>>,
    stopped_by: &'static str,
    standing: BTreeMap<&'static str, usize>,
    shape_bound: Py<PyArray1<f64>>,
    color_bound: Py<PyArray1<f64>>,
    bound: (f64, f64),
    attained: (f64, f64),
    slack: f64,
    color_slack: f64,
    proven: bool,
    /// Triangles left, those of the result and of the input without a proof, collapses and attempts, of each pass.
    passes: Vec<(usize, usize, usize, usize, u64)>,
}

/// Simplify within bounds that are proven to hold everywhere; infinite for none.
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, fixed, importance, *, bounds, weight, share, tolerance, effort, close,
                    wanted_threads, patch_triangles, partial, progress))]
#[allow(clippy::too_many_arguments)]
pub fn simplify_certified(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
    fixed: PyReadonlyArray1<'_, bool>,
    importance: PyReadonlyArray1<'_, f64>,
    bounds: (f64, f64),
    weight: f64,
    share: f64,
    tolerance: (f64, f64),
    effort: f64,
    close: bool,
    wanted_threads: usize,
    patch_triangles: usize,
    partial: bool,
    progress: Py<PyAny>,
) -> PyResult<Proven> {
    let all = [bounds.0, bounds.1, weight, tolerance.0, tolerance.1, effort];
    if !(all.iter().all(|x| *x >= 0.0) && weight.is_finite() && share > 0.0 && share <= 1.0) {
        return Err(PyValueError::new_err(
            "bounds, weight, tolerance and effort must not be negative, and share be up to 1",
        ));
    }
    let count = vertices.as_array().nrows();
    let (fixed, importance) = (fixed.as_array().to_vec(), importance.as_array().to_vec());
    for (name, length) in [("fixed", fixed.len()), ("importance", importance.len())] {
        if !(length == 0 || length == count) {
            return Err(PyValueError::new_err(format!("{name} needs one value a vertex")));
        }
    }
    let tolerance = Deviation { shape: tolerance.0, color: tolerance.1 };
    let options = Options {
        weight,
        importance,
        share,
        close,
        proof: certify::Options { tolerance, effort, ..certify::Options::default() },
        ..Options::new(Deviation { shape: bounds.0, color: bounds.1 })
    };
    let goal =
        Goal { triangles: 0, threads: threads(wanted_threads), patch: patch_triangles.max(1), record: false };
    let inputs = Inputs { vertices, attributes, triangles, fixed };
    match inputs.attributes.as_array().ncols() {
        0 => prove_points::<3, 0>(py, &inputs, &options, &goal, partial, &progress),
        1 => prove_points::<4, 1>(py, &inputs, &options, &goal, partial, &progress),
        3 => prove_points::<6, 3>(py, &inputs, &options, &goal, partial, &progress),
        k => Err(PyValueError::new_err(format!(
            "{k} attributes a vertex; 0, 1 (intensity) or 3 (RGB) are known"
        ))),
    }
}

struct Inputs<'py> {
    vertices: PyReadonlyArray2<'py, f64>,
    attributes: PyReadonlyArray2<'py, f64>,
    triangles: PyReadonlyArray2<'py, i32>,
    fixed: Vec<bool>,
}

fn prove_points<const D: usize, const K: usize>(
    py: Python<'_>,
    inputs: &Inputs<'_>,
    options: &Options,
    goal: &Goal,
    partial: bool,
    progress: &Py<PyAny>,
) -> PyResult<Proven> {
    let points = points_from::<D>(&inputs.vertices, &inputs.attributes)?;
    let triangles = triangles_from(&inputs.triangles, points.len())?;
    let fixed = inputs.fixed.clone();
    let result = detached(py, progress, partial, |progress| {
        simplify::<D, K>(points, triangles, fixed, options, goal, progress)
    })?;
    let illegal = |wanted| result.held.iter().filter(|r| **r == Refusal::Illegal(wanted)).count();
    let bound = |wanted| {
        let held = |r: &&Refusal<Bound>| **r == Refusal::Bound(wanted);
        result.held.iter().filter(held).count()
    };
    let standing = [
        ("shape", bound(Bound::Shape)),
        ("color", bound(Bound::Color)),
        ("needle", bound(Bound::Needle)),
        ("topology", illegal(Illegal::Topology)),
        ("bridge", illegal(Illegal::Bridge)),
        ("pinned", illegal(Illegal::Pinned)),
        ("fold", illegal(Illegal::Fold)),
    ];
    let mesh = &result.mesh;
    let table = |columns: std::ops::Range<usize>| {
        let width = columns.len();
        let values: Vec<f64> = mesh.points.iter().flat_map(|p| &p[columns.clone()]).copied().collect();
        PyResult::Ok(PyArray1::from_vec(py, values).reshape([mesh.points.len(), width])?.unbind())
    };
    let corners: Vec<i32> = mesh.triangles.iter().flatten().map(|&v| v as i32).collect();
    let sources =
        |of: &[u32]| PyArray1::from_vec(py, of.iter().map(|&s| s as i32).collect::<Vec<i32>>()).unbind();
    let certificate = &result.certificate;
    let bounds = |of: fn(&Deviation) -> f64| {
        PyArray1::from_vec(py, certificate.result.iter().map(of).collect::<Vec<f64>>()).unbind()
    };
    let pair = |d: Deviation| (d.shape, d.color);
    Ok(Proven {
        vertices: table(0..3)?,
        attributes: table(3..D)?,
        triangles: PyArray1::from_vec(py, corners).reshape([mesh.triangles.len(), 3])?.unbind(),
        vertex_source: sources(&mesh.vertex_source),
        triangle_source: sources(&mesh.triangle_source),
        stopped_by: match result.stop {
            Stop::Enough => "request",
            Stop::Target => "triangles",
            Stop::Exhausted => "bounds",
        },
        standing: standing.into(),
        shape_bound: bounds(|d| d.shape),
        color_bound: bounds(|d| d.color),
        bound: pair(certificate.bound),
        attained: pair(certificate.attained),
        slack: certificate.slack,
        color_slack: certificate.color_slack,
        proven: result.proven,
        passes: result
            .passes
            .iter()
            .map(|p| {
                let [a, b] = p.unproven;
                (p.triangles, a, b, p.collapses, p.attempts)
            })
            .collect(),
    })
}
