//! `scanloom.stages._kernels.match_pair`, `sweep_planes`, `agreeing`, `inside_all`, `not_before`,
//! `first_inside` and `weighted_medians`.

use numpy::ndarray::Array2;
use numpy::{Element, IntoPyArray, PyArray2, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::atlas::shape;
use super::detached::detached;
use super::guarded::guarded;
use crate::base::parallel::threads;
use crate::stereo::median::weighted_medians as medians_of;
use crate::stereo::planes::{Bound, Partner, Shown, words};
use crate::stereo::ranges::Ranges;
use crate::stereo::seen_by::{Matrix, Other};
use crate::stereo::volume::{LANES, Search, Size};

type Image<'py> = PyReadonlyArray3<'py, u8>;
type Map<T> = Py<PyArray2<T>>;
/// Disparity of the left and of the right image; path sum, margin and cost of the best disparity.
type Found = (Map<f32>, Map<f32>, Map<i16>, Map<i16>, Map<i16>);

fn pixels(image: &Image<'_>) -> PyResult<(Vec<[u8; 3]>, Size)> {
    let levels = image.as_array();
    let [height, width, 3] = *levels.shape() else {
        return Err(PyValueError::new_err(format!(
            "an image has shape {:?}; h × w × 3 is expected",
            levels.shape()
        )));
    };
    if width == 0 || height == 0 {
        return Err(PyValueError::new_err("an image has no pixels"));
    }
    let standard = levels.as_standard_layout();
    let chunks = standard.as_slice().unwrap_or_default().chunks_exact(3);
    Ok((chunks.map(|c| [c[0], c[1], c[2]]).collect(), Size { width, height }))
}

fn map<T: Element>(py: Python<'_>, size: Size, values: Vec<T>) -> PyResult<Map<T>> {
    Ok(Array2::from_shape_vec((size.height, size.width), values).map_err(shape)?.into_pyarray(py).unbind())
}

/// Estimate the memory of a search, in rows of 192 bytes: three volumes of two bytes per value.
fn rows_of(size: Size, count: usize) -> usize {
    size.pixels().saturating_mul(count.saturating_mul(6) / 192 + 1)
}

/// Compute the disparities of a rectified pair by semi-global matching.
#[pyfunction]
#[pyo3(signature = (left, right, *, lowest, count, wanted_threads))]
pub fn match_pair(
    py: Python<'_>,
    left: Image<'_>,
    right: Image<'_>,
    lowest: i32,
    count: usize,
    wanted_threads: usize,
) -> PyResult<Found> {
    let [height, width, _] = *left.as_array().shape() else { unreachable!("an array of three dimensions") };
    if left.as_array().shape() != right.as_array().shape() {
        return Err(PyValueError::new_err("the two images have different sizes"));
    }
    if count == 0 || !count.is_multiple_of(LANES) || count > 1 << 14 || lowest.unsigned_abs() > 1 << 20 {
        return Err(PyValueError::new_err(format!(
            "{count} disparities from {lowest} on; a multiple of {LANES} up to 16384 is expected"
        )));
    }
    guarded(rows_of(Size { width, height }, count), || {
        let ((left, size), (right, _)) = (pixels(&left)?, pixels(&right)?);
        let threads = threads(wanted_threads);
        let search = Search { lowest, count };
        let found = detached(py, None, false, |progress| {
            crate::stereo::match_pair(&left, &right, size, search, threads, progress)
        })?;
        Ok((
            map(py, size, found.disparity)?,
            map(py, size, found.of_right)?,
            map(py, size, found.sum)?,
            map(py, size, found.margin)?,
            map(py, size, found.cost)?,
        ))
    })
}

type Grey<'py> = PyReadonlyArray2<'py, u8>;
/// Warped image of a partner, its mask ([`Shown`]), and the map of each plane.
type WarpedPartner<'py> = (Grey<'py>, Grey<'py>, PyReadonlyArray2<'py, f32>);

fn size_of(shape: &[usize]) -> PyResult<Size> {
    match *shape {
        [height, width] if width > 0 && height > 0 && width.max(height) < 1 << 20 => {
            Ok(Size { width, height })
        }
        _ => Err(PyValueError::new_err(format!(
            "an image has shape {shape:?}; h × w with sides from 1 to below 2²⁰ is expected"
        ))),
    }
}

fn partner(given: &WarpedPartner<'_>, planes: usize, threads: usize) -> PyResult<Partner> {
    let (grey, shown, maps) = given;
    let size = size_of(grey.as_array().shape())?;
    if shown.as_array().shape() != grey.as_array().shape() || *maps.as_array().shape() != [planes, 3] {
        return Err(PyValueError::new_err("the mask or the maps of a partner do not match its image"));
    }
    let grey: Vec<u8> = grey.as_array().iter().copied().collect();
    let shown: Vec<u8> = shown.as_array().iter().copied().collect();
    let said = |i: usize| match shown[i] {
        0 => Shown::Nothing,
        1 => Shown::Scene,
        _ => Shown::Empty,
    };
    Ok(Partner {
        words: words(&grey, size, said, threads),
        size,
        maps: maps.as_array().rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect(),
    })
}

/// Find the best depth plane of each pixel of a view, from its partners: plane index with a fraction, and
/// margin.
#[pyfunction]
#[pyo3(signature = (grey, partners, first, count, bound = None, *, planes, wanted_threads))]
#[allow(clippy::too_many_arguments)]
pub fn sweep_planes(
    py: Python<'_>,
    grey: Grey<'_>,
    partners: Vec<WarpedPartner<'_>>,
    first: PyReadonlyArray2<'_, i32>,
    count: PyReadonlyArray2<'_, u16>,
    bound: Option<(PyReadonlyArray2<'_, f32>, f32)>,
    planes: usize,
    wanted_threads: usize,
) -> PyResult<(Map<f32>, Map<i16>)> {
    let size = size_of(grey.as_array().shape())?;
    if first.as_array().shape() != grey.as_array().shape()
        || count.as_array().shape() != grey.as_array().shape()
        || bound.as_ref().is_some_and(|(nearest, _)| nearest.as_array().shape() != grey.as_array().shape())
    {
        return Err(PyValueError::new_err("the size of first, count or bound differs from the view"));
    }
    let (first, count) = (first.as_array(), count.as_array());
    for (&first, &count) in first.iter().zip(count) {
        let end = i64::from(first) + i64::from(count);
        if first < 0 || count == 0 || usize::from(count) % LANES != 0 || end > planes as i64 {
            return Err(PyValueError::new_err(format!(
                "planes {first} to {end} are not within 0 to {planes}, or not a multiple of {LANES}"
            )));
        }
    }
    let numbers: usize = count.iter().map(|&n| usize::from(n)).sum();
    let images: usize = partners.iter().map(|one| one.0.as_array().len()).sum();
    // Three volumes of two bytes per value, and the image descriptors, in rows of 192 bytes.
    guarded(numbers / 32 + (images + size.pixels()) / 8, || {
        let threads = threads(wanted_threads);
        let partners =
            partners.iter().map(|one| partner(one, planes, threads)).collect::<PyResult<Vec<_>>>()?;
        let ranges = Ranges::new(first.iter().copied().collect(), count.iter().copied().collect());
        let grey: Vec<u8> = grey.as_array().iter().copied().collect();
        let bound = bound.as_ref().map(|(nearest, lean)| Bound {
            nearest: nearest.as_array().iter().copied().collect(),
            lean: *lean,
        });
        let found = detached(py, None, false, |progress| {
            crate::stereo::sweep(&grey, &partners, size, &ranges, bound.as_ref(), threads, progress)
        })?;
        Ok((map(py, size, found.plane)?, map(py, size, found.margin)?))
    })
}

/// Another view: the 3 × 4 projection from pixels into it, and its map.
type OtherView<'py, T> = (PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, T>);

fn other<T: Element + Copy>(given: &OtherView<'_, T>) -> PyResult<Other<T>> {
    let (matrix, map) = (given.0.as_array(), given.1.as_array());
    let size = size_of(map.shape())?;
    if *matrix.shape() != [3, 4] {
        return Err(PyValueError::new_err(format!(
            "a matrix has shape {:?}; 3 × 4 is expected",
            matrix.shape()
        )));
    }
    let from_pixels: Matrix = std::array::from_fn(|row| std::array::from_fn(|column| matrix[[row, column]]));
    Ok(Other { from_pixels, size, map: map.iter().copied().collect() })
}

/// Count the other views with a consistent depth, within the first and within the second tolerance.
#[pyfunction]
#[pyo3(signature = (depth, others, *, tolerances, wanted_threads))]
pub fn agreeing(
    py: Python<'_>,
    depth: PyReadonlyArray2<'_, f32>,
    others: Vec<OtherView<'_, f32>>,
    tolerances: [f64; 2],
    wanted_threads: usize,
) -> PyResult<(Map<u8>, Map<u8>)> {
    let size = size_of(depth.as_array().shape())?;
    let images: usize = others.iter().map(|one| one.1.as_array().len()).sum();
    guarded((images + size.pixels()) / 24, || {
        let others = others.iter().map(other).collect::<PyResult<Vec<_>>>()?;
        let depth: Vec<f32> = depth.as_array().iter().copied().collect();
        let threads = threads(wanted_threads);
        let counts =
            py.detach(|| crate::stereo::seen_by::agreeing(&depth, size, &others, tolerances, threads));
        let of = |which: usize| counts.iter().map(|count| count[which]).collect();
        Ok((map(py, size, of(0))?, map(py, size, of(1))?))
    })
}

/// Check whether points are inside the masks of all views that see them.
#[pyfunction]
#[pyo3(signature = (depth, masks, *, wanted_threads))]
pub fn inside_all(
    py: Python<'_>,
    depth: PyReadonlyArray2<'_, f32>,
    masks: Vec<OtherView<'_, bool>>,
    wanted_threads: usize,
) -> PyResult<Map<bool>> {
    let size = size_of(depth.as_array().shape())?;
    let images: usize = masks.iter().map(|one| one.1.as_array().len()).sum();
    guarded((images + 4 * size.pixels()) / 96, || {
        let masks = masks.iter().map(other).collect::<PyResult<Vec<_>>>()?;
        let depth: Vec<f32> = depth.as_array().iter().copied().collect();
        let threads = threads(wanted_threads);
        let inside = py.detach(|| crate::stereo::seen_by::inside_all(&depth, size, &masks, threads));
        map(py, size, inside)
    })
}

/// Count the other views in which nothing occludes a point: their depth is more than `share` times the
/// point's depth.
#[pyfunction]
#[pyo3(signature = (depth, others, *, share, wanted_threads))]
pub fn not_before(
    py: Python<'_>,
    depth: PyReadonlyArray2<'_, f32>,
    others: Vec<OtherView<'_, f32>>,
    share: f64,
    wanted_threads: usize,
) -> PyResult<Map<u8>> {
    let size = size_of(depth.as_array().shape())?;
    let images: usize = others.iter().map(|one| one.1.as_array().len()).sum();
    guarded((images + size.pixels()) / 24, || {
        let others = others.iter().map(other).collect::<PyResult<Vec<_>>>()?;
        let depth: Vec<f32> = depth.as_array().iter().copied().collect();
        let threads = threads(wanted_threads);
        let counts = py.detach(|| crate::stereo::seen_by::not_before(&depth, size, &others, share, threads));
        map(py, size, counts)
    })
}

/// Find the depth at which pixels' rays enter the visual hull of the masks.
#[pyfunction]
#[pyo3(signature = (wanted, masks, *, least, span, steps, wanted_threads))]
pub fn first_inside(
    py: Python<'_>,
    wanted: PyReadonlyArray2<'_, bool>,
    masks: Vec<OtherView<'_, bool>>,
    least: usize,
    span: [f64; 2],
    steps: usize,
    wanted_threads: usize,
) -> PyResult<Map<f32>> {
    let size = size_of(wanted.as_array().shape())?;
    let [near, far] = span;
    if !(near > 0.0 && far > near && far.is_finite() && steps > 0 && steps <= 1 << 20) {
        return Err(PyValueError::new_err("span must be 0 < near < far, and steps 1 to 2²⁰"));
    }
    let images: usize = masks.iter().map(|one| one.1.as_array().len()).sum();
    guarded((images + 4 * size.pixels()) / 96, || {
        let masks = masks.iter().map(other).collect::<PyResult<Vec<_>>>()?;
        let wanted: Vec<bool> = wanted.as_array().iter().copied().collect();
        let threads = threads(wanted_threads);
        let found = py.detach(|| {
            crate::stereo::seen_by::first_inside(&wanted, size, &masks, least, span, steps, threads)
        });
        map(py, size, found)
    })
}

/// Compute weighted medians of disparities at the pixels in `wanted`, with weights from colour similarity.
#[pyfunction]
#[pyo3(signature = (image, disparity, wanted, *, lowest, count, radius, falloff, wanted_threads))]
#[allow(clippy::too_many_arguments)]
pub fn weighted_medians(
    py: Python<'_>,
    image: Image<'_>,
    disparity: PyReadonlyArray2<'_, f32>,
    wanted: PyReadonlyArray2<'_, bool>,
    lowest: i32,
    count: usize,
    radius: usize,
    falloff: f32,
    wanted_threads: usize,
) -> PyResult<(Map<f32>, Map<f32>, Map<f32>)> {
    let [height, width, _] = *image.as_array().shape() else { unreachable!("an array of three dimensions") };
    let expected = [height, width];
    if disparity.as_array().shape() != expected || wanted.as_array().shape() != expected {
        return Err(PyValueError::new_err("the size of disparity or wanted differs from the image"));
    }
    if radius > 64 || count > 1 << 14 || falloff.is_nan() || falloff <= 0.0 {
        return Err(PyValueError::new_err(
            "radius must be at most 64, count at most 16384, and falloff above 0",
        ));
    }
    guarded(width * height, || {
        let (image, size) = pixels(&image)?;
        let disparity: Vec<f32> = disparity.as_array().iter().copied().collect();
        let wanted: Vec<bool> = wanted.as_array().iter().copied().collect();
        let threads = threads(wanted_threads);
        let medians = py.detach(|| {
            medians_of(&image, &disparity, &wanted, size, lowest, count, radius, falloff, threads)
        });
        Ok((
            map(py, size, medians.iter().map(|m| m.disparity).collect())?,
            map(py, size, medians.iter().map(|m| m.agreeing).collect())?,
            map(py, size, medians.iter().map(|m| m.known).collect())?,
        ))
    })
}
