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
//! | [`sample_tracker`], [`collapsed_star`], [`input_surface`] | samples of the input that a collapse must keep within limits; nearest points on the star; nearest points on the input |
//! | [`bounded_qem`], [`bounded_seams`] | attribute quadrics and the method `seams`, restricted by the samples |
//! | `proof_cache` | cache of proofs |
//! | [`collapse_history`], `sample_owners`, `collapse_undo` | collapses that can be undone; samples per triangle; the choice of collapses to undo |

pub mod bounded_qem;
pub mod bounded_seams;
pub mod collapse_history;
mod collapse_undo;
pub mod collapsed_star;
pub mod input_surface;
pub mod proof_cache;
mod sample_owners;
pub mod sample_tracker;
pub mod simplify;
