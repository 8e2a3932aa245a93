//! C interface to meshoptimizer's simplifier, for `benches/simplify.py` and `benches/textured.py`.
//!
//! It calls `meshopt_simplifyWithUpdate`, which also updates positions and attributes, through the FFI
//! declarations: the `meshopt` crate has no safe wrapper for it yet.

use meshopt::ffi::meshopt_simplifyWithUpdate;

/// Simplifies in place to `target` triangles without an error limit; returns the number of triangles left.
///
/// # Safety
///
/// `indices` holds 3 · `triangles` vertex indices. `positions` holds 3 and `attributes` `attribute_count`
/// floats per vertex. `weights` holds `attribute_count` floats. All arrays except `weights` are written to.
#[no_mangle]
pub unsafe extern "C" fn simplify(
    indices: *mut u32,
    triangles: usize,
    positions: *mut f32,
    attributes: *mut f32,
    vertices: usize,
    weights: *const f32,
    attribute_count: usize,
    target: usize,
) -> usize {
    let null = std::ptr::null();
    unsafe {
        simplify_with_options(
            indices,
            triangles,
            positions,
            attributes,
            vertices,
            weights,
            attribute_count,
            target,
            null,
            0,
        )
    }
}

/// Simplifies like `simplify`, with the library's `meshopt_Simplify…` options and vertex flags.
///
/// # Safety
///
/// As for `simplify`; `flags` holds one byte per vertex, or is null.
#[no_mangle]
pub unsafe extern "C" fn simplify_with_options(
    indices: *mut u32,
    triangles: usize,
    positions: *mut f32,
    attributes: *mut f32,
    vertices: usize,
    weights: *const f32,
    attribute_count: usize,
    target: usize,
    flags: *const u8,
    options: u32,
) -> usize {
    let float = std::mem::size_of::<f32>();
    let left = unsafe {
        meshopt_simplifyWithUpdate(
            indices,
            3 * triangles,
            positions,
            vertices,
            3 * float,
            attributes,
            attribute_count * float,
            weights,
            attribute_count,
            flags,
            3 * target,
            f32::MAX,
            options,
            std::ptr::null_mut(),
        )
    };
    left / 3
}
