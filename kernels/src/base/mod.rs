//! What every room uses.
//!
//! | file | what |
//! | --- | --- |
//! | `by_processor` | inner loops in the widest instructions that the processor has |
//! | [`ids`] | numbers of vertices, halfedges, edges and triangles |
//! | [`errors`] | what can be wrong with a mesh |
//! | [`geometry`] | vectors, triangles, distances |
//! | [`parallel`] | work on several threads, with the same result for any number of them |
//! | [`progress`] | how far a run is, and whether to stop |
//! | [`memory`] | giving back what is free |
//! | [`reserve`] | what happens when there is no more memory |

pub(crate) mod by_processor;
pub mod errors;
pub mod geometry;
pub mod ids;
pub mod memory;
pub mod parallel;
pub mod progress;
pub mod reserve;
