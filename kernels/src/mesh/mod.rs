//! Triangle meshes, and queries on them.
//!
//! | file | content |
//! | --- | --- |
//! | [`connectivity`], `connect` | halfedge structure; collapse and split; construction from triangles |
//! | [`triangle_mesh`] | connectivity, points, and the input element of every element |
//! | [`star`] | neighbourhood of an edge |
//! | [`legality`] | legality of edge collapses |
//! | [`bvh`] | bounding volume hierarchy |
//! | [`intersections`] | self-intersections |
//! | [`spatial`] | Z-order of vertices and triangles |
//! | [`validate`] | checks of all invariants of the connectivity, for tests |

pub mod bvh;
pub mod connect;
pub mod connectivity;
pub mod intersections;
pub mod legality;
pub mod spatial;
pub mod star;
pub mod triangle_mesh;
pub mod validate;
