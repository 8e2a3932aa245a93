//! Simplification within proven bounds.
//!
//! ```text
//! limits of all samples ← a ratio of the bounds
//! repeat:
//!     collapse edges, every sample within its limits                  tracked
//!     certify: which triangles are within the bounds everywhere?      certify
//!     all proven: done
//!     tighten the limits of the samples around unproven triangles
//!     undo the collapses that produced them and all collapses built on them;
//!         after repeated failures, undo everything around and lock it
//! ```
//!
//! After the first pass, only changed triangles are certified again. The loop ends because a region whose
//! vertices are all locked is the input itself.
//!
//! | file | content |
//! | --- | --- |
//! | [`simplify`] | the loop |
//! | [`tracker`], [`fan`], [`original`] | samples of the input that a collapse must keep within limits; nearest points on the star; nearest points on the input |
//! | [`tracked`], [`along_seams`] | attribute quadrics and the method `seams`, restricted by the samples |
//! | `ledger` | cache of proofs |
//! | [`history`], `watched`, `retreat` | collapses that can be undone; samples per triangle; the choice of collapses to undo |

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
