//! `scanloom.stages._kernels.match_descriptors`.

use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::atlas::shape_error;
use super::memory_guard::with_memory_reserve;
use crate::recognition::matching::{DESCRIPTOR_LENGTH, Descriptor, match_mutual_nearest};

fn descriptors(values: &PyReadonlyArray2<'_, u8>) -> PyResult<Vec<Descriptor>> {
    let values = values.as_array();
    if values.ncols() != DESCRIPTOR_LENGTH {
        return Err(PyValueError::new_err(format!(
            "descriptors have shape {:?}; n × {DESCRIPTOR_LENGTH} is expected",
            values.shape()
        )));
    }
    Ok(values.rows().into_iter().map(|row| std::array::from_fn(|i| row[i])).collect())
}

/// Match descriptors that are mutual nearest neighbours and pass the ratio test.
#[pyfunction]
#[pyo3(signature = (source, target, *, max_distance_ratio))]
pub fn match_descriptors(
    py: Python<'_>,
    source: PyReadonlyArray2<'_, u8>,
    target: PyReadonlyArray2<'_, u8>,
    max_distance_ratio: f32,
) -> PyResult<Py<PyArray2<i64>>> {
    if max_distance_ratio.is_nan() || max_distance_ratio <= 0.0 {
        return Err(PyValueError::new_err("max_distance_ratio must be more than 0"));
    }
    // Per descriptor: bytes, RootSIFT values and the best match in each lane, 3 rows of 192 bytes.
    let rows = source.as_array().nrows().saturating_add(target.as_array().nrows()).saturating_mul(3);
    with_memory_reserve(rows, || {
        let (source, target) = (descriptors(&source)?, descriptors(&target)?);
        let found = py.detach(|| match_mutual_nearest(&source, &target, max_distance_ratio));
        let count = found.len();
        let places = found.into_iter().flatten().map(|place| place as i64).collect();
        Ok(Array2::from_shape_vec((count, 2), places).map_err(shape_error)?.into_pyarray(py).unbind())
    })
}
