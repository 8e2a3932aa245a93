//! `scanloom.stages._kernels.give_back`.

use pyo3::prelude::*;

/// Give free memory that the allocator holds back to the system.
#[pyfunction]
pub fn give_back(py: Python<'_>) {
    py.detach(crate::base::memory::give_back);
}
