//! Accumulated sums of JIA01 on the whole mesh, between rounds.

use super::attribute_contrast::compute_vertex_contrast;
use super::measure::{AccumulatedChange, Change, Jia01, StopRule};
use super::options::Options;
use crate::base::ids::HalfedgeId;
use crate::collapse::method_state::MethodState;
use crate::collapse::whole_mesh::WholeMesh;
use crate::mesh::triangle_mesh::Mesh;

/// Accumulated sums of JIA01 on the whole mesh.
pub struct JiaState {
    options: Options,
    /// Contrast by vertex, before the first round; empty afterwards.
    vertex_contrast: Vec<f64>,
    /// Sums of each region of the last round, with the index of its first triangle.
    region_sums: Vec<(u32, RegionSums)>,
    pub largest: Change,
}

/// Sums on the edges of a region. Each edge stores them at one corner of a triangle; an edge on a rim, in
/// each region.
pub struct RegionSums {
    /// By triangle: bit mask of the corners that store sums.
    corners: Vec<u8>,
    /// By triangle: index of its first sums.
    starts: Vec<u32>,
    accumulated: Vec<AccumulatedChange>,
    largest: Change,
}

impl RegionSums {
    /// Iterate over the corners of a triangle that store sums, and the sums.
    fn sums_of_triangle(&self, triangle: usize) -> impl Iterator<Item = (usize, &AccumulatedChange)> {
        let corners = (0..3).filter(move |corner| self.corners[triangle] >> corner & 1 == 1);
        corners.zip(&self.accumulated[self.starts[triangle] as usize..])
    }
}

impl JiaState {
    pub fn new<const D: usize>(mesh: &WholeMesh<D, StopRule>, options: &Options) -> Self {
        let around = compute_vertex_contrast(&mesh.points, mesh.triangles.iter().copied());
        Self { options: *options, vertex_contrast: around, region_sums: vec![], largest: Change::default() }
    }
}

impl<const D: usize> MethodState<D> for JiaState {
    type Measure = Jia01<D>;
    type RegionState = RegionSums;

    const KEEPS_MERGES: bool = false;

    fn load_region(&self, region: &Mesh<D>) -> Jia01<D> {
        let connectivity = &region.connectivity;
        let mut accumulated = vec![AccumulatedChange::default(); connectivity.edge_slots()];
        if !self.vertex_contrast.is_empty() {
            for edge in connectivity.edges() {
                let [a, b] = connectivity.ends(edge).map(|v| region.vertex_source[v.index()] as usize);
                accumulated[edge.index()].contrast = self.vertex_contrast[a].max(self.vertex_contrast[b]);
            }
        }
        // Triangles are in the order of the whole mesh, and so region by region.
        let mut pieces = self.region_sums.iter().peekable();
        let mut piece = pieces.next();
        for (local, &t) in region.triangle_source.iter().enumerate() {
            while pieces.peek().is_some_and(|(first, _)| *first <= t) {
                piece = pieces.next();
            }
            for (corner, sums) in
                piece.iter().flat_map(|(first, sums)| sums.sums_of_triangle((t - first) as usize))
            {
                let edge = connectivity.edge(HalfedgeId((3 * local + corner) as u32));
                // An edge on a rim does not change, but one of its regions may have lost its sums.
                accumulated[edge.index()] = accumulated[edge.index()].larger(sums);
            }
        }
        Jia01::from_accumulated(&self.options, accumulated)
    }

    fn unload_region(measure: Jia01<D>, region: &Mesh<D>) -> RegionSums {
        let connectivity = &region.connectivity;
        let (triangles, edges) = (connectivity.triangle_count(), connectivity.edges().count());
        let mut sums = RegionSums {
            corners: Vec::with_capacity(triangles),
            starts: Vec::with_capacity(triangles),
            accumulated: Vec::with_capacity(edges),
            largest: measure.largest_change,
        };
        for t in connectivity.triangles() {
            sums.starts.push(sums.accumulated.len() as u32);
            let mut corners = 0;
            for corner in 0..3 {
                let h = HalfedgeId(3 * t.0 + corner);
                let edge = connectivity.edge(h);
                if connectivity.halfedge(edge) == h {
                    corners |= 1 << corner;
                    sums.accumulated.push(*measure.accumulated(edge));
                }
            }
            sums.corners.push(corners);
        }
        sums
    }

    fn join_regions(mut self, _: &[u32], pieces: Vec<RegionSums>) -> Self {
        self.vertex_contrast = vec![];
        self.region_sums.clear();
        let mut first = 0;
        for piece in pieces {
            self.largest.shape = self.largest.shape.max(piece.largest.shape);
            self.largest.texture = self.largest.texture.max(piece.largest.texture);
            let count = piece.corners.len() as u32;
            self.region_sums.push((first, piece));
            first += count;
        }
        self
    }
}
