//! Search for the vertices of a new level, in the encoder only.
//!
//! Li, Li, Xu and Li 2002, section 3.3. A line runs through the predicted vertex along its normal. It is
//! intersected with the associated sets of the adjacent base triangles. The nearest hit on either side is
//! stored as one number. Hits that are too far away or face another way belong to another sheet and are
//! ignored. Without a hit, the nearest point of the sets is stored as a vector.

use super::associated::Sets;
use super::domain::Domain;
use super::found::Found;
use super::grid::Steps;
use super::level::Level;
use super::parameters::Parameter;
use super::predict::Predicted;
use super::rim::{Rims, Span};
use super::surface::{Place, Surface};
use crate::base::geometry::{Vec3, distance2};
use crate::base::parallel::fill;
use crate::subdivision::contents::Offset;
use crate::subdivision::topology::NONE;

/// Maximum distance along a line, and to a nearest point, in lengths of the split edge.
const REACH: f64 = 1.0;
const NEAR: f64 = 2.0;
/// Maximum distance to a nearest point outside the associated sets, in lengths of the split edge.
const HERE: f64 = 0.5;
/// Maximum distance of a hit from its expected position on the base, in lengths of the edge there.
const ASTRAY: f64 = 1.5;
/// Minimum cosine between a line and the normal of a triangle it hits.
const LEAST_COSINE: f64 = 0.1;

/// Search input that all levels share.
pub struct Original<'a> {
    pub surface: &'a Surface,
    pub sets: &'a Sets,
    pub rims: &'a Rims,
    pub domain: &'a Domain<'a>,
    pub threads: usize,
}

/// Part of a chain that each boundary edge represents, sorted by the ends of the edge.
pub type Rim = Vec<([u32; 2], Span)>;

/// Positions of a level's vertices on the input.
#[derive(Clone, Debug)]
pub struct Placed {
    pub places: Vec<Place>,
    /// Positions of the same vertices on the base.
    pub parameters: Vec<Parameter>,
    pub rim: Rim,
}

/// Search for the new vertices of one level, indexed by the edges of the coarser level.
pub struct Search<'a> {
    pub original: &'a Original<'a>,
    /// Coarser level exactly as the decoder reconstructs it, and its number.
    pub level: &'a Level,
    pub number: usize,
    pub placed: &'a Placed,
    pub predicted: &'a Predicted,
    pub steps: &'a Steps,
}

/// Expected position of a new vertex on the base, and the length of its edge there.
#[derive(Clone, Copy, Debug)]
struct Expected {
    triangle: u32,
    barycentric: [f64; 3],
    length: f64,
}

fn apart(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max)
}

impl Search<'_> {
    /// Find all new vertices.
    pub fn refine(&self) -> Vec<Found> {
        let nowhere = Place { slot: 0, barycentric: [0.0; 3], point: [0.0; 3] };
        let nothing = Found { offset: Offset::Scalar(0), point: [0.0; 3], place: nowhere, along: 0.0 };
        let mut found = vec![nothing; self.level.topology.edges.len()];
        fill(&mut found, self.original.threads, |edge| match self.span(edge) {
            Some(span) => {
                let (along, place) = self.original.rims.nearest(&span, &self.predicted.points[edge]);
                Found { along, ..self.vector(edge, place) }
            }
            None if self.level.topology.is_boundary_edge(edge) => nothing,
            None => self.inside(edge),
        });
        found
    }

    /// Split the boundary spans at the new vertices.
    pub fn rim(&self, found: &[Found]) -> Rim {
        let topology = &self.level.topology;
        let mut rim = Vec::with_capacity(2 * self.placed.rim.len());
        for (edge, ends) in topology.edges.iter().enumerate() {
            let Some(span) = self.span(edge) else { continue };
            let (middle, along) = ((topology.vertices + edge) as u32, found[edge].along);
            rim.push(([ends[0], middle], Span { to: along, ..span }));
            rim.push(([middle, ends[1]], Span { from: along, ..span }));
        }
        rim.sort_unstable_by_key(|(ends, _)| *ends);
        rim
    }

    /// Return the part of a chain that an edge represents; None for interior edges.
    fn span(&self, edge: usize) -> Option<Span> {
        let topology = &self.level.topology;
        let (rim, ends) = (&self.placed.rim, &topology.edges[edge]);
        let known =
            if topology.is_boundary_edge(edge) { rim.binary_search_by_key(ends, |r| r.0).ok() } else { None };
        known.map(|known| rim[known].1)
    }

    /// Place the new vertex of a boundary edge at a fraction of its span; None for interior edges.
    pub fn on_rim(&self, edge: usize, share: f64) -> Option<Found> {
        let span = self.span(edge)?;
        let along = span.from + share * (span.to - span.from);
        Some(Found { along, ..self.vector(edge, self.original.rims.at(span.chain, along)) })
    }

    fn inside(&self, edge: usize) -> Found {
        self.scalar(edge).or_else(|| self.unrelaxed(edge)).unwrap_or_else(|| {
            let from = &self.predicted.points[edge];
            let place = self.expected_place(edge);
            self.vector(
                edge,
                place.unwrap_or_else(|| self.nearest(edge, from, &self.predicted.frames[edge][0])),
            )
        })
    }

    /// Find the vertex of an edge on the line through its predicted point.
    pub fn scalar(&self, edge: usize) -> Option<Found> {
        self.along(edge, &self.predicted.points[edge], Offset::Scalar)
    }

    /// Find the vertex of an edge on the line through the unrelaxed point; None if both points are equal.
    pub fn unrelaxed(&self, edge: usize) -> Option<Found> {
        let from = &self.predicted.unrelaxed[edge];
        if self.predicted.points[edge] == *from { None } else { self.along(edge, from, Offset::Unrelaxed) }
    }

    /// Find the vertex of an edge on the line through `from`. The hit must be near its expected position on
    /// the base.
    fn along(&self, edge: usize, from: &Vec3, kind: fn(i32) -> Offset) -> Option<Found> {
        let reach = REACH * self.length(edge);
        let expected = self.expected(edge);
        let accept = |slot: u32, barycentric: &[f64; 3]| {
            self.is_associated(edge, slot)
                && expected.is_none_or(|expected| {
                    let at = self.original.domain.parameter(slot, barycentric, expected.triangle);
                    at.is_none_or(|at| apart(&at, &expected.barycentric) <= ASTRAY * expected.length)
                })
        };
        let normal = &self.predicted.frames[edge][0];
        let (distance, place) = self.original.surface.pierced(from, normal, reach, LEAST_COSINE, accept)?;
        let offset = kind(self.steps.scalar(distance));
        Some(Found { offset, point: self.steps.apply(self.predicted, edge, &offset), place, along: 0.0 })
    }

    /// Encode a surface point as the vertex of an edge by a vector offset.
    pub fn vector(&self, edge: usize, place: Place) -> Found {
        let (point, frame) = (&self.predicted.points[edge], &self.predicted.frames[edge]);
        let offset = match self.steps.vector(point, frame, &place.point) {
            // A zero scalar is shorter than a zero vector. Boundary edges always store vectors.
            Offset::Vector([0, 0, 0]) if !self.level.topology.is_boundary_edge(edge) => Offset::Scalar(0),
            offset => offset,
        };
        Found { offset, point: self.steps.apply(self.predicted, edge, &offset), place, along: 0.0 }
    }

    /// Find the surface point at the expected position of an edge's vertex.
    pub fn expected_place(&self, edge: usize) -> Option<Place> {
        let expected = self.expected(edge)?;
        let domain = self.original.domain;
        domain.located(&domain.settled(expected.triangle, expected.barycentric))
    }

    /// Compute the midpoint of an edge on the base, in the coordinates of the edge's first base triangle.
    fn expected(&self, edge: usize) -> Option<Expected> {
        let triangle = self.base_triangle(edge);
        let [a, b] = self.level.topology.edges[edge]
            .map(|v| self.original.domain.seen_from(&self.placed.parameters[v as usize], triangle));
        let (a, b) = (a?, b?);
        let barycentric = [0, 1, 2].map(|i| 0.5 * (a[i] + b[i]));
        Some(Expected { triangle, barycentric, length: apart(&a, &b) })
    }

    /// Map the surface point of an edge's vertex to the base.
    pub fn parameter(&self, edge: usize, place: &Place) -> Parameter {
        let (domain, triangle) = (self.original.domain, self.base_triangle(edge));
        let at = domain.parameter(place.slot, &place.barycentric, triangle);
        at.map_or(Parameter::NOWHERE, |at| domain.settled(triangle, at))
    }

    /// Find the nearest point of the associated sets that faces along `normal`, or the nearest one of any
    /// orientation.
    pub fn nearest(&self, edge: usize, p: &Vec3, normal: &Vec3) -> Place {
        let surface = self.original.surface;
        let reach = NEAR * self.length(edge);
        let set = |slot| self.is_associated(edge, slot);
        let found = surface.nearest(p, normal, reach, LEAST_COSINE, set);
        found.unwrap_or_else(|| {
            let all = self.base_triangles(edge).flat_map(|t| self.original.sets.of(t)).copied();
            surface.nearest_among(p, all)
        })
    }

    /// Find the nearest point of the whole surface that faces along `normal`, within [`HERE`] edge lengths.
    pub fn anywhere(&self, edge: usize, p: &Vec3, normal: &Vec3) -> Option<Place> {
        self.original.surface.nearest(p, normal, HERE * self.length(edge), LEAST_COSINE, |_| true)
    }

    /// List the base triangles adjacent to an edge, one or two.
    fn base_triangles(&self, edge: usize) -> impl Iterator<Item = usize> {
        let beside = self.level.topology.edge_triangles[edge].into_iter().filter(|&t| t != NONE);
        beside.map(|t| t as usize >> (2 * self.number))
    }

    /// Return the first base triangle adjacent to an edge.
    fn base_triangle(&self, edge: usize) -> u32 {
        self.level.topology.edge_triangles[edge][0] >> (2 * self.number)
    }

    /// Check whether an input triangle is in the associated sets of an edge.
    fn is_associated(&self, edge: usize, slot: u32) -> bool {
        self.base_triangles(edge).any(|t| self.original.sets.holds(t, slot))
    }

    /// Compute the length of an edge.
    fn length(&self, edge: usize) -> f64 {
        let [a, b] = self.level.topology.edges[edge].map(|v| &self.level.points[v as usize]);
        distance2(a, b).sqrt()
    }
}
