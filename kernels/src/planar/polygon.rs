//! Straightened loops of a patch as a polygon, projected along its normal.

use std::ops::Range;

use super::border::Borders;
use super::fit::complete_frame;
use super::patches::Patch;
use crate::base::geometry::{Vec3, dot, position_of, segment_distance2, sub};
use crate::base::ids::{HalfedgeId, VertexId};
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::Mesh;

/// Kept border vertex, with its outgoing border halfedge.
#[derive(Clone, Copy, Debug)]
pub struct Corner {
    pub vertex: VertexId,
    pub halfedge: HalfedgeId,
    /// Position in the plane of the patch, relative to the extent of the loops.
    pub position: [f64; 2],
    pub next: usize,
    /// Index among the halfedges of its loop.
    loop_position: usize,
    loop_index: usize,
}

/// Corners of a patch, loop by loop, with the patch on the left.
pub struct Polygon<'a> {
    connectivity: &'a Connectivity,
    pub corners: Vec<Corner>,
    pub loops: Vec<Range<usize>>,
    halfedges: Vec<&'a [HalfedgeId]>,
}

impl<'a> Polygon<'a> {
    /// Project the kept vertices of patch `number` into its plane.
    pub fn new<const D: usize>(
        mesh: &'a Mesh<D>,
        borders: &'a Borders,
        number: usize,
        patch: &Patch,
        stays: &[bool],
    ) -> Self {
        let connectivity = &mesh.connectivity;
        let [e, f] = complete_frame(&patch.normal);
        let mut polygon = Self {
            connectivity,
            corners: vec![],
            loops: vec![],
            halfedges: borders.trace_patch_loops(number).collect(),
        };
        for (in_loop, halfedges) in borders.trace_patch_loops(number).enumerate() {
            let first = polygon.corners.len();
            for (place, &halfedge) in halfedges.iter().enumerate() {
                let vertex = connectivity.origin(halfedge);
                if stays[vertex.index()] {
                    let from = sub(&position_of(mesh.point(vertex)), &patch.origin);
                    let at = [dot(&e, &from), dot(&f, &from)];
                    let next = polygon.corners.len() + 1;
                    polygon.corners.push(Corner {
                        vertex,
                        halfedge,
                        position: at,
                        next,
                        loop_position: place,
                        loop_index: in_loop,
                    });
                }
            }
            let end = polygon.corners.len();
            if end > first {
                polygon.corners[end - 1].next = first;
            }
            polygon.loops.push(first..end);
        }
        polygon.scale_to_unit();
        polygon
    }

    /// Scale to unit extent, because the triangulator rejects coordinates near the limits of double
    /// precision.
    fn scale_to_unit(&mut self) {
        let extent = self.corners.iter().flat_map(|c| c.position).fold(0.0f64, |most, x| most.max(x.abs()));
        let settled = |x: f64| if x.abs() < 1e-30 { 0.0 } else { x };
        if extent > 0.0 {
            self.corners.iter_mut().for_each(|c| c.position = c.position.map(|x| settled(x / extent)));
        }
    }

    /// List the input edges that the chord from a corner to the next one replaces.
    pub fn chord_edges(&self, corner: usize) -> impl Iterator<Item = HalfedgeId> + '_ {
        let Corner { loop_position: place, loop_index: in_loop, next, .. } = self.corners[corner];
        let halfedges = self.halfedges[in_loop];
        let to = self.corners[next].loop_position;
        let length = if to > place { to - place } else { halfedges.len() + to - place };
        (place..place + length).map(move |i| halfedges[i % halfedges.len()])
    }

    /// Find the removed vertex farthest from the chord at a corner, and its distance.
    pub fn find_farthest<const D: usize>(&self, mesh: &Mesh<D>, corner: usize) -> Option<(VertexId, f64)> {
        let point = |v: VertexId| -> Vec3 { position_of(mesh.point(v)) };
        let a = point(self.corners[corner].vertex);
        let b = point(self.corners[self.corners[corner].next].vertex);
        let mut best: Option<(VertexId, f64)> = None;
        for h in self.chord_edges(corner).skip(1) {
            let v = self.connectivity.origin(h);
            let away = segment_distance2(&point(v), &a, &b);
            // Break ties by index, so that both sides of the border choose the same vertex.
            if best.is_none_or(|(w, most)| away > most || (away == most && v < w)) {
                best = Some((v, away));
            }
        }
        best.map(|(v, away)| (v, away.sqrt()))
    }

    /// List all vertices of loops without corners.
    pub fn vertices_of_empty_loops(&self) -> Vec<VertexId> {
        let bare = self.loops.iter().zip(&self.halfedges).filter(|(range, _)| range.is_empty());
        bare.flat_map(|(_, halfedges)| halfedges.iter().map(|&h| self.connectivity.origin(h))).collect()
    }

    /// Check whether all vertices of the loops are kept.
    pub fn is_complete(&self) -> bool {
        self.corners.len() == self.halfedges.iter().map(|l| l.len()).sum::<usize>()
    }

    /// Compute twice the signed area of a loop.
    pub fn twice_signed_area(&self, in_loop: usize) -> f64 {
        self.loops[in_loop]
            .clone()
            .map(|i| {
                let (a, b) = (self.corners[i].position, self.corners[self.corners[i].next].position);
                a[0] * b[1] - a[1] * b[0]
            })
            .sum()
    }
}
