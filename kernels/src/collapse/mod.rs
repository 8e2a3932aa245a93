//! Edge-collapse loop shared by all simplification methods. A method provides the cost and the constraints.
//!
//! | file | content |
//! | --- | --- |
//! | [`queue`] | priority queue of edges |
//! | [`engine`] | the loop over one queue; [`engine::Measure`] is the interface of a method |
//! | [`partition`] | cutting a mesh into regions |
//! | [`whole`], [`region`] | the whole mesh between rounds; cutting out regions and joining them |
//! | [`records`] | state of a method for the whole mesh between rounds |
//! | [`logs`] | collapses in an order in which they can be replayed |
//! | [`rounds`], `histogram` | the loop over a mesh of any size, region by region, in parallel |

pub mod engine;
mod histogram;
pub mod logs;
pub mod partition;
pub mod queue;
pub mod records;
pub mod region;
pub mod rounds;
pub mod whole;
