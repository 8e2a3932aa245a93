//! `scanloom.stages._kernels.build_levels` and `scanloom.stages._kernels.assemble_front`.

use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{Attributes, MeshInputs, column_array, id_array, triangle_array, unsupported_attributes};
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use super::simplification_result::RunSettings;
use crate::certified::bounded_qem::Rules;
use crate::certified::simplify;
use crate::certify::{self, Deviation};
use crate::lod::front_assembly::{FrontNode, build_front_mesh};
use crate::lod::hierarchy::{Hierarchy, Options, build_hierarchy};

/// Minimum ratio of height to longest side for triangles of levels. Above [`certify::NEEDLE_RATIO`], because other
/// programs drop thinner triangles: Open3D up to 0.007.
const MIN_NEEDLE_RATIO: f64 = 0.01;

/// Hierarchy of levels, nodes from the root down. Pairs are (shape in metres, colour in levels).
#[pyclass(frozen, get_all)]
pub struct LevelHierarchy {
    parent: Py<PyArray1<i32>>,
    level: Py<PyArray1<i32>>,
    shape_bound: Py<PyArray1<f64>>,
    color_bound: Py<PyArray1<f64>>,
    shape_attained: Py<PyArray1<f64>>,
    color_attained: Py<PyArray1<f64>>,
    /// Triangles of each node without any split.
    coarse_triangle_counts: Py<PyArray1<i32>>,
    /// Number of vertices before any split.
    root_vertex_count: usize,
    vertices: Py<PyArray2<f64>>,
    attributes: Py<PyArray2<f64>>,
    /// Per vertex from `root_vertex_count` on: the vertex it merges into.
    origin: Py<PyArray1<i32>>,
    /// Per split: the number of new vertices and new triangles.
    new_vertex_counts: Py<PyArray1<u8>>,
    new_triangle_counts: Py<PyArray1<u8>>,
    /// Splits of node n: `first_split[n]..first_split[n + 1]`; triangles accordingly.
    first_split: Py<PyArray1<i64>>,
    first_triangle: Py<PyArray1<i64>>,
    triangles: Py<PyArray2<i32>>,
    triangle_source: Py<PyArray1<i32>>,
    stopped: bool,
    unproven: usize,
}

/// Build the levels of a manifold mesh.
#[pyfunction]
#[pyo3(signature = (vertices, attributes, triangles, locked, *, first, ratio, max_cell_triangles,
                    root_triangles, weight, share, tolerance, effort, single, running, progress))]
#[allow(clippy::too_many_arguments)]
pub fn build_levels(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    attributes: Attributes<'_>,
    triangles: PyReadonlyArray2<'_, i32>,
    locked: PyReadonlyArray1<'_, bool>,
    first: f64,
    ratio: f64,
    max_cell_triangles: u32,
    root_triangles: usize,
    weight: f64,
    share: f64,
    tolerance: (f64, f64),
    effort: f64,
    single: bool,
    running: PyRef<'_, RunSettings>,
    progress: Py<PyAny>,
) -> PyResult<LevelHierarchy> {
    let all = [first, weight, tolerance.0, tolerance.1, effort];
    if !(all.iter().all(|x| *x >= 0.0 && x.is_finite()) && first > 0.0 && ratio >= 1.1 && ratio.is_finite()) {
        return Err(PyValueError::new_err(
            "weight, tolerance and effort must not be negative, first must be above 0, and ratio at least 1.1",
        ));
    }
    if max_cell_triangles < 4 || !(share > 0.0 && share <= 1.0) {
        return Err(PyValueError::new_err(
            "max_cell_triangles must be at least 4, and share above 0 and at most 1",
        ));
    }
    let inputs = MeshInputs { vertices, attributes, triangles };
    with_memory_reserve(inputs.row_count(), || {
        let tolerance = Deviation { shape: tolerance.0, color: tolerance.1 };
        let within = Deviation { shape: first, color: f64::INFINITY };
        let simplify = simplify::Options {
            weight,
            sample_ratio: share,
            rules: Rules {
                forbid_chords: true,
                single_precision: single,
                min_needle_ratio: MIN_NEEDLE_RATIO,
            },
            ..simplify::Options::new(within)
        };
        let close = certify::Options { tolerance, effort, ..certify::Options::default() };
        let locked = inputs.per_vertex("locked", &locked)?;
        let options = Options {
            first_bound: first,
            bound_ratio: ratio,
            max_cell_triangles,
            max_root_triangles: root_triangles,
            locked,
            simplify,
            bounding: close,
        };
        match inputs.attribute_count() {
            0 => build_points::<3, 0>(py, &inputs, &options, &running, &progress),
            3 => build_points::<6, 3>(py, &inputs, &options, &running, &progress),
            k => Err(unsupported_attributes(k)),
        }
    })
}

fn build_points<const D: usize, const K: usize>(
    py: Python<'_>,
    inputs: &MeshInputs<'_>,
    options: &Options,
    running: &RunSettings,
    progress: &Py<PyAny>,
) -> PyResult<LevelHierarchy> {
    let (points, triangles) = inputs.copy_mesh::<D>()?;
    let Hierarchy { nodes, forest, stopped, unproven_count: unproven } =
        run_detached(py, Some(progress), running.partial, |progress| {
            build_hierarchy::<D, K>(points, triangles, options, &running.goal(), progress)
        })?;
    let last = nodes.len() as u32;
    let down = || nodes.iter().rev();
    let numbers =
        |of: &dyn Fn(usize) -> f64| PyArray1::from_vec(py, (0..nodes.len()).rev().map(of).collect()).unbind();
    let offsets = |all: &[usize]| PyArray1::from_vec(py, all.iter().map(|&i| i as i64).collect()).unbind();
    // A node without parent gets −1.
    let parent = down().map(|n| n.parent.checked_add(1).map_or(u32::MAX, |above| last - above));
    Ok(LevelHierarchy {
        parent: id_array(py, parent),
        level: id_array(py, down().map(|n| n.level)),
        shape_bound: numbers(&|n| nodes[n].bound.shape),
        color_bound: numbers(&|n| nodes[n].bound.color),
        shape_attained: numbers(&|n| nodes[n].attained.shape),
        color_attained: numbers(&|n| nodes[n].attained.color),
        coarse_triangle_counts: id_array(py, down().map(|n| n.triangle_count as u32)),
        root_vertex_count: forest.roots,
        vertices: column_array(py, &forest.points, 0..3)?,
        attributes: column_array(py, &forest.points, 3..D)?,
        origin: id_array(py, forest.origin.iter().copied()),
        new_vertex_counts: PyArray1::from_vec(py, forest.vertices_per_split).unbind(),
        new_triangle_counts: PyArray1::from_vec(py, forest.triangles_per_split).unbind(),
        first_split: offsets(&forest.splits),
        first_triangle: offsets(&forest.starts),
        triangles: triangle_array(py, &forest.triangles)?,
        triangle_source: id_array(py, forest.source.iter().copied()),
        stopped,
        unproven,
    })
}

/// Mesh of a front: its renumbered triangles, their indices in the hierarchy, and the vertices they use.
#[pyclass(frozen, get_all)]
pub struct FrontMesh {
    vertices: Py<PyArray1<i32>>,
    triangles: Py<PyArray2<i32>>,
    source: Py<PyArray1<i32>>,
}

/// Assemble the mesh of a front: per node the first `count` triangles from `start` on, with vertices below
/// `below`.
#[pyfunction]
#[pyo3(signature = (triangles, origin, *, roots, start, count, below))]
pub fn assemble_front(
    py: Python<'_>,
    triangles: PyReadonlyArray2<'_, u32>,
    origin: PyReadonlyArray1<'_, u32>,
    roots: u32,
    start: PyReadonlyArray1<'_, i64>,
    count: PyReadonlyArray1<'_, i64>,
    below: PyReadonlyArray1<'_, i64>,
) -> PyResult<FrontMesh> {
    let corners = triangles.as_slice()?;
    let origin = origin.as_slice()?;
    let vertices = roots as usize + origin.len();
    let (start, count, below) = (start.as_slice()?, count.as_slice()?, below.as_slice()?);
    if triangles.as_array().ncols() != 3 || start.len() != count.len() || start.len() != below.len() {
        return Err(PyValueError::new_err(
            "triangles must be m × 3, and start, count and below must have equal lengths",
        ));
    }
    let there = (corners.len() / 3) as i64;
    let mut front = Vec::with_capacity(start.len());
    for ((&start, &count), &below) in start.iter().zip(count).zip(below) {
        let within = start >= 0 && count >= 0 && start.checked_add(count).is_some_and(|end| end <= there);
        if !within || below < i64::from(roots) || below > vertices as i64 {
            return Err(PyValueError::new_err("a node of the front is out of range"));
        }
        front.push(FrontNode { start: start as usize, count: count as usize, vertex_limit: below as u32 });
    }
    let rows: usize = front.iter().map(|open| open.count).sum();
    with_memory_reserve(rows + vertices, || {
        let mesh = run_detached(py, None, false, |_| Ok(build_front_mesh(corners, origin, roots, &front)))?;
        Ok(FrontMesh {
            vertices: id_array(py, mesh.vertices.into_iter()),
            triangles: triangle_array(py, &mesh.triangles)?,
            source: id_array(py, mesh.source.into_iter()),
        })
    })
}
