//! Associated sets: the original triangles and boundary edges that each simplified triangle and edge
//! represents.
//!
//! Li, Li, Xu and Li, "Normal mesh generation based on Laplacian operator", 2002, section 2. When v1
//! collapses into v2, each moved triangle gets the union of the sets of all triangles around v1. Sets of
//! neighbouring triangles therefore overlap, as the paper intends. A union is stored as a node that
//! references its parts, so a collapse costs O(valence). The members are expanded once, at the end.

use crate::base::ids::{EdgeId, HalfedgeId};
use crate::mesh::connectivity::Connectivity;

const NONE: u32 = u32::MAX;

/// Sets of original triangles, one per triangle of the current mesh.
#[derive(Clone, Debug)]
pub struct TriangleSets {
    /// Number of original triangles. Node ids below it are triangles; ids from it on are unions.
    originals: usize,
    /// Start of each union in `parts`, plus the end of the last one.
    starts: Vec<u32>,
    parts: Vec<u32>,
    /// Node of each triangle, indexed by triangle slot.
    node: Vec<u32>,
}

impl TriangleSets {
    /// Create one set per triangle, containing only the triangle.
    pub fn new(triangles: usize) -> Self {
        Self { originals: triangles, starts: vec![0], parts: vec![], node: (0..triangles as u32).collect() }
    }

    /// Assign to each triangle in `moved` the union of the sets of the triangles `around`.
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

    /// List the members of the sets of some triangles. `number[t]` renumbers original triangle `t`; each set
    /// is sorted by these numbers.
    pub fn list_members(&self, triangles: impl Iterator<Item = usize>, number: &[u32]) -> AssociatedSets {
        let mut sets = AssociatedSets { starts: vec![0], members: vec![] };
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

/// Sets of numbers in compressed form; the members of each set are sorted.
#[derive(Clone, Debug)]
pub struct AssociatedSets {
    starts: Vec<usize>,
    members: Vec<u32>,
}

impl AssociatedSets {
    /// Sort the members of every set with two counting passes: by member, then back by set. All members are
    /// below `count`.
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

    /// Return the sorted members of a set.
    pub fn members_of(&self, set: usize) -> &[u32] {
        &self.members[self.starts[set]..self.starts[set + 1]]
    }

    /// Return the sets permuted: set `i` of the result is set `order[i]`.
    pub fn permute(&self, order: &[u32]) -> Self {
        let mut sets = Self { starts: vec![0], members: Vec::with_capacity(self.members.len()) };
        for &set in order {
            sets.members.extend_from_slice(self.members_of(set as usize));
            sets.starts.push(sets.members.len());
        }
        sets
    }

    /// Check whether a set contains a member, by binary search.
    #[inline]
    pub fn contains(&self, set: usize, member: u32) -> bool {
        self.members_of(set).binary_search(&member).is_ok()
    }
}

/// Chains of original boundary edges, one per boundary edge of the current mesh.
#[derive(Clone, Debug)]
pub struct Chains {
    /// First and last original edge of each edge's chain; [`NONE`] for interior edges.
    span: Vec<[u32; 2]>,
    /// Successor of each boundary edge of the input along the boundary, and its halfedge.
    next_edge: Vec<u32>,
    halfedge: Vec<HalfedgeId>,
}

impl Chains {
    /// Create one chain per boundary edge, containing only the edge.
    pub fn new(connectivity: &Connectivity) -> Self {
        let slots = connectivity.edge_slots();
        let mut chains = Self {
            span: vec![[NONE; 2]; slots],
            next_edge: vec![NONE; slots],
            halfedge: vec![HalfedgeId::NONE; slots],
        };
        for edge in connectivity.edges().filter(|&e| connectivity.is_boundary_edge(e)) {
            let [_, to] = connectivity.ends(edge);
            chains.span[edge.index()] = [edge.0; 2];
            chains.halfedge[edge.index()] = connectivity.halfedge(edge);
            chains.next_edge[edge.index()] = connectivity.edge(connectivity.outgoing[to.index()]).0;
        }
        chains
    }

    /// Merge the chains of two edges that a collapse has joined. At most one of the edges is a boundary edge.
    pub fn merge_chains(&mut self, kept: EdgeId, gone: EdgeId) {
        if self.span[kept.index()][0] == NONE {
            self.span[kept.index()] = self.span[gone.index()];
        }
    }

    /// Append the chain of a collapsed boundary edge to the boundary edge before or after it.
    pub fn append(&mut self, gone: EdgeId, before: Option<EdgeId>, after: Option<EdgeId>) {
        let [first, last] = self.span[gone.index()];
        if let Some(edge) = before {
            self.span[edge.index()][1] = last;
        } else if let Some(edge) = after {
            self.span[edge.index()][0] = first;
        }
    }

    /// List the original halfedges along a boundary edge, in boundary order.
    pub fn halfedges(&self, edge: EdgeId) -> Vec<HalfedgeId> {
        let [first, last] = self.span[edge.index()];
        let mut halfedges = vec![];
        let mut at = first;
        while at != NONE {
            halfedges.push(self.halfedge[at as usize]);
            if at == last {
                break;
            }
            at = self.next_edge[at as usize];
        }
        halfedges
    }
}
