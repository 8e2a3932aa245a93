//! Constraints of a collapse on the texture and on touching sheets. [`crate::mesh::collapse_legality`] checks
//! triangles in space.

use super::merge_plan::{Candidate, MergePlan};
use super::region_state::{RefusalReason, SeamMeasure};
use super::texture_space::keeps_orientation;
use super::wedges::{ABSENT, uv_of};
use super::welding::NO_SET;
use crate::base::geometry::{Vec3, distance2};
use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::mesh::collapse_legality::check_triangles;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::edge_star::EdgeStar;
use crate::mesh::triangle_mesh::Mesh;

impl<const D: usize, const K: usize> SeamMeasure<'_, D, K> {
    /// Check a candidate in space and texture, and complete the plan for it.
    ///
    /// No triangle may fold in space or texture. Every texture coordinate must stay in its chart, and seams
    /// within the drift bound.
    pub(super) fn check_candidate(
        &self,
        mesh: &Mesh<3>,
        star: &EdgeStar<3>,
        plan: &mut MergePlan<K>,
        candidate: Candidate,
    ) -> Result<(), RefusalReason> {
        if !is_within_reach(star, &candidate.position) || !is_in_box(&self.bounds, &candidate.position) {
            return Err(RefusalReason::Fold);
        }
        check_triangles(star, &candidate.position).map_err(|_| RefusalReason::Fold)?;
        let exact = candidate.kept_end.filter(|&end| candidate.position == star.end_points[end]);
        for i in 0..plan.classes.len() {
            let class = &plan.classes[i];
            let value = match exact.filter(|_| class.is_only_at(exact)) {
                Some(end) => self.wedges.get(class.at_end[end]).attributes,
                None => self.class_attributes(plan, class, &candidate.position, candidate.kept_end),
            };
            plan.classes[i].value = value;
        }
        if !self.keeps_texture_orientation(mesh, star, plan)
            || !self.find_homes(plan, candidate.kept_end.is_some())
        {
            return Err(RefusalReason::Chart);
        }
        plan.runs = [None; 2];
        if !self.is_seam[star.edge.index()] {
            plan.runs = self.find_moved_tips(mesh, star.edge, plan, &candidate.position, candidate.kept_end);
        } else if let Some(end) = candidate.kept_end {
            let mut runs = self.find_growing_seams(mesh, star.edge, plan.sides, end);
            let runs = [runs.next(), runs.next()];
            plan.runs = runs;
        }
        let drift = plan.runs.iter().flatten().fold(0.0, |drift: f64, run| drift.max(run.drift));
        if drift > self.knobs.seam_drift { Err(RefusalReason::Drift) } else { Ok(()) }
    }

    /// Test if no textured triangle of the star folds in the texture.
    fn keeps_texture_orientation(&self, mesh: &Mesh<3>, star: &EdgeStar<3>, plan: &MergePlan<K>) -> bool {
        star.remaining.iter().all(|wing| {
            let v = star.ends[wing.end];
            let corners = [0, 1, 2].map(|i| HalfedgeId(3 * wing.triangle.0 + i));
            let wedges = corners.map(|h| self.wedges.wedge_of(h));
            let moved = corners.iter().position(|&h| mesh.connectivity.origin(h) == v);
            let to =
                moved.and_then(|corner| plan.class_of(wing.end, wedges[corner]).map(|class| (corner, class)));
            let (true, Some((corner, class))) = (self.is_textured(wedges[0]), to) else {
                return true;
            };
            let before = wedges.map(|w| self.wedges.uv(w));
            let mut after = before;
            after[corner] = uv_of(&class.value);
            keeps_orientation(before, after)
        })
    }

    /// Find the input triangle that contains the texture coordinate of each class.
    ///
    /// False if one of them has no triangle. If `is_kept`, the coordinate comes from an end and is valid even
    /// if the walk leaves the chart.
    fn find_homes(&self, plan: &mut MergePlan<K>, is_kept: bool) -> bool {
        plan.classes.iter_mut().all(|class| {
            let mut own = class.at_end.into_iter().filter(|&w| w != ABSENT);
            let some = class.any_wedge();
            let uv = uv_of(&class.value);
            let start = self.wedges.get(some).home_triangle;
            let home = if !self.is_textured(some) {
                Some(start)
            } else if let Some(same) = own.find(|&w| self.wedges.uv(w) == uv) {
                Some(self.wedges.get(same).home_triangle)
            } else {
                self.charts.find_triangle(start, uv).or(is_kept.then_some(start))
            };
            class.home_triangle = home.unwrap_or(start);
            home.is_some()
        })
    }

    /// Test if a collapse would duplicate an edge or a triangle of another sheet.
    ///
    /// The link condition misses this case, because the other fan has separate vertices of the same set.
    pub(super) fn duplicates_element(&self, mesh: &Mesh<3>, star: &EdgeStar<3>, survivor: usize) -> bool {
        !self.touching_vertices.is_empty()
            && (self.duplicates_edge(mesh, star, survivor) || self.duplicates_triangle(mesh, star, survivor))
    }

    /// Iterate over the vertices of a set.
    fn vertices_of_set(&self, set: u32) -> impl Iterator<Item = VertexId> + '_ {
        let first = self.touching_vertices.partition_point(|&(other, _)| other < set);
        self.touching_vertices[first..].iter().take_while(move |(other, _)| *other == set).map(|&(_, v)| v)
    }

    /// Test if a new spoke of the survivor duplicates an edge.
    ///
    /// One of its ends is a touching vertex.
    fn duplicates_edge(&self, mesh: &Mesh<3>, star: &EdgeStar<3>, survivor: usize) -> bool {
        let (kept, gone) = (star.ends[survivor], star.ends[1 - survivor]);
        let own = self.touching_set(kept);
        let is_apex = |v: VertexId| star.vanishing.iter().any(|(_, apex, _)| *apex == v);
        // Test if a vertex has a neighbour in a set, other than a known one.
        let reaches = |from: VertexId, set: u32, known: VertexId| {
            mesh.connectivity.vertex_edges(from).any(|(_, v)| v != known && self.touching_set(v) == set)
        };
        let is_beside =
            |one: VertexId, other: VertexId| mesh.connectivity.vertex_edges(one).any(|(_, v)| v == other);
        mesh.connectivity.vertex_edges(gone).filter(|(_, v)| *v != kept).any(|(_, v)| {
            let touching = self.touching_set(v);
            if touching != NO_SET {
                (own != NO_SET && (own == touching || !is_apex(v))) || reaches(kept, touching, v)
            } else {
                // Some spokes of `v` may be in another region, but all vertices of the set are in this one.
                let others = || self.vertices_of_set(own).filter(|&other| other != kept);
                own != NO_SET && !is_apex(v) && others().any(|other| is_beside(other, v))
            }
        })
    }

    /// Test if a moved triangle gets the same corners as another one.
    ///
    /// Two of them are touching vertices then; the link condition covers all other cases.
    fn duplicates_triangle(&self, mesh: &Mesh<3>, star: &EdgeStar<3>, survivor: usize) -> bool {
        let connectivity = &mesh.connectivity;
        let (kept, gone) = (star.ends[survivor], star.ends[1 - survivor]);
        // Identity of a vertex in space after the collapse: its set, or the vertex itself.
        let place = |v: VertexId| {
            let v = if v == gone { kept } else { v };
            let set = self.touching_set(v);
            if set == NO_SET { (NO_SET, v) } else { (set, VertexId::NONE) }
        };
        let touches = |v: VertexId| place(v).0 != NO_SET;
        let vanishes = |t: TriangleId| star.vanishing.iter().any(|(vanishing, ..)| *vanishing == t);
        let own = self.touching_set(kept);
        let is_another = |v: &VertexId| *v != kept;
        let fans = || [kept, gone].into_iter().chain(self.vertices_of_set(own).filter(is_another));
        let moved = star.remaining.iter().filter(|wing| wing.end != survivor);
        moved
            .filter(|wing| {
                [kept, wing.side_start, wing.side_end].into_iter().filter(|&v| touches(v)).count() > 1
            })
            .any(|wing| {
                let [from, to] = [wing.side_start, wing.side_end].map(place);
                fans().flat_map(|v| connectivity.fan(v)).any(|h| {
                    let sides = [h, Connectivity::next(h)].map(|h| place(connectivity.target(h)));
                    let t = Connectivity::triangle(h);
                    t != wing.triangle && !vanishes(t) && (sides == [from, to] || sides == [to, from])
                })
            })
    }
}

/// Test if a position is in a box.
fn is_in_box([low, high]: &[Vec3; 2], place: &Vec3) -> bool {
    (0..3).all(|i| low[i] <= place[i] && place[i] <= high[i])
}

/// Check that a position is no farther from the middle than the star's vertices.
///
/// Nearly parallel planes intersect far away, where their quadric is small but the surface is not.
fn is_within_reach(star: &EdgeStar<3>, place: &Vec3) -> bool {
    let ends = star.end_points.iter().chain(star.spokes.iter().map(|(_, point)| point));
    let reach2 = ends.map(|point| distance2(point, &star.middle)).fold(0.0, f64::max);
    distance2(place, &star.middle) <= reach2
}
