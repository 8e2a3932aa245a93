//! Level of detail: a tree of cells with progressive meshes, each level proven against the input.
//!
//! The method follows Wang, Lu and Pan, "Dynamic evaluation and modification for progressive mesh
//! hierarchies", 2012, with fitted collapses instead of half-edge collapses. A fitted collapse creates a new
//! vertex, so one vertex forest contains all levels.
//!
//! | file | content |
//! | --- | --- |
//! | [`dual_graph`] | dual graph of triangles, with links between separate components |
//! | [`clustering`] | clustering of triangles to cells, and of cells to larger cells |
//! | [`initial_cells`] | initial cells, from small clusters built in blocks |
//! | [`hierarchy`] | levels: simplify within a bound with locked cell borders, prove, join cells, repeat |
//! | [`vertex_forest`] | collapses as vertex splits, ordered so that every prefix is a mesh |
//! | [`front_assembly`] | mesh of a front of the tree |

pub mod clustering;
pub mod dual_graph;
pub mod front_assembly;
pub mod hierarchy;
pub mod initial_cells;
pub mod vertex_forest;
