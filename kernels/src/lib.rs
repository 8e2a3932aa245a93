//! Mesh kernels of scanloom: a pure Rust library, with Python bindings behind the `python` feature.
//!
//! | module | content | depends on |
//! | --- | --- | --- |
//! | [`base`] | indices, errors, geometry, threads, progress | |
//! | [`mesh`] | connectivity, legality of edge collapses, bounding volume hierarchy, spatial orders | `base` |
//! | [`subdivision`] | 1-to-4 triangle subdivision, and the data stored per level | `mesh` |
//! | [`quadrics`] | error quadrics of shape and attributes | `base` |
//! | [`collapse`] | the edge-collapse engine, multithreaded over mesh regions | `mesh` |
//! | [`fitting`] | least-squares fit of a simplified mesh to its input | `mesh` |
//! | [`certify`] | proven distance bounds between two surfaces | `mesh` |
//! | [`jia01`] | texture-preserving simplification, with a cost per changed shape and attribute | `collapse` |
//! | [`quadric`] | simplification by attribute quadrics | `collapse`, `quadrics`, `certify` |
//! | [`certified`] | simplification within proven bounds | `collapse`, `quadric`, `certify` |
//! | [`lod`] | levels of detail: a tree of cells, with proven bounds on every level | `certified`, `certify` |
//! | [`seams`] | simplification of meshes with vertices duplicated along texture seams | `collapse`, `quadrics`, `fitting` |
//! | [`planar`] | simplification by near-planar patches | `mesh` |
//! | [`atlas`] | texture atlas: flat charts of the surface, packed into images | `base` |
//! | [`texture`] | colours of a mesh from photos | `base` |
//! | [`recognition`] | matching of image descriptors | `base` |
//! | [`stereo`] | disparity of a rectified stereo pair by semi-global matching | `base` |
//! | [`fusion`] | depth maps fused into a TSDF, and surface extraction | `base` |
//! | [`refinement`] | a fused mesh without the noise of the sensor, with planes and straight creases | `fusion`, `mesh`, `planar` |
//! | [`snm`] | the file format of normal meshes | `subdivision` |
//! | [`normal`] | normal meshes: base mesh, levels, and the search for vertex positions | `collapse`, `quadrics`, `subdivision`, `snm` |

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
pub mod refinement;
pub mod seams;
pub mod snm;
pub mod stereo;
pub mod subdivision;
pub mod texture;

#[cfg(feature = "python")]
mod python;

// Integration tests of tests/, which use public names only. They are compiled into the unit-test program,
// because a separate test program would compile and optimise the whole crate a second time.
#[cfg(test)]
extern crate self as scanloom_kernels;
#[cfg(test)]
#[path = "../tests/main.rs"]
mod promises;
