//! Common input and output of all simplifiers.

use std::collections::BTreeMap;

use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use super::arrays::{column_array, id_array, triangle_array};
use crate::base::parallel::resolve_thread_count;
use crate::collapse::collapse_log::CollapseSequence;
use crate::collapse::engine::Stop;
use crate::collapse::rounds::{Goal, REGION_TRIANGLES};
use crate::mesh::triangle_mesh::CompactMesh;

/// Common settings of the simplifiers: target triangle count, threads (0 for all cores), triangles per
/// region, whether to record the collapses, and whether Ctrl-C returns the mesh simplified so far.
#[pyclass(frozen, get_all)]
pub struct RunSettings {
    target_triangles: usize,
    threads: usize,
    region_triangles: usize,
    record: bool,
    pub partial: bool,
}

#[pymethods]
impl RunSettings {
    #[new]
    #[pyo3(signature = (*, target_triangles = 0, threads = 0, region_triangles = REGION_TRIANGLES, record = false, partial = false))]
    fn new(
        target_triangles: usize,
        threads: usize,
        region_triangles: usize,
        record: bool,
        partial: bool,
    ) -> Self {
        Self { target_triangles, threads, region_triangles, record, partial }
    }
}

impl RunSettings {
    /// Convert the settings for the collapse engine.
    pub fn goal(&self) -> Goal {
        Goal {
            triangles: self.target_triangles,
            threads: resolve_thread_count(self.threads),
            region: self.region_triangles.max(1),
            min_collapse_ratio: 0.0,
            record_positions: self.record,
        }
    }
}

/// Simplified mesh with statistics of the run.
#[pyclass(frozen, get_all, subclass)]
pub struct SimplificationResult {
    vertices: Py<PyArray2<f64>>,
    attributes: Py<PyArray2<f64>>,
    triangles: Py<PyArray2<i32>>,
    vertex_source: Py<PyArray1<i32>>,
    triangle_source: Py<PyArray1<i32>>,
    stopped_by: &'static str,
    /// Number of edges refused by each rule at the end.
    refused: BTreeMap<&'static str, usize>,
    collapses: u64,
    attempts: u64,
    /// Recorded collapses: the removed vertex, the surviving vertex, and its new position and attributes.
    removed: Py<PyArray1<i32>>,
    survivor: Py<PyArray1<i32>>,
    path: Py<PyArray2<f64>>,
}

/// Return the stop reason as a name used in Python.
pub fn stop_reason(stop: Stop) -> &'static str {
    match stop {
        Stop::Exhausted | Stop::Stalled => "bounds",
        Stop::Target => "triangles",
        Stop::StoppedByCaller => "request",
    }
}

impl SimplificationResult {
    /// Convert a simplified mesh and its statistics to arrays.
    pub fn new<const D: usize, const RULES: usize>(
        py: Python<'_>,
        mesh: &CompactMesh<D>,
        stop: Stop,
        refused: [(&'static str, usize); RULES],
        collapses: u64,
        attempts: u64,
        way: &CollapseSequence<D>,
    ) -> PyResult<Self> {
        Ok(Self {
            vertices: column_array(py, &mesh.points, 0..3)?,
            attributes: column_array(py, &mesh.points, 3..D)?,
            triangles: triangle_array(py, &mesh.triangles)?,
            vertex_source: id_array(py, mesh.vertex_source.iter().copied()),
            triangle_source: id_array(py, mesh.triangle_source.iter().copied()),
            stopped_by: stop_reason(stop),
            refused: refused.into(),
            collapses,
            attempts,
            removed: id_array(py, way.removed.iter().copied()),
            survivor: id_array(py, way.survivor.iter().copied()),
            path: column_array(py, &way.survivor_points, 0..D)?,
        })
    }
}
