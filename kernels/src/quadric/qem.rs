//! Measure of the simplification by attribute quadrics.
//!
//! The quadric of a vertex sums over its current triangles, not over triangles of the input: "memoryless"
//! (Lindstrom and Turk, "Fast and memory efficient polygonal simplification", 1998; Hoppe 1999 for
//! attributes). The next edge is the one whose collapse changes the current surface least. On scans, shape
//! errors are a sixth lower than with accumulated quadrics, at an equal weight of the colours. The final
//! least-squares fit corrects the drift.

use crate::base::geometry::{Vec3, distance2, position_of};
use crate::base::ids::{EdgeId, VertexId};
use crate::collapse::engine::{CollapseChange, Measure, PriorityScope, Proposal};
use crate::collapse::method_state::MethodState;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::edge_star::EdgeStar;
use crate::mesh::triangle_mesh::{Mesh, VertexLock};
use crate::quadrics::placement::{best_position, length_cost};
use crate::quadrics::quadric::Quadric;

/// Weight of boundary walls: the squared distance to the wall through each boundary edge, times the squared
/// length of the edge.
pub const BOUNDARY_WEIGHT: f64 = 1.0;

/// Measure of the simplification by attribute quadrics.
pub struct Qem<const D: usize, const K: usize> {
    /// Length that counts as much as one level of an attribute.
    weight: f64,
    quadrics: Vec<Quadric<K>>,
    /// Factor on the error by vertex; empty for 1.
    importance: Vec<f64>,
}

/// Parameters from which quadrics are computed.
pub struct QemState<const K: usize> {
    pub weight: f64,
    /// Factor on the error by vertex; empty for 1.
    pub importance: Vec<f64>,
}

impl<const D: usize, const K: usize> Qem<D, K> {
    fn new(mesh: &Mesh<D>, weight: f64, importance: Vec<f64>) -> Self {
        let mut qem = Self { weight, quadrics: vec![Quadric::default(); mesh.points.len()], importance };
        let mut triangles = mesh.connectivity.triangles();
        while let Some(first) = triangles.next() {
            let second = triangles.next();
            let corners = [first, second.unwrap_or(first)].map(|t| mesh.connectivity.corners(t));
            let importance = corners.map(|c| c.map(|v| qem.importance(v)));
            let quadrics = qem.of_triangles(corners.map(|c| c.map(|v| mesh.point(v))), importance);
            for (corners, quadric) in corners.iter().zip(&quadrics).take(1 + usize::from(second.is_some())) {
                corners.iter().for_each(|v| qem.quadrics[v.index()].add(quadric));
            }
        }
        for edge in mesh.connectivity.edges().filter(|&e| mesh.connectivity.is_boundary_edge(e)) {
            for v in mesh.connectivity.ends(edge) {
                let mut quadric = qem.quadrics[v.index()];
                qem.add_wall(mesh, edge, &mut quadric);
                qem.quadrics[v.index()] = quadric;
            }
        }
        qem
    }

    /// Return the quadric of a vertex.
    pub fn quadric(&self, v: VertexId) -> &Quadric<K> {
        &self.quadrics[v.index()]
    }

    #[inline]
    fn importance(&self, v: VertexId) -> f64 {
        self.importance.get(v.index()).copied().unwrap_or(1.0)
    }

    fn of_triangle(&self, points: [&[f64; D]; 3], importance: [f64; 3]) -> Quadric<K> {
        let [quadric] = self.of_triangles([points], [importance]);
        quadric
    }

    #[inline]
    fn of_triangles<const N: usize>(
        &self,
        points: [[&[f64; D]; 3]; N],
        importance: [[f64; 3]; N],
    ) -> [Quadric<K>; N] {
        let mut quadrics = Quadric::of_triangles(points, self.weight);
        if !self.importance.is_empty() {
            for (quadric, importance) in quadrics.iter_mut().zip(importance) {
                quadric.scale(importance.iter().sum::<f64>() / 3.0);
            }
        }
        quadrics
    }

    /// Add the squared distance to the wall through a boundary edge.
    ///
    /// The wall is perpendicular to the triangle of the edge.
    fn add_wall(&self, mesh: &Mesh<D>, edge: EdgeId, quadric: &mut Quadric<K>) {
        let h = mesh.connectivity.halfedge(edge);
        let ends = mesh.connectivity.ends(edge);
        let across = mesh.connectivity.origin(Connectivity::prev(h));
        let [a, b, c] = [ends[0], ends[1], across].map(|v| position_of(mesh.point(v)));
        let importance = 0.5 * (self.importance(ends[0]) + self.importance(ends[1]));
        quadric.add_wall(BOUNDARY_WEIGHT * importance, [&a, &b, &c]);
    }

    /// Compute the quadric of a vertex from its current triangles and boundary edges.
    fn recompute_quadric(&self, mesh: &Mesh<D>, v: VertexId) -> Quadric<K> {
        let mut quadric = Quadric::default();
        for h in mesh.connectivity.fan(v) {
            let corners = mesh.connectivity.corners(Connectivity::triangle(h));
            let importance = corners.map(|v| self.importance(v));
            quadric.add(&self.of_triangle(corners.map(|v| mesh.point(v)), importance));
        }
        for (edge, _) in mesh.connectivity.vertex_edges(v) {
            if mesh.connectivity.is_boundary_edge(edge) {
                self.add_wall(mesh, edge, &mut quadric);
            }
        }
        quadric
    }

    /// Find the best position for the vertex that replaces an edge; also returns the error.
    fn best_position(&self, mesh: &Mesh<D>, edge: EdgeId, together: &Quadric<K>) -> (Vec3, f64) {
        let ends = mesh.connectivity.ends(edge);
        let [a, b] = ends.map(|v| position_of(mesh.point(v)));
        let (place, error) = match mesh.fixed_ends(edge) {
            [false, false] => best_position(together, [&a, &b]),
            [true, _] => (a, together.error(&a)),
            [_, true] => (b, together.error(&b)),
        };
        (place, error + length_cost(together.area, [&a, &b]))
    }

    #[inline]
    fn summed_quadric(&self, mesh: &Mesh<D>, edge: EdgeId) -> Quadric<K> {
        let [a, b] = mesh.connectivity.ends(edge);
        self.quadrics[a.index()].sum(&self.quadrics[b.index()])
    }
}

impl<const D: usize, const K: usize> Measure<D> for Qem<D, K> {
    type Reason = ();
    type Change = ();

    const PRIORITY_SCOPE: PriorityScope = PriorityScope::Ring;

    #[inline]
    fn priority(&self, mesh: &Mesh<D>, edge: EdgeId) -> Result<f64, ()> {
        Ok(self.best_position(mesh, edge, &self.summed_quadric(mesh, edge)).1)
    }

    fn propose(&mut self, mesh: &Mesh<D>, star: &EdgeStar<D>) -> Result<Proposal<D, ()>, ()> {
        let together = self.summed_quadric(mesh, star.edge);
        let (place, _) = self.best_position(mesh, star.edge, &together);
        let locked = star.ends.iter().position(|&v| mesh.lock(v) == VertexLock::Locked);
        let point = match locked {
            Some(end) => star.end_points[end],
            None => together.with_attributes(&place, self.weight, &star.middle),
        };
        let survivor = match star.end_is_fixed {
            [true, _] => 0,
            [_, true] => 1,
            _ => usize::from(distance2(&star.end_points[1], &point) < distance2(&star.end_points[0], &point)),
        };
        Ok(Proposal { survivor, point, change: () })
    }

    fn judge(&mut self, _: &Mesh<D>, _: &EdgeStar<D>, _: &mut Proposal<D, ()>) -> Result<(), ()> {
        Ok(())
    }

    /// Replace the quadrics of all changed triangles at their corners.
    fn commit(&mut self, mesh: &Mesh<D>, star: &EdgeStar<D>, collapsed: &CollapseChange, (): ()) {
        let ends = star.ends.map(|v| self.importance(v));
        // A boundary edge has only one vanishing triangle, which then fills both lanes.
        let sides = [0, star.vanishing.len() - 1].map(|side| &star.vanishing[side]);
        let [first, second] = &star.end_points;
        let corners = sides.map(|(_, _, apex_point)| [first, second, apex_point]);
        let importance = sides.map(|(_, apex, _)| [ends[0], ends[1], self.importance(*apex)]);
        let vanished = self.of_triangles(corners, importance);
        for ((_, apex, _), old) in star.vanishing.iter().zip(&vanished) {
            self.quadrics[apex.index()].subtract(old);
        }
        let survivor = collapsed.survivor;
        let most = ends[0].max(ends[1]);
        let mut own = Quadric::default();
        for wing in &star.remaining {
            let (from, to) = (&wing.from_point, &wing.to_point);
            let corners = [star.end_point(wing.end), mesh.point(survivor)].map(|tip| [tip, from, to]);
            let ring = [self.importance(wing.side_start), self.importance(wing.side_end)];
            let importance = [ends[wing.end], most].map(|tip| [tip, ring[0], ring[1]]);
            let [old, new] = self.of_triangles(corners, importance);
            own.add(&new);
            let difference = new.difference(&old);
            for v in [wing.side_start, wing.side_end] {
                self.quadrics[v.index()].add(&difference);
            }
        }
        if !self.importance.is_empty() {
            self.importance[survivor.index()] = most;
        }
        self.quadrics[survivor.index()] = own;
        // A wall also depends on its triangle.
        let on_boundary = |v: VertexId| mesh.connectivity.is_boundary_vertex(v);
        if on_boundary(survivor) {
            self.quadrics[survivor.index()] = self.recompute_quadric(mesh, survivor);
        }
        for (_, v) in mesh.connectivity.vertex_edges(survivor).filter(|(_, v)| on_boundary(*v)) {
            self.quadrics[v.index()] = self.recompute_quadric(mesh, v);
        }
    }
}

impl<const D: usize, const K: usize> MethodState<D> for QemState<K> {
    type Measure = Qem<D, K>;
    /// Importance of the vertices that are not on the rim; empty for 1.
    type RegionState = Vec<f64>;

    fn load_region(&self, region: &Mesh<D>) -> Qem<D, K> {
        let importance = if self.importance.is_empty() {
            vec![]
        } else {
            region.vertex_source.iter().map(|&v| self.importance[v as usize]).collect()
        };
        Qem::new(region, self.weight, importance)
    }

    fn unchanged_region(&self, _: &[u32], inside: &[u32]) -> Option<Vec<f64>> {
        let importance = &self.importance;
        Some(if importance.is_empty() {
            vec![]
        } else {
            inside.iter().map(|&v| importance[v as usize]).collect()
        })
    }

    fn unload_region(measure: Qem<D, K>, region: &Mesh<D>) -> Vec<f64> {
        if measure.importance.is_empty() {
            return vec![];
        }
        let inside = region.connectivity.vertices().filter(|&v| region.lock(v) != VertexLock::Rim);
        inside.map(|v| measure.importance(v)).collect()
    }

    fn join_regions(mut self, rim: &[u32], pieces: Vec<Vec<f64>>) -> Self {
        if !self.importance.is_empty() {
            let on_rim = rim.iter().map(|&v| self.importance[v as usize]);
            self.importance = on_rim.chain(pieces.into_iter().flatten()).collect();
        }
        self
    }
}
