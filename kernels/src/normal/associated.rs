//! What a simplified mesh stands for: associated sets of original triangles and boundary vertices.
//!
//! Li, Li, Xu and Li, "Normal mesh generation based on Laplacian operator", 2002, section 2: when v1 collapses into
//! v2, the triangles that move along get the union of the sets of all triangles around v1. Neighbouring sets
//! overlap, on purpose. A union is a node that names its parts, so that a collapse costs its valence only; what a
//! set holds is listed once, at the end.

use crate::base::ids::{EdgeId, HalfedgeId};
use crate::mesh::connectivity::Connectivity;

const NONE: u32 = u32::MAX;

/// Sets of original triangles, one for each triangle of the mesh as it is.
#[derive(Clone, Debug)]
pub struct TriangleSets {
    /// Nodes below this are original triangles.
    originals: usize,
    /// Where the parts of each union start, and one more for the end.
    starts: Vec<u32>,
    parts: Vec<u32>,
    /// The node of each triangle.
    node: Vec<u32>,
}

impl TriangleSets {
    /// Every triangle stands for itself.
    pub fn new(triangles: usize) -> Self {
        Self { originals: triangles, starts: vec![0], parts: vec![], node: (0..triangles as u32).collect() }
    }

    /// The triangles `moved` get the union of the sets of the triangles `around`.
    pub fn unite(&mut self, around: impl Iterator<Item = usize>, moved: impl Iterator<Item = usize>) {
        let first = self.parts.len();
        for triangle in around {
            let node = self.node[triangle];
            if !self.parts[first..].contains(&node) {
                self.parts.push(node);
            }
        }
        let union = (self.originals + self.starts.len() - 1) as u32;
        self.starts.push(self.parts.len() as u32);
        moved.for_each(|triangle| self.node[triangle] = union);
    }

    /// What the sets of some triangles hold, each in the order of `number` and numbered so.
    pub fn listed(&self, triangles: impl Iterator<Item = usize>, number: &[u32]) -> Sets {
        let mut sets = Sets { starts: vec![0], members: vec![] };
        let mut seen = vec![NONE; self.originals + self.starts.len() - 1];
        let mut open = vec![];
        for (set, triangle) in triangles.enumerate() {
            open.push(self.node[triangle]);
            while let Some(node) = open.pop() {
                if std::mem::replace(&mut seen[node as usize], set as u32) == set as u32 {
                    continue;
                }
                match (node as usize).checked_sub(self.originals) {
                    None => sets.members.push(number[node as usize]),
                    Some(union) => {
                        let parts = self.starts[union] as usize..self.starts[union + 1] as usize;
                        open.extend_from_slice(&self.parts[parts]);
                    }
                }
            }
            sets.starts.push(sets.members.len());
        }
        sets.sort(number.len());
        sets
    }
}

/// Sets of numbers, each sorted.
#[derive(Clone, Debug)]
pub struct Sets {
    starts: Vec<usize>,
    members: Vec<u32>,
}

impl Sets {
    /// Sort each set, of numbers below `count`: listed by number and dealt out again, all are sorted at once.
    fn sort(&mut self, count: usize) {
        let mut ends = vec![0u32; count + 1];
        self.members.iter().for_each(|&member| ends[member as usize + 1] += 1);
        (0..count).for_each(|i| ends[i + 1] += ends[i]);
        let mut set_of = vec![(0, 0); self.members.len()];
        for set in 0..self.starts.len() - 1 {
            for &member in &self.members[self.starts[set]..self.starts[set + 1]] {
                set_of[ends[member as usize] as usize] = (set as u32, member);
                ends[member as usize] += 1;
            }
        }
        let mut next = self.starts.clone();
        for (set, member) in set_of {
            self.members[next[set as usize]] = member;
            next[set as usize] += 1;
        }
    }

    pub fn of(&self, set: usize) -> &[u32] {
        &self.members[self.starts[set]..self.starts[set + 1]]
    }

    /// The same sets in another order.
    pub fn reordered(&self, order: &[u32]) -> Self {
        let mut sets = Self { starts: vec![0], members: Vec::with_capacity(self.members.len()) };
        for &set in order {
            sets.members.extend_from_slice(self.of(set as usize));
            sets.starts.push(sets.members.len());
        }
        sets
    }

    #[inline]
    pub fn holds(&self, set: usize, member: u32) -> bool {
        self.of(set).binary_search(&member).is_ok()
    }
}

/// Chains of original boundary edges, one for each boundary edge of the mesh as it is.
#[derive(Clone, Debug)]
pub struct Chains {
    /// First and last of the chain of each edge, [`NONE`] inside.
    span: Vec<[u32; 2]>,
    /// The boundary edge after each boundary edge of the input, and its halfedge.
    after: Vec<u32>,
    halfedge: Vec<HalfedgeId>,
}

impl Chains {
    /// Every boundary edge stands for itself.
    pub fn new(connectivity: &Connectivity) -> Self {
        let slots = connectivity.edge_slots();
        let mut chains = Self {
            span: vec![[NONE; 2]; slots],
            after: vec![NONE; slots],
            halfedge: vec![HalfedgeId::NONE; slots],
        };
        for edge in connectivity.edges().filter(|&e| connectivity.is_boundary_edge(e)) {
            let [_, to] = connectivity.ends(edge);
            chains.span[edge.index()] = [edge.0; 2];
            chains.halfedge[edge.index()] = connectivity.halfedge(edge);
            chains.after[edge.index()] = connectivity.edge(connectivity.outgoing[to.index()]).0;
        }
        chains
    }

    /// Two edges have become one: the boundary edge among them, if any, hands its chain on.
    pub fn merge_sides(&mut self, kept: EdgeId, gone: EdgeId) {
        if self.span[kept.index()][0] == NONE {
            self.span[kept.index()] = self.span[gone.index()];
        }
    }

    /// The chain of a boundary edge that has become a point goes to the edge before or after it.
    pub fn append(&mut self, gone: EdgeId, before: Option<EdgeId>, after: Option<EdgeId>) {
        let [first, last] = self.span[gone.index()];
        if let Some(edge) = before {
            self.span[edge.index()][1] = last;
        } else if let Some(edge) = after {
            self.span[edge.index()][0] = first;
        }
    }

    /// Original halfedges along a boundary edge.
    pub fn halfedges(&self, edge: EdgeId) -> Vec<HalfedgeId> {
        let [first, last] = self.span[edge.index()];
        let mut halfedges = vec![];
        let mut at = first;
        while at != NONE {
            halfedges.push(self.halfedge[at as usize]);
            if at == last {
                break;
            }
            at = self.after[at as usize];
        }
        halfedges
    }
}
