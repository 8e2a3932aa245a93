//! Search for the vertices of a new level, in the encoder only.
//!
//! Li, Li, Xu and Li 2002, section 3.3. A line runs through the predicted vertex along its normal. It is
//! intersected with the associated sets of the adjacent base triangles. The nearest hit on either side is
//! stored as one number. Hits that are too far away or face another way belong to another sheet and are
//! ignored. Without a hit, the nearest point of the sets is stored as a vector.

use super::associated_sets::AssociatedSets;
use super::base_parametrization::BasePoint;
use super::boundary_chains::{BoundaryChains, ChainSpan};
use super::domain::Domain;
use super::level::Level;
use super::new_vertex::NewVertex;
use super::prediction::PredictedVertices;
use super::quantization::QuantizationSteps;
use super::surface::{Surface, SurfacePoint};
use crate::base::geometry::{Vec3, distance2};
use crate::base::parallel::fill;
use crate::subdivision::snm_contents::Offset;
use crate::subdivision::topology::NONE;

/// Maximum distance along a line, and to a nearest point, in lengths of the split edge.
const LINE_REACH: f64 = 1.0;
const NEAREST_REACH: f64 = 2.0;
/// Maximum distance to a nearest point outside the associated sets, in lengths of the split edge.
const UNASSOCIATED_REACH: f64 = 0.5;
/// Maximum distance of a hit from its expected position on the base, in lengths of the edge there.
const MAX_BASE_DEVIATION: f64 = 1.5;
/// Minimum cosine between a line and the normal of a triangle it hits.
const MIN_COSINE: f64 = 0.1;

/// Search input that all levels share.
pub struct SearchContext<'a> {
    pub surface: &'a Surface,
    pub sets: &'a AssociatedSets,
    pub rims: &'a BoundaryChains,
    pub domain: &'a Domain<'a>,
    pub threads: usize,
}

/// Part of a chain that each boundary edge represents, sorted by the ends of the edge.
pub type BoundarySpans = Vec<([u32; 2], ChainSpan)>;

/// Positions of a level's vertices on the input.
#[derive(Clone, Debug)]
pub struct LevelPositions {
    pub surface_points: Vec<SurfacePoint>,
    /// Positions of the same vertices on the base.
    pub base_points: Vec<BasePoint>,
    pub boundary_spans: BoundarySpans,
}

/// Search for the new vertices of one level, indexed by the edges of the coarser level.
pub struct VertexSearch<'a> {
    pub context: &'a SearchContext<'a>,
    /// Coarser level exactly as the decoder reconstructs it, and its number.
    pub level: &'a Level,
    pub level_index: usize,
    pub positions: &'a LevelPositions,
    pub predicted: &'a PredictedVertices,
    pub steps: &'a QuantizationSteps,
}

/// Expected position of a new vertex on the base, and the length of its edge there.
#[derive(Clone, Copy, Debug)]
struct ExpectedPosition {
    triangle: u32,
    barycentric: [f64; 3],
    length: f64,
}

fn max_coordinate_difference(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max)
}

impl VertexSearch<'_> {
    /// Find all new vertices.
    pub fn find_vertices(&self) -> Vec<NewVertex> {
        let nowhere = SurfacePoint { slot: 0, barycentric: [0.0; 3], point: [0.0; 3] };
        let nothing =
            NewVertex { offset: Offset::Scalar(0), point: [0.0; 3], surface_point: nowhere, arc_length: 0.0 };
        let mut found = vec![nothing; self.level.topology.edges.len()];
        fill(&mut found, self.context.threads, |edge| match self.find_span(edge) {
            Some(span) => {
                let (along, place) = self.context.rims.find_nearest(&span, &self.predicted.points[edge]);
                NewVertex { arc_length: along, ..self.encode_as_vector(edge, place) }
            }
            None if self.level.topology.is_boundary_edge(edge) => nothing,
            None => self.find_interior(edge),
        });
        found
    }

    /// Split the boundary spans at the new vertices.
    pub fn split_spans(&self, found: &[NewVertex]) -> BoundarySpans {
        let topology = &self.level.topology;
        let mut rim = Vec::with_capacity(2 * self.positions.boundary_spans.len());
        for (edge, ends) in topology.edges.iter().enumerate() {
            let Some(span) = self.find_span(edge) else { continue };
            let (middle, along) = ((topology.vertices + edge) as u32, found[edge].arc_length);
            rim.push(([ends[0], middle], ChainSpan { to: along, ..span }));
            rim.push(([middle, ends[1]], ChainSpan { from: along, ..span }));
        }
        rim.sort_unstable_by_key(|(ends, _)| *ends);
        rim
    }

    /// Return the part of a chain that an edge represents; None for interior edges.
    fn find_span(&self, edge: usize) -> Option<ChainSpan> {
        let topology = &self.level.topology;
        let (rim, ends) = (&self.positions.boundary_spans, &topology.edges[edge]);
        let known =
            if topology.is_boundary_edge(edge) { rim.binary_search_by_key(ends, |r| r.0).ok() } else { None };
        known.map(|known| rim[known].1)
    }

    /// Place the new vertex of a boundary edge at a fraction of its span; None for interior edges.
    pub fn find_on_boundary(&self, edge: usize, share: f64) -> Option<NewVertex> {
        let span = self.find_span(edge)?;
        let along = span.from + share * (span.to - span.from);
        Some(NewVertex {
            arc_length: along,
            ..self.encode_as_vector(edge, self.context.rims.point_at(span.chain, along))
        })
    }

    fn find_interior(&self, edge: usize) -> NewVertex {
        self.find_by_scalar(edge).or_else(|| self.find_by_unrelaxed_scalar(edge)).unwrap_or_else(|| {
            let from = &self.predicted.points[edge];
            let place = self.find_expected_point(edge);
            self.encode_as_vector(
                edge,
                place.unwrap_or_else(|| self.find_nearest(edge, from, &self.predicted.frames[edge][0])),
            )
        })
    }

    /// Find the vertex of an edge on the line through its predicted point.
    pub fn find_by_scalar(&self, edge: usize) -> Option<NewVertex> {
        self.find_on_line(edge, &self.predicted.points[edge], Offset::Scalar)
    }

    /// Find the vertex of an edge on the line through the unrelaxed point; None if both points are equal.
    pub fn find_by_unrelaxed_scalar(&self, edge: usize) -> Option<NewVertex> {
        let from = &self.predicted.unrelaxed[edge];
        if self.predicted.points[edge] == *from {
            None
        } else {
            self.find_on_line(edge, from, Offset::Unrelaxed)
        }
    }

    /// Find the vertex of an edge on the line through `from`. The hit must be near its expected position on
    /// the base.
    fn find_on_line(&self, edge: usize, from: &Vec3, kind: fn(i32) -> Offset) -> Option<NewVertex> {
        let reach = LINE_REACH * self.edge_length(edge);
        let expected = self.compute_expected_position(edge);
        let accept = |slot: u32, barycentric: &[f64; 3]| {
            self.is_associated(edge, slot)
                && expected.is_none_or(|expected| {
                    let at = self.context.domain.map_to_base(slot, barycentric, expected.triangle);
                    at.is_none_or(|at| {
                        max_coordinate_difference(&at, &expected.barycentric)
                            <= MAX_BASE_DEVIATION * expected.length
                    })
                })
        };
        let normal = &self.predicted.frames[edge][0];
        let (distance, place) =
            self.context.surface.intersect_line(from, normal, reach, MIN_COSINE, accept)?;
        let offset = kind(self.steps.scalar(distance));
        Some(NewVertex {
            offset,
            point: self.steps.apply_offset(self.predicted, edge, &offset),
            surface_point: place,
            arc_length: 0.0,
        })
    }

    /// Encode a surface point as the vertex of an edge by a vector offset.
    pub fn encode_as_vector(&self, edge: usize, place: SurfacePoint) -> NewVertex {
        let (point, frame) = (&self.predicted.points[edge], &self.predicted.frames[edge]);
        let offset = match self.steps.vector(point, frame, &place.point) {
            // A zero scalar is shorter than a zero vector. Boundary edges always store vectors.
            Offset::Vector([0, 0, 0]) if !self.level.topology.is_boundary_edge(edge) => Offset::Scalar(0),
            offset => offset,
        };
        NewVertex {
            offset,
            point: self.steps.apply_offset(self.predicted, edge, &offset),
            surface_point: place,
            arc_length: 0.0,
        }
    }

    /// Find the surface point at the expected position of an edge's vertex.
    pub fn find_expected_point(&self, edge: usize) -> Option<SurfacePoint> {
        let expected = self.compute_expected_position(edge)?;
        let domain = self.context.domain;
        domain.find_surface_point(&domain.to_containing_triangle(expected.triangle, expected.barycentric))
    }

    /// Compute the midpoint of an edge on the base, in the coordinates of the edge's first base triangle.
    fn compute_expected_position(&self, edge: usize) -> Option<ExpectedPosition> {
        let triangle = self.base_triangle(edge);
        let [a, b] = self.level.topology.edges[edge]
            .map(|v| self.context.domain.coordinates_in(&self.positions.base_points[v as usize], triangle));
        let (a, b) = (a?, b?);
        let barycentric = [0, 1, 2].map(|i| 0.5 * (a[i] + b[i]));
        Some(ExpectedPosition { triangle, barycentric, length: max_coordinate_difference(&a, &b) })
    }

    /// Map the surface point of an edge's vertex to the base.
    pub fn map_to_base(&self, edge: usize, place: &SurfacePoint) -> BasePoint {
        let (domain, triangle) = (self.context.domain, self.base_triangle(edge));
        let at = domain.map_to_base(place.slot, &place.barycentric, triangle);
        at.map_or(BasePoint::UNDEFINED, |at| domain.to_containing_triangle(triangle, at))
    }

    /// Find the nearest point of the associated sets that faces along `normal`, or the nearest one of any
    /// orientation.
    pub fn find_nearest(&self, edge: usize, p: &Vec3, normal: &Vec3) -> SurfacePoint {
        let surface = self.context.surface;
        let reach = NEAREST_REACH * self.edge_length(edge);
        let set = |slot| self.is_associated(edge, slot);
        let found = surface.find_nearest(p, normal, reach, MIN_COSINE, set);
        found.unwrap_or_else(|| {
            let all = self.base_triangles(edge).flat_map(|t| self.context.sets.members_of(t)).copied();
            surface.find_nearest_among(p, all)
        })
    }

    /// Find the nearest point of the whole surface that faces along `normal`, within [`UNASSOCIATED_REACH`] edge lengths.
    pub fn find_nearest_anywhere(&self, edge: usize, p: &Vec3, normal: &Vec3) -> Option<SurfacePoint> {
        self.context.surface.find_nearest(
            p,
            normal,
            UNASSOCIATED_REACH * self.edge_length(edge),
            MIN_COSINE,
            |_| true,
        )
    }

    /// List the base triangles adjacent to an edge, one or two.
    fn base_triangles(&self, edge: usize) -> impl Iterator<Item = usize> {
        let beside = self.level.topology.edge_triangles[edge].into_iter().filter(|&t| t != NONE);
        beside.map(|t| t as usize >> (2 * self.level_index))
    }

    /// Return the first base triangle adjacent to an edge.
    fn base_triangle(&self, edge: usize) -> u32 {
        self.level.topology.edge_triangles[edge][0] >> (2 * self.level_index)
    }

    /// Check whether an input triangle is in the associated sets of an edge.
    fn is_associated(&self, edge: usize, slot: u32) -> bool {
        self.base_triangles(edge).any(|t| self.context.sets.contains(t, slot))
    }

    /// Compute the length of an edge.
    fn edge_length(&self, edge: usize) -> f64 {
        let [a, b] = self.level.topology.edges[edge].map(|v| &self.level.points[v as usize]);
        distance2(a, b).sqrt()
    }
}
