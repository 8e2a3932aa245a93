//! `scanloom.stages._kernels.optimize_strip_order`, `encode_rows`, `encode_triangles`, `decode_rows` and
//! `decode_indices`: buffers of EXT_meshopt_compression.
//!
//! meshoptimizer does the work. A failed allocation in C++ would end the process, so meshoptimizer allocates
//! from the allocator of this module, which falls back to the memory reserve of the call.

use std::alloc::Layout;
use std::ffi::c_void;
use std::ptr::null_mut;

use meshopt::ffi;
use numpy::{PyArray2, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use super::arrays::triangle_array;
use super::memory_guard::with_memory_reserve;
use crate::mesh::connectivity_builder::check_indices;

/// Version of the vertex codec that the extension specifies; the index codec uses the default of the library.
const CODEC_VERSION: i32 = 0;
/// Without effect in that version.
const CODEC_LEVEL: i32 = 2;
/// Maximum decoded bytes (vertex codec) and indices (index codec) per encoded byte. A block of 256 equal rows
/// takes a quarter of a byte per column; a triangle takes a byte.
const MAX_BYTES_PER_BYTE: usize = 1024;
const MAX_INDICES_PER_BYTE: usize = 3;
/// Bytes before each block of meshoptimizer, which hold the size of the block: meshoptimizer frees blocks
/// without their size. Also the alignment that C++ expects.
const HEADER_BYTES: usize = 16;

/// Let meshoptimizer allocate from the global allocator. Call this before other functions of meshoptimizer.
pub fn set_allocator() {
    // SAFETY: the two functions match each other and never unwind.
    unsafe { ffi::meshopt_setAllocator(Some(allocate), Some(deallocate)) };
}

/// Allocate a block for meshoptimizer, like `operator new`, but without exceptions.
///
/// The reserve of a call suffices for all blocks: the ordering allocates at most 12 bytes per vertex and 17 per
/// triangle, the codecs none. It also refuses the sizes for which this function would return null.
unsafe extern "C" fn allocate(bytes: usize) -> *mut c_void {
    let Some(layout) = block_layout(bytes) else { return null_mut() };
    // SAFETY: the layout is not empty, and the header is inside the block.
    unsafe {
        let start = std::alloc::alloc(layout);
        if start.is_null() {
            std::alloc::handle_alloc_error(layout);
        }
        start.cast::<usize>().write(bytes);
        start.add(HEADER_BYTES).cast()
    }
}

/// Free a block of [`allocate`].
unsafe extern "C" fn deallocate(block: *mut c_void) {
    if block.is_null() {
        return;
    }
    // SAFETY: `allocate` returned the block, and wrote its size to the header.
    unsafe {
        let start = block.cast::<u8>().sub(HEADER_BYTES);
        let Some(layout) = block_layout(start.cast::<usize>().read()) else { return };
        std::alloc::dealloc(start, layout);
    }
}

/// Layout of a block with its header.
fn block_layout(bytes: usize) -> Option<Layout> {
    Layout::from_size_align(bytes.checked_add(HEADER_BYTES)?, HEADER_BYTES).ok()
}

/// Reorder triangles (m, 3) and their first corners for compression: each is adjacent to the one before, if
/// possible.
#[pyfunction]
pub fn optimize_strip_order(
    py: Python<'_>,
    triangles: PyReadonlyArray2<'_, i32>,
    vertices: usize,
) -> PyResult<Py<PyArray2<i32>>> {
    let count = triangles.as_array().nrows();
    with_memory_reserve(count.saturating_add(vertices), || {
        let indices = copy_indices(&triangles, vertices)?;
        let ordered = py.detach(|| {
            let mut ordered = vec![0u32; indices.len()];
            // SAFETY: the output is as long as the input, and each index is below `vertices`.
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

/// Encode rows (n, k) of bytes in the mode ATTRIBUTES; k must be a multiple of 4 up to 256.
#[pyfunction]
pub fn encode_rows(py: Python<'_>, rows: PyReadonlyArray2<'_, u8>) -> PyResult<Py<PyBytes>> {
    let (count, size) = rows.as_array().dim();
    if size == 0 || size > 256 || size % 4 != 0 {
        return Err(PyValueError::new_err(format!(
            "a row has {size} bytes; it must have a multiple of 4 up to 256"
        )));
    }
    with_memory_reserve(count.saturating_mul(size) / 8, || {
        let bytes: Vec<u8> = rows.as_array().iter().copied().collect();
        let packed = py.detach(|| {
            // SAFETY: the function only computes with two integers.
            let mut packed = vec![0u8; unsafe { ffi::meshopt_encodeVertexBufferBound(count, size) }];
            // SAFETY: `bytes` has `count` rows of `size` bytes, and the output has the worst-case size.
            let used = unsafe {
                ffi::meshopt_encodeVertexBufferLevel(
                    packed.as_mut_ptr(),
                    packed.len(),
                    bytes.as_ptr().cast(),
                    count,
                    size,
                    CODEC_LEVEL,
                    CODEC_VERSION,
                )
            };
            packed.truncate(used);
            packed
        });
        copy_to_bytes(py, &packed)
    })
}

/// Encode triangles (m, 3) in the mode TRIANGLES. Decoding may rotate the corners of a triangle.
#[pyfunction]
pub fn encode_triangles(
    py: Python<'_>,
    triangles: PyReadonlyArray2<'_, i32>,
    vertices: usize,
) -> PyResult<Py<PyBytes>> {
    with_memory_reserve(triangles.as_array().nrows(), || {
        let indices = copy_indices(&triangles, vertices)?;
        let packed = py.detach(|| {
            // SAFETY: the function only computes with two integers.
            let bound = unsafe { ffi::meshopt_encodeIndexBufferBound(indices.len(), vertices) };
            let mut packed = vec![0u8; bound];
            // SAFETY: each index is below `vertices`, and the output has the worst-case size for that.
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
        copy_to_bytes(py, &packed)
    })
}

/// Decode `count` rows of `size` bytes from the mode ATTRIBUTES.
///
/// `filter_name` is the filter to undo: "NONE", "OCTAHEDRAL", "QUATERNION" or "EXPONENTIAL".
#[pyfunction]
pub fn decode_rows(
    py: Python<'_>,
    packed: &[u8],
    count: usize,
    size: usize,
    filter_name: &str,
) -> PyResult<Py<PyBytes>> {
    if size == 0 || size > 256 || !size.is_multiple_of(4) {
        return Err(PyValueError::new_err(format!(
            "a row has {size} bytes; it must have a multiple of 4 up to 256"
        )));
    }
    let undo = filter_decoder(filter_name, size)?;
    check_decoded_size(count.saturating_mul(size), packed.len(), MAX_BYTES_PER_BYTE)?;
    let filled = PyBytes::new_with(py, count * size, |rows| {
        // SAFETY: the output has `count` rows of `size` bytes, and the decoder reads at most `packed.len()`
        // bytes.
        let code = unsafe {
            ffi::meshopt_decodeVertexBuffer(
                rows.as_mut_ptr().cast(),
                count,
                size,
                packed.as_ptr(),
                packed.len(),
            )
        };
        if code != 0 {
            return Err(damaged_error());
        }
        if let Some(undo) = undo {
            // SAFETY: as above; `filter_decoder` has checked that the filter accepts `size`.
            unsafe { undo(rows.as_mut_ptr().cast(), count, size) };
        }
        Ok(())
    })?;
    Ok(filled.unbind())
}

/// Decode `count` indices of `size` bytes (2 or 4) from the mode TRIANGLES or INDICES.
#[pyfunction]
pub fn decode_indices(
    py: Python<'_>,
    packed: &[u8],
    count: usize,
    size: usize,
    mode: &str,
) -> PyResult<Py<PyBytes>> {
    if size != 2 && size != 4 {
        return Err(PyValueError::new_err(format!("indices have {size} bytes; 2 or 4 are supported")));
    }
    let decode = match mode {
        "TRIANGLES" if count.is_multiple_of(3) => ffi::meshopt_decodeIndexBuffer,
        "INDICES" => ffi::meshopt_decodeIndexSequence,
        _ => {
            return Err(PyValueError::new_err(format!(
                "{count} indices cannot be decoded in the mode {mode}"
            )));
        }
    };
    check_decoded_size(count, packed.len(), MAX_INDICES_PER_BYTE)?;
    let filled = PyBytes::new_with(py, count * size, |indices| {
        // SAFETY: the output has `count` indices of `size` bytes, and the decoder reads at most
        // `packed.len()` bytes.
        let code = unsafe { decode(indices.as_mut_ptr().cast(), count, size, packed.as_ptr(), packed.len()) };
        if code == 0 { Ok(()) } else { Err(damaged_error()) }
    })?;
    Ok(filled.unbind())
}

type Filter = unsafe extern "C" fn(*mut std::os::raw::c_void, usize, usize);

/// Return the function that undoes a filter in place; None for "NONE".
fn filter_decoder(filter: &str, size: usize) -> PyResult<Option<Filter>> {
    let (undo, fits): (Filter, bool) = match filter {
        "NONE" => return Ok(None),
        "OCTAHEDRAL" => (ffi::meshopt_decodeFilterOct, size == 4 || size == 8),
        "QUATERNION" => (ffi::meshopt_decodeFilterQuat, size == 8),
        "EXPONENTIAL" => (ffi::meshopt_decodeFilterExp, true),
        _ => return Err(PyValueError::new_err(format!("filter {filter} is unknown"))),
    };
    if !fits {
        return Err(PyValueError::new_err(format!("filter {filter} does not support rows of {size} bytes")));
    }
    Ok(Some(undo))
}

/// Reject a decoded size that the encoded data cannot produce, so that a few bytes cannot request any amount
/// of memory.
fn check_decoded_size(asked: usize, held: usize, most: usize) -> PyResult<()> {
    if asked > held.saturating_mul(most) {
        return Err(damaged_error());
    }
    Ok(())
}

fn damaged_error() -> PyErr {
    PyValueError::new_err("the data is damaged or truncated")
}

fn copy_indices(triangles: &PyReadonlyArray2<'_, i32>, vertices: usize) -> PyResult<Vec<u32>> {
    let rows = triangles.as_array();
    if rows.ncols() != 3 {
        return Err(PyValueError::new_err("triangles must be m × 3"));
    }
    // Negative indices become too large and are rejected, too.
    let found: Vec<[u32; 3]> =
        rows.rows().into_iter().map(|row| [row[0], row[1], row[2]].map(|at| at as u32)).collect();
    check_indices(vertices, &found)?;
    Ok(found.into_iter().flatten().collect())
}

/// Copy to Python bytes; raises MemoryError if Python cannot allocate them.
fn copy_to_bytes(py: Python<'_>, packed: &[u8]) -> PyResult<Py<PyBytes>> {
    let filled = PyBytes::new_with(py, packed.len(), |bytes| {
        bytes.copy_from_slice(packed);
        Ok(())
    })?;
    Ok(filled.unbind())
}
