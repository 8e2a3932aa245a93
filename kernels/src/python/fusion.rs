//! `scanloom.stages._kernels.oriented_depth`, `touched_blocks` and `Volume`.

use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::ndarray::{Array2, Array3};
use numpy::{
    Element, IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::triangle_array;
use super::atlas::shape;
use super::detached::detached;
use super::guarded::guarded;
use crate::base::memory::give_back;
use crate::base::parallel::threads;
use crate::fusion::field::VOXELS;
use crate::fusion::filter::{Limits, oriented};
use crate::fusion::integrate::versions;
use crate::fusion::order::block;
use crate::fusion::surface::{BlockBox, surface};
use crate::fusion::touch::{Surface, touched};
use crate::fusion::view::{Affine, Camera, Images, View, Weighing};

/// fx, fy, cx, cy, width, height.
type Pinhole = (f64, f64, f64, f64, usize, usize);
/// Intrinsics with the (4, 4) camera-to-world matrix.
type Posed<'py> = (Pinhole, PyReadonlyArray2<'py, f64>);
type Map<'py> = PyReadonlyArray2<'py, f32>;
type NewMap = Py<PyArray2<f32>>;
/// Blocks (n, 3), distances (n, 512) in truncations, weights, observation counts, and colours (n, 512, 3) if
/// the volume has colours.
type Voxels =
    (Py<PyArray2<i32>>, Py<PyArray2<f32>>, Py<PyArray2<u16>>, Py<PyArray2<u8>>, Option<Py<PyArray3<f32>>>);

/// Vertices, triangles, colours and observation counts.
type Extracted = (Py<PyArray2<f64>>, Py<PyArray2<i32>>, Py<PyArray2<f32>>, Py<PyArray1<f32>>);

/// Vertices to stitch: block keys and edge codes of foreign vertices; and block keys, edge codes and indices
/// of shared vertices.
type Joints = [Py<PyArray1<u64>>; 5];
/// First block of a box along each axis, and the end (exclusive).
type Corners = ([i32; 3], [i32; 3]);

fn boxed((low, high): Corners) -> BlockBox {
    BlockBox { low, high }
}

/// Maximum number of pixels, so that 32-bit indices suffice.
const MOST_PIXELS: usize = 1 << 30;
/// Image sides must be shorter, because single precision represents all integers only up to this value.
const LONGEST: usize = 1 << 24;

fn camera(posed: &Posed<'_>) -> PyResult<Camera> {
    let (pinhole, ref pose) = *posed;
    let pose = pose.as_array();
    if pose.shape() != [4, 4] || !pose.iter().all(|x| x.is_finite()) {
        return Err(PyValueError::new_err("the camera pose must be a finite 4 × 4 matrix"));
    }
    at(pinhole, [0, 1, 2].map(|i| [0, 1, 2, 3].map(|k| pose[[i, k]])))
}

fn at((fx, fy, cx, cy, width, height): Pinhole, pose: Affine) -> PyResult<Camera> {
    if ![fx, fy, cx, cy].iter().all(|x| x.is_finite()) || fx <= 0.0 || fy <= 0.0 {
        return Err(PyValueError::new_err(
            "the camera must have finite focal lengths above 0, and a finite principal point",
        ));
    }
    let is_small = width.max(height) < LONGEST && (width + 1).saturating_mul(height + 1) <= MOST_PIXELS;
    if width == 0 || height == 0 || !is_small {
        return Err(PyValueError::new_err(
            "a camera image must have at least one pixel, fewer than 2³⁰ pixels, and sides below 2²⁴ pixels",
        ));
    }
    Ok(Camera::new((width, height), [fx, fy], [cx, cy], pose))
}

/// Return the pixels of an image, row by row; checks that its size is the camera's.
fn pixels<'a, T: Element>(image: &'a PyReadonlyArray2<'_, T>, camera: &Camera) -> PyResult<&'a [T]> {
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
pub fn oriented_depth(
    py: Python<'_>,
    depth: Map<'_>,
    pinhole: Pinhole,
    limits: (f32, f32, f32, f32),
    wanted_threads: usize,
) -> PyResult<(NewMap, (NewMap, NewMap, NewMap), NewMap)> {
    let camera = at(pinhole, [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])?;
    guarded(camera.width * camera.height, || {
        let depth = pixels(&depth, &camera)?.to_vec();
        let (nearest, farthest, jump, cosine) = limits;
        let limits = Limits { nearest, farthest, jump, cosine };
        let found = py.detach(|| oriented(depth, &camera, limits, threads(wanted_threads)));
        let map = |values| {
            let map = Array2::from_shape_vec((camera.height, camera.width), values).map_err(shape)?;
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
pub fn touched_blocks(
    py: Python<'_>,
    camera: Posed<'_>,
    depth: Map<'_>,
    normal: (Map<'_>, Map<'_>, Map<'_>),
    obliqueness: Map<'_>,
    wanted: PyReadonlyArray2<'_, bool>,
    voxel_size: f64,
    truncation: f32,
    within: Option<Corners>,
) -> PyResult<Py<PyArray1<u64>>> {
    let camera = self::camera(&camera)?;
    guarded(camera.width * camera.height, || {
        let surface = Surface {
            depth: pixels(&depth, &camera)?,
            normal: [pixels(&normal.0, &camera)?, pixels(&normal.1, &camera)?, pixels(&normal.2, &camera)?],
            obliqueness: pixels(&obliqueness, &camera)?,
            wanted: pixels(&wanted, &camera)?,
        };
        let within = within.map(boxed);
        let keys = touched(&camera, surface, voxel_size, truncation, within)?;
        Ok(PyArray1::from_vec(py, keys).unbind())
    })
}

/// TSDF volume in blocks of 8³ voxels.
#[pyclass(frozen, module = "scanloom.stages._kernels")]
pub struct Volume {
    inner: Mutex<crate::fusion::volume::Volume>,
    truncation: f32,
}

#[pymethods]
impl Volume {
    /// Create an empty volume. Lengths are in metres; the truncation is along the surface normal.
    #[new]
    #[pyo3(signature = (voxel_size, truncation, *, color, most_blocks, instructions = None))]
    fn new(
        voxel_size: f64,
        truncation: f64,
        color: bool,
        most_blocks: usize,
        instructions: Option<&str>,
    ) -> PyResult<Self> {
        let are_sound = [voxel_size, truncation].iter().all(|x| x.is_finite() && *x > 0.0);
        if !are_sound {
            return Err(PyValueError::new_err("voxel_size and truncation must be above 0"));
        }
        let wanted = instructions.unwrap_or(versions()[0].0);
        let Some((_, add)) = versions().into_iter().find(|(name, _)| *name == wanted) else {
            return Err(PyValueError::new_err(format!("this processor does not support {wanted}")));
        };
        let field = crate::fusion::volume::Volume::new(voxel_size, truncation, color, most_blocks).using(add);
        Ok(Self { inner: Mutex::new(field), truncation: truncation as f32 })
    }

    /// List the instruction sets that this processor supports, widest first; all give identical bits.
    #[staticmethod]
    fn instructions() -> Vec<&'static str> {
        versions().into_iter().map(|(name, _)| name).collect()
    }

    /// Number of blocks in use.
    #[getter]
    fn blocks(&self) -> usize {
        self.locked().blocks().count()
    }

    /// Memory of the voxels in bytes.
    #[getter]
    fn bytes(&self) -> usize {
        self.locked().blocks().bytes()
    }

    /// Compute the histogram (256,) of observation counts of voxels near the surface, in a box of blocks.
    #[pyo3(signature = (*, within))]
    fn frame_counts(&self, py: Python<'_>, within: Option<Corners>) -> Py<PyArray1<u64>> {
        PyArray1::from_slice(py, &self.locked().frame_counts(within.map(boxed))).unbind()
    }

    /// Integrate a frame into the blocks with the given keys; images must be contiguous. `weighing` is
    /// (typical, constant, quadratic).
    #[pyo3(signature = (keys, camera, depth, obliqueness, color, *, weighing, wanted_threads))]
    #[allow(clippy::too_many_arguments)]
    fn integrate(
        &self,
        py: Python<'_>,
        keys: PyReadonlyArray1<'_, u64>,
        camera: Posed<'_>,
        depth: Map<'_>,
        obliqueness: Map<'_>,
        color: Option<PyReadonlyArray3<'_, u8>>,
        weighing: (f32, f32, f32),
        wanted_threads: usize,
    ) -> PyResult<()> {
        let camera = self::camera(&camera)?;
        guarded(keys.as_array().len() + camera.width * camera.height, || {
            let (typical, constant, quadratic) = weighing;
            if ![typical, constant, quadratic].iter().all(|x| x.is_finite() && *x >= 0.0) {
                return Err(PyValueError::new_err("weighing must have finite values that are not negative"));
            }
            let threads = threads(wanted_threads);
            let color = color.as_ref().map(|color| levels(color, &camera)).transpose()?;
            if color.is_none() && self.locked().blocks().is_colored() {
                return Err(PyValueError::new_err(
                    "the volume has colours, but the frame has no colour image",
                ));
            }
            let images = Images {
                depth: pixels(&depth, &camera)?,
                obliqueness: pixels(&obliqueness, &camera)?,
                color,
            };
            let weighing = Weighing { typical, constant, quadratic };
            // Copied while the GIL prevents other writers.
            let view = View::new(camera, images, weighing, self.truncation, threads);
            let keys = keys.as_array().to_vec();
            detached(py, None, false, |progress| self.locked().integrate(&keys, &view, threads, progress))
        })
    }

    /// Extract the surface through voxels observed by at least `least` frames: vertices (n, 3) in voxels,
    /// triangles (m, 3), colours (n, 3) of 0 to 255, and mean observation counts (n,). `within` restricts the
    /// surface to a box of blocks; see `Joints`.
    #[pyo3(signature = (least, *, within, wanted_threads))]
    fn surface(
        &self,
        py: Python<'_>,
        least: u32,
        within: Option<Corners>,
        wanted_threads: usize,
    ) -> PyResult<(Extracted, Joints)> {
        let count = self.locked().blocks().count();
        guarded(count.saturating_mul(VOXELS / 8), || {
            // Locked by the worker thread, which needs no GIL to finish.
            let found = detached(py, None, false, |progress| {
                surface(&*self.locked(), least, within.map(boxed), threads(wanted_threads), progress)
            })?;
            let count = found.positions.len();
            let places = found.positions.into_iter().flatten().collect();
            let colors = found.samples.iter().flat_map(|sample| sample.color).collect();
            let frames = found.samples.iter().map(|sample| sample.frames).collect();
            let column = |values: Vec<u64>| PyArray1::from_vec(py, values).unbind();
            let (foreign, shared) = (&found.foreign, &found.shared);
            Ok((
                (
                    Array2::from_shape_vec((count, 3), places).map_err(shape)?.into_pyarray(py).unbind(),
                    triangle_array(py, &found.triangles)?,
                    Array2::from_shape_vec((count, 3), colors).map_err(shape)?.into_pyarray(py).unbind(),
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
    fn voxels(&self, py: Python<'_>) -> PyResult<Voxels> {
        let volume = self.locked();
        let blocks = volume.blocks();
        let count = blocks.count();
        guarded(count.saturating_mul(VOXELS), || {
            let all = (0..count).map(|slot| blocks.distances(slot));
            let places = (0..count).flat_map(|slot| block(blocks.key(slot))).collect();
            let distances = all.clone().flat_map(|one| (0..VOXELS).map(|v| one.of(v, 0))).collect();
            let weights = all.clone().flat_map(|one| one.weight.as_flattened().iter().copied()).collect();
            let frames = all.flat_map(|one| one.frames.as_flattened().iter().copied()).collect();
            let colors = blocks.is_colored().then(|| {
                let colors = (0..count).filter_map(|slot| blocks.colors(slot));
                colors.flat_map(|one| (0..VOXELS).flat_map(|v| one.of(v))).collect()
            });
            let size = (count, VOXELS);
            Ok((
                Array2::from_shape_vec((count, 3), places).map_err(shape)?.into_pyarray(py).unbind(),
                Array2::from_shape_vec(size, distances).map_err(shape)?.into_pyarray(py).unbind(),
                Array2::from_shape_vec(size, weights).map_err(shape)?.into_pyarray(py).unbind(),
                Array2::from_shape_vec(size, frames).map_err(shape)?.into_pyarray(py).unbind(),
                colors
                    .map(|colors| Array3::from_shape_vec((count, VOXELS, 3), colors).map_err(shape))
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
        *self.locked() = crate::fusion::volume::Volume::new(1.0, 1.0, false, 0);
        give_back();
    }
}

impl Volume {
    fn locked(&self) -> MutexGuard<'_, crate::fusion::volume::Volume> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn levels<'a>(color: &'a PyReadonlyArray3<'_, u8>, camera: &Camera) -> PyResult<&'a [u8]> {
    match color.as_slice() {
        Ok(levels) if color.as_array().shape() == [camera.height, camera.width, 3] => Ok(levels),
        _ => Err(PyValueError::new_err(
            "a colour image is not contiguous h × w × 3, or its size differs from the camera's",
        )),
    }
}
