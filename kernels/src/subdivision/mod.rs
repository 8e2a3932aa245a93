//! Subdivision: from a triangle list to the next, and what is kept of the step.
//!
//! | file | what |
//! | --- | --- |
//! | [`topology`] | which vertices are between which |
//! | [`butterfly`] | where they are expected |
//! | [`contents`] | whole numbers that say where they are instead |

pub mod butterfly;
pub mod contents;
pub mod topology;
