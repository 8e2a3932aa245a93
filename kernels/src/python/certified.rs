//! `scanloom.stages._kernels.simplify_certified`.

use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{Attributes, MeshInputs, unsupported_attributes};
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use super::simplification_result::{RunSettings, SimplificationResult};
use crate::certified::sample_tracker::LimitKind;
use crate::certified::simplify::{Options, simplify};
use crate::certify::{self, Deviation};
use crate::collapse::engine::Refusal;
use crate::mesh::collapse_legality::IllegalCollapse;

/// Simplified mesh with proven bounds. Pairs are (shape in metres, colour in levels).
#[pyclass(frozen, get_all, extends = SimplificationResult)]
pub struct CertifiedResult {
    shape_bound: Py<PyArray1<f64>>,
    color_bound: Py<PyArray1<f64>>,
    bound: (f64, f64),
    attained: (f64, f64),
    slack: f64,
    color_slack: f64,
    proven: bool,
    iterations: usize,
    /// Unproven triangles of the result, and of the input.
    unproven: (usize, usize),
}

/// Simplify within bounds that are proven everywhere; infinity disables a bound.
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, locked, importance, *, bounds, weight, share, tolerance, effort, close,
                    running, progress))]
#[allow(clippy::too_many_arguments)]
pub fn simplify_certified(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: Attributes<'_>,
    triangles: PyReadonlyArray2<'_, i32>,
    locked: PyReadonlyArray1<'_, bool>,
    importance: PyReadonlyArray1<'_, f64>,
    bounds: (f64, f64),
    weight: f64,
    share: f64,
    tolerance: (f64, f64),
    effort: f64,
    close: bool,
    running: PyRef<'_, RunSettings>,
    progress: Py<PyAny>,
) -> PyResult<Py<CertifiedResult>> {
    let all = [bounds.0, bounds.1, weight, tolerance.0, tolerance.1, effort];
    if !(all.iter().all(|x| *x >= 0.0) && weight.is_finite() && share > 0.0 && share <= 1.0) {
        return Err(PyValueError::new_err(
            "bounds, weight, tolerance and effort must not be negative, and share must be above 0 and at most 1",
        ));
    }
    let inputs = MeshInputs { vertices, attributes, triangles };
    with_memory_reserve(inputs.row_count(), || {
        let locked = inputs.per_vertex("locked", &locked)?;
        let tolerance = Deviation { shape: tolerance.0, color: tolerance.1 };
        let options = Options {
            weight,
            importance: inputs.per_vertex("importance", &importance)?,
            sample_ratio: share,
            tight_bounds: close,
            proof: certify::Options { tolerance, effort, ..certify::Options::default() },
            ..Options::new(Deviation { shape: bounds.0, color: bounds.1 })
        };
        match inputs.attribute_count() {
            0 => simplify_points::<3, 0>(py, &inputs, locked, &options, &running, &progress),
            3 => simplify_points::<6, 3>(py, &inputs, locked, &options, &running, &progress),
            k => Err(unsupported_attributes(k)),
        }
    })
}

fn simplify_points<const D: usize, const K: usize>(
    py: Python<'_>,
    inputs: &MeshInputs<'_>,
    locked: Vec<bool>,
    options: &Options,
    running: &RunSettings,
    progress: &Py<PyAny>,
) -> PyResult<Py<CertifiedResult>> {
    let (points, triangles) = inputs.copy_mesh::<D>()?;
    let result = run_detached(py, Some(progress), running.partial, |progress| {
        simplify::<D, K>(points, triangles, locked, options, &running.goal(), progress)
    })?;
    let count = |wanted| result.refused.iter().filter(|r| **r == wanted).count();
    let refused = [
        ("shape", count(Refusal::ProposalRefused(LimitKind::Shape))),
        ("color", count(Refusal::ProposalRefused(LimitKind::Color))),
        ("needle", count(Refusal::ProposalRefused(LimitKind::Needle))),
        ("topology", count(Refusal::Illegal(IllegalCollapse::Topology))),
        ("bridge", count(Refusal::Illegal(IllegalCollapse::Bridge))),
        ("locked", count(Refusal::Illegal(IllegalCollapse::Locked))),
        ("fold", count(Refusal::Illegal(IllegalCollapse::Fold))),
    ];
    // Certification runs at least once; its last pass checked the result.
    let ([own, original], collapses, attempts) =
        result.passes.last().map_or(([0, 0], 0, 0), |p| (p.unproven, p.collapses as u64, p.attempts));
    let certificate = &result.certificate;
    let bounds = |of: fn(&Deviation) -> f64| {
        PyArray1::from_vec(py, certificate.result.iter().map(of).collect()).unbind()
    };
    let pair = |d: Deviation| (d.shape, d.color);
    let proven = CertifiedResult {
        shape_bound: bounds(|d| d.shape),
        color_bound: bounds(|d| d.color),
        bound: pair(certificate.bound),
        attained: pair(certificate.attained),
        slack: certificate.slack,
        color_slack: certificate.color_slack,
        proven: result.proven,
        iterations: result.passes.len(),
        unproven: (own, original),
    };
    let simplified = SimplificationResult::new(
        py,
        &result.mesh,
        result.stop,
        refused,
        collapses,
        attempts,
        &result.collapse_sequence,
    )?;
    Py::new(py, PyClassInitializer::from(simplified).add_subclass(proven))
}
