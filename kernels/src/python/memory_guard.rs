//! Calls that raise MemoryError if the system runs out of memory.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use pyo3::prelude::*;

use crate::base::errors::KernelError;
use crate::base::memory_reserve::Reserve;

/// Run `work` with a memory reserve for a number of rows of arrays (vertices, triangles, bytes). The reserve
/// must last from one cancellation check to the next.
///
/// Every function called from Python does all its work inside, including the copies of its arrays.
pub fn with_memory_reserve<R>(rows: usize, work: impl FnOnce() -> PyResult<R>) -> PyResult<R> {
    let (mut work, mut outcome) = (Some(work), None);
    guard_memory(rows, &mut || outcome = work.take().map(|work| work()))?;
    outcome.unwrap_or_else(|| Err(KernelError::OutOfMemory.into()))
}

/// As [`with_memory_reserve`]. Without type parameters, so that it is compiled only once.
fn guard_memory(rows: usize, work: &mut dyn FnMut()) -> PyResult<()> {
    let reserve = Reserve::for_rows(rows)?;
    match catch_unwind(AssertUnwindSafe(work)) {
        // The result may be stored in the reserve, and an error may be a consequence of the shortage; so the
        // shortage takes precedence.
        Ok(()) => Ok(reserve.check()?),
        Err(panic) => {
            reserve.check()?;
            resume_unwind(panic)
        }
    }
}
