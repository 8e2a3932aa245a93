//! `stages._kernels.match_pair` and `weighted_medians`.

use numpy::ndarray::Array2;
use numpy::{Element, IntoPyArray, PyArray2, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::atlas::shape;
use super::detached::detached;
use super::guarded::guarded;
use crate::base::parallel::threads;
use crate::stereo::median::weighted_medians as medians_of;
use crate::stereo::volume::{LANES, Search, Size};

type Image<'py> = PyReadonlyArray3<'py, u8>;
type Map<T> = Py<PyArray2<T>>;
/// Disparity of the left and of the right image; sum, margin and cost of the best.
type Found = (Map<f32>, Map<f32>, Map<i16>, Map<i16>, Map<i16>);

fn pixels(image: &Image<'_>) -> PyResult<(Vec<[u8; 3]>, Size)> {
    let levels = image.as_array();
    let [height, width, 3] = *levels.shape() else {
        return Err(PyValueError::new_err(format!(
            "an image is {:?}; h × w × 3 is expected",
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

/// What a search takes, as rows of 192 bytes: three volumes of two bytes.
fn rows_of(size: Size, count: usize) -> usize {
    size.pixels().saturating_mul(count.saturating_mul(6) / 192 + 1)
}

/// Disparities of a rectified pair, by semi-global matching.
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
        return Err(PyValueError::new_err("the images of a pair are of different sizes"));
    }
    if count == 0 || count % LANES != 0 || count > 1 << 14 || lowest.unsigned_abs() > 1 << 20 {
        return Err(PyValueError::new_err(format!("{count} disparities; a multiple of {LANES} is expected")));
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

/// Medians of the disparities around the pixels that `wanted` names, weighted by likeness of colour.
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
        return Err(PyValueError::new_err("disparity is of another size than its image"));
    }
    if radius > 64 || count > 1 << 14 || falloff.is_nan() || falloff <= 0.0 {
        return Err(PyValueError::new_err("a median is of at most 64 pixels each way"));
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
