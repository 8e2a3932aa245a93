//! Normal meshes: a base mesh and, level by level, mostly one number per vertex.
//!
//! | module | content |
//! | --- | --- |
//! | [`base_mesh`], [`coarsening`], [`half_edge`], [`needles`] | base mesh; its simplification; collapse costs; removal of needles that ordinary collapses keep |
//! | [`locking`] | rebuild of the base with more input vertices where levels fold |
//! | [`associated`], [`parameters`] | input triangles per base triangle; positions of input vertices on the base |
//! | [`domain`] | base as a parametrisation domain, with coordinates across triangles |
//! | [`predict`], [`grid`], [`level`] | step from level to level, shared by encoder and decoder |
//! | [`rounding`] | rate-distortion rounding to the grid if no levels follow |
//! | [`surface`], [`rim`], [`place`], [`found`], [`unfold`], [`fold`] | positions of new vertices: interior, boundary, and repair of folds |
//! | [`carried`] | colours and confidence |
//! | [`distance`], [`importance`] | error of a level, and vertex weights for the next trial |
//! | [`noise`], [`tolerance`] | noise of the input, and the file precision derived from it |
//! | [`input`], [`ordered`], [`refining`], [`trials`] | input mesh; quantised base in coder order; its levels; selection of the best base |
//! | [`settings`], [`header`], [`normal_mesh`] | settings; quantisation steps of a file; result |
//! | [`remesh`], [`decode`] | encoder and decoder |

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
