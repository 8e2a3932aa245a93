//! Accumulated sums of JIA01 on the whole mesh, between rounds.

use super::contrast::contrast_around;
use super::measure::{Accumulated, Bound, Change, Jia01};
use super::options::Options;
use crate::base::ids::HalfedgeId;
use crate::collapse::records::Records;
use crate::collapse::whole::Whole;
use crate::mesh::triangle_mesh::Mesh;

/// Accumulated sums of JIA01 on the whole mesh.
pub struct JiaRecords {
    options: Options,
    /// Contrast by vertex, before the first round; empty afterwards.
    around: Vec<f64>,
    /// Sums of each region of the last round, with the index of its first triangle.
    pieces: Vec<(u32, Sums)>,
    pub largest: Change,
}

/// Sums on the edges of a region. Each edge stores them at one corner of a triangle; an edge on a rim, in
/// each region.
pub struct Sums {
    /// By triangle: bit mask of the corners that store sums.
    corners: Vec<u8>,
    /// By triangle: index of its first sums.
    starts: Vec<u32>,
    accumulated: Vec<Accumulated>,
    largest: Change,
}

impl Sums {
    /// Iterate over the corners of a triangle that store sums, and the sums.
    fn of(&self, triangle: usize) -> impl Iterator<Item = (usize, &Accumulated)> {
        let corners = (0..3).filter(move |corner| self.corners[triangle] >> corner & 1 == 1);
        corners.zip(&self.accumulated[self.starts[triangle] as usize..])
    }
}

impl JiaRecords {
    pub fn new<const D: usize>(mesh: &Whole<D, Bound>, options: &Options) -> Self {
        let around = contrast_around(&mesh.points, mesh.triangles.iter().copied());
        Self { options: *options, around, pieces: vec![], largest: Change::default() }
    }
}

impl<const D: usize> Records<D> for JiaRecords {
    type Measure = Jia01<D>;
    type Remains = Sums;

    const KEEPS_MERGES: bool = false;

    fn load(&self, region: &Mesh<D>) -> Jia01<D> {
        let connectivity = &region.connectivity;
        let mut accumulated = vec![Accumulated::default(); connectivity.edge_slots()];
        if !self.around.is_empty() {
            for edge in connectivity.edges() {
                let [a, b] = connectivity.ends(edge).map(|v| region.vertex_source[v.index()] as usize);
                accumulated[edge.index()].contrast = self.around[a].max(self.around[b]);
            }
        }
        // Triangles are in the order of the whole mesh, and so region by region.
        let mut pieces = self.pieces.iter().peekable();
        let mut piece = pieces.next();
        for (local, &t) in region.triangle_source.iter().enumerate() {
            while pieces.peek().is_some_and(|(first, _)| *first <= t) {
                piece = pieces.next();
            }
            for (corner, sums) in piece.iter().flat_map(|(first, sums)| sums.of((t - first) as usize)) {
                let edge = connectivity.edge(HalfedgeId((3 * local + corner) as u32));
                // An edge on a rim does not change, but one of its regions may have lost its sums.
                accumulated[edge.index()] = accumulated[edge.index()].larger(sums);
            }
        }
        Jia01::with(&self.options, accumulated)
    }

    fn unload(measure: Jia01<D>, region: &Mesh<D>) -> Sums {
        let connectivity = &region.connectivity;
        let (triangles, edges) = (connectivity.triangle_count(), connectivity.edges().count());
        let mut sums = Sums {
            corners: Vec::with_capacity(triangles),
            starts: Vec::with_capacity(triangles),
            accumulated: Vec::with_capacity(edges),
            largest: measure.largest,
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

    fn join(mut self, _: &[u32], pieces: Vec<Sums>) -> Self {
        self.around = vec![];
        self.pieces.clear();
        let mut first = 0;
        for piece in pieces {
            self.largest.shape = self.largest.shape.max(piece.largest.shape);
            self.largest.texture = self.largest.texture.max(piece.largest.texture);
            let count = piece.corners.len() as u32;
            self.pieces.push((first, piece));
            first += count;
        }
        self
    }
}
