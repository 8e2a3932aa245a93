//! Level of detail: a tree of cells with progressive meshes, each level proven against the input.
//!
//! The method follows Wang, Lu and Pan, "Dynamic evaluation and modification for progressive mesh
//! hierarchies", 2012, with fitted collapses instead of half-edge collapses. A fitted collapse creates a new
//! vertex, so one vertex forest contains all levels.
//!
//! | file | content |
//! | --- | --- |
//! | [`dual`] | dual graph of triangles, with links between separate components |
//! | [`cluster`] | clustering of triangles to cells, and of cells to larger cells |
//! | [`cells`] | initial cells, from small clusters built in blocks |
//! | [`ladder`] | levels: simplify within a bound with locked cell borders, prove, join cells, repeat |
//! | [`forest`] | collapses as vertex splits, ordered so that every prefix is a mesh |
//! | [`assemble`] | mesh of a front of the tree |

pub mod assemble;
pub mod cells;
pub mod cluster;
pub mod dual;
pub mod forest;
pub mod ladder;
