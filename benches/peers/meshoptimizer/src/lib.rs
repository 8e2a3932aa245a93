//! meshoptimizer's simplifier behind C functions, for `benches/simplify.py` and `benches/textured.py`.
//!
//! The crate links the C++ library and declares the function that also updates positions and attributes;
//! it has no safe wrapper for that one yet.

use meshopt::ffi::meshopt_simplifyWithUpdate;

/// Simplifies in place to `target` triangles, whatever the error, and returns the number left.
///
/// # Safety
///
/// `indices` holds 3 · `triangles` vertex numbers; `positions` 3 and `attributes` `attribute_count` floats a
/// vertex; `weights` one a float of `attributes`. All may be written to but `weights`.
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
/// As for `simplify`; `flags` holds one byte a vertex, or is null.
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
