//! Normal meshes: a base mesh and, level by level, one number a vertex.
//!
//! | module | what |
//! | --- | --- |
//! | [`base_mesh`], [`coarsening`], [`half_edge`], [`needles`] | the base mesh; how it is found; what a half-edge collapse costs; needles that stay otherwise |
//! | [`associated`], [`parameters`] | what base triangles stand for; where the input lies on them |
//! | [`domain`] | the base as a domain: points seen from any of its triangles |
//! | [`predict`], [`grid`], [`level`] | the step from level to level, for encoder and decoder |
//! | [`rounding`] | where vertices go on the grid if no levels follow |
//! | [`surface`], [`rim`], [`place`], [`found`], [`unfold`] | where new vertices go: inside, on the boundary, and so that nothing folds |
//! | [`carried`] | colours and confidence |
//! | [`distance`], [`importance`] | how far off a level is, and what the next trial makes of it |
//! | [`noise`], [`tolerance`] | how rough the input is by itself, and how exact a file has to be |
//! | [`remesh`], [`decode`] | from a mesh to a file and its levels, and back |

pub mod associated;
pub mod base_mesh;
pub mod carried;
pub mod coarsening;
pub mod decode;
pub mod distance;
pub mod domain;
pub mod found;
pub mod grid;
pub mod half_edge;
pub mod importance;
pub mod level;
pub mod needles;
pub mod noise;
pub mod parameters;
pub mod place;
pub mod predict;
pub mod remesh;
pub mod rim;
pub mod rounding;
pub mod surface;
pub mod tolerance;
pub mod unfold;
