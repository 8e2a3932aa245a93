//! `scanloom.stages._kernels.simplify_seams`.

use std::collections::BTreeMap;

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{column_array, copy_triangles, id_array, triangle_array};
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use super::simplification_result::{RunSettings, stop_reason};
use crate::certified::bounded_seams::{self, SampleBound};
use crate::seams::welding::{NO_SET, weld};
use crate::seams::{CostParameters, SeamGoal, SeamRefusals, SeamSurface, SimplifiedSurface, simplify};

/// Penalties and weights of `simplify_seams`; see `scanloom_kernels::seams::CostParameters`.
#[pyclass(frozen)]
pub struct SeamWeights(CostParameters);

#[pymethods]
impl SeamWeights {
    #[new]
    #[pyo3(signature = (*, material_border_penalty, part_border_penalty, valence_penalty, duplicate_penalty,
                        shape_weight, seam_drift))]
    fn new(
        material_border_penalty: f64,
        part_border_penalty: f64,
        valence_penalty: f64,
        duplicate_penalty: f64,
        shape_weight: f64,
        seam_drift: f64,
    ) -> PyResult<Self> {
        let values = [
            material_border_penalty,
            part_border_penalty,
            valence_penalty,
            duplicate_penalty,
            shape_weight,
            seam_drift,
        ];
        if !values.iter().all(|&x| x >= 0.0) {
            return Err(PyValueError::new_err("penalties and weights must not be negative"));
        }
        Ok(Self(CostParameters {
            material_border_penalty,
            part_border_penalty,
            valence: valence_penalty,
            wedges: duplicate_penalty,
            shape: shape_weight,
            seam_drift,
        }))
    }
}

/// Mesh simplified with its texture seams.
#[pyclass(frozen, get_all)]
pub struct SeamResult {
    vertices: Py<PyArray2<f64>>,
    triangles: Py<PyArray2<i32>>,
    /// Attributes of the corners (3 q, k).
    corners: Py<PyArray2<f64>>,
    /// Input corner with the same attributes (3 q,), −1 for none.
    corner_source: Py<PyArray1<i32>>,
    vertex_source: Py<PyArray1<i32>>,
    triangle_source: Py<PyArray1<i32>>,
    stopped_by: &'static str,
    refused: BTreeMap<&'static str, usize>,
    collapses: u64,
    attempts: u64,
    seam_drift: f64,
    is_fitted: bool,
    /// Provable maximum distance in metres, if a bound was given: the bound, or the smallest provable
    /// distance above it.
    provable_distance: Option<f64>,
    log: Option<Py<SeamLog>>,
}

/// Log of all collapses; see `scanloom_kernels::seams::progressive_record::Log`.
#[pyclass(frozen, get_all)]
pub struct SeamLog {
    removed: Py<PyArray1<i32>>,
    survivor: Py<PyArray1<i32>>,
    positions: Py<PyArray2<f64>>,
    wedge_removed: Py<PyArray1<i32>>,
    wedge_survivor: Py<PyArray1<i32>>,
    wedge_when: Py<PyArray1<i32>>,
    changed: Py<PyArray1<i32>>,
    changed_to: Py<PyArray2<f64>>,
    changed_source: Py<PyArray1<i32>>,
    changed_when: Py<PyArray1<i32>>,
    corner_wedge: Py<PyArray1<i32>>,
    corner_vertex: Py<PyArray1<i32>>,
}

/// Simplify a mesh with vertices duplicated along seams. `sets` (n,) is equal for duplicates of a vertex.
/// `corners` (3 m, k) are the corner attributes as lengths: the texture coordinate (0 unless the triangle is
/// `textured`, (m,)), then three or six more. `importance` (m,) multiplies the error around triangles; empty
/// for 1. `within` is a maximum distance in metres, the ratio of it available to vertices, and a factor per
/// vertex (n,).
#[pyfunction]
#[pyo3(signature = (vertices, sets, triangles, corners, textured, materials, parts, importance, locked, *, knobs, fit, within=None, running, progress))]
#[allow(clippy::too_many_arguments)]
pub fn simplify_seams(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    sets: PyReadonlyArray1<'_, i32>,
    triangles: PyReadonlyArray2<'_, i32>,
    corners: PyReadonlyArray2<'_, f64>,
    textured: PyReadonlyArray1<'_, bool>,
    materials: PyReadonlyArray1<'_, i32>,
    parts: PyReadonlyArray1<'_, i32>,
    importance: PyReadonlyArray1<'_, f64>,
    locked: PyReadonlyArray1<'_, bool>,
    knobs: PyRef<'_, SeamWeights>,
    fit: bool,
    within: Option<(f64, f64, PyReadonlyArray1<'_, f64>)>,
    running: PyRef<'_, RunSettings>,
    progress: Py<PyAny>,
) -> PyResult<SeamResult> {
    // Each corner counts as a row.
    let count = vertices.as_array().nrows() + 4 * triangles.as_array().nrows();
    with_memory_reserve(count, || {
        let points = copy_table::<3>(&vertices)?;
        let triangles = copy_triangles(&triangles, points.len())?;
        let sets = sets.as_array();
        let lengths = [
            (sets.len(), points.len()),
            (locked.as_array().len(), points.len()),
            (textured.as_array().len(), triangles.len()),
            (materials.as_array().len(), triangles.len()),
            (parts.as_array().len(), triangles.len()),
            (corners.as_array().nrows(), 3 * triangles.len()),
        ];
        if lengths.iter().any(|(found, wanted)| found != wanted)
            || sets.iter().any(|&s| s < 0 || s as usize >= points.len())
        {
            return Err(PyValueError::new_err(
                "sets, locked, corners, textured, materials or parts do not match the mesh",
            ));
        }
        let importance = importance.as_array().to_vec();
        if !importance.is_empty() && importance.len() != triangles.len() {
            return Err(PyValueError::new_err(
                "importance must have one value for each triangle, or be empty",
            ));
        }
        let within = within.map(|(shape, share, factors)| SampleBound {
            shape,
            sample_ratio: share,
            factors: factors.as_array().iter().map(|&factor| factor as f32).collect(),
        });
        if within.as_ref().is_some_and(|within| within.factors.len() != points.len()) {
            return Err(PyValueError::new_err("within must have one factor for each vertex"));
        }
        let light = BareSurface {
            points,
            sets: sets.iter().map(|&s| s as u32).collect(),
            triangles,
            textured: textured.as_array().to_vec(),
            materials: materials.as_array().to_vec(),
            parts: parts.as_array().to_vec(),
            importance,
            locked: locked.as_array().to_vec(),
        };
        let how = SeamSettings { knobs: knobs.0, within, fit, running: &running };
        match corners.as_array().ncols() {
            2 => light.simplify::<5, 2>(py, &corners, &how, &progress),
            5 => light.simplify::<8, 5>(py, &corners, &how, &progress),
            8 => light.simplify::<11, 8>(py, &corners, &how, &progress),
            k => Err(PyValueError::new_err(format!("{k} attributes per corner; 2, 5 or 8 are supported"))),
        }
    })
}

/// Manifold sheets of a surface; see `scanloom_kernels::seams::welding`.
#[pyclass(frozen, get_all)]
pub struct WeldedSheets {
    triangles: Py<PyArray2<i32>>,
    triangle_source: Py<PyArray1<i32>>,
    touches: Py<PyArray1<bool>>,
}

/// Weld triangles where two share an edge between the same `sets` (n,), and split them into sheets where more
/// do.
#[pyfunction]
pub fn weld_sheets(
    py: Python<'_>,
    sets: PyReadonlyArray1<'_, i32>,
    triangles: PyReadonlyArray2<'_, i32>,
) -> PyResult<WeldedSheets> {
    with_memory_reserve(sets.as_array().len() + triangles.as_array().nrows(), || {
        let sets = sets.as_array();
        let triangles = copy_triangles(&triangles, sets.len())?;
        if sets.iter().any(|&s| s < 0 || s as usize >= sets.len()) {
            return Err(PyValueError::new_err("sets must be vertex indices"));
        }
        let sets: Vec<u32> = sets.iter().map(|&s| s as u32).collect();
        let welded = py.detach(|| weld(&sets, &triangles))?;
        let corners: Vec<[u32; 3]> =
            welded.corner_vertex.chunks_exact(3).map(|t| [t[0].0, t[1].0, t[2].0]).collect();
        let touches = welded.touching.iter().map(|&set| set != NO_SET).collect();
        Ok(WeldedSheets {
            triangles: triangle_array(py, &corners)?,
            triangle_source: id_array(py, welded.triangle_source.into_iter()),
            touches: PyArray1::from_vec(py, touches).unbind(),
        })
    })
}

/// Simplification settings.
struct SeamSettings<'a> {
    knobs: CostParameters,
    within: Option<SampleBound>,
    fit: bool,
    running: &'a RunSettings,
}

/// Surface without corner attributes.
struct BareSurface {
    points: Vec<[f64; 3]>,
    sets: Vec<u32>,
    triangles: Vec<[u32; 3]>,
    textured: Vec<bool>,
    materials: Vec<i32>,
    parts: Vec<i32>,
    importance: Vec<f64>,
    locked: Vec<bool>,
}

impl BareSurface {
    fn simplify<const D: usize, const K: usize>(
        self,
        py: Python<'_>,
        corners: &PyReadonlyArray2<'_, f64>,
        how: &SeamSettings<'_>,
        progress: &Py<PyAny>,
    ) -> PyResult<SeamResult> {
        let surface = SeamSurface {
            points: self.points,
            coincident_sets: self.sets,
            triangles: self.triangles,
            corners: copy_table::<K>(corners)?,
            textured: self.textured,
            materials: self.materials,
            parts: self.parts,
            importance: self.importance,
            locked: self.locked,
        };
        let goal = SeamGoal { rounds: how.running.goal(), fit: how.fit };
        let (outcome, provable) = run_detached(py, Some(progress), how.running.partial, |progress| {
            let Some(within) = &how.within else {
                return Ok((simplify::<D, K>(&surface, how.knobs, goal, progress)?, None));
            };
            let (outcome, provable) =
                bounded_seams::simplify::<D, K>(&surface, how.knobs, within, goal, progress)?;
            Ok((outcome, Some(provable)))
        })?;
        to_result(py, outcome, provable)
    }
}

fn to_result<const K: usize>(
    py: Python<'_>,
    outcome: SimplifiedSurface<K>,
    provable: Option<f64>,
) -> PyResult<SeamResult> {
    let log = outcome.log.map(|log| {
        let ids = |ids: Vec<u32>| id_array(py, ids.into_iter());
        Py::new(
            py,
            SeamLog {
                removed: ids(log.removed),
                survivor: ids(log.survivor),
                positions: column_array(py, &log.survivor_points, 0..3)?,
                wedge_removed: ids(log.wedge_removed),
                wedge_survivor: ids(log.wedge_survivor),
                wedge_when: ids(log.wedge_collapse_index),
                changed: ids(log.changed_wedges),
                changed_to: column_array(py, &log.changed_attributes, 0..K)?,
                changed_source: ids(log.changed_source),
                changed_when: ids(log.changed_collapse_index),
                corner_wedge: ids(log.corner_wedge),
                corner_vertex: ids(log.corner_vertex),
            },
        )
    });
    let SeamRefusals { topology, bridge, locked, fold, seam, chart, drift, shape, needle } = outcome.refused;
    let refused = [
        ("topology", topology),
        ("bridge", bridge),
        ("locked", locked),
        ("fold", fold),
        ("seam", seam),
        ("chart", chart),
        ("drift", drift),
        ("shape", shape),
        ("needle", needle),
    ];
    Ok(SeamResult {
        vertices: column_array(py, &outcome.points, 0..3)?,
        triangles: triangle_array(py, &outcome.triangles)?,
        corners: column_array(py, &outcome.corners, 0..K)?,
        corner_source: id_array(py, outcome.corner_source.into_iter()),
        vertex_source: id_array(py, outcome.vertex_source.into_iter()),
        triangle_source: id_array(py, outcome.triangle_source.into_iter()),
        stopped_by: stop_reason(outcome.stop),
        refused: refused.into(),
        collapses: outcome.collapses as u64,
        attempts: outcome.attempts,
        seam_drift: outcome.seam_drift,
        is_fitted: outcome.is_fitted,
        provable_distance: provable,
        log: log.transpose()?,
    })
}

fn copy_table<const K: usize>(table: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<[f64; K]>> {
    let table = table.as_array();
    if table.ncols() != K {
        return Err(PyValueError::new_err(format!(
            "an array has {} columns; {K} are expected",
            table.ncols()
        )));
    }
    Ok(table.rows().into_iter().map(|row| std::array::from_fn(|i| row[i])).collect())
}
