//! Edge-collapse loop shared by all simplification methods. A method provides the cost and the constraints.
//!
//! | file | content |
//! | --- | --- |
//! | [`edge_queue`] | priority queue of edges |
//! | [`engine`] | the loop over one queue; [`engine::PixelMeasure`] is the interface of a method |
//! | [`partition`] | cutting a mesh into regions |
//! | [`whole_mesh`], [`region`] | the whole mesh between rounds; cutting out regions and joining them |
//! | [`method_state`] | state of a method for the whole mesh between rounds |
//! | [`collapse_log`] | collapses in an order in which they can be replayed |
//! | [`rounds`], `priority_histogram` | the loop over a mesh of any size, region by region, in parallel |

pub mod collapse_log;
pub mod edge_queue;
pub mod engine;
pub mod method_state;
pub mod partition;
mod priority_histogram;
pub mod region;
pub mod rounds;
pub mod whole_mesh;
