//! `scanloom.stages._kernels.MeshRenderer`, `Photo`, `View`, `SurfacePoints` and `TexturedSurface`.

use std::sync::{Arc, Mutex};

use numpy::ndarray::{Array2, Array3};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
    PyReadwriteArray2,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::arrays::{copy_triangles, rows};
use super::atlas::{copy_corners, shape_error};
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use crate::base::parallel::{collect, resolve_thread_count};
use crate::texture::blending::{BlendWeights, NO_VIEW, blend_points};
use crate::texture::mesh_clusters::MeshClusters;
use crate::texture::neighbour_colors::collect_neighbours;
use crate::texture::photo_sampling::PhotoPixels as Pixels;
use crate::texture::photo_view::{DepthImage, PhotoColors, PhotoView as Photographed, PhotoWarp, ViewKind};
use crate::texture::pinhole_camera::PinholeCamera;
use crate::texture::rendering::{TexturedMesh, render_textured as shaded};
use crate::texture::seam_levelling::level_seams;
use crate::texture::surface_points::{MAX_SAMPLES, SurfacePoints as Points};
use crate::texture::zbuffer::{NO_TRIANGLE, render_zbuffer as drawn};

/// fx, fy, cx, cy, width, height; and the (4, 4) world-to-camera matrix.
type CameraTuple<'py> = ((f64, f64, f64, f64, usize, usize), PyReadonlyArray2<'py, f64>);
type FloatMap<'py> = PyReadonlyArray2<'py, f32>;
type RgbArray<'py> = PyReadonlyArray3<'py, u8>;
/// Depth and triangle at each pixel.
type RenderedArrays = (Py<PyArray2<f32>>, Py<PyArray2<i32>>);
/// Colours of pixels, and mask of textured pixels.
type ShadedArrays = (Py<PyArray3<u8>>, Py<PyArray2<bool>>);
/// Views, colours and scores of samples.
type SampleArrays = (Py<PyArray2<i32>>, Py<PyArray3<u8>>, Py<PyArray2<f32>>);
/// Pairs of points, and their colours.
type NeighbourArrays = (Py<PyArray2<u32>>, Py<PyArray3<u8>>);
/// Colours, best views and view counts of points.
type BlendedArrays = (Py<PyArray2<f32>>, Py<PyArray1<i32>>, Py<PyArray1<u8>>);

fn copy_camera(camera: &CameraTuple<'_>) -> PyResult<PinholeCamera> {
    let ((fx, fy, cx, cy, width, height), ref pose) = *camera;
    let pose = pose.as_array();
    if pose.shape() != [4, 4] || width < 2 || height < 2 {
        return Err(PyValueError::new_err(
            "a camera must have an image of at least 2 × 2 pixels and a 4 × 4 pose",
        ));
    }
    Ok(PinholeCamera {
        focal: [fx, fy],
        centre: [cx, cy],
        width,
        height,
        rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|k| pose[[i, k]])),
        translation: [0, 1, 2].map(|i| pose[[i, 3]]),
    })
}

/// Mesh for rendering from many cameras.
#[pyclass(frozen, module = "scanloom.stages._kernels")]
pub struct MeshRenderer(MeshClusters);

#[pymethods]
impl MeshRenderer {
    #[new]
    fn new(vertices: PyReadonlyArray2<'_, f64>, triangles: PyReadonlyArray2<'_, i32>) -> PyResult<Self> {
        with_memory_reserve(vertices.as_array().nrows() + triangles.as_array().nrows(), || {
            let points = rows::<f64, 3>(&vertices)?;
            let triangles = copy_triangles(&triangles, points.len())?;
            crate::mesh::connectivity_builder::check_indices(points.len(), &triangles)?;
            Ok(Self(MeshClusters::new(&points, &triangles)))
        })
    }

    /// Render depth and triangle at each pixel of a camera; infinity and −1 where nothing is visible.
    #[pyo3(signature = (camera, *, near))]
    fn render_zbuffer(&self, py: Python<'_>, camera: CameraTuple<'_>, near: f64) -> PyResult<RenderedArrays> {
        let camera = copy_camera(&camera)?;
        with_memory_reserve(camera.width * camera.height / 16, || {
            let seen = py.detach(|| drawn(&self.0, &camera, near));
            let size = (camera.height, camera.width);
            let numbers =
                seen.triangle.into_iter().map(|t| if t == NO_TRIANGLE { -1 } else { t as i32 }).collect();
            Ok((
                Array2::from_shape_vec(size, seen.depth).map_err(shape_error)?.into_pyarray(py).unbind(),
                Array2::from_shape_vec(size, numbers).map_err(shape_error)?.into_pyarray(py).unbind(),
            ))
        })
    }

    /// Return the cluster of each triangle (m,). Clusters are small and compact, and consecutive clusters are
    /// close in space.
    fn triangle_clusters(&self, py: Python<'_>) -> Py<PyArray1<u32>> {
        PyArray1::from_vec(py, self.0.triangle_clusters()).unbind()
    }
}

/// Photo of a camera.
#[pyclass(frozen, module = "scanloom.stages._kernels")]
pub struct Photo(Arc<PhotoColors>);

#[pymethods]
impl Photo {
    #[new]
    #[pyo3(signature = (camera, photo, blurred, *, warp))]
    fn new(
        camera: CameraTuple<'_>,
        photo: RgbArray<'_>,
        blurred: RgbArray<'_>,
        warp: Option<PyReadonlyArray3<'_, f32>>,
    ) -> PyResult<Self> {
        let camera = copy_camera(&camera)?;
        let (photo, blurred) = (copy_image(&photo)?, copy_image(&blurred)?);
        for picture in [&photo, &blurred] {
            if (picture.width, picture.height) != (camera.width, camera.height) {
                return Err(PyValueError::new_err("the size of a photo differs from its camera's"));
            }
        }
        let warp = warp.map(|warp| copy_warp(&warp)).transpose()?;
        Ok(Self(Arc::new(PhotoColors { camera, photo, blurred, warp })))
    }
}

/// Photo with the rendered mesh and the measured depth of its view.
#[pyclass(frozen, module = "scanloom.stages._kernels")]
pub struct View(Photographed);

#[pymethods]
impl View {
    #[new]
    #[pyo3(signature = (photo, mesh_camera, mesh_nearest, mesh_depth, mesh_triangles, *, reach, measured, weight, min_cosine))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        photo: &Photo,
        mesh_camera: CameraTuple<'_>,
        mesh_nearest: FloatMap<'_>,
        mesh_depth: FloatMap<'_>,
        mesh_triangles: PyReadonlyArray2<'_, i32>,
        reach: (f64, f64),
        measured: Option<(CameraTuple<'_>, FloatMap<'_>, FloatMap<'_>)>,
        weight: f32,
        min_cosine: f64,
    ) -> PyResult<Self> {
        let mesh = copy_depths(&mesh_camera, &mesh_nearest, &mesh_depth, reach.0)?;
        let triangles: Vec<u32> =
            mesh_triangles.as_array().iter().map(|&t| if t < 0 { NO_TRIANGLE } else { t as u32 }).collect();
        let measured = measured
            .map(|(camera, nearest, depth)| copy_depths(&camera, &nearest, &depth, reach.1))
            .transpose()?;
        let colors = Arc::clone(&photo.0);
        let place = colors.camera.camera_center();
        let is_drawn_in_size = mesh.camera.has_same_intrinsics(&colors.camera);
        let view = Photographed {
            colors,
            camera_center: place,
            mesh,
            triangles,
            is_rendered_at_photo_size: is_drawn_in_size,
            measured,
            weight,
            min_cosine,
        };
        Ok(Self(view))
    }
}

fn copy_image(image: &RgbArray<'_>) -> PyResult<Pixels> {
    let pixels = image.as_array();
    let [height, width, channels] = *pixels.shape() else { unreachable!("an array of three dimensions") };
    if channels != 3 || width < 2 || height < 2 {
        return Err(PyValueError::new_err(format!(
            "an image has shape {:?}; h × w × 3 of at least 2 × 2 pixels is expected",
            pixels.shape()
        )));
    }
    let standard = pixels.as_standard_layout();
    let levels = standard.as_slice().unwrap_or_default().chunks_exact(3);
    Ok(Pixels { width, height, pixels: levels.map(|c| [c[0], c[1], c[2], 0]).collect() })
}

fn copy_depths(
    camera: &CameraTuple<'_>,
    nearest: &FloatMap<'_>,
    exact: &FloatMap<'_>,
    reach: f64,
) -> PyResult<DepthImage> {
    let camera = copy_camera(camera)?;
    let [nearest, exact] = [nearest, exact].map(|map| map.as_array());
    if [&nearest, &exact].iter().any(|map| map.shape() != [camera.height, camera.width]) {
        return Err(PyValueError::new_err("the size of a depth map differs from its camera's"));
    }
    let [nearest, exact] = [nearest, exact]
        .map(|map| map.as_slice().map_or_else(|| map.iter().copied().collect(), <[f32]>::to_vec));
    Ok(DepthImage { camera, nearest, exact, reach })
}

fn copy_warp(warp: &PyReadonlyArray3<'_, f32>) -> PyResult<PhotoWarp> {
    let warp = warp.as_array();
    let [rows, columns, 2] = *warp.shape() else {
        return Err(PyValueError::new_err("warp must be h × w × 2"));
    };
    if rows < 2 || columns < 2 {
        return Err(PyValueError::new_err("warp must have at least two rows and columns"));
    }
    let shifts = (0..rows * columns).map(|i| [0, 1].map(|k| warp[[i / columns, i % columns, k]])).collect();
    Ok(PhotoWarp { columns, rows, shifts })
}

/// Points of a surface, grouped by triangle, each with the few views that show it best.
#[pyclass(frozen, module = "scanloom.stages._kernels")]
pub struct SurfacePoints(Mutex<Points>);

/// Maximum number of pixels of an image, and maximum reach in texels, for levelling.
const MAX_PIXELS: usize = 1 << 30;
const MAX_REACH: f32 = 100.0;
/// Reserve rows for the working memory of a few threads.
const BASE_RESERVE_ROWS: usize = 100_000;

#[pymethods]
impl SurfacePoints {
    /// Create points. `point_triangles` is the triangle of each point in ascending order, `weights` are
    /// barycentric weights.
    #[new]
    #[pyo3(signature = (vertices, normals, triangles, point_triangles, weights, *, samples_per_point))]
    fn new(
        vertices: PyReadonlyArray2<'_, f64>,
        normals: PyReadonlyArray2<'_, f64>,
        triangles: PyReadonlyArray2<'_, i32>,
        point_triangles: PyReadonlyArray1<'_, u32>,
        weights: FloatMap<'_>,
        samples_per_point: usize,
    ) -> PyResult<Self> {
        with_memory_reserve(point_triangles.as_array().len(), || {
            let (points, normals) = (rows::<f64, 3>(&vertices)?, rows::<f64, 3>(&normals)?);
            let triangles = copy_triangles(&triangles, points.len())?;
            crate::mesh::connectivity_builder::check_indices(points.len(), &triangles)?;
            let (point_triangles, weights) = (point_triangles.as_array().to_vec(), rows::<f32, 3>(&weights)?);
            let is_sorted = point_triangles.is_sorted()
                && point_triangles.last().is_none_or(|&t| (t as usize) < triangles.len());
            if !is_sorted
                || point_triangles.len() != weights.len()
                || normals.len() != points.len()
                || !(1..=MAX_SAMPLES).contains(&samples_per_point)
            {
                return Err(PyValueError::new_err(
                    "points do not match their mesh, or samples_per_point is out of range",
                ));
            }
            let mut first = vec![0u32; triangles.len() + 1];
            point_triangles.iter().for_each(|&t| first[t as usize + 1] += 1);
            for t in 0..triangles.len() {
                first[t + 1] += first[t];
            }
            let at = |values: &[[f64; 3]], i: usize| {
                let corners = triangles[point_triangles[i] as usize].map(|v| values[v as usize]);
                crate::atlas::texels::interpolate(&weights[i], &corners)
            };
            let places = collect(point_triangles.len(), resolve_thread_count(0), |i| at(&points, i));
            let normals = collect(point_triangles.len(), resolve_thread_count(0), |i| {
                crate::base::geometry::normalize(&at(&normals, i)).map(|x| x as f32)
            });
            Ok(Self(Mutex::new(Points::new(
                &places,
                normals,
                first,
                triangles,
                points.len(),
                samples_per_point,
            )?)))
        })
    }

    /// Add the samples of one more view, and return the triangles that it may show. View indices are below
    /// 65,535. With `remember`, `update_view_colors` can update the view later.
    #[pyo3(signature = (view, number, *, remember, wanted_threads))]
    fn add_view(
        &self,
        py: Python<'_>,
        view: &View,
        number: u16,
        remember: bool,
        wanted_threads: usize,
    ) -> PyResult<Py<PyArray1<u32>>> {
        with_memory_reserve(0, || {
            let found = run_detached(py, None, false, |progress| {
                self.lock().add_view(
                    &view.0,
                    number,
                    remember,
                    resolve_thread_count(wanted_threads),
                    progress,
                )
            })?;
            Ok(PyArray1::from_vec(py, found).unbind())
        })
    }

    /// Update the colours of a view's samples at the points for which it is one of the best.
    #[pyo3(signature = (photo, number, *, wanted_threads))]
    fn update_view_colors(
        &self,
        py: Python<'_>,
        photo: &Photo,
        number: u16,
        wanted_threads: usize,
    ) -> PyResult<()> {
        with_memory_reserve(0, || {
            run_detached(py, None, false, |progress| {
                self.lock().update_view_colors(
                    &photo.0,
                    number,
                    resolve_thread_count(wanted_threads),
                    progress,
                )
            })
        })
    }

    /// Return views (n, k) by descending score, −1 for none; colours (n, k, 3) and scores (n, k).
    fn samples(&self, py: Python<'_>) -> PyResult<SampleArrays> {
        let points = self.lock();
        let (n, k) = (points.len(), points.samples_per_point());
        with_memory_reserve(n * k, || {
            let (mut views, mut colors, mut scores) = (vec![-1; n * k], vec![0; n * k * 3], vec![0.0; n * k]);
            let mut order = Vec::with_capacity(k);
            for point in 0..n {
                let samples = points.samples(point);
                order.clear();
                order.extend(0..samples.len());
                order.sort_by(|&a, &b| samples.is_better(b, a).cmp(&samples.is_better(a, b)));
                for (i, &sample) in (point * k..).zip(&order) {
                    (views[i], scores[i]) = (samples.views[sample].into(), samples.scores[sample]);
                    colors[3 * i..][..3].copy_from_slice(&samples.colors[sample][0]);
                }
            }
            Ok((
                Array2::from_shape_vec((n, k), views).map_err(shape_error)?.into_pyarray(py).unbind(),
                Array3::from_shape_vec((n, k, 3), colors).map_err(shape_error)?.into_pyarray(py).unbind(),
                Array2::from_shape_vec((n, k), scores).map_err(shape_error)?.into_pyarray(py).unbind(),
            ))
        })
    }

    /// Return the maximum resolution over all views in pixels per metre (n,); 0 where no view shows a point.
    fn density(&self, py: Python<'_>) -> Py<PyArray1<f32>> {
        PyArray1::from_slice(py, &self.lock().density).unbind()
    }

    /// Return the mask (n,) of points that are only seen at grazing angles.
    fn grazing_mask(&self, py: Python<'_>) -> Py<PyArray1<bool>> {
        let points = self.lock();
        PyArray1::from_vec(py, points.looks.iter().map(|&look| look == ViewKind::Grazing).collect()).unbind()
    }

    /// Blend the samples: colours (n, 3), the best inlier view (n,), −1 for none, and the number of inlier
    /// views (n,).
    #[pyo3(signature = (*, blurred, details, deviations, levels, wanted_threads))]
    fn blend(
        &self,
        py: Python<'_>,
        blurred: i32,
        details: i32,
        deviations: f32,
        levels: f32,
        wanted_threads: usize,
    ) -> PyResult<BlendedArrays> {
        let weights = BlendWeights {
            low_exponent: blurred,
            detail_exponent: details,
            max_deviations: deviations,
            min_levels: levels,
        };
        let points = self.lock();
        with_memory_reserve(points.len(), || {
            let found = run_detached(py, None, false, |progress| {
                blend_points(&points, &weights, resolve_thread_count(wanted_threads), progress)
            })?;
            let colors = found.colors.into_flattened();
            let labels = found.labels.into_iter().map(|l| if l == NO_VIEW { -1 } else { l.into() }).collect();
            Ok((
                Array2::from_shape_vec((points.len(), 3), colors)
                    .map_err(shape_error)?
                    .into_pyarray(py)
                    .unbind(),
                PyArray1::from_vec(py, labels).unbind(),
                PyArray1::from_vec(py, found.views).unbind(),
            ))
        })
    }

    /// Level colours (n, 3) in place, where the set of contributing photos changes between texels. `pixels`
    /// (n,) are row × width + column of an image.
    #[pyo3(signature = (colors, pixels, *, width, reach, wanted_threads))]
    fn level_seams(
        &self,
        py: Python<'_>,
        mut colors: PyReadwriteArray2<'_, f32>,
        pixels: PyReadonlyArray1<'_, u32>,
        width: usize,
        reach: f32,
        wanted_threads: usize,
    ) -> PyResult<()> {
        let points = self.lock();
        with_memory_reserve(points.len() + BASE_RESERVE_ROWS, || {
            let (colors, pixels) = (colors.as_slice_mut()?.as_chunks_mut::<3>().0, pixels.as_slice()?);
            if [colors.len(), pixels.len()] != [points.len(); 2]
                || !is_valid_image(pixels, width)
                || !(1.0..=MAX_REACH).contains(&reach)
            {
                return Err(PyValueError::new_err(
                    "colours or pixels do not match the points or the image, or reach is out of range",
                ));
            }
            run_detached(py, None, false, |progress| {
                level_seams(
                    &points,
                    colors,
                    pixels,
                    width,
                    reach,
                    resolve_thread_count(wanted_threads),
                    progress,
                )
            })
        })
    }

    /// Collect adjacent points (k, 2) in every `row_step`-th row of an image, and their colours (k, 2, 3) in
    /// the photo with the highest weight (`labels`, (n,), −1 for none) at the first point, or else at the
    /// second.
    #[pyo3(signature = (labels, pixels, *, width, row_step))]
    fn collect_neighbours(
        &self,
        py: Python<'_>,
        labels: PyReadonlyArray1<'_, i32>,
        pixels: PyReadonlyArray1<'_, u32>,
        width: usize,
        row_step: usize,
    ) -> PyResult<NeighbourArrays> {
        let points = self.lock();
        with_memory_reserve(points.len(), || {
            let (labels, pixels) = (labels.as_slice()?, pixels.as_slice()?);
            if [labels.len(), pixels.len()] != [points.len(); 2]
                || !is_valid_image(pixels, width)
                || row_step == 0
            {
                return Err(PyValueError::new_err("labels or pixels do not match the points or the image"));
            }
            let found = run_detached(py, None, false, |progress| {
                collect_neighbours(&points, labels, pixels, width, row_step, progress)
            })?;
            let count = found.pairs.len();
            let pairs =
                Array2::from_shape_vec((count, 2), found.pairs.into_flattened()).map_err(shape_error)?;
            let shown = found.shown.into_flattened().into_flattened();
            let shown = Array3::from_shape_vec((count, 2, 3), shown).map_err(shape_error)?;
            Ok((pairs.into_pyarray(py).unbind(), shown.into_pyarray(py).unbind()))
        })
    }
}

/// Check that pixels (row × width + column) belong to an image that is not too large.
fn is_valid_image(pixels: &[u32], width: usize) -> bool {
    let last = pixels.iter().copied().max().unwrap_or(0) as usize;
    width > 0 && last / width < MAX_PIXELS / width
}

impl SurfacePoints {
    fn lock(&self) -> std::sync::MutexGuard<'_, Points> {
        self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

/// Mesh with texture images, for rendering.
#[pyclass(frozen, module = "scanloom.stages._kernels")]
pub struct TexturedSurface {
    clusters: MeshClusters,
    points: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    corners: Vec<[[f64; 2]; 3]>,
    pages: Vec<u16>,
    images: Vec<Pixels>,
}

#[pymethods]
impl TexturedSurface {
    /// Create the surface. `corners` are in pixels of the image in `pages` of each triangle; −1 for none.
    #[new]
    fn new(
        vertices: PyReadonlyArray2<'_, f64>,
        triangles: PyReadonlyArray2<'_, i32>,
        corners: PyReadonlyArray3<'_, f64>,
        pages: PyReadonlyArray1<'_, i32>,
        images: Vec<RgbArray<'_>>,
    ) -> PyResult<Self> {
        let bytes: usize = images.iter().map(|image| image.as_array().len()).sum();
        with_memory_reserve(vertices.as_array().nrows() + triangles.as_array().nrows() + bytes / 64, || {
            let points = rows::<f64, 3>(&vertices)?;
            let triangles = copy_triangles(&triangles, points.len())?;
            crate::mesh::connectivity_builder::check_indices(points.len(), &triangles)?;
            let corners = copy_corners(&corners)?;
            let pages: Vec<u16> =
                pages.as_array().iter().map(|&p| u16::try_from(p).unwrap_or(u16::MAX)).collect();
            if corners.len() != triangles.len() || pages.len() != triangles.len() {
                return Err(PyValueError::new_err("corners and pages must have one row for each triangle"));
            }
            let images = images.iter().map(copy_image).collect::<PyResult<Vec<_>>>()?;
            let clusters = MeshClusters::new(&points, &triangles);
            Ok(Self { clusters, points, triangles, corners, pages, images })
        })
    }

    /// Render the surface from a camera: colours (h, w, 3), and mask of textured pixels.
    #[pyo3(signature = (camera, *, near))]
    fn render(&self, py: Python<'_>, camera: CameraTuple<'_>, near: f64) -> PyResult<ShadedArrays> {
        let camera = copy_camera(&camera)?;
        with_memory_reserve(camera.width * camera.height / 16, || {
            let (colors, shown) = py.detach(|| {
                let seen = drawn(&self.clusters, &camera, near);
                let mesh = TexturedMesh {
                    points: &self.points,
                    triangles: &self.triangles,
                    corners: &self.corners,
                    pages: &self.pages,
                    images: &self.images,
                };
                shaded(&mesh, &seen, &camera)
            });
            let (h, w) = (camera.height, camera.width);
            let colors = colors.into_flattened();
            Ok((
                Array3::from_shape_vec((h, w, 3), colors).map_err(shape_error)?.into_pyarray(py).unbind(),
                Array2::from_shape_vec((h, w), shown).map_err(shape_error)?.into_pyarray(py).unbind(),
            ))
        })
    }
}
