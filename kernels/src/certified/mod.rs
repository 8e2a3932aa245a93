//! Simplification as far as a proof allows.
//!
//! ```text
//! limits of all samples ← a share of the bounds
//! repeat:
//!     simplify, every sample within its limits                    tracked
//!     which triangles stay within the bounds, everywhere?         certify
//!     all: done
//!     tighten the limits of the samples around the others
//!     take back the collapses that made those, and what was built on them; where it goes on failing, all around, for good
//! ```
//!
//! After the first time only what has changed is looked at. What is locked on all sides is the input itself, which is why
//! this ends.
//!
//! | file | what |
//! | --- | --- |
//! | [`simplify`] | the loop |
//! | [`tracker`], [`fan`], [`original`] | samples of the input that say whether a collapse may take place; where they fall; the input |
//! | [`tracked`], [`along_seams`] | attribute quadrics, or the method `seams`, asked only for what samples allow |
//! | `ledger` | what is proven so far |
//! | [`history`], `watched`, `retreat` | collapses that can be taken back, and which to take back |

pub mod along_seams;
pub mod fan;
pub mod history;
pub mod ledger;
pub mod original;
mod retreat;
pub mod simplify;
pub mod tracked;
pub mod tracker;
mod watched;
