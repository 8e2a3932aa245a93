//! Basics that every module uses.
//!
//! | file | content |
//! | --- | --- |
//! | `by_processor` | dispatch of inner loops to the widest SIMD instructions |
//! | [`components`] | connected components of a graph |
//! | [`ids`] | typed indices of vertices, halfedges, edges and triangles |
//! | [`errors`] | errors of the kernels |
//! | [`geometry`] | vectors, triangles, distances |
//! | [`parallel`] | multithreaded loops with results independent of the thread count |
//! | [`progress`] | progress counters, and cancellation |
//! | [`memory`] | return of free memory to the system |
//! | [`memory_reserve`] | reserved memory for a clean exit when the system is out of memory |

pub(crate) mod by_processor;
pub mod components;
pub mod errors;
pub mod geometry;
pub mod ids;
pub mod memory;
pub mod memory_reserve;
pub mod parallel;
pub mod progress;
