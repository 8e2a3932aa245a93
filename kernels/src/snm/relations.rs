//! Relations of a level's edges to each other and to edges of the coarser level.

use crate::subdivision::topology::{NONE, Topology};

/// Relations between the edges of a level.
pub(super) struct Relations<'a> {
    pub topology: &'a Topology,
    /// Coding order of the edges.
    pub order: Vec<u32>,
    /// Parallel edge of the coarser level, per edge; empty on the first level.
    above: Vec<u32>,
    /// Other half of the same coarse edge; [`NONE`] for edges inside a coarse triangle.
    sibling: Vec<u32>,
}

impl<'a> Relations<'a> {
    /// Derive the relations. `coarse` holds the edges of each triangle on the coarser level.
    ///
    /// Halves of coarse edges are coded first, then edges inside coarse triangles, whose neighbours are
    /// mostly known by then. Both groups are ordered by index.
    pub(super) fn new(topology: &'a Topology, coarse: Option<&[[u32; 3]]>) -> Self {
        let count = topology.edges.len();
        let mut order: Vec<u32> = (0..count as u32).collect();
        let Some(coarse) = coarse else {
            return Self { topology, order, above: vec![], sibling: vec![] };
        };
        let mut above = vec![NONE; count];
        let mut sibling = vec![NONE; count];
        let mut first_half = vec![NONE; 1 + coarse.iter().flatten().max().map_or(0, |&edge| edge as usize)];
        let mut is_half = vec![false; count];
        for (t, edges) in topology.triangle_edges.iter().enumerate() {
            let (parent, place) = (coarse[t / 4], t % 4);
            for (corner, &edge) in edges.iter().enumerate() {
                if above[edge as usize] != NONE {
                    continue;
                }
                // The middle child is rotated by one corner relative to its parent.
                let parallel = parent[if place == 3 { (corner + 2) % 3 } else { corner }];
                above[edge as usize] = parallel;
                if place == 3 || corner == (place + 1) % 3 {
                    continue;
                }
                is_half[edge as usize] = true;
                let first = &mut first_half[parallel as usize];
                if *first == NONE {
                    *first = edge;
                } else {
                    sibling[edge as usize] = *first;
                    sibling[*first as usize] = edge;
                }
            }
        }
        order.sort_by_key(|&edge| !is_half[edge as usize]);
        Self { topology, order, above, sibling }
    }

    /// List the other edges of the triangles adjacent to `edge`.
    pub(super) fn neighbours(&self, edge: usize) -> impl Iterator<Item = usize> + use<'_> {
        let triangles = self.topology.edge_triangles[edge].into_iter().filter(|&t| t != NONE);
        let edges = triangles.flat_map(|t| self.topology.triangle_edges[t as usize]);
        edges.map(|e| e as usize).filter(move |&e| e != edge)
    }

    /// Return the parallel edge of the coarser level.
    pub(super) fn above(&self, edge: usize) -> Option<usize> {
        self.above.get(edge).map(|&e| e as usize)
    }

    /// Return the other half of the same coarse edge.
    pub(super) fn sibling(&self, edge: usize) -> Option<usize> {
        self.sibling.get(edge).filter(|&&e| e != NONE).map(|&e| e as usize)
    }
}
