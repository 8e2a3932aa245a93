//! `scanloom.stages._kernels.give_back`.

use pyo3::prelude::*;

/// Return free memory of the allocator to the system.
#[pyfunction]
pub fn give_back(py: Python<'_>) {
    py.detach(crate::base::memory::give_back);
}
