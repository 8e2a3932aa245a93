//! Mesh kernels of scanloom: a pure library; the Python layer sits behind the `python` feature.
//!
//! | module | what |
//! | --- | --- |
//! | [`connectivity`], `connect` | halfedges on flat arrays; collapse and split; building them from triangles |
//! | [`mesh`] | connectivity + points + where every element came from |
//! | [`star`] | the neighbourhood of an edge that a collapse sees |
//! | [`legality`] | what no collapse may do |
//! | [`queue`], `front`, [`engine`] | the collapse loop; a [`engine::Measure`] says what varies |
//! | [`split`] | splitting long edges |
//! | [`jia01`], [`shape`] | texture-preserving simplification; how far a collapse takes the surface |
//! | [`partition`], [`patch`], [`rounds`], [`parallel`] | the loop over a mesh of any size, patch by patch, on all threads |
//! | [`memory`] | giving back what is free |
//! | [`spatial`] | an order in which neighbours in space are neighbours in memory |
//! | [`quadric`], [`qem`] | attribute quadrics, and the measure that uses them |
//! | [`balance`], [`trial`] | how much a colour counts: what follows from the data, and what it costs in shape |
//! | [`seams`] | surfaces whose vertices are doubled along texture seams |
//! | [`fit`] | fitting a result to its input by least squares |
//! | [`certified`], [`tracked`], [`original`], [`fan`] | simplification within proven bounds; samples of the input that steer it |
//! | [`normal`] | normal meshes: base, levels, and the search that places their vertices |
//! | [`snm`] | the file that keeps them |
//! | [`certify`], [`bvh`] | proven bounds between two surfaces; the tree they search |
//! | [`validate`] | every invariant of the connectivity, for tests |

pub mod balance;
pub mod bvh;
pub mod certified;
pub mod certify;
mod connect;
pub mod connectivity;
pub mod engine;
pub mod error;
pub mod fan;
pub mod fit;
mod front;
pub mod geometry;
pub mod ids;
pub mod jia01;
pub mod legality;
pub mod memory;
pub mod mesh;
pub mod normal;
pub mod original;
pub mod parallel;
pub mod partition;
pub mod patch;
pub mod planar;
pub mod progress;
pub mod qem;
pub mod quadric;
pub mod queue;
pub mod rounds;
pub mod seams;
pub mod shape;
pub mod snm;
pub mod spatial;
pub mod split;
pub mod star;
pub mod tracked;
pub mod trial;
pub mod validate;

#[cfg(feature = "python")]
mod python;
