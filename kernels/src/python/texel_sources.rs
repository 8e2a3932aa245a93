//! `scanloom.stages._kernels.draw_sources`, `locate_texels`, `sample_texels` and `sample_points`.

use numpy::ndarray::Array2;
use numpy::{
    IntoPyArray, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyReadwriteArray3,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::atlas::shape_error;
use super::memory_guard::with_memory_reserve;
use crate::atlas::texels::barycentric_weights;
use crate::base::geometry::Vec3;
use crate::base::parallel::{collect, resolve_thread_count};
use crate::texture::image_sampling::{
    DrawnTriangles, SampledImage, WrapMode, sample, sample_points as samples,
};
use crate::texture::texel_sources::{Corners, OriginalTriangles, SimplifiedCharts, rasterize_meshes};

/// Maximum number of texels of an image, so that 32-bit indices suffice.
const MAX_TEXELS: usize = 1 << 30;

/// Triangles in the atlas, their charts, and their corner positions in 3-D.
type TriangleArrays<'py> =
    (PyReadonlyArray3<'py, f64>, PyReadonlyArray1<'py, i32>, PyReadonlyArray3<'py, f64>);

/// The same arrays as slices.
type TriangleSlices<'a> = (&'a [Corners], &'a [i32], &'a [[Vec3; 3]]);
/// Images of triangle indices.
type TriangleImages = (Py<PyArray2<i32>>, Py<PyArray2<i32>>);

/// Rasterise the triangles of a simplified mesh, and the triangles of its original into their charts.
///
/// Returns images (height, width) of both, with triangle indices, or −1 for none.
#[pyfunction]
#[pyo3(signature = (simplified, original, max_distances, *, width, height, wanted_threads))]
pub fn draw_sources(
    py: Python<'_>,
    simplified: TriangleArrays<'_>,
    original: TriangleArrays<'_>,
    max_distances: PyReadonlyArray1<'_, f64>,
    width: usize,
    height: usize,
    wanted_threads: usize,
) -> PyResult<TriangleImages> {
    check_size(width, height)?;
    let rows = simplified.0.len() + original.0.len();
    with_memory_reserve(rows + width * height / 8, || {
        let (corners, charts, positions) = borrow_triangles(&simplified)?;
        let of_simplified = SimplifiedCharts { corners, charts, positions };
        let (corners, charts, positions) = borrow_triangles(&original)?;
        let max_distances = max_distances.as_slice()?;
        if max_distances.len() != corners.len() {
            return Err(PyValueError::new_err("max_distances must have one value for each triangle"));
        }
        let sources = OriginalTriangles { corners, charts, positions, max_distances };
        let found = py.detach(|| {
            rasterize_meshes(of_simplified, sources, width, height, resolve_thread_count(wanted_threads))
        });
        let image = |values| Array2::from_shape_vec((height, width), values).map_err(shape_error);
        Ok((
            image(found.simplified)?.into_pyarray(py).unbind(),
            image(found.sources)?.into_pyarray(py).unbind(),
        ))
    })
}

/// Compute the barycentric weights (n, 3) of the points of triangles nearest to texel centres.
#[pyfunction]
#[pyo3(signature = (corners, triangles, texels, *, width, wanted_threads))]
pub fn locate_texels(
    py: Python<'_>,
    corners: PyReadonlyArray3<'_, f64>,
    triangles: PyReadonlyArray1<'_, i32>,
    texels: PyReadonlyArray1<'_, i64>,
    width: usize,
    wanted_threads: usize,
) -> PyResult<Py<PyArray2<f32>>> {
    with_memory_reserve(triangles.len(), || {
        let (corners, triangles, texels) =
            (borrow_corners(&corners)?, triangles.as_slice()?, texels.as_slice()?);
        let is_known = |&t: &i32| usize::try_from(t).is_ok_and(|t| t < corners.len());
        if triangles.len() != texels.len() || !triangles.iter().all(is_known) || width == 0 {
            return Err(PyValueError::new_err("texels do not match their triangles or the image"));
        }
        let weights = py.detach(|| {
            collect(texels.len(), resolve_thread_count(wanted_threads), |i| {
                let at = [texels[i].rem_euclid(width as i64), texels[i].div_euclid(width as i64)];
                barycentric_weights(&corners[triangles[i] as usize], at.map(|x| x as f64 + 0.5))
                    .map(|x| x as f32)
            })
        });
        let weights = weights.into_flattened();
        Ok(Array2::from_shape_vec((texels.len(), 3), weights).map_err(shape_error)?.into_pyarray(py).unbind())
    })
}

/// Write samples of an image into the texels of an atlas whose triangles use the image; other texels do not
/// change.
#[pyfunction]
#[pyo3(signature = (atlas, triangles, corners, uvs, uses_image, image, *, wrap, wanted_threads))]
#[allow(clippy::too_many_arguments)]
pub fn sample_texels(
    py: Python<'_>,
    mut atlas: PyReadwriteArray3<'_, u8>,
    triangles: PyReadonlyArray2<'_, i32>,
    corners: PyReadonlyArray3<'_, f64>,
    uvs: PyReadonlyArray3<'_, f64>,
    uses_image: PyReadonlyArray1<'_, bool>,
    image: PyReadonlyArray3<'_, u8>,
    wrap: (String, String),
    wanted_threads: usize,
) -> PyResult<()> {
    with_memory_reserve(0, || {
        let &[height, width, channels] = atlas.shape() else { return Err(mismatch_error("the atlas")) };
        check_size(width, height)?;
        let image = borrow_image(&image, &wrap, channels)?;
        if triangles.shape() != [height, width] {
            return Err(mismatch_error("the atlas"));
        }
        let (corners, uvs) = (borrow_corners(&corners)?, borrow_corners(&uvs)?);
        let (triangles, uses_image) = (triangles.as_slice()?, uses_image.as_slice()?);
        if uvs.len() != corners.len()
            || uses_image.len() != corners.len()
            || triangles.iter().any(|&t| t >= 0 && t as usize >= corners.len())
        {
            return Err(mismatch_error("a triangle"));
        }
        let drawn = DrawnTriangles { triangles, corners, uvs, uses_image };
        let (texels, count) = (atlas.as_slice_mut()?, resolve_thread_count(wanted_threads));
        py.detach(|| match channels {
            1 => sample::<1>(&image, &drawn, texels.as_chunks_mut().0, width, count),
            2 => sample::<2>(&image, &drawn, texels.as_chunks_mut().0, width, count),
            3 => sample::<3>(&image, &drawn, texels.as_chunks_mut().0, width, count),
            _ => sample::<4>(&image, &drawn, texels.as_chunks_mut().0, width, count),
        });
        Ok(())
    })
}

/// Sample the first channels of an image at texture coordinates (n, 2), v up.
#[pyfunction]
#[pyo3(signature = (image, uvs, *, channels, wrap, wanted_threads))]
pub fn sample_points(
    py: Python<'_>,
    image: PyReadonlyArray3<'_, u8>,
    uvs: PyReadonlyArray2<'_, f64>,
    channels: usize,
    wrap: (String, String),
    wanted_threads: usize,
) -> PyResult<Py<PyArray2<u8>>> {
    with_memory_reserve(uvs.len(), || {
        let image = borrow_image(&image, &wrap, channels)?;
        if uvs.shape()[1] != 2 || !uvs.as_slice()?.iter().all(|x| x.is_finite()) {
            return Err(mismatch_error("a texture coordinate"));
        }
        let (uvs, count) = (uvs.as_slice()?.as_chunks::<2>().0, resolve_thread_count(wanted_threads));
        let found = py.detach(|| match channels {
            1 => samples::<1>(&image, uvs, count).into_flattened(),
            2 => samples::<2>(&image, uvs, count).into_flattened(),
            3 => samples::<3>(&image, uvs, count).into_flattened(),
            _ => samples::<4>(&image, uvs, count).into_flattened(),
        });
        Ok(Array2::from_shape_vec((uvs.len(), channels), found)
            .map_err(shape_error)?
            .into_pyarray(py)
            .unbind())
    })
}

/// Borrow an image; checks that it has enough channels.
fn borrow_image<'a>(
    image: &'a PyReadonlyArray3<'_, u8>,
    wrap: &(String, String),
    channels: usize,
) -> PyResult<SampledImage<'a>> {
    let &[height, width, found] = image.shape() else { return Err(mismatch_error("the image")) };
    check_size(width, height)?;
    if !(1..=4).contains(&channels) || channels > found {
        return Err(mismatch_error("the image"));
    }
    let wrap = [parse_wrap(&wrap.0)?, parse_wrap(&wrap.1)?];
    Ok(SampledImage { pixels: image.as_slice()?, width, height, channels: found, wrap })
}

fn parse_wrap(name: &str) -> PyResult<WrapMode> {
    match name {
        "repeat" => Ok(WrapMode::Repeat),
        "clamp" => Ok(WrapMode::Clamp),
        "mirror" => Ok(WrapMode::Mirror),
        _ => Err(PyValueError::new_err(format!(
            "wrap mode {name:?} is unknown; repeat, clamp and mirror are supported"
        ))),
    }
}

fn mismatch_error(what: &str) -> PyErr {
    PyValueError::new_err(format!("{what} does not match the other arrays"))
}

fn check_size(width: usize, height: usize) -> PyResult<()> {
    if width == 0 || height == 0 || width.checked_mul(height).is_none_or(|texels| texels > MAX_TEXELS) {
        return Err(PyValueError::new_err(format!("an image of {width} × {height} is empty or too large")));
    }
    Ok(())
}

fn borrow_triangles<'a>(arrays: &'a TriangleArrays<'_>) -> PyResult<TriangleSlices<'a>> {
    let (corners, charts) = (borrow_corners(&arrays.0)?, arrays.1.as_slice()?);
    let positions = borrow_finite(&arrays.2, 3)?.as_chunks::<3>().0.as_chunks::<3>().0;
    if [charts.len(), positions.len()] != [corners.len(); 2] || corners.len() > i32::MAX as usize {
        return Err(PyValueError::new_err("charts and positions must have one row for each triangle"));
    }
    Ok((corners, charts, positions))
}

/// Borrow 2-D triangle corners, m × 3 × 2.
fn borrow_corners<'a>(array: &'a PyReadonlyArray3<'_, f64>) -> PyResult<&'a [Corners]> {
    Ok(borrow_finite(array, 2)?.as_chunks::<2>().0.as_chunks::<3>().0)
}

/// Borrow the numbers of an array m × 3 × k; checks that they are finite.
fn borrow_finite<'a>(array: &'a PyReadonlyArray3<'_, f64>, k: usize) -> PyResult<&'a [f64]> {
    if array.shape()[1..] != [3, k] {
        let found = array.shape();
        return Err(PyValueError::new_err(format!("an array has shape {found:?}; m × 3 × {k} is expected")));
    }
    let numbers = array.as_slice()?;
    if !numbers.iter().all(|x| x.is_finite()) {
        return Err(PyValueError::new_err("an array has values that are not finite"));
    }
    Ok(numbers)
}
