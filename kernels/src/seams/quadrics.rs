//! Quadrics of a surface with seams, updated as edges collapse.
//!
//! Quadrics sum over the current triangles, not over triangles of the input: "memoryless" (Lindstrom and
//! Turk, "Fast and memory efficient polygonal simplification", 1998), as in [`crate::quadric`]. With quadrics
//! summed over the input, shape errors are a quarter larger. Walls on a boundary would also keep the weight
//! of vanished edges, and be outweighed by areas late in the run. The input still has a part in the cost: see
//! `INPUT_QUADRIC_WEIGHT`.

use super::region_state::{MovedCorner, SeamMeasure};
use crate::base::geometry::{Vec3, position_of};
use crate::base::ids::{EdgeId, HalfedgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;
use crate::mesh::edge_star::EdgeStar;
use crate::mesh::triangle_mesh::Mesh;
use crate::quadrics::quadric::Quadric;

/// Weight of the wall on a boundary edge, times the squared length of the edge.
const BOUNDARY_WEIGHT: f64 = 1.0;

/// Weight of each of the two walls on a seam: it may move on the surface if the texture moves along.
const SEAM_WEIGHT: f64 = 0.25;

impl<const D: usize, const K: usize> SeamMeasure<'_, D, K> {
    /// Compute the quadrics of all wedges.
    pub(super) fn compute_quadrics(&mut self, mesh: &Mesh<3>) {
        for t in mesh.connectivity.triangles() {
            let halfedges = corners_of(t);
            let points = halfedges.map(|h| self.corner_point(h, mesh.point(mesh.connectivity.origin(h))));
            let quadric = self.apply_importance(t, Quadric::of_triangle(points.each_ref(), 1.0));
            for h in halfedges {
                self.quadrics[self.wedges.wedge_of(h) as usize].add(&quadric);
            }
        }
    }

    /// Subtract the triangles that a collapse removes from the wedges of their apexes.
    pub(super) fn remove_vanished(&mut self, connectivity: &Connectivity, star: &EdgeStar<3>) {
        for (side, &(t, _, apex_point)) in star.vanishing.iter().enumerate() {
            // Removed halfedges keep the index of their edge.
            let Some(h) = corners_of(t).into_iter().find(|&h| connectivity.edge(h) == star.edge) else {
                continue;
            };
            let apex = Connectivity::prev(h);
            let points = [
                self.corner_point(h, star.end_point(side)),
                self.corner_point(Connectivity::next(h), star.end_point(1 - side)),
                self.corner_point(apex, &apex_point),
            ];
            let quadric = self.apply_importance(t, Quadric::of_triangle(points.each_ref(), 1.0));
            self.quadrics[self.wedges.wedge_of(apex) as usize].subtract(&quadric);
        }
    }

    /// Store the corners that a collapse moves, before their wedges change.
    pub(super) fn store_moved_corners(
        &mut self,
        connectivity: &Connectivity,
        star: &EdgeStar<3>,
        survivor: VertexId,
    ) {
        self.moved.clear();
        for wing in &star.remaining {
            let corner = corners_of(wing.triangle).into_iter().find(|&h| connectivity.origin(h) == survivor);
            if let Some(corner) = corner {
                let before = self.corner_point(corner, star.end_point(wing.end));
                self.moved.push(MovedCorner { corner, before });
            }
        }
    }

    /// Update the quadrics around the stored corners.
    pub(super) fn update_quadrics(&mut self, mesh: &Mesh<3>) {
        for i in 0..self.moved.len() {
            let MovedCorner { corner, before } = self.moved[i];
            let t = Connectivity::triangle(corner);
            let ring = [Connectivity::next(corner), Connectivity::prev(corner)];
            let [tip, from, to] = [corner, ring[0], ring[1]]
                .map(|h| self.corner_point(h, mesh.point(mesh.connectivity.origin(h))));
            let [old, new] = Quadric::of_triangles([[&before, &from, &to], [&tip, &from, &to]], 1.0);
            let [old, new] = [old, new].map(|quadric| self.apply_importance(t, quadric));
            self.quadrics[self.wedges.wedge_of(corner) as usize].add(&new);
            let difference = new.difference(&old);
            for h in ring {
                self.quadrics[self.wedges.wedge_of(h) as usize].add(&difference);
            }
        }
    }

    /// Compute the shape quadric of a vertex: its triangles, and the walls on its seams and boundaries.
    pub(super) fn shape_quadric(&self, mesh: &Mesh<3>, v: VertexId) -> Quadric<0> {
        if let Some(quadric) = self.shape.borrow()[v.index()] {
            return quadric;
        }
        let connectivity = &mesh.connectivity;
        let mut quadric = Quadric::default();
        for h in connectivity.fan(v) {
            let t = Connectivity::triangle(h);
            let points: [&Vec3; 3] = connectivity.corners(t).map(|v| mesh.point(v));
            quadric.add(&self.apply_importance(t, Quadric::of_triangle(points, 1.0)));
        }
        for (edge, _) in connectivity.vertex_edges(v).filter(|(edge, _)| self.is_seam[edge.index()]) {
            self.add_walls(mesh, edge, &mut quadric);
        }
        self.shape.borrow_mut()[v.index()] = Some(quadric);
        quadric
    }

    /// Invalidate the shape quadrics around a vertex that has moved.
    pub(super) fn invalidate_shape(&mut self, connectivity: &Connectivity, v: VertexId) {
        let shape = self.shape.get_mut();
        shape[v.index()] = None;
        connectivity.vertex_edges(v).for_each(|(_, other)| shape[other.index()] = None);
    }

    /// Add the walls on an edge, one for each of its triangles.
    ///
    /// Only if the wedges differ at both ends: a seam that ends inside a chart gets no wall at its tip, so it
    /// may be pulled back.
    fn add_walls(&self, mesh: &Mesh<3>, edge: EdgeId, quadric: &mut Quadric<0>) {
        let connectivity = &mesh.connectivity;
        let first = connectivity.halfedge(edge);
        let second = connectivity.twin(first);
        let wedge = |h: HalfedgeId| self.wedges.wedge_of(h);
        let is_torn = second.is_none()
            || wedge(first) != wedge(Connectivity::next(second))
                && wedge(Connectivity::next(first)) != wedge(second);
        if !is_torn {
            return;
        }
        for h in [first, second].into_iter().filter(|h| h.is_some()) {
            let t = Connectivity::triangle(h);
            let points =
                [h, Connectivity::next(h), Connectivity::prev(h)].map(|h| mesh.point(connectivity.origin(h)));
            let weight = if second.is_none() { BOUNDARY_WEIGHT } else { SEAM_WEIGHT };
            quadric.add_wall(weight * self.importance.get(t.index()).copied().unwrap_or(1.0), points);
        }
    }

    /// Return the position and attributes of a corner.
    #[inline]
    fn corner_point(&self, h: HalfedgeId, point: &Vec3) -> [f64; D] {
        let attributes = &self.wedges.get(self.wedges.wedge_of(h)).attributes;
        let point = position_of(point);
        std::array::from_fn(|i| if i < 3 { point[i] } else { attributes[i - 3] })
    }

    #[inline]
    fn apply_importance<const N: usize>(&self, t: TriangleId, mut quadric: Quadric<N>) -> Quadric<N> {
        if let Some(&importance) = self.importance.get(t.index()) {
            quadric.scale(importance);
        }
        quadric
    }
}

fn corners_of(t: TriangleId) -> [HalfedgeId; 3] {
    [0, 1, 2].map(|i| HalfedgeId(3 * t.0 + i))
}
