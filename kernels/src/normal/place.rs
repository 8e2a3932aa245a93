//! Where the vertices of a new level go: the encoder's search for offsets.
//!
//! Li, Li, Xu and Li 2002, section 3.3: the line through a predicted vertex along its normal is pierced by the
//! associated triangles of the base triangles it lies on; the nearest hit in either direction is kept as one number.
//! What is too far away, or looks another way, is another sheet, and no hit. Where there is none, the nearest point of
//! the sets is kept as a vector.

use super::associated::Sets;
use super::domain::Domain;
use super::grid::Steps;
use super::parameters::Parameter;
use super::predict::Predicted;
use super::rim::{Rims, Span};
use super::surface::{Place, Surface};
use super::topology::{NONE, Topology};
use crate::geometry::{Vec3, norm2, sub};
use crate::parallel::fill;
use crate::snm::contents::Offset;

/// How far a line may reach, in lengths of the edge that is split.
const REACH: f64 = 1.0;
/// How far from where it is expected on the base a line may pierce, in lengths of the edge there.
const ASTRAY: f64 = 1.5;
/// Least cosine between a line and the normal of a triangle it pierces.
const LEAST_COSINE: f64 = 0.1;

/// The input of the search, the same for all levels.
pub struct Original<'a> {
    pub surface: &'a Surface,
    pub sets: &'a Sets,
    pub rims: &'a Rims,
    pub domain: &'a Domain<'a>,
    pub threads: usize,
}

/// A level as it is placed: points as the decoder will have them, and where on the surface they lie.
#[derive(Clone, Debug)]
pub struct Placed {
    pub points: Vec<Vec3>,
    pub places: Vec<Place>,
    /// Where on the base they lie.
    pub parameters: Vec<Parameter>,
    /// Boundary edges by their ends, sorted.
    pub rim: Vec<([u32; 2], Span)>,
}

/// Where a new vertex is expected on the base, and how far apart the ends of its edge are there.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    pub triangle: u32,
    pub barycentric: [f64; 3],
    pub length: f64,
}

fn apart(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max)
}

/// A new vertex.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    pub offset: Offset,
    pub point: Vec3,
    pub place: Place,
}

impl Original<'_> {
    /// The sets that count for a new vertex on an edge of level `level`.
    fn is_associated(&self, topology: &Topology, level: usize, edge: usize, slot: u32) -> bool {
        topology.edge_triangles[edge]
            .iter()
            .any(|&t| t != NONE && self.sets.holds(t as usize >> (2 * level), slot))
    }

    /// Offsets for the new vertices of one level, and the boundary of the next.
    pub fn refine(
        &self,
        topology: &Topology,
        level: usize,
        coarse: &Placed,
        predicted: &Predicted,
        steps: &Steps,
    ) -> (Vec<Found>, Vec<([u32; 2], Span)>) {
        let n = topology.vertices as u32;
        let mut rim = Vec::with_capacity(2 * coarse.rim.len());
        let mut on_rim = vec![];
        for (edge, ends) in topology.edges.iter().enumerate().filter(|(e, _)| topology.is_boundary_edge(*e)) {
            let Ok(known) = coarse.rim.binary_search_by_key(ends, |(ends, _)| *ends) else { continue };
            let span = coarse.rim[known].1;
            let (at, place) = self.rims.nearest(&span, &predicted.points[edge]);
            let middle = n + edge as u32;
            rim.push(([ends[0], middle], Span { to: at, ..span }));
            rim.push(([middle, ends[1]], Span { from: at, ..span }));
            on_rim.push((edge, place));
        }
        rim.sort_unstable_by_key(|(ends, _)| *ends);

        let nowhere = Place { slot: 0, barycentric: [0.0; 3], point: [0.0; 3] };
        let mut found =
            vec![Found { offset: Offset::Scalar(0), point: [0.0; 3], place: nowhere }; topology.edges.len()];
        fill(&mut found, self.threads, |edge| self.inside(topology, level, coarse, predicted, steps, edge));
        for (edge, place) in on_rim {
            found[edge] = vector_to(place, predicted, steps, edge, true);
        }
        (found, rim)
    }

    fn inside(
        &self,
        topology: &Topology,
        level: usize,
        coarse: &Placed,
        predicted: &Predicted,
        steps: &Steps,
        edge: usize,
    ) -> Found {
        let (relaxed, unrelaxed) = (&predicted.points[edge], &predicted.unrelaxed[edge]);
        let along = |from: &Vec3, kind: fn(i32) -> Offset| {
            self.scalar(topology, level, coarse, predicted, steps, edge, from, kind)
        };
        let scalar = along(relaxed, Offset::Scalar);
        let scalar =
            scalar.or_else(|| (relaxed != unrelaxed).then(|| along(unrelaxed, Offset::Unrelaxed))?);
        scalar.unwrap_or_else(|| {
            let place = self.expected_place(topology, level, coarse, edge).unwrap_or_else(|| {
                let normal = &predicted.frames[edge][0];
                self.nearest(topology, level, coarse, edge, relaxed, normal)
            });
            vector_to(place, predicted, steps, edge, false)
        })
    }

    /// The vertex of an edge on the line through `from`, if it pierces the surface near where it is expected.
    #[allow(clippy::too_many_arguments)]
    pub fn scalar(
        &self,
        topology: &Topology,
        level: usize,
        coarse: &Placed,
        predicted: &Predicted,
        steps: &Steps,
        edge: usize,
        from: &Vec3,
        kind: impl Fn(i32) -> Offset,
    ) -> Option<Found> {
        let [a, b] = topology.edges[edge].map(|v| coarse.points[v as usize]);
        let reach = REACH * norm2(&sub(&b, &a)).sqrt();
        let expected = self.expected(topology, level, coarse, edge);
        let accept = |slot: u32, barycentric: &[f64; 3]| {
            self.is_associated(topology, level, edge, slot)
                && expected.is_none_or(|expected| {
                    self.domain
                        .parameter(slot, barycentric, expected.triangle)
                        .is_none_or(|at| apart(&at, &expected.barycentric) <= ASTRAY * expected.length)
                })
        };
        let (distance, place) =
            self.surface.pierced(from, &predicted.frames[edge][0], reach, LEAST_COSINE, accept)?;
        let offset = kind(steps.scalar(distance));
        Some(Found { offset, point: steps.apply(predicted, edge, &offset), place })
    }

    /// The place of the surface where the vertex of an edge is expected.
    pub fn expected_place(
        &self,
        topology: &Topology,
        level: usize,
        coarse: &Placed,
        edge: usize,
    ) -> Option<Place> {
        let expected = self.expected(topology, level, coarse, edge)?;
        self.domain.located(&self.domain.settled(expected.triangle, expected.barycentric))
    }

    /// Half-way between the ends of an edge on the base, seen from the base triangle of the edge.
    pub fn expected(
        &self,
        topology: &Topology,
        level: usize,
        coarse: &Placed,
        edge: usize,
    ) -> Option<Expected> {
        let triangle = topology.edge_triangles[edge][0] >> (2 * level);
        let [a, b] =
            topology.edges[edge].map(|v| self.domain.seen_from(&coarse.parameters[v as usize], triangle));
        let (a, b) = (a?, b?);
        let barycentric = [0, 1, 2].map(|i| 0.5 * (a[i] + b[i]));
        Some(Expected { triangle, barycentric, length: apart(&a, &b) })
    }

    /// Where a place lies on the base, for the vertex of an edge.
    pub fn parameter_of(&self, topology: &Topology, level: usize, edge: usize, place: &Place) -> Parameter {
        let triangle = topology.edge_triangles[edge][0] >> (2 * level);
        match self.domain.parameter(place.slot, &place.barycentric, triangle) {
            Some(barycentric) => self.domain.settled(triangle, barycentric),
            None => Parameter::NOWHERE,
        }
    }

    /// The nearest place of the associated sets that looks along `normal`, or else any way.
    pub fn nearest(
        &self,
        topology: &Topology,
        level: usize,
        coarse: &Placed,
        edge: usize,
        p: &Vec3,
        normal: &Vec3,
    ) -> Place {
        let set = |slot| self.is_associated(topology, level, edge, slot);
        let [a, b] = topology.edges[edge].map(|v| coarse.points[v as usize]);
        let reach = 2.0 * norm2(&sub(&b, &a)).sqrt();
        let found = self.surface.nearest(p, normal, reach, LEAST_COSINE, set);
        let found = found.or_else(|| self.surface.nearest(p, normal, f64::INFINITY, f64::NEG_INFINITY, set));
        // A set is never empty.
        found.map_or(Place { slot: 0, barycentric: [1.0, 0.0, 0.0], point: *p }, |(_, place)| place)
    }
}

/// The vertex of an edge at a place that no scalar leads to.
pub fn vector_to(
    place: Place,
    predicted: &Predicted,
    steps: &Steps,
    edge: usize,
    on_boundary: bool,
) -> Found {
    let (point, frame) = (&predicted.points[edge], &predicted.frames[edge]);
    let offset = match steps.vector(point, frame, &place.point) {
        // Nothing to correct: a scalar says so in less.
        Offset::Vector([0, 0, 0]) if !on_boundary => Offset::Scalar(0),
        offset => offset,
    };
    Found { offset, point: steps.apply(predicted, edge, &offset), place }
}
