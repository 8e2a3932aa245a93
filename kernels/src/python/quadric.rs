//! `scanloom.stages._kernels.simplify_by_quadrics`.

use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{Attributes, MeshInputs, unsupported_attributes};
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use super::simplification_result::{RunSettings, SimplificationResult};
use crate::collapse::collapse_log::{CollapseSequence, RegionLog};
use crate::collapse::engine::Refusal;
use crate::collapse::whole_mesh::WholeMesh;
use crate::mesh::collapse_legality::IllegalCollapse;
use crate::quadric::qem::QemState;
use crate::quadric::simplify;

/// Mesh simplified by attribute quadrics.
#[pyclass(frozen, get_all, extends = SimplificationResult)]
pub struct QuadricResult {
    /// Result vertex that each input vertex was merged into, −1 for none.
    became: Py<PyArray1<i32>>,
}

/// Simplify a mesh by attribute quadrics to a number of triangles. `weight` is the length in metres that is
/// equivalent to one attribute level; `importance` multiplies the error around each vertex (empty for 1
/// everywhere).
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, locked, importance, *, weight, running, progress))]
#[allow(clippy::too_many_arguments)]
pub fn simplify_by_quadrics(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: Attributes<'_>,
    triangles: PyReadonlyArray2<'_, i32>,
    locked: PyReadonlyArray1<'_, bool>,
    importance: PyReadonlyArray1<'_, f64>,
    weight: f64,
    running: PyRef<'_, RunSettings>,
    progress: Py<PyAny>,
) -> PyResult<Py<QuadricResult>> {
    if !(weight >= 0.0 && weight.is_finite()) {
        return Err(PyValueError::new_err("weight must be finite and not negative"));
    }
    let inputs = MeshInputs { vertices, attributes, triangles };
    with_memory_reserve(inputs.row_count(), || {
        let locked = inputs.per_vertex("locked", &locked)?;
        let importance = inputs.per_vertex("importance", &importance)?;
        match inputs.attribute_count() {
            0 => simplify_points::<3, 0>(py, &inputs, locked, importance, weight, &running, &progress),
            3 => simplify_points::<6, 3>(py, &inputs, locked, importance, weight, &running, &progress),
            k => Err(unsupported_attributes(k)),
        }
    })
}

fn simplify_points<const D: usize, const K: usize>(
    py: Python<'_>,
    inputs: &MeshInputs<'_>,
    locked: Vec<bool>,
    importance: Vec<f64>,
    weight: f64,
    running: &RunSettings,
    progress: &Py<PyAny>,
) -> PyResult<Py<QuadricResult>> {
    let (points, triangles) = inputs.copy_mesh::<D>()?;
    let vertices = points.len();
    let (mesh, refused, stop, collapses, became, way, attempts) =
        run_detached(py, Some(progress), running.partial, |progress| {
            let whole = WholeMesh::new(points, triangles, locked)?;
            let records = QemState::<K> { weight, importance };
            let outcome = simplify::simplify_by_quadrics(whole, records, &running.goal(), progress)?;
            let refused = outcome.mesh.refused_edges();
            let count = |wanted| refused.iter().filter(|r| **r == Refusal::Illegal(wanted)).count();
            let refused = [
                ("topology", count(IllegalCollapse::Topology)),
                ("bridge", count(IllegalCollapse::Bridge)),
                ("locked", count(IllegalCollapse::Locked)),
                ("fold", count(IllegalCollapse::Fold)),
            ];
            let mesh = outcome.mesh.into_compact();
            let became = follow_merges(vertices, &mesh.vertex_source, &outcome.logs);
            let way = CollapseSequence::new(&outcome.logs);
            Ok((mesh, refused, outcome.stop, outcome.collapses, became, way, outcome.attempts))
        })?;
    let became = PyArray1::from_vec(py, became).unbind();
    let simplified = SimplificationResult::new(py, &mesh, stop, refused, collapses as u64, attempts, &way)?;
    Py::new(py, PyClassInitializer::from(simplified).add_subclass(QuadricResult { became }))
}

/// Follow the merges in reverse order: a removed vertex ends in the final vertex of its survivor.
fn follow_merges<const D: usize>(vertices: usize, left: &[u32], logs: &[RegionLog<D>]) -> Vec<i32> {
    let mut became = vec![-1; vertices];
    for (new, &v) in left.iter().enumerate() {
        became[v as usize] = new as i32;
    }
    for merge in logs.iter().rev().flat_map(|log| log.merges.iter().rev()) {
        became[merge.removed.index()] = became[merge.survivor.index()];
    }
    became
}
