//! `stages._kernels.strip_order`, `encode_rows` and `encode_triangles`: buffers as EXT_meshopt_compression keeps them.
//!
//! The work is meshoptimizer's. It takes its own memory by C++, where a failure would end the process: what it needs is
//! asked for before.

use meshopt::ffi;
use numpy::{PyArray2, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use super::arrays::triangle_array;
use super::guarded::guarded;
use crate::base::errors::KernelError;
use crate::base::reserve::is_there;
use crate::mesh::connect::check_indices;

/// The version of the codec of rows that the extension names; the one of triangles is the library's own default.
const VERSION: i32 = 0;
/// Without a meaning in that version.
const LEVEL: i32 = 2;
/// Bytes that ordering takes for each vertex and triangle: lists of the triangles around vertices, and marks.
const NEEDED: usize = 64;

/// Triangles (m, 3) in an order, and with first corners, that pack well: each is next to the one before, if one is.
#[pyfunction]
pub fn strip_order(
    py: Python<'_>,
    triangles: PyReadonlyArray2<'_, i32>,
    vertices: usize,
) -> PyResult<Py<PyArray2<i32>>> {
    let count = triangles.as_array().nrows();
    guarded(count.saturating_add(vertices), || {
        let indices = checked(&triangles, vertices)?;
        if !is_there(count.saturating_add(vertices).saturating_mul(NEEDED)) {
            return Err(KernelError::OutOfMemory.into());
        }
        let ordered = py.detach(|| {
            let mut ordered = vec![0u32; indices.len()];
            // SAFETY: there are as many places as indices, and each index is below `vertices`.
            unsafe {
                ffi::meshopt_optimizeVertexCacheStrip(
                    ordered.as_mut_ptr(),
                    indices.as_ptr(),
                    indices.len(),
                    vertices,
                );
            }
            ordered
        });
        let rows: Vec<_> = ordered.chunks_exact(3).map(|row| [row[0], row[1], row[2]]).collect();
        triangle_array(py, &rows)
    })
}

/// Rows (n, k) of bytes, k a multiple of 4 up to 256, in the mode ATTRIBUTES.
#[pyfunction]
pub fn encode_rows(py: Python<'_>, rows: PyReadonlyArray2<'_, u8>) -> PyResult<Py<PyBytes>> {
    let (count, size) = rows.as_array().dim();
    if size == 0 || size > 256 || size % 4 != 0 {
        return Err(PyValueError::new_err(format!(
            "a row has {size} bytes; it must have a multiple of 4 up to 256"
        )));
    }
    guarded(count.saturating_mul(size) / 8, || {
        let bytes: Vec<u8> = rows.as_array().iter().copied().collect();
        let packed = py.detach(|| {
            // SAFETY: of a function of two numbers.
            let mut packed = vec![0u8; unsafe { ffi::meshopt_encodeVertexBufferBound(count, size) }];
            // SAFETY: `bytes` are `count` rows of `size`, and there is room for the worst case.
            let used = unsafe {
                ffi::meshopt_encodeVertexBufferLevel(
                    packed.as_mut_ptr(),
                    packed.len(),
                    bytes.as_ptr().cast(),
                    count,
                    size,
                    LEVEL,
                    VERSION,
                )
            };
            packed.truncate(used);
            packed
        });
        bytes_of(py, &packed)
    })
}

/// Triangles (m, 3) in the mode TRIANGLES; their first corners may come back as others of the same triangle.
#[pyfunction]
pub fn encode_triangles(
    py: Python<'_>,
    triangles: PyReadonlyArray2<'_, i32>,
    vertices: usize,
) -> PyResult<Py<PyBytes>> {
    guarded(triangles.as_array().nrows(), || {
        let indices = checked(&triangles, vertices)?;
        let packed = py.detach(|| {
            // SAFETY: of a function of two numbers.
            let bound = unsafe { ffi::meshopt_encodeIndexBufferBound(indices.len(), vertices) };
            let mut packed = vec![0u8; bound];
            // SAFETY: each index is below `vertices`, for which the room is the worst case.
            let used = unsafe {
                ffi::meshopt_encodeIndexBuffer(
                    packed.as_mut_ptr(),
                    packed.len(),
                    indices.as_ptr(),
                    indices.len(),
                )
            };
            packed.truncate(used);
            packed
        });
        bytes_of(py, &packed)
    })
}

fn checked(triangles: &PyReadonlyArray2<'_, i32>, vertices: usize) -> PyResult<Vec<u32>> {
    let rows = triangles.as_array();
    if rows.ncols() != 3 {
        return Err(PyValueError::new_err("a triangle has three corners"));
    }
    // What is negative is too large as well.
    let found: Vec<[u32; 3]> =
        rows.rows().into_iter().map(|row| [row[0], row[1], row[2]].map(|at| at as u32)).collect();
    check_indices(vertices, &found)?;
    Ok(found.into_iter().flatten().collect())
}

/// Bytes that Python takes memory for, which it may not have.
fn bytes_of(py: Python<'_>, packed: &[u8]) -> PyResult<Py<PyBytes>> {
    let filled = PyBytes::new_with(py, packed.len(), |bytes| {
        bytes.copy_from_slice(packed);
        Ok(())
    })?;
    Ok(filled.unbind())
}
