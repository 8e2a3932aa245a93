//! The one loop of edge collapses, for every method: a method says what a collapse costs and what it may not do.
//!
//! | file | what |
//! | --- | --- |
//! | [`queue`] | which edge is next |
//! | [`engine`] | the loop over one queue; an [`engine::Measure`] says what varies |
//! | [`partition`] | cutting a mesh into regions |
//! | [`whole`], [`region`] | a mesh as a whole, and the regions it is worked on in |
//! | [`records`] | what a method knows of the whole from round to round |
//! | [`logs`] | what happened, in an order in which it can be repeated |
//! | [`rounds`], `histogram` | the loop over a mesh of any size, region by region, on all threads |

pub mod engine;
mod histogram;
pub mod logs;
pub mod partition;
pub mod queue;
pub mod records;
pub mod region;
pub mod rounds;
pub mod whole;
