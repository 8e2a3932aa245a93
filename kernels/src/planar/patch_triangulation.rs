//! Triangulation of one patch, or the vertices to restore before the next attempt.

use super::assembly_state::{Assembly, sort_pair};
use super::border_straightening::compute_tolerance;
use super::polygon::Polygon;
use super::polygon_triangulation::{InvalidPolygon, Triangles, is_counterclockwise, triangulate};
use crate::base::geometry::dot;
use crate::base::ids::VertexId;
use crate::mesh::connectivity::Connectivity;

/// Attempts after which a patch gets all its border vertices back. One more failure makes it keep its
/// triangles.
pub(super) const MAX_ATTEMPTS: u8 = 8;

/// Result of triangulating one patch.
#[derive(Clone)]
pub(super) enum Outcome {
    Triangulated(Vec<([u32; 3], u32)>),
    /// Vertices to restore, because there is no triangulation without them.
    Restore(Vec<VertexId>),
    /// Vertices to restore, because they are too far from their chord since other vertices were restored.
    RestoreDistant(Vec<VertexId>),
    /// Keep the patch: nothing can be simplified.
    Keep,
    /// Keep the patch: no triangulation was found.
    Untriangulable,
}

impl<const D: usize> Assembly<'_, D> {
    /// Triangulate a patch, or determine the vertices to restore first.
    pub(super) fn retriangulate(&self, number: u32) -> Outcome {
        let patch = &self.patches.patches[number as usize];
        let inner = self.borders.interior_counts[number as usize];
        if patch.faces == 1 && self.is_border_complete(number) {
            return Outcome::Keep;
        }
        if !self.borders.is_disc_with_holes(number as usize, patch.faces)
            || dot(&patch.normal, &patch.normal) == 0.0
        {
            return Outcome::Untriangulable;
        }
        let polygon = self.polygon(number);
        if inner == 0 && polygon.is_complete() {
            return Outcome::Keep;
        }
        if self.rounds > 1 {
            let most = compute_tolerance(patch, self.options);
            let too_far = |c| polygon.find_farthest(self.mesh, c).filter(|(_, away)| *away > most);
            let far: Vec<VertexId> = (0..polygon.corners.len()).filter_map(too_far).map(|(v, _)| v).collect();
            if !far.is_empty() {
                return Outcome::RestoreDistant(far);
            }
        }
        let found =
            triangulate(&polygon).and_then(|found| self.flip_forbidden_edges(number, &polygon, found));
        match found {
            Ok(triangles) => Outcome::Triangulated(self.attach_sources(&polygon, &triangles)),
            Err(InvalidPolygon(chords)) => self.select_vertices_to_restore(number, &polygon, &chords),
        }
    }

    fn is_border_complete(&self, patch: u32) -> bool {
        let mut border = self.borders.trace_patch_loops(patch as usize).flatten();
        border.all(|&h| self.stays[self.mesh.connectivity.origin(h).index()])
    }

    /// Select vertices to restore: on the conflicting chords if known, otherwise on small loops or all
    /// chords.
    pub(super) fn select_vertices_to_restore(
        &self,
        number: u32,
        polygon: &Polygon<'_>,
        chords: &[usize],
    ) -> Outcome {
        let tries = self.attempt_counts[number as usize];
        if tries > MAX_ATTEMPTS || polygon.is_complete() {
            return Outcome::Untriangulable;
        }
        if tries == MAX_ATTEMPTS {
            let all = self.borders.trace_patch_loops(number as usize).flatten();
            return Outcome::Restore(all.map(|&h| self.mesh.connectivity.origin(h)).collect());
        }
        let mut back = polygon.vertices_of_empty_loops();
        let farthest = |&c: &usize| polygon.find_farthest(self.mesh, c).map(|(v, _)| v);
        back.extend(chords.iter().filter_map(farthest));
        if back.is_empty() {
            // Small loops are the most likely ones to have become invalid.
            let longest = polygon.loops.iter().map(|l| l.len()).max().unwrap_or(0);
            let small = polygon.loops.iter().filter(|l| l.len() < longest).flat_map(Clone::clone);
            back.extend(small.filter_map(|c| farthest(&c)));
        }
        if back.is_empty() {
            back.extend((0..polygon.corners.len()).filter_map(|c| farthest(&c)));
        }
        Outcome::Restore(back)
    }

    fn attach_sources(&self, polygon: &Polygon<'_>, triangles: &Triangles) -> Vec<([u32; 3], u32)> {
        let corner = |c: u32| &polygon.corners[c as usize];
        let sourced =
            |t: &[u32; 3]| (t.map(|c| corner(c).vertex.0), Connectivity::triangle(corner(t[0]).halfedge).0);
        triangles.iter().map(sourced).collect()
    }

    /// Flip edges that already exist elsewhere in the result.
    fn flip_forbidden_edges(
        &self,
        number: u32,
        polygon: &Polygon<'_>,
        mut triangles: Triangles,
    ) -> Result<Triangles, InvalidPolygon> {
        let from = self.forbidden.partition_point(|f| f.0 < number);
        let own: Vec<[VertexId; 2]> =
            self.forbidden[from..].iter().take_while(|f| f.0 == number).map(|f| f.1).collect();
        let vertex = |c: u32| polygon.corners[c as usize].vertex;
        let is_forbidden = |a: u32, b: u32| own.binary_search(&sort_pair(vertex(a), vertex(b))).is_ok();
        for _ in 0..2 * own.len() {
            let Some((t, side)) = (0..triangles.len())
                .flat_map(|t| (0..3).map(move |side| (t, side)))
                .find(|&(t, side)| is_forbidden(triangles[t][side], triangles[t][(side + 1) % 3]))
            else {
                return Ok(triangles);
            };
            let [a, b, c] = [0, 1, 2].map(|i| triangles[t][(side + i) % 3]);
            let across =
                (0..triangles.len()).flat_map(|t| (0..3).map(move |side| (t, side))).find(|&(u, side)| {
                    let ends = (triangles[u][side], triangles[u][(side + 1) % 3]);
                    vertex(ends.0) == vertex(b) && vertex(ends.1) == vertex(a)
                });
            let Some((u, other)) = across else { return Err(InvalidPolygon(vec![])) };
            let d = triangles[u][(other + 2) % 3];
            let flipped = [[a, d, c], [d, b, c]];
            if is_forbidden(c, d) || !flipped.iter().all(|&f| is_counterclockwise(polygon, f)) {
                return Err(InvalidPolygon(vec![]));
            }
            (triangles[t], triangles[u]) = (flipped[0], flipped[1]);
        }
        if own.is_empty() { Ok(triangles) } else { Err(InvalidPolygon(vec![])) }
    }
}
