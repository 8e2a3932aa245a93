//! The thin layer that Python sees as `stages._kernels`.

use pyo3::prelude::*;

#[pymodule(gil_used = false)]
fn _kernels(_module: &Bound<'_, PyModule>) -> PyResult<()> {
    Ok(())
}
