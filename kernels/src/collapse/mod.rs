//! The one loop of edge collapses, for every method: a method says what a collapse costs and what it may not do.
//!
//! | file | what |
//! | --- | --- |
//! | [`queue`] | which edge is next |
//! | [`engine`] | the loop over one queue; an [`engine::Measure`] says what varies |
//! | [`partition`] | cutting a mesh into regions |
//! | [`region`] | a mesh as a whole, and the regions it is worked on in |
//! | [`rounds`] | the loop over a mesh of any size, region by region, on all threads |

pub mod engine;
pub mod partition;
pub mod queue;
pub mod region;
pub mod rounds;
