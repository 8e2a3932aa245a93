//! `scanloom.stages._kernels`: `SurfaceRefiner`, `BoundaryAligner`, `smooth_boundaries`.

use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{column_array, copy_triangles, rows, triangle_array};
use super::background_work::run_detached;
use super::fusion::{DepthMap, PosedCamera, camera_from_pose, image_pixels};
use super::memory_guard::with_memory_reserve;
use crate::base::errors::KernelError;
use crate::base::parallel::resolve_thread_count;
use crate::fusion::frame_view::DepthNoiseModel;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::check_points;
use crate::refinement::boundary::smooth_boundaries as smooth_boundaries_of;
use crate::refinement::depth_frame::DepthFrame;
use crate::refinement::normal_filter::{area_normals, vertex_normals};
use crate::refinement::outlines::Outlines;
use crate::refinement::plane_growth::NO_PLANE;
use crate::refinement::refiner::{Refiner, mean_edge};

/// Vertices (n, 3), triangles (m, 3), input vertex of the first n − k vertices, ends (k, 2) and shares (k,) of
/// the others.
type MeshArrays =
    (Py<PyArray2<f64>>, Py<PyArray2<i32>>, Py<PyArray1<u32>>, Py<PyArray2<u32>>, Py<PyArray1<f64>>);
/// Moves, deviations, best cosines, free space and planes of the vertices, −1 for no plane; and the number of
/// planes.
type VertexArrays =
    (Py<PyArray1<f64>>, Py<PyArray1<f64>>, Py<PyArray1<f64>>, Py<PyArray1<bool>>, Py<PyArray1<i32>>, usize);

/// Mesh under refinement. Show all frames, then `filter`; again, then `correct`, once or more; then `flatten`.
#[pyclass(frozen, module = "scanloom.stages._kernels")]
pub struct SurfaceRefiner {
    inner: Mutex<Option<Refiner>>,
}

#[pymethods]
impl SurfaceRefiner {
    /// Prepare a mesh, which must be manifold. `strength` scales how far vertices may move.
    #[new]
    #[pyo3(signature = (vertices, triangles, *, strength, wanted_threads))]
    fn new(
        py: Python<'_>,
        vertices: PyReadonlyArray2<'_, f64>,
        triangles: PyReadonlyArray2<'_, i32>,
        strength: f64,
        wanted_threads: usize,
    ) -> PyResult<Self> {
        if !(strength.is_finite() && strength >= 0.0) {
            return Err(PyValueError::new_err("strength must be a finite number from 0"));
        }
        let count = vertices.as_array().nrows() + triangles.as_array().nrows();
        with_memory_reserve(count, || {
            let points: Vec<[f64; 3]> = rows(&vertices)?;
            let triangles = copy_triangles(&triangles, points.len())?;
            let threads = resolve_thread_count(wanted_threads);
            let refiner =
                run_detached(py, None, false, |_| Refiner::new(points, triangles, strength, threads))?;
            Ok(Self { inner: Mutex::new(Some(refiner)) })
        })
    }

    /// Compare the surface with a filtered depth map. `noise` is (constant, quadratic).
    fn observe(
        &self,
        py: Python<'_>,
        camera: PosedCamera<'_>,
        depth: DepthMap<'_>,
        noise: (f32, f32),
    ) -> PyResult<()> {
        with_depth_frame(&camera, &depth, noise, |frame| {
            self.run_detached(py, |refiner| refiner.observe(frame))
        })
    }

    /// Measure the deviation of each vertex, and filter the surface.
    fn filter(&self, py: Python<'_>) -> PyResult<()> {
        self.run(py, Refiner::filter)
    }

    /// Move the surface to the observations, smoothly.
    fn correct(&self, py: Python<'_>) -> PyResult<()> {
        self.run(py, Refiner::correct)
    }

    /// Make planar patches planar and their creases straight.
    fn flatten(&self, py: Python<'_>) -> PyResult<()> {
        self.run(py, Refiner::flatten)
    }

    /// Return the mesh and the values of its vertices. The refiner cannot be used any more.
    fn finish(&self, py: Python<'_>) -> PyResult<(MeshArrays, VertexArrays)> {
        with_memory_reserve(self.row_count(), || {
            let found = self.lock().take().ok_or_else(finished)?.finish();
            let ends: Vec<u32> = found.created.iter().flat_map(|one| one.ends).collect();
            let labels = found.labels.iter().map(|&label| if label == NO_PLANE { -1 } else { label as i32 });
            Ok((
                (
                    column_array(py, &found.points, 0..3)?,
                    triangle_array(py, &found.triangles)?,
                    PyArray1::from_vec(py, found.vertex_source).unbind(),
                    PyArray1::from_vec(py, ends).reshape([found.created.len(), 2])?.unbind(),
                    PyArray1::from_iter(py, found.created.iter().map(|one| one.share)).unbind(),
                ),
                (
                    PyArray1::from_vec(py, found.moves).unbind(),
                    PyArray1::from_vec(py, found.deviations).unbind(),
                    PyArray1::from_vec(py, found.best_cosines).unbind(),
                    PyArray1::from_vec(py, found.contradicted).unbind(),
                    PyArray1::from_iter(py, labels).unbind(),
                    found.plane_count,
                ),
            ))
        })
    }
}

/// Mesh whose boundaries move to the outlines in depth maps. Show all frames, then `finish`.
#[pyclass(frozen, module = "scanloom.stages._kernels")]
pub struct BoundaryAligner {
    inner: Mutex<Option<Outlines>>,
}

#[pymethods]
impl BoundaryAligner {
    /// Find the boundaries of a mesh, which must be manifold.
    #[new]
    #[pyo3(signature = (vertices, triangles, *, wanted_threads))]
    fn new(
        py: Python<'_>,
        vertices: PyReadonlyArray2<'_, f64>,
        triangles: PyReadonlyArray2<'_, i32>,
        wanted_threads: usize,
    ) -> PyResult<Self> {
        let count = vertices.as_array().nrows() + triangles.as_array().nrows();
        with_memory_reserve(count, || {
            let points: Vec<[f64; 3]> = rows(&vertices)?;
            let triangles = copy_triangles(&triangles, points.len())?;
            let threads = resolve_thread_count(wanted_threads);
            let outlines = run_detached(py, None, false, |_| {
                check_points(&points)?;
                let connectivity = Connectivity::from_triangles_on(threads, points.len(), &triangles)?;
                Ok(Outlines::new(connectivity, points, threads))
            })?;
            Ok(Self { inner: Mutex::new(Some(outlines)) })
        })
    }

    /// Compare the boundaries with a filtered depth map. `noise` is (constant, quadratic).
    fn observe(
        &self,
        py: Python<'_>,
        camera: PosedCamera<'_>,
        depth: DepthMap<'_>,
        noise: (f32, f32),
    ) -> PyResult<()> {
        with_depth_frame(&camera, &depth, noise, |frame| {
            run_detached(py, None, false, |_| match self.lock().as_mut() {
                Some(outlines) => {
                    outlines.observe(frame);
                    Ok::<_, KernelError>(Ok(()))
                }
                None => Ok(Err(())),
            })?
            .map_err(|()| finished())
        })
    }

    /// Return the vertices, with the boundaries at the outlines. The aligner cannot be used any more.
    fn finish(&self, py: Python<'_>) -> PyResult<Py<PyArray2<f64>>> {
        let outlines = self.lock().take().ok_or_else(finished)?;
        with_memory_reserve(outlines.row_count(), || {
            let points = run_detached(py, None, false, |_| Ok::<_, KernelError>(outlines.finish()))?;
            column_array(py, &points, 0..3)
        })
    }
}

impl BoundaryAligner {
    fn lock(&self) -> MutexGuard<'_, Option<Outlines>> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Call `work` with a filtered depth map. `noise` is (constant, quadratic).
fn with_depth_frame<T>(
    camera: &PosedCamera<'_>,
    depth: &DepthMap<'_>,
    (constant, quadratic): (f32, f32),
    work: impl FnOnce(DepthFrame<'_>) -> PyResult<T>,
) -> PyResult<T> {
    let camera = camera_from_pose(camera)?;
    with_memory_reserve(camera.width * camera.height, || {
        // Copied while the GIL prevents other writers.
        let depth = image_pixels(depth, &camera)?.to_vec();
        let noise = DepthNoiseModel { typical: 1.0, constant, quadratic };
        work(DepthFrame { camera: &camera, depth: &depth, noise })
    })
}

/// Smooth the boundaries of a mesh, within its surface. Returns the vertices, moved at most `max_move_ratio` mean
/// edge lengths.
#[pyfunction]
#[pyo3(signature = (vertices, triangles, *, max_move_ratio, wanted_threads))]
pub fn smooth_boundaries(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
    max_move_ratio: f64,
    wanted_threads: usize,
) -> PyResult<Py<PyArray2<f64>>> {
    let count = vertices.as_array().nrows() + triangles.as_array().nrows();
    with_memory_reserve(count, || {
        let mut points: Vec<[f64; 3]> = rows(&vertices)?;
        let triangles = copy_triangles(&triangles, points.len())?;
        let threads = resolve_thread_count(wanted_threads);
        let points = run_detached(py, None, false, |_| {
            check_points(&points)?;
            let connectivity = Connectivity::from_triangles_on(threads, points.len(), &triangles)?;
            let normals =
                vertex_normals(&connectivity, &area_normals(&connectivity, &points, threads), threads);
            let max_move = max_move_ratio * mean_edge(&connectivity, &points);
            smooth_boundaries_of(&connectivity, &mut points, &normals, max_move, threads);
            Ok(points)
        })?;
        column_array(py, &points, 0..3)
    })
}

impl SurfaceRefiner {
    fn lock(&self) -> MutexGuard<'_, Option<Refiner>> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn run(&self, py: Python<'_>, work: impl FnOnce(&mut Refiner) + Send) -> PyResult<()> {
        with_memory_reserve(self.row_count(), || self.run_detached(py, work))
    }

    fn run_detached(&self, py: Python<'_>, work: impl FnOnce(&mut Refiner) + Send) -> PyResult<()> {
        run_detached(py, None, false, |_| {
            match self.lock().as_mut() {
                Some(refiner) => work(refiner),
                None => return Ok(Err(())),
            }
            Ok::<_, KernelError>(Ok(()))
        })?
        .map_err(|()| finished())
    }

    fn row_count(&self) -> usize {
        self.lock().as_ref().map_or(0, Refiner::row_count)
    }
}

fn finished() -> PyErr {
    PyValueError::new_err("this refinement is finished")
}
