//! Mesh kernels of scanloom: a pure library; the Python layer sits behind the `python` feature.
//!
//! | room | what | knows |
//! | --- | --- | --- |
//! | [`base`] | ids, errors, geometry, threads, progress | |
//! | [`mesh`] | what a mesh is: connectivity, legality of a collapse, trees and orders in space | `base` |
//! | [`subdivision`] | triangles in four, and what is kept of the step | `mesh` |
//! | [`quadrics`] | quadrics of shape and attributes | `base` |
//! | [`collapse`] | the one loop of edge collapses, region by region, on all threads | `mesh` |
//! | [`fitting`] | fitting a result to its input by least squares | `mesh` |
//! | [`certify`] | proven bounds between two surfaces | `mesh` |
//! | [`jia01`] | texture-preserving simplification by what a collapse changes | `collapse` |
//! | [`quadric`] | simplification by attribute quadrics | `collapse`, `quadrics`, `certify` |
//! | [`certified`] | simplification within proven bounds | `collapse`, `quadric`, `certify` |
//! | [`lod`] | levels of detail: a tree of cells, each proven on every level | `certified`, `certify` |
//! | [`seams`] | surfaces whose vertices are doubled along texture seams | `collapse`, `quadrics`, `fitting` |
//! | [`planar`] | simplification by near-planar patches | `mesh` |
//! | [`atlas`] | the surface cut into charts that lie flat, packed into images | `base` |
//! | [`texture`] | the colours of a mesh from photos of it | `base` |
//! | [`recognition`] | descriptors of points in images, each with its likest in another | `base` |
//! | [`stereo`] | disparity of a rectified pair by semi-global matching | `base` |
//! | [`fusion`] | depth maps fused into a field of distances, and its surface | `base` |
//! | [`snm`] | the file that keeps normal meshes | `subdivision` |
//! | [`normal`] | normal meshes: base, levels, and the search that places their vertices | `collapse`, `quadrics`, `subdivision`, `snm` |

pub mod atlas;
pub mod base;
pub mod certified;
pub mod certify;
pub mod collapse;
pub mod fitting;
pub mod fusion;
pub mod jia01;
pub mod lod;
pub mod mesh;
pub mod normal;
pub mod planar;
pub mod quadric;
pub mod quadrics;
pub mod recognition;
pub mod seams;
pub mod snm;
pub mod stereo;
pub mod subdivision;
pub mod texture;

#[cfg(feature = "python")]
mod python;

// What tests/ holds the rooms to, by their public names alone. It is compiled with the tests within the rooms, as one
// program: beside it, as a program of its own, it would have the whole crate compiled and optimised twice.
#[cfg(test)]
extern crate self as scanloom_kernels;
#[cfg(test)]
#[path = "../tests/main.rs"]
mod promises;
