//! `scanloom.stages._kernels.filter_depth`, `find_touched_blocks` and `Volume`.

use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::ndarray::{Array2, Array3};
use numpy::{
    Element, IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::triangle_array;
use super::atlas::shape_error;
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use crate::base::memory::release_free_memory;
use crate::base::parallel::resolve_thread_count;
use crate::fusion::block_order::block_of_key;
use crate::fusion::depth_filter::{DepthLimits, filter_depth_map};
use crate::fusion::distance_field::BLOCK_VOXELS;
use crate::fusion::frame_view::{Affine, DepthNoiseModel, FrameImages, FrameView, FusionCamera};
use crate::fusion::integration::instruction_variants;
use crate::fusion::surface_extraction::{BlockBox, extract_surface};
use crate::fusion::touched_blocks::{MeasuredSurface, collect_touched_blocks};

/// fx, fy, cx, cy, width, height.
pub(super) type Intrinsics = (f64, f64, f64, f64, usize, usize);
/// Intrinsics with the (4, 4) camera-to-world matrix.
pub(super) type PosedCamera<'py> = (Intrinsics, PyReadonlyArray2<'py, f64>);
pub(super) type DepthMap<'py> = PyReadonlyArray2<'py, f32>;
type DepthMapArray = Py<PyArray2<f32>>;
/// Blocks (n, 3), distances (n, 512) in truncations, weights, observation counts, and colours (n, 512, 3) if
/// the volume has colours.
type VoxelArrays =
    (Py<PyArray2<i32>>, Py<PyArray2<f32>>, Py<PyArray2<u16>>, Py<PyArray2<u8>>, Option<Py<PyArray3<f32>>>);

/// Vertices, triangles, colours and observation counts.
type SurfaceArrays = (Py<PyArray2<f64>>, Py<PyArray2<i32>>, Py<PyArray2<f32>>, Py<PyArray1<f32>>);

/// Vertices to stitch: block keys and edge codes of foreign vertices; and block keys, edge codes and indices
/// of shared vertices.
type StitchingArrays = [Py<PyArray1<u64>>; 5];
/// First block of a box along each axis, and the end (exclusive).
type BlockCorners = ([i32; 3], [i32; 3]);

fn block_box((low, high): BlockCorners) -> BlockBox {
    BlockBox { low, high }
}

/// Maximum number of pixels, so that 32-bit indices suffice.
const MAX_PIXELS: usize = 1 << 30;
/// Image sides must be shorter, because single precision represents all integers only up to this value.
const MAX_SIDE: usize = 1 << 24;

pub(super) fn camera_from_pose(posed: &PosedCamera<'_>) -> PyResult<FusionCamera> {
    let (pinhole, ref pose) = *posed;
    let pose = pose.as_array();
    if pose.shape() != [4, 4] || !pose.iter().all(|x| x.is_finite()) {
        return Err(PyValueError::new_err("the camera pose must be a finite 4 × 4 matrix"));
    }
    camera_at(pinhole, [0, 1, 2].map(|i| [0, 1, 2, 3].map(|k| pose[[i, k]])))
}

fn camera_at((fx, fy, cx, cy, width, height): Intrinsics, pose: Affine) -> PyResult<FusionCamera> {
    if ![fx, fy, cx, cy].iter().all(|x| x.is_finite()) || fx <= 0.0 || fy <= 0.0 {
        return Err(PyValueError::new_err(
            "the camera must have finite focal lengths above 0, and a finite principal point",
        ));
    }
    let is_small = width.max(height) < MAX_SIDE && (width + 1).saturating_mul(height + 1) <= MAX_PIXELS;
    if width == 0 || height == 0 || !is_small {
        return Err(PyValueError::new_err(
            "a camera image must have at least one pixel, fewer than 2³⁰ pixels, and sides below 2²⁴ pixels",
        ));
    }
    Ok(FusionCamera::new((width, height), [fx, fy], [cx, cy], pose))
}

/// Return the pixels of an image, row by row; checks that its size is the camera's.
pub(super) fn image_pixels<'a, T: Element>(
    image: &'a PyReadonlyArray2<'_, T>,
    camera: &FusionCamera,
) -> PyResult<&'a [T]> {
    match image.as_slice() {
        Ok(pixels) if image.as_array().shape() == [camera.height, camera.width] => Ok(pixels),
        _ => Err(PyValueError::new_err("an image is not contiguous, or its size differs from the camera's")),
    }
}

/// Filter a depth map: fill gaps of one pixel, drop discontinuities and grazing angles, and estimate normals
/// (one image per axis) and their lengths. `limits` is (minimum depth, maximum depth, relative jump, minimum
/// cosine).
#[pyfunction]
#[pyo3(signature = (depth, pinhole, *, limits, wanted_threads))]
pub fn filter_depth(
    py: Python<'_>,
    depth: DepthMap<'_>,
    pinhole: Intrinsics,
    limits: (f32, f32, f32, f32),
    wanted_threads: usize,
) -> PyResult<(DepthMapArray, (DepthMapArray, DepthMapArray, DepthMapArray), DepthMapArray)> {
    let camera = camera_at(pinhole, [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])?;
    with_memory_reserve(camera.width * camera.height, || {
        let depth = image_pixels(&depth, &camera)?.to_vec();
        let (nearest, farthest, jump, cosine) = limits;
        let limits = DepthLimits { min_depth: nearest, max_depth: farthest, jump, min_cosine: cosine };
        let found =
            py.detach(|| filter_depth_map(depth, &camera, limits, resolve_thread_count(wanted_threads)));
        let map = |values| {
            let map = Array2::from_shape_vec((camera.height, camera.width), values).map_err(shape_error)?;
            PyResult::Ok(map.into_pyarray(py).unbind())
        };
        let [x, y, z] = found.normal;
        Ok((map(found.depth)?, (map(x)?, map(y)?, map(z)?), map(found.obliqueness)?))
    })
}

/// Find the sorted keys of the blocks that a frame touches. `within` restricts them to a box (first block,
/// end block). Images must be contiguous; `normal` has one image per axis.
#[pyfunction]
#[pyo3(signature = (camera, depth, normal, obliqueness, wanted, *, voxel_size, truncation, within))]
#[allow(clippy::too_many_arguments)]
pub fn find_touched_blocks(
    py: Python<'_>,
    camera: PosedCamera<'_>,
    depth: DepthMap<'_>,
    normal: (DepthMap<'_>, DepthMap<'_>, DepthMap<'_>),
    obliqueness: DepthMap<'_>,
    wanted: PyReadonlyArray2<'_, bool>,
    voxel_size: f64,
    truncation: f32,
    within: Option<BlockCorners>,
) -> PyResult<Py<PyArray1<u64>>> {
    let camera = self::camera_from_pose(&camera)?;
    with_memory_reserve(camera.width * camera.height, || {
        let surface = MeasuredSurface {
            depth: image_pixels(&depth, &camera)?,
            normal: [
                image_pixels(&normal.0, &camera)?,
                image_pixels(&normal.1, &camera)?,
                image_pixels(&normal.2, &camera)?,
            ],
            obliqueness: image_pixels(&obliqueness, &camera)?,
            wanted: image_pixels(&wanted, &camera)?,
        };
        let within = within.map(block_box);
        let keys = collect_touched_blocks(&camera, surface, voxel_size, truncation, within)?;
        Ok(PyArray1::from_vec(py, keys).unbind())
    })
}

/// TSDF volume in blocks of 8³ voxels.
#[pyclass(frozen, module = "scanloom.stages._kernels")]
pub struct Volume {
    inner: Mutex<crate::fusion::volume::TsdfVolume>,
    truncation: f32,
}

#[pymethods]
impl Volume {
    /// Create an empty volume. Lengths are in metres; the truncation is along the surface normal.
    #[new]
    #[pyo3(signature = (voxel_size, truncation, *, color, max_blocks, instructions = None))]
    fn new(
        voxel_size: f64,
        truncation: f64,
        color: bool,
        max_blocks: usize,
        instructions: Option<&str>,
    ) -> PyResult<Self> {
        let are_sound = [voxel_size, truncation].iter().all(|x| x.is_finite() && *x > 0.0);
        if !are_sound {
            return Err(PyValueError::new_err("voxel_size and truncation must be above 0"));
        }
        let wanted = instructions.unwrap_or(instruction_variants()[0].0);
        let Some((_, add)) = instruction_variants().into_iter().find(|(name, _)| *name == wanted) else {
            return Err(PyValueError::new_err(format!("this processor does not support {wanted}")));
        };
        let field = crate::fusion::volume::TsdfVolume::new(voxel_size, truncation, color, max_blocks)
            .with_variant(add);
        Ok(Self { inner: Mutex::new(field), truncation: truncation as f32 })
    }

    /// List the instruction sets that this processor supports, widest first; all give identical bits.
    #[staticmethod]
    fn supported_instructions() -> Vec<&'static str> {
        instruction_variants().into_iter().map(|(name, _)| name).collect()
    }

    /// Number of blocks in use.
    #[getter]
    fn block_count(&self) -> usize {
        self.lock().blocks().count()
    }

    /// Memory of the voxels in bytes.
    #[getter]
    fn bytes(&self) -> usize {
        self.lock().blocks().bytes()
    }

    /// Compute the histogram (256,) of observation counts of voxels near the surface, in a box of blocks.
    #[pyo3(signature = (*, within))]
    fn observation_histogram(&self, py: Python<'_>, within: Option<BlockCorners>) -> Py<PyArray1<u64>> {
        PyArray1::from_slice(py, &self.lock().observation_histogram(within.map(block_box))).unbind()
    }

    /// Integrate a frame into the blocks with the given keys; images must be contiguous. `weighing` is
    /// (typical, constant, quadratic).
    #[pyo3(signature = (keys, camera, depth, obliqueness, color, *, weighing, wanted_threads))]
    #[allow(clippy::too_many_arguments)]
    fn integrate(
        &self,
        py: Python<'_>,
        keys: PyReadonlyArray1<'_, u64>,
        camera: PosedCamera<'_>,
        depth: DepthMap<'_>,
        obliqueness: DepthMap<'_>,
        color: Option<PyReadonlyArray3<'_, u8>>,
        weighing: (f32, f32, f32),
        wanted_threads: usize,
    ) -> PyResult<()> {
        let camera = self::camera_from_pose(&camera)?;
        with_memory_reserve(keys.as_array().len() + camera.width * camera.height, || {
            let (typical, constant, quadratic) = weighing;
            if ![typical, constant, quadratic].iter().all(|x| x.is_finite() && *x >= 0.0) {
                return Err(PyValueError::new_err("weighing must have finite values that are not negative"));
            }
            let threads = resolve_thread_count(wanted_threads);
            let color = color.as_ref().map(|color| color_pixels(color, &camera)).transpose()?;
            if color.is_none() && self.lock().blocks().is_colored() {
                return Err(PyValueError::new_err(
                    "the volume has colours, but the frame has no colour image",
                ));
            }
            let images = FrameImages {
                depth: image_pixels(&depth, &camera)?,
                obliqueness: image_pixels(&obliqueness, &camera)?,
                color,
            };
            let weighing = DepthNoiseModel { typical, constant, quadratic };
            // Copied while the GIL prevents other writers.
            let view = FrameView::new(camera, images, weighing, self.truncation, threads);
            let keys = keys.as_array().to_vec();
            run_detached(py, None, false, |progress| self.lock().integrate(&keys, &view, threads, progress))
        })
    }

    /// Extract the surface through voxels observed by at least `min_frames` frames: vertices (n, 3) in
    /// voxels, triangles (m, 3), colours (n, 3) of 0 to 255, and mean observation counts (n,). `within`
    /// restricts the surface to a box of blocks; see `StitchingArrays`.
    #[pyo3(signature = (min_frames, *, within, wanted_threads))]
    fn extract_surface(
        &self,
        py: Python<'_>,
        min_frames: u32,
        within: Option<BlockCorners>,
        wanted_threads: usize,
    ) -> PyResult<(SurfaceArrays, StitchingArrays)> {
        let count = self.lock().blocks().count();
        with_memory_reserve(count.saturating_mul(BLOCK_VOXELS / 8), || {
            // Locked by the worker thread, which needs no GIL to finish.
            let found = run_detached(py, None, false, |progress| {
                extract_surface(
                    &*self.lock(),
                    min_frames,
                    within.map(block_box),
                    resolve_thread_count(wanted_threads),
                    progress,
                )
            })?;
            let count = found.positions.len();
            let places = found.positions.into_iter().flatten().collect();
            let colors = found.samples.iter().flat_map(|sample| sample.color).collect();
            let frames = found.samples.iter().map(|sample| sample.observation_count).collect();
            let column = |values: Vec<u64>| PyArray1::from_vec(py, values).unbind();
            let (foreign, shared) = (&found.foreign, &found.shared);
            Ok((
                (
                    Array2::from_shape_vec((count, 3), places)
                        .map_err(shape_error)?
                        .into_pyarray(py)
                        .unbind(),
                    triangle_array(py, &found.triangles)?,
                    Array2::from_shape_vec((count, 3), colors)
                        .map_err(shape_error)?
                        .into_pyarray(py)
                        .unbind(),
                    PyArray1::from_vec(py, frames).unbind(),
                ),
                [
                    column(foreign.iter().map(|key| key.block).collect()),
                    column(foreign.iter().map(|key| key.code.into()).collect()),
                    column(shared.iter().map(|(key, _)| key.block).collect()),
                    column(shared.iter().map(|(key, _)| key.code.into()).collect()),
                    column(shared.iter().map(|(_, number)| (*number).into()).collect()),
                ],
            ))
        })
    }

    /// Copy all voxel data, blocks in slot order; NaN for voxels that were never observed.
    fn copy_voxels(&self, py: Python<'_>) -> PyResult<VoxelArrays> {
        let volume = self.lock();
        let blocks = volume.blocks();
        let count = blocks.count();
        with_memory_reserve(count.saturating_mul(BLOCK_VOXELS), || {
            let all = (0..count).map(|slot| blocks.distances(slot));
            let places = (0..count).flat_map(|slot| block_of_key(blocks.key(slot))).collect();
            let distances =
                all.clone().flat_map(|one| (0..BLOCK_VOXELS).map(|v| one.distance_of(v, 0))).collect();
            let weights = all.clone().flat_map(|one| one.weight.as_flattened().iter().copied()).collect();
            let frames = all.flat_map(|one| one.frames.as_flattened().iter().copied()).collect();
            let colors = blocks.is_colored().then(|| {
                let colors = (0..count).filter_map(|slot| blocks.colors(slot));
                colors.flat_map(|one| (0..BLOCK_VOXELS).flat_map(|v| one.color_of(v))).collect()
            });
            let size = (count, BLOCK_VOXELS);
            Ok((
                Array2::from_shape_vec((count, 3), places).map_err(shape_error)?.into_pyarray(py).unbind(),
                Array2::from_shape_vec(size, distances).map_err(shape_error)?.into_pyarray(py).unbind(),
                Array2::from_shape_vec(size, weights).map_err(shape_error)?.into_pyarray(py).unbind(),
                Array2::from_shape_vec(size, frames).map_err(shape_error)?.into_pyarray(py).unbind(),
                colors
                    .map(|colors| {
                        Array3::from_shape_vec((count, BLOCK_VOXELS, 3), colors).map_err(shape_error)
                    })
                    .transpose()?
                    .map(|colors| colors.into_pyarray(py).unbind()),
            ))
        })
    }
}

impl Drop for Volume {
    /// Release the memory to the system, because bricks are fused one after another, and the allocator would
    /// keep it.
    fn drop(&mut self) {
        *self.lock() = crate::fusion::volume::TsdfVolume::new(1.0, 1.0, false, 0);
        release_free_memory();
    }
}

impl Volume {
    fn lock(&self) -> MutexGuard<'_, crate::fusion::volume::TsdfVolume> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn color_pixels<'a>(color: &'a PyReadonlyArray3<'_, u8>, camera: &FusionCamera) -> PyResult<&'a [u8]> {
    match color.as_slice() {
        Ok(levels) if color.as_array().shape() == [camera.height, camera.width, 3] => Ok(levels),
        _ => Err(PyValueError::new_err(
            "a colour image is not contiguous h × w × 3, or its size differs from the camera's",
        )),
    }
}
