//! Normal meshes: a base mesh and, level by level, one number a vertex.
//!
//! | module | what |
//! | --- | --- |
//! | [`base_mesh`], [`coarsening`], [`half_edge`], [`needles`] | the base mesh; how it is found; what a half-edge collapse costs; needles that stay otherwise |
//! | [`locking`] | the base once more, with more of the input's vertices where levels fold |
//! | [`associated`], [`parameters`] | what base triangles stand for; where the input lies on them |
//! | [`domain`] | the base as a domain: points seen from any of its triangles |
//! | [`predict`], [`grid`], [`level`] | the step from level to level, for encoder and decoder |
//! | [`rounding`] | where vertices go on the grid if no levels follow |
//! | [`surface`], [`rim`], [`place`], [`found`], [`unfold`], [`fold`] | where new vertices go: inside, on the boundary, and so that nothing folds |
//! | [`carried`] | colours and confidence |
//! | [`distance`], [`importance`] | how far off a level is, and what the next trial makes of it |
//! | [`noise`], [`tolerance`] | how rough the input is by itself, and how exact a file has to be |
//! | [`input`], [`ordered`], [`refining`], [`trials`] | what is remeshed; a base in whole numbers; its levels; which base is the best |
//! | [`settings`], [`header`], [`normal_mesh`] | what is asked for; the steps of a file; what comes out |
//! | [`remesh`], [`decode`] | from a mesh to a file and its levels, and back |

pub mod associated;
pub mod base_mesh;
pub mod carried;
pub mod coarsening;
pub mod decode;
pub mod distance;
pub mod domain;
pub mod fold;
pub mod found;
pub mod grid;
pub mod half_edge;
pub mod header;
pub mod importance;
pub mod input;
pub mod level;
pub mod locking;
pub mod needles;
pub mod noise;
pub mod normal_mesh;
pub mod ordered;
pub mod parameters;
pub mod place;
pub mod predict;
pub mod refining;
pub mod remesh;
pub mod rim;
pub mod rounding;
pub mod settings;
pub mod surface;
pub mod tolerance;
pub mod trials;
pub mod unfold;
