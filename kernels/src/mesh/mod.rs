//! Triangle meshes, and queries on them.
//!
//! | file | content |
//! | --- | --- |
//! | [`connectivity`], `connectivity_builder` | halfedge structure; collapse and split; construction from triangles |
//! | [`triangle_mesh`] | connectivity, points, and the input element of every element |
//! | [`edge_star`] | neighbourhood of an edge |
//! | [`collapse_legality`] | legality of edge collapses |
//! | [`bvh`] | bounding volume hierarchy |
//! | [`irregular_elements`] | defects of a triangle list, and its topological counts |
//! | [`self_intersections`] | self-intersections |
//! | [`spatial_order`] | Z-order of vertices and triangles |
//! | [`vertex_triangles`] | triangles around each vertex, without halfedges |
//! | [`validation`] | checks of all invariants of the connectivity, for tests |

pub mod bvh;
pub mod collapse_legality;
pub mod connectivity;
pub mod connectivity_builder;
pub mod edge_star;
pub mod irregular_elements;
pub mod self_intersections;
pub mod spatial_order;
pub mod triangle_mesh;
pub mod validation;
pub mod vertex_triangles;
