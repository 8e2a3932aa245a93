//! Normal meshes: a base mesh and, level by level, mostly one number per vertex.
//!
//! | module | content |
//! | --- | --- |
//! | [`base_mesh`], [`coarsening`], [`half_edge_measure`], [`needle_removal`] | base mesh; its simplification; collapse costs; removal of needles that ordinary collapses keep |
//! | [`locking`] | rebuild of the base with more input vertices where levels fold |
//! | [`associated_sets`], [`base_parametrization`] | input triangles per base triangle; positions of input vertices on the base |
//! | [`domain`] | base as a parametrisation domain, with coordinates across triangles |
//! | [`prediction`], [`quantization`], [`level`] | step from level to level, shared by encoder and decoder |
//! | [`rounding`] | rate-distortion rounding to the grid if no levels follow |
//! | [`surface`], [`boundary_chains`], [`vertex_search`], [`new_vertex`], [`fold_repair`], [`fold`] | positions of new vertices: interior, boundary, and repair of folds |
//! | [`vertex_attributes`] | colours and confidence |
//! | [`distance`], [`importance`] | error of a level, and vertex weights for the next trial |
//! | [`noise`], [`tolerance`] | noise of the input, and the file precision derived from it |
//! | [`input`], [`coder_order`], [`refinement`], [`base_selection`] | input mesh; quantised base in coder order; its levels; selection of the best base |
//! | [`settings`], [`header`], [`normal_mesh`] | settings; quantisation steps of a file; result |
//! | [`remesh`], [`decode`] | encoder and decoder |

pub mod associated_sets;
pub mod base_mesh;
pub mod base_parametrization;
pub mod base_selection;
pub mod boundary_chains;
pub mod coarsening;
pub mod coder_order;
pub mod decode;
pub mod distance;
pub mod domain;
pub mod fold;
pub mod fold_repair;
pub mod half_edge_measure;
pub mod header;
pub mod importance;
pub mod input;
pub mod level;
pub mod locking;
pub mod needle_removal;
pub mod new_vertex;
pub mod noise;
pub mod normal_mesh;
pub mod prediction;
pub mod quantization;
pub mod refinement;
pub mod remesh;
pub mod rounding;
pub mod settings;
pub mod surface;
pub mod tolerance;
pub mod vertex_attributes;
pub mod vertex_search;
