//! From a list of triangles to connectivity, by one counting sort.

use crate::base::errors::KernelError;
use crate::base::ids::{EdgeId, HalfedgeId, VertexId};
use crate::mesh::connectivity::{Connectivity, Halfedge};

/// # Errors
/// More triangles than have numbers, or an index out of range.
pub fn check_indices(vertex_count: usize, triangles: &[[u32; 3]]) -> Result<(), KernelError> {
    let limit = Connectivity::MOST_TRIANGLES;
    if triangles.len() > limit || vertex_count >= (u32::MAX / 2) as usize {
        return Err(KernelError::TooManyTriangles { wanted: triangles.len() as f64, limit });
    }
    let out_of_range = |corners: &[u32; 3]| corners.iter().copied().find(|&v| v as usize >= vertex_count);
    for (triangle, corners) in triangles.iter().enumerate() {
        if let Some(vertex) = out_of_range(corners) {
            return Err(KernelError::IndexOutOfRange {
                triangle,
                vertex: vertex.into(),
                vertices: vertex_count,
            });
        }
    }
    Ok(())
}

impl Connectivity {
    /// Connect triangles that share edges.
    ///
    /// # Errors
    /// An index out of range, an edge of three triangles or of two with opposite orientation, two triangles with
    /// the same vertices, a vertex where two fans touch. Triangles that name a vertex twice must be left out.
    pub fn from_triangles(vertex_count: usize, triangles: &[[u32; 3]]) -> Result<Self, KernelError> {
        Self::from_region(vertex_count, triangles, |_| false)
    }

    /// The same for a part of a mesh. Vertices on its rim have triangles elsewhere, too, and are not held against
    /// the rule of one fan.
    ///
    /// # Errors
    /// As [`Connectivity::from_triangles`].
    pub fn from_region(
        vertex_count: usize,
        triangles: &[[u32; 3]],
        on_rim: impl Fn(VertexId) -> bool,
    ) -> Result<Self, KernelError> {
        check_indices(vertex_count, triangles)?;
        let mut halfedges: Vec<Halfedge> = Vec::with_capacity(3 * triangles.len());
        for &corner in triangles.iter().flatten() {
            halfedges.push(Halfedge { origin: VertexId(corner), twin: HalfedgeId::NONE, edge: EdgeId::NONE });
        }
        let edges = pair_twins(vertex_count, &mut halfedges)?;
        let mut connectivity = Self {
            halfedges,
            outgoing: vec![HalfedgeId::NONE; vertex_count],
            edges,
            triangle_count: triangles.len(),
        };
        connectivity.find_back_to_back()?;
        connectivity.find_outgoing(on_rim)?;
        Ok(connectivity)
    }

    /// Connect triangles whose sides are paired already. `origins` names the vertex each halfedge starts from: one for
    /// every fan of triangles, so that no vertex has two.
    pub(crate) fn from_twins(vertex_count: usize, origins: &[VertexId], twins: &[HalfedgeId]) -> Self {
        let mut halfedges: Vec<Halfedge> = Vec::with_capacity(origins.len());
        let mut edges = Vec::with_capacity(origins.len() / 2 + 1);
        for (h, (&origin, &twin)) in origins.iter().zip(twins).enumerate() {
            let edge = if twin.index() < h {
                halfedges[twin.index()].edge
            } else {
                edges.push(HalfedgeId::from_index(h));
                EdgeId::from_index(edges.len() - 1)
            };
            halfedges.push(Halfedge { origin, twin, edge });
        }
        let triangle_count = halfedges.len() / 3;
        let mut outgoing = vec![HalfedgeId::NONE; vertex_count];
        for (h, halfedge) in halfedges.iter().enumerate() {
            let slot = &mut outgoing[halfedge.origin.index()];
            if slot.is_none() || halfedge.twin.is_none() {
                *slot = HalfedgeId::from_index(h);
            }
        }
        Self { halfedges, outgoing, edges, triangle_count }
    }

    fn find_back_to_back(&self) -> Result<(), KernelError> {
        let across = |h| self.origin(Self::prev(h));
        let same = |&edge: &EdgeId| {
            let h = self.halfedge(edge);
            self.twin(h).is_some() && across(h) == across(self.twin(h))
        };
        let beside = |edge| {
            let h = self.halfedge(edge);
            let (one, other) = (Self::triangle(h).0, Self::triangle(self.twin(h)).0);
            [one.min(other), one.max(other)]
        };
        let mut pairs: Vec<[u32; 2]> = self.edges().filter(same).map(beside).collect();
        pairs.sort_unstable();
        pairs.dedup();
        if pairs.is_empty() { Ok(()) } else { Err(KernelError::SameVertices(pairs)) }
    }

    fn find_outgoing(&mut self, on_rim: impl Fn(VertexId) -> bool) -> Result<(), KernelError> {
        let mut degree = vec![0u32; self.outgoing.len()];
        for (index, halfedge) in self.halfedges.iter().enumerate() {
            let slot = &mut self.outgoing[halfedge.origin.index()];
            if slot.is_none() || halfedge.twin.is_none() {
                *slot = HalfedgeId::from_index(index);
            }
            degree[halfedge.origin.index()] += 1;
        }
        let pinched: Vec<u32> = self
            .vertices()
            .filter(|&v| !on_rim(v) && self.fan(v).count() != degree[v.index()] as usize)
            .map(|v| v.0)
            .collect();
        if pinched.is_empty() { Ok(()) } else { Err(KernelError::PinchedVertices(pinched)) }
    }
}

/// Number the edges and let the two halfedges of each know each other; returns one halfedge of every edge.
fn pair_twins(vertex_count: usize, halfedges: &mut [Halfedge]) -> Result<Vec<HalfedgeId>, KernelError> {
    // Lower end first.
    let ends = |halfedges: &[Halfedge], h: u32| {
        let target = Connectivity::next(HalfedgeId(h)).index();
        let (a, b) = (halfedges[h as usize].origin.0, halfedges[target].origin.0);
        if a < b { (a, b) } else { (b, a) }
    };
    // Halfedges grouped by the lower end of their edge; a group is as small as a vertex's degree.
    let mut group = vec![0u32; vertex_count + 1];
    for h in 0..halfedges.len() as u32 {
        group[ends(halfedges, h).0 as usize + 1] += 1;
    }
    for v in 0..vertex_count {
        group[v + 1] += group[v];
    }
    let mut fill = group.clone();
    let mut sorted = vec![(0u32, 0u32); halfedges.len()];
    for h in 0..halfedges.len() as u32 {
        let (low, high) = ends(halfedges, h);
        let place = &mut fill[low as usize];
        sorted[*place as usize] = (high, h);
        *place += 1;
    }
    drop(fill);

    let mut edges = Vec::with_capacity(halfedges.len() / 2 + 1);
    let (mut crowded, mut inconsistent) = (Vec::new(), Vec::new());
    for low in 0..vertex_count {
        let around = &mut sorted[group[low] as usize..group[low + 1] as usize];
        around.sort_unstable();
        for same in around.chunk_by(|g, h| g.0 == h.0) {
            let edge = EdgeId::from_index(edges.len());
            edges.push(HalfedgeId(same[0].1));
            match *same {
                [(_, h)] => halfedges[h as usize].edge = edge,
                [(_, g), (_, h)] if halfedges[g as usize].origin != halfedges[h as usize].origin => {
                    halfedges[g as usize] = Halfedge { twin: HalfedgeId(h), edge, ..halfedges[g as usize] };
                    halfedges[h as usize] = Halfedge { twin: HalfedgeId(g), edge, ..halfedges[h as usize] };
                }
                [(high, _), _] => inconsistent.push([low as u32, high]),
                _ => crowded.push([low as u32, same[0].0]),
            }
        }
    }
    if !crowded.is_empty() {
        return Err(KernelError::NonManifoldEdges(crowded));
    }
    if !inconsistent.is_empty() {
        return Err(KernelError::InconsistentEdges(inconsistent));
    }
    Ok(edges)
}
