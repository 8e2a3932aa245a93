//! Level of detail: a tree of cells, each with a progressive mesh, every level proven against the input.
//!
//! Wang, Lu and Pan, "Dynamic evaluation and modification for progressive mesh hierarchies", 2012, with fitted collapses in
//! place of half-edge ones: each makes a vertex of its own, so that one forest of vertices holds all levels.
//!
//! | file | what |
//! | --- | --- |
//! | [`dual`] | which triangles are neighbours, and how islands hang together |
//! | [`cluster`] | neighbours joined to cells, and cells to larger ones |
//! | [`cells`] | the first cells, from small clusters made block by block |
//! | [`ladder`] | the levels: simplify within a bound, the cells' borders locked; prove; join cells; go on |
//! | [`forest`] | collapses as splits of vertices, in an order in which any prefix is a mesh |
//! | [`assemble`] | the mesh of a front of the tree |

pub mod assemble;
pub mod cells;
pub mod cluster;
pub mod dual;
pub mod forest;
pub mod ladder;
