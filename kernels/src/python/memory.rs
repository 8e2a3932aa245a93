//! `scanloom.stages._kernels.release_free_memory`.

use pyo3::prelude::*;

/// Return free memory of the allocator to the system.
#[pyfunction]
pub fn release_free_memory(py: Python<'_>) {
    py.detach(crate::base::memory::release_free_memory);
}
