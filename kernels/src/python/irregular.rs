//! `scanloom.stages._kernels.find_irregular_elements`.

use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{copy_triangles, rows};
use super::memory_guard::with_memory_reserve;
use crate::base::parallel::resolve_thread_count;
use crate::mesh::connectivity_builder::check_indices;
use crate::mesh::irregular_elements::{AngleLimits, find_irregular_elements as find};

/// Find the irregular elements of each class, and the topological counts. Angle limits are in degrees.
#[pyfunction]
#[pyo3(signature = (vertices, triangles, *, corner_deg, fold_deg, spike_deg, wanted_threads))]
pub fn find_irregular_elements(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
    corner_deg: f64,
    fold_deg: f64,
    spike_deg: f64,
    wanted_threads: usize,
) -> PyResult<(Py<PyDict>, Py<PyDict>)> {
    with_memory_reserve(vertices.as_array().nrows() + triangles.as_array().nrows(), || {
        let points = rows::<f64, 3>(&vertices)?;
        let triangles = copy_triangles(&triangles, points.len())?;
        check_indices(points.len(), &triangles)?;
        let limits = AngleLimits {
            corner: corner_deg.to_radians(),
            fold: fold_deg.to_radians(),
            spike: spike_deg.to_radians(),
        };
        let found = py.detach(|| find(&points, &triangles, limits, resolve_thread_count(wanted_threads)));
        let (classes, counts) = (PyDict::new(py), PyDict::new(py));
        let put_ids = |name: &str, ids: &[u32]| {
            classes.set_item(name, PyArray1::from_iter(py, ids.iter().map(|&id| i64::from(id))))
        };
        let put_edges = |name: &str, edges: &[[u32; 2]]| {
            let ends = PyArray1::from_iter(py, edges.as_flattened().iter().map(|&id| i64::from(id)));
            classes.set_item(name, ends.reshape([edges.len(), 2])?)
        };
        put_edges("border_edges", &found.border_edges)?;
        put_edges("nonmanifold_edges", &found.nonmanifold_edges)?;
        put_edges("inconsistent_edges", &found.inconsistent_edges)?;
        put_ids("singular_vertices", &found.singular_vertices)?;
        put_ids("focal_vertices", &found.focal_vertices)?;
        put_ids("singular_border_triangles", &found.singular_border_triangles)?;
        put_ids("degenerate_triangles", &found.degenerate_triangles)?;
        put_ids("duplicate_triangles", &found.duplicate_triangles)?;
        put_ids("caps", &found.caps)?;
        put_ids("needles", &found.needles)?;
        put_edges("sharp_edges", &found.sharp_edges)?;
        put_ids("spikes", &found.spikes)?;
        for (name, count) in [
            ("edges", found.counts.edges),
            ("boundary_loops", found.counts.boundary_loops),
            ("components", found.counts.components),
            ("used", found.counts.used),
            ("referenced", found.counts.referenced),
            ("repeating", found.counts.repeating),
        ] {
            counts.set_item(name, count)?;
        }
        Ok((classes.unbind(), counts.unbind()))
    })
}
