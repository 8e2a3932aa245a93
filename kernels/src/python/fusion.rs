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
/// With the (4, 4) matrix that takes the camera to the field.
type Posed<'py> = (Pinhole, PyReadonlyArray2<'py, f64>);
type Map<'py> = PyReadonlyArray2<'py, f32>;
type NewMap = Py<PyArray2<f32>>;
/// Blocks (n, 3), distances (n, 512) in truncations, weights, frames, and colours (n, 512, 3) if there are any.
type Voxels =
    (Py<PyArray2<i32>>, Py<PyArray2<f32>>, Py<PyArray2<u16>>, Py<PyArray2<u8>>, Option<Py<PyArray3<f32>>>);

/// Vertices, triangles, colours and frames.
type Extracted = (Py<PyArray2<f64>>, Py<PyArray2<i32>>, Py<PyArray2<f32>>, Py<PyArray1<f32>>);

/// Vertices that others have, by the Z-order of their blocks and the codes of their edges; the same of those that others may
/// refer to, with their numbers.
type Joints = [Py<PyArray1<u64>>; 5];
/// The first block of a box along each axis, and the one after its last.
type Corners = ([i32; 3], [i32; 3]);

fn boxed((low, high): Corners) -> BlockBox {
    BlockBox { low, high }
}

/// More pixels than 32-bit numbers count.
const MOST_PIXELS: usize = 1 << 30;
/// Columns and rows from here on are not all told apart in single precision.
const LONGEST: usize = 1 << 24;

fn camera(posed: &Posed<'_>) -> PyResult<Camera> {
    let (pinhole, ref pose) = *posed;
    let pose = pose.as_array();
    if pose.shape() != [4, 4] || !pose.iter().all(|x| x.is_finite()) {
        return Err(PyValueError::new_err("a camera needs a finite 4 × 4 pose"));
    }
    at(pinhole, [0, 1, 2].map(|i| [0, 1, 2, 3].map(|k| pose[[i, k]])))
}

fn at((fx, fy, cx, cy, width, height): Pinhole, pose: Affine) -> PyResult<Camera> {
    if ![fx, fy, cx, cy].iter().all(|x| x.is_finite()) || fx <= 0.0 || fy <= 0.0 {
        return Err(PyValueError::new_err(
            "a camera needs finite focal lengths above 0, and a finite centre",
        ));
    }
    let is_small = width.max(height) < LONGEST && (width + 1).saturating_mul(height + 1) <= MOST_PIXELS;
    if width == 0 || height == 0 || !is_small {
        return Err(PyValueError::new_err(
            "a camera needs an image of a pixel at least, fewer than 2³⁰, and of sides below 2²⁴",
        ));
    }
    Ok(Camera::new((width, height), [fx, fy], [cx, cy], pose))
}

/// Pixels row by row, of an image of a camera's size.
fn pixels<'a, T: Element>(image: &'a PyReadonlyArray2<'_, T>, camera: &Camera) -> PyResult<&'a [T]> {
    match image.as_slice() {
        Ok(pixels) if image.as_array().shape() == [camera.height, camera.width] => Ok(pixels),
        _ => Err(PyValueError::new_err("an image is not contiguous, or of another size than its camera")),
    }
}

/// A depth map without gaps of one pixel and without what is torn or too oblique; normals of its surface, an image for each
/// axis, and their lengths. `limits` holds the least and greatest depth, the jump, and the least cosine.
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

/// Keys of the blocks that a frame touches, sorted; with `within`, of those from its first to before its second block alone.
/// Images are contiguous; normals are three, one for each axis.
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

/// A field of signed distances in blocks of 8³ voxels.
#[pyclass(frozen, module = "scanloom.stages._kernels")]
pub struct Volume {
    inner: Mutex<crate::fusion::volume::Volume>,
    truncation: f32,
}

#[pymethods]
impl Volume {
    /// Lengths are metres; the truncation is along the surface's normal.
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
            return Err(PyValueError::new_err(format!("this processor has no {wanted}")));
        };
        let field = crate::fusion::volume::Volume::new(voxel_size, truncation, color, most_blocks).using(add);
        Ok(Self { inner: Mutex::new(field), truncation: truncation as f32 })
    }

    /// The sets of instructions that the processor has and a field may use, the widest first; all give the same bits.
    #[staticmethod]
    fn instructions() -> Vec<&'static str> {
        versions().into_iter().map(|(name, _)| name).collect()
    }

    /// Blocks in use.
    #[getter]
    fn blocks(&self) -> usize {
        self.locked().blocks().count()
    }

    /// Memory of the voxels.
    #[getter]
    fn bytes(&self) -> usize {
        self.locked().blocks().bytes()
    }

    /// Of how many voxels near the surface each number (256,) of frames is, in a box of blocks.
    #[pyo3(signature = (*, within))]
    fn frame_counts(&self, py: Python<'_>, within: Option<Corners>) -> Py<PyArray1<u64>> {
        PyArray1::from_slice(py, &self.locked().frame_counts(within.map(boxed))).unbind()
    }

    /// Add a frame to the blocks with some keys; images are contiguous. `weighing` holds typical, constant and quadratic.
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
                return Err(PyValueError::new_err("weighing needs finite numbers that are not below 0"));
            }
            let threads = threads(wanted_threads);
            let color = color.as_ref().map(|color| levels(color, &camera)).transpose()?;
            if color.is_none() && self.locked().blocks().is_colored() {
                return Err(PyValueError::new_err("the voxels have colours, but the frame has none"));
            }
            let images = Images {
                depth: pixels(&depth, &camera)?,
                obliqueness: pixels(&obliqueness, &camera)?,
                color,
            };
            let weighing = Weighing { typical, constant, quadratic };
            // Copied while nobody else can write to them.
            let view = View::new(camera, images, weighing, self.truncation, threads);
            let keys = keys.as_array().to_vec();
            detached(py, None, false, |progress| self.locked().integrate(&keys, &view, threads, progress))
        })
    }

    /// The zero surface through voxels that `least` frames have seen: vertices (n, 3) in voxels, triangles (m, 3), colours (n, 3),
    /// 0 to 255, and mean frames (n,). Of the blocks in a box alone, if there is one: see `Joints`.
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
            // Locked by the thread that works, which needs no GIL to end.
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

    /// All voxels as they are, blocks in the order of their slots; NaN where none was seen.
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
    /// Fields come one after the other where space is cut in bricks: none is to leave its memory to the allocator.
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
            "a colour image is not contiguous h × w × 3, or not of its camera's size",
        )),
    }
}
