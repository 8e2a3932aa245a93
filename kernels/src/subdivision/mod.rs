//! Subdivision of triangle meshes, and the data of each step.
//!
//! | file | content |
//! | --- | --- |
//! | [`topology`] | connectivity of a level and its refinement |
//! | [`butterfly`] | predicted positions of new vertices |
//! | [`snm_contents`] | quantised offsets from the predictions |

pub mod butterfly;
pub mod snm_contents;
pub mod topology;
