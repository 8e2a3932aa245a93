//! Simplification by attribute quadrics: the measure, and what it remembers from round to round.
//!
//! The next edge is the one whose collapse adds least error: the error of the merged vertex at its best place
//! minus what its two ends have already. (Garland and Heckbert order by the error itself, which spends on what is
//! already lost.) Quadrics add up, so that every vertex keeps the error to all input triangles it stands for.

use crate::connectivity::Connectivity;
use crate::engine::{Collapsed, Measure, Proposal};
use crate::geometry::{Vec3, cross, distance2, dot, midpoint, norm2, position, sub};
use crate::ids::{EdgeId, VertexId};
use crate::mesh::{Mesh, Pin};
use crate::patch::Records;
use crate::quadric::Quadric;
use crate::star::Star;

/// Strength of the spring that holds a vertex at the middle of its edge where the error does not: on a plane.
const TETHER: f64 = 1e-5;

/// The same for the choice among edges that cost nothing: shorter ones go first.
const SHORTER_FIRST: f64 = 1e-9;

/// Weight of the boundary: of the squared distance from each boundary edge's own side wall, against the area of
/// the square over the edge.
const BOUNDARY: f64 = 1.0;

pub struct Qem<const D: usize, const K: usize> {
    /// Length that counts as much as one level of an attribute.
    weight: f64,
    quadrics: Vec<Quadric<K>>,
    /// The error of each vertex where it is.
    errors: Vec<f64>,
}

/// The quadrics of the whole mesh, once there are any, and what they are made from.
pub struct QemRecords<const K: usize> {
    pub weight: f64,
    /// Factor of the error around each vertex of the input; empty for 1.
    pub importance: Vec<f64>,
    quadrics: Vec<Quadric<K>>,
}

impl<const K: usize> QemRecords<K> {
    pub fn new(weight: f64, importance: Vec<f64>) -> Self {
        Self { weight, importance, quadrics: vec![] }
    }

    fn importance(&self, v: u32) -> f64 {
        self.importance.get(v as usize).copied().unwrap_or(1.0)
    }

    /// Quadrics of the vertices of a patch from its triangles: whole ones inside, a part of them on the rim.
    fn at_start<const D: usize>(&self, mesh: &Mesh<D>) -> Vec<Quadric<K>> {
        let mut quadrics = vec![Quadric::default(); mesh.points.len()];
        for t in mesh.connectivity.triangles() {
            let corners = mesh.connectivity.corners(t);
            let mut quadric = Quadric::of_triangle(corners.map(|v| mesh.point(v)), self.weight);
            if !self.importance.is_empty() {
                let sum: f64 = corners.iter().map(|v| self.importance(mesh.vertex_source[v.index()])).sum();
                quadric.scale(sum / 3.0);
            }
            corners.iter().for_each(|v| quadrics[v.index()].add(&quadric));
        }
        for edge in mesh.connectivity.edges().filter(|&e| mesh.connectivity.is_boundary_edge(e)) {
            let h = mesh.connectivity.halfedge(edge);
            let ends = mesh.connectivity.ends(edge);
            if ends.iter().all(|&v| mesh.pin(v) == Pin::Rim) {
                continue; // the triangle beside it may be in another patch; see `join`
            }
            let across = mesh.connectivity.origin(Connectivity::prev(h));
            let [a, b, c] = [ends[0], ends[1], across].map(|v| position(mesh.point(v)));
            let source = |v: VertexId| self.importance(mesh.vertex_source[v.index()]);
            let importance = 0.5 * (source(ends[0]) + source(ends[1]));
            ends.iter().for_each(|v| add_boundary(&mut quadrics[v.index()], importance, &a, &b, &c));
        }
        quadrics
    }
}

/// Add the squared distance to the wall that stands on the boundary edge a b, at a right angle to its triangle.
fn add_boundary<const K: usize>(
    quadric: &mut Quadric<K>,
    importance: f64,
    a: &Vec3,
    b: &Vec3,
    across: &Vec3,
) {
    let along = sub(b, a);
    let outwards = cross(&along, &cross(&along, &sub(across, a)));
    let length = norm2(&outwards).sqrt();
    if length > 0.0 {
        let normal = outwards.map(|x| x / length);
        quadric.add_plane(BOUNDARY * importance * norm2(&along), &normal, -dot(&normal, a));
    }
}

impl<const D: usize, const K: usize> Qem<D, K> {
    /// The best place for the vertex an edge becomes, and the error the collapse adds.
    fn place(&self, mesh: &Mesh<D>, edge: EdgeId, together: &Quadric<K>) -> (Vec3, f64) {
        let ends = mesh.connectivity.ends(edge);
        let [a, b] = ends.map(|v| position(mesh.point(v)));
        let (place, error) = match mesh.staying_ends(edge) {
            [false, false] => together.minimum(&midpoint(&a, &b), TETHER),
            [true, _] => (a, together.error(&a)),
            [_, true] => (b, together.error(&b)),
        };
        let before = self.errors[ends[0].index()] + self.errors[ends[1].index()];
        (place, error - before + SHORTER_FIRST * together.area * distance2(&a, &b))
    }

    fn together(&self, mesh: &Mesh<D>, edge: EdgeId) -> Quadric<K> {
        let [a, b] = mesh.connectivity.ends(edge);
        self.quadrics[a.index()].sum(&self.quadrics[b.index()])
    }
}

impl<const D: usize, const K: usize> Measure<D> for Qem<D, K> {
    type Bound = ();
    type Change = ();

    const RISING: bool = true;

    #[inline]
    fn priority(&self, mesh: &Mesh<D>, edge: EdgeId) -> Result<f64, ()> {
        Ok(self.place(mesh, edge, &self.together(mesh, edge)).1.max(0.0))
    }

    fn propose(&mut self, mesh: &Mesh<D>, star: &Star<D>) -> Result<Proposal<D, ()>, ()> {
        let together = self.together(mesh, star.edge);
        let (place, _) = self.place(mesh, star.edge, &together);
        let point = together.with_attributes(&place, self.weight, &star.middle);
        let survivor = match star.end_stays {
            [true, _] => 0,
            [_, true] => 1,
            _ => usize::from(distance2(&star.end_points[1], &point) < distance2(&star.end_points[0], &point)),
        };
        Ok(Proposal { survivor, point, change: () })
    }

    fn judge(&mut self, _: &Mesh<D>, _: &Star<D>, _: &mut Proposal<D, ()>) -> Result<(), ()> {
        Ok(())
    }

    fn commit(&mut self, mesh: &Mesh<D>, _: &Star<D>, collapsed: &Collapsed, (): ()) {
        let (removed, survivor) = (collapsed.removed.index(), collapsed.survivor.index());
        let quadric = self.quadrics[survivor].sum(&self.quadrics[removed]);
        self.quadrics[survivor] = quadric;
        self.errors[survivor] = quadric.error(&position(mesh.point(collapsed.survivor)));
    }
}

/// Quadrics of the vertices inside, and, before the first round, the parts of those on the rim.
pub struct QemPiece<const K: usize> {
    inside: Vec<Quadric<K>>,
    rim: Vec<(u32, Quadric<K>)>,
}

impl<const D: usize, const K: usize> Records<D> for QemRecords<K> {
    type Measure = Qem<D, K>;
    type Piece = QemPiece<K>;

    fn load(&self, patch: &Mesh<D>) -> Qem<D, K> {
        let quadrics: Vec<Quadric<K>> = if self.quadrics.is_empty() {
            self.at_start(patch)
        } else {
            patch.vertex_source.iter().map(|&v| self.quadrics[v as usize]).collect()
        };
        let errors = quadrics.iter().zip(&patch.points).map(|(q, p)| q.error(&position(p))).collect();
        Qem { weight: self.weight, quadrics, errors }
    }

    fn unload(measure: Qem<D, K>, patch: &Mesh<D>) -> QemPiece<K> {
        let (mut inside, mut rim) = (vec![], vec![]);
        for v in patch.connectivity.vertices() {
            let quadric = measure.quadrics[v.index()];
            if patch.pin(v) == Pin::Rim {
                rim.push((patch.vertex_source[v.index()], quadric));
            } else {
                inside.push(quadric);
            }
        }
        QemPiece { inside, rim }
    }

    fn join(mut self, rim: &[u32], seam: &[[u32; 3]], points: &[[f64; D]], pieces: Vec<QemPiece<K>>) -> Self {
        let inside: usize = pieces.iter().map(|piece| piece.inside.len()).sum();
        let mut next = Vec::with_capacity(rim.len() + inside);
        if self.quadrics.is_empty() {
            next.resize(rim.len(), Quadric::default());
            let place = |v: u32| rim.binary_search(&v).expect("a piece's rim is part of the whole rim");
            for (v, part) in pieces.iter().flat_map(|piece| &piece.rim) {
                next[place(*v)].add(part);
            }
            for [a, b, across] in seam {
                let importance = 0.5 * (self.importance(*a) + self.importance(*b));
                let [pa, pb, pc] = [a, b, across].map(|v| position(&points[*v as usize]));
                [a, b].iter().for_each(|v| add_boundary(&mut next[place(**v)], importance, &pa, &pb, &pc));
            }
        } else {
            next.extend(rim.iter().map(|&v| self.quadrics[v as usize]));
        }
        pieces.iter().for_each(|piece| next.extend_from_slice(&piece.inside));
        self.quadrics = next;
        self
    }
}
