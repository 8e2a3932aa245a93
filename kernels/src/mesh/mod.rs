//! What a mesh is, and what can be asked of it.
//!
//! | file | what |
//! | --- | --- |
//! | [`connectivity`], `connect` | halfedges on flat arrays; collapse and split; building them from triangles |
//! | [`triangle_mesh`] | connectivity + points + where every element came from |
//! | [`star`] | the neighbourhood of an edge that a collapse sees |
//! | [`legality`] | what no collapse may do |
//! | [`bvh`] | the tree of boxes that searches walk |
//! | [`intersections`] | triangles that meet elsewhere than the mesh says |
//! | [`spatial`] | an order in which neighbours in space are neighbours in memory |
//! | [`validate`] | every invariant of the connectivity, for tests |

pub mod bvh;
pub mod connect;
pub mod connectivity;
pub mod intersections;
pub mod legality;
pub mod spatial;
pub mod star;
pub mod triangle_mesh;
pub mod validate;
