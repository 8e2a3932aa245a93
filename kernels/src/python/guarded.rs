//! Calls that end with a MemoryError where the memory is used up.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use pyo3::prelude::*;

use crate::base::reserve::Reserve;

/// Run `work` on so many rows of arrays (vertices, triangles, bytes) with a reserve that lasts from one check to the next.
///
/// All that Python calls comes through here, and does all its work in here, with the copies of its arrays.
pub fn guarded<R>(rows: usize, work: impl FnOnce() -> PyResult<R>) -> PyResult<R> {
    let reserve = Reserve::for_rows(rows)?;
    match catch_unwind(AssertUnwindSafe(work)) {
        // What it returns may lie in the reserve, and what went wrong may have come of the shortage.
        Ok(outcome) => reserve.check().map_err(PyErr::from).and(outcome),
        Err(panic) => {
            reserve.check()?;
            resume_unwind(panic)
        }
    }
}
