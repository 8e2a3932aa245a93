//! Edge star N_c(e): all triangles at either end of an edge, gathered once per collapse attempt.

use crate::base::geometry::{Vec3, cross, midpoint, position_of, sub};
use crate::base::ids::{EdgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::Mesh;

/// A triangle of the star that survives the collapse: one end of the edge, and the opposite side.
#[derive(Clone, Copy, Debug)]
pub struct StarTriangle<const D: usize> {
    pub triangle: TriangleId,
    /// Incident end of the edge, 0 or 1.
    pub end: usize,
    /// Ends of the opposite side; the triangle (end, from, to) is counter-clockwise.
    pub side_start: VertexId,
    pub side_end: VertexId,
    pub from_point: [f64; D],
    pub to_point: [f64; D],
}

/// Star of one edge; the buffers are reused for the next edge.
#[derive(Clone, Debug)]
pub struct EdgeStar<const D: usize> {
    pub edge: EdgeId,
    pub ends: [VertexId; 2],
    pub end_points: [[f64; D]; 2],
    pub middle: [f64; D],
    /// Ends that a collapse must not move; see [`Mesh::fixed_ends`].
    pub end_is_fixed: [bool; 2],
    /// Triangles that a collapse removes, with their corners opposite to the edge.
    pub vanishing: Vec<(TriangleId, VertexId, [f64; D])>,
    pub remaining: Vec<StarTriangle<D>>,
    /// Edges from an end (0 or 1) to a neighbour other than the opposite end.
    pub spokes: Vec<(usize, [f64; D])>,
    /// Edges of the star except `edge`: spokes of both ends, and the ring around them.
    pub other_edges: Vec<EdgeId>,
    /// For a boundary edge: the boundary vertices before its first end and after its second end.
    pub boundary_neighbours: Option<[VertexId; 2]>,
}

impl<const D: usize> Default for EdgeStar<D> {
    fn default() -> Self {
        Self {
            edge: EdgeId::NONE,
            ends: [VertexId::NONE; 2],
            end_points: [[0.0; D]; 2],
            middle: [0.0; D],
            end_is_fixed: [false; 2],
            vanishing: vec![],
            remaining: vec![],
            spokes: vec![],
            other_edges: vec![],
            boundary_neighbours: None,
        }
    }
}

impl<const D: usize> EdgeStar<D> {
    /// Fill with the star of `edge`.
    pub fn gather(&mut self, mesh: &Mesh<D>, edge: EdgeId) {
        let connectivity = &mesh.connectivity;
        self.edge = edge;
        self.ends = connectivity.ends(edge);
        self.end_points = self.ends.map(|v| *mesh.point(v));
        self.end_is_fixed = mesh.fixed_ends(edge);
        self.middle = midpoint(&self.end_points[0], &self.end_points[1]);
        self.vanishing.clear();
        self.remaining.clear();
        self.spokes.clear();
        self.other_edges.clear();

        let first = connectivity.halfedge(edge);
        for h in [first, connectivity.twin(first)] {
            if h.is_some() {
                let apex = connectivity.origin(Connectivity::prev(h));
                self.vanishing.push((Connectivity::triangle(h), apex, *mesh.point(apex)));
            }
        }
        let before = self.gather_end(mesh, 0);
        self.gather_end(mesh, 1);
        self.boundary_neighbours = connectivity.is_boundary_edge(edge).then(|| {
            let after = connectivity.target(connectivity.outgoing[self.ends[1].index()]);
            [before, after]
        });
    }

    /// Gather the wings and edges of one end; returns its last neighbour in counter-clockwise order.
    fn gather_end(&mut self, mesh: &Mesh<D>, end: usize) -> VertexId {
        let connectivity = &mesh.connectivity;
        let (v, opposite) = (self.ends[end], self.ends[1 - end]);
        for h in connectivity.fan(v) {
            let side = Connectivity::next(h);
            let (from, to) = (connectivity.origin(side), connectivity.target(side));
            if from != opposite && to != opposite {
                self.other_edges.push(connectivity.edge(side));
                self.remaining.push(StarTriangle {
                    triangle: Connectivity::triangle(h),
                    end,
                    side_start: from,
                    side_end: to,
                    from_point: *mesh.point(from),
                    to_point: *mesh.point(to),
                });
            }
        }
        let mut last = VertexId::NONE;
        for (spoke, neighbour) in connectivity.vertex_edges(v) {
            if neighbour != opposite {
                self.other_edges.push(spoke);
                self.spokes.push((end, *mesh.point(neighbour)));
            }
            last = neighbour;
        }
        last
    }

    /// Return the point of an end of the edge.
    #[inline]
    pub fn end_point(&self, end: usize) -> &[f64; D] {
        &self.end_points[end]
    }

    /// Compute the sum of the area-weighted normals of all triangles.
    pub fn mean_normal(&self) -> Vec3 {
        let ends = self.end_points.map(|p| position_of(&p));
        let mut sum = [0.0; 3];
        let mut add = |p: &Vec3, a: &[f64; D], b: &[f64; D]| {
            let normal = cross(&sub(&position_of(a), p), &sub(&position_of(b), p));
            (0..3).for_each(|i| sum[i] += normal[i]);
        };
        for wing in &self.remaining {
            add(&ends[wing.end], &wing.from_point, &wing.to_point);
        }
        for (side, (_, _, apex)) in self.vanishing.iter().enumerate() {
            add(&ends[side], &self.end_points[1 - side], apex);
        }
        sum
    }
}
