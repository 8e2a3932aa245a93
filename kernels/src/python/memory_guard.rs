//! Calls that raise MemoryError if the system runs out of memory.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use pyo3::prelude::*;

use crate::base::memory_reserve::Reserve;

/// Run `work` with a memory reserve for a number of rows of arrays (vertices, triangles, bytes). The reserve
/// must last from one cancellation check to the next.
///
/// Every function called from Python does all its work inside, including the copies of its arrays.
pub fn with_memory_reserve<R>(rows: usize, work: impl FnOnce() -> PyResult<R>) -> PyResult<R> {
    let reserve = Reserve::for_rows(rows)?;
    match catch_unwind(AssertUnwindSafe(work)) {
        // The result may be stored in the reserve, and an error may be a consequence of the shortage; so the
        // shortage takes precedence.
        Ok(outcome) => reserve.check().map_err(PyErr::from).and(outcome),
        Err(panic) => {
            reserve.check()?;
            resume_unwind(panic)
        }
    }
}
