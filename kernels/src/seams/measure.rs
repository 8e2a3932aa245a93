//! Measure of the simplification of a surface with seams: cost, new position and constraints.
//!
//! There are two quadrics (Feng, Ni and Luo 2012). Each vertex has one of shape alone, from the triangles of
//! all its copies and the walls on seams and boundaries. Each wedge has one of shape and attributes, from its
//! own triangles. Away from seams, only the wedge quadric is used. Near a seam, the position comes from the
//! shape quadric, and the attributes of each wedge from its own quadric. The cost is the weighted sum of
//! both. See [`super::quadrics`].
//!
//! A seam is a curve of edges. Vertices next to a seam collapse into it. A seam edge shrinks along the seam.
//! It keeps the texture coordinates of one end on each side, so they stay on the border of the chart. If the
//! removed end is in further charts, as where three charts meet, it keeps its texture coordinates there. The
//! tip of a seam that ends inside a chart may move on in the chart, or merge with the tip of the adjacent
//! seam. For example, the pole of a globe emits one seam for each triangle of its fan.

use super::merge_plan::MergePlan;
use super::region_state::{RefusalReason, SeamMeasure, common_value};
use super::wedges::{ABSENT, Wedge};
use crate::base::geometry::{Vec3, distance2};
use crate::base::ids::{EdgeId, HalfedgeId, VertexId};
use crate::collapse::engine::{CollapseChange, Measure, PriorityScope, Proposal};
use crate::mesh::connectivity::Connectivity;
use crate::mesh::edge_star::EdgeStar;
use crate::mesh::triangle_mesh::{Mesh, VertexLock};
use crate::quadrics::placement::{best_position, length_cost};
use crate::quadrics::quadric::Quadric;

impl<const D: usize, const K: usize> SeamMeasure<'_, D, K> {
    /// Find the cheapest legal position for a star that `allows` accepts.
    pub fn propose_if_allowed(
        &mut self,
        mesh: &Mesh<3>,
        star: &EdgeStar<3>,
        mut allows: impl FnMut(&Vec3) -> Result<(), RefusalReason>,
    ) -> Result<Proposal<3, ()>, RefusalReason> {
        let mut plan = self.plan.take();
        let proposal = self.find_proposal(mesh, star, &mut plan, &mut allows);
        self.plan.replace(plan);
        proposal
    }

    /// Find the cheapest legal position.
    ///
    /// Its candidate moves to the front of the plan.
    fn find_proposal(
        &self,
        mesh: &Mesh<3>,
        star: &EdgeStar<3>,
        plan: &mut MergePlan<K>,
        allows: &mut impl FnMut(&Vec3) -> Result<(), RefusalReason>,
    ) -> Result<Proposal<3, ()>, RefusalReason> {
        self.plan_collapse(mesh, star.edge, plan)?;
        let refusal = match self.find_first_legal(mesh, star, plan, allows) {
            Ok(proposal) => return Ok(proposal),
            Err(refusal) => refusal,
        };
        if !plan.is_plain || star.end_is_fixed != [false, false] {
            return Err(refusal);
        }
        plan.candidates.clear();
        for end in 0..2 {
            let candidate = self.price_candidate(mesh, star.edge, plan, star.end_points[end], Some(end));
            plan.candidates.push(candidate);
        }
        plan.candidates.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        self.find_first_legal(mesh, star, plan, allows)
    }

    /// Move the cheapest legal candidate to the front of the plan; otherwise return the last refusal.
    fn find_first_legal(
        &self,
        mesh: &Mesh<3>,
        star: &EdgeStar<3>,
        plan: &mut MergePlan<K>,
        allows: &mut impl FnMut(&Vec3) -> Result<(), RefusalReason>,
    ) -> Result<Proposal<3, ()>, RefusalReason> {
        let mut refusal = RefusalReason::Fold;
        for i in 0..plan.candidates.len() {
            let candidate = plan.candidates[i];
            let survivor = candidate.kept_end.unwrap_or_else(|| {
                let [a, b] = star.end_points.map(|p| distance2(&p, &candidate.position));
                usize::from(b < a)
            });
            if self.duplicates_element(mesh, star, survivor) {
                refusal = RefusalReason::Locked;
                continue;
            }
            let found = self.check_candidate(mesh, star, plan, candidate);
            match found.and_then(|()| allows(&candidate.position)) {
                Ok(()) => {
                    plan.candidates.swap(0, i);
                    return Ok(Proposal { survivor, point: candidate.position, change: () });
                }
                Err(rule) => refusal = rule,
            }
        }
        Err(refusal)
    }

    /// Merge each class into its remaining wedge, and reassign the corners around the survivor.
    fn merge_wedges(
        &mut self,
        connectivity: &Connectivity,
        star: &EdgeStar<3>,
        survivor: VertexId,
        plan: &MergePlan<K>,
    ) {
        let end = usize::from(star.ends[1] == survivor);
        for class in &plan.classes {
            let wedge = class.remaining_wedge(end);
            // Recomputed later from the remaining triangles.
            self.quadrics[wedge as usize] = Quadric::default();
            if self.wedges.set_attributes(wedge, class.at_end, class.value, class.home_triangle)
                && let Some(changes) = &mut self.changes
            {
                let &Wedge { initial_index: name, source, .. } = self.wedges.get(wedge);
                changes.changed(name, class.value, source);
            }
        }
        for wing in &star.remaining {
            let corners = [0, 1, 2].map(|i| HalfedgeId(3 * wing.triangle.0 + i));
            for h in corners.into_iter().filter(|&h| connectivity.origin(h) == survivor) {
                if let Some(class) = plan.class_of(wing.end, self.wedges.wedge_of(h)) {
                    self.wedges.of_corner[h.index()] = class.remaining_wedge(end);
                }
            }
        }
        if let Some(changes) = &mut self.changes {
            for member in &plan.members {
                let into = plan.classes[member.class].remaining_wedge(end);
                if into != member.wedge {
                    changes.merged(
                        self.wedges.get(member.wedge).initial_index,
                        self.wedges.get(into).initial_index,
                    );
                }
            }
            changes.finish_collapse();
        }
    }

    /// Update the summaries of the survivor and of the apexes.
    fn update_summaries(
        &mut self,
        connectivity: &Connectivity,
        star: &EdgeStar<3>,
        survivor: VertexId,
        is_plain: bool,
    ) {
        let [a, b] = star.ends.map(|v| self.summaries[v.index()]);
        let own = &mut self.summaries[survivor.index()];
        (own.material, own.part) = (common_value(a.material, b.material), common_value(a.part, b.part));
        if is_plain {
            // Inside a chart: one wedge remains, and two edges merge on either side.
            own.valence = a.valence + b.valence - 4;
        } else {
            let is_seam = |edge: EdgeId| self.is_seam[edge.index()];
            own.only_wedge = self.wedges.single_wedge(connectivity, survivor).unwrap_or(ABSENT);
            own.seam_degree =
                connectivity.vertex_edges(survivor).filter(|(edge, _)| is_seam(*edge)).count() as u32;
            own.valence = connectivity.vertex_edges(survivor).count() as u32;
        }
        for &(_, apex, _) in &star.vanishing {
            let spot = &mut self.summaries[apex.index()];
            spot.valence -= 1;
            if spot.only_wedge == ABSENT {
                spot.only_wedge = self.wedges.single_wedge(connectivity, apex).unwrap_or(ABSENT);
            }
        }
    }

    /// Recompute the seams around a vertex.
    ///
    /// A chart between two seams may have vanished.
    fn recompute_seams(&mut self, connectivity: &Connectivity, v: VertexId) {
        for (edge, _) in connectivity.vertex_edges(v) {
            self.is_seam[edge.index()] = self.wedges.is_seam(connectivity, edge);
        }
        for (_, other) in connectivity.vertex_edges(v) {
            let seams =
                connectivity.vertex_edges(other).filter(|(edge, _)| self.is_seam[edge.index()]).count();
            self.summaries[other.index()].seam_degree = seams as u32;
        }
    }
}

impl<const D: usize, const K: usize> Measure<3> for SeamMeasure<'_, D, K> {
    type Reason = RefusalReason;
    type Change = ();

    const PRIORITY_SCOPE: PriorityScope = PriorityScope::Ring;

    fn priority(&self, mesh: &Mesh<3>, edge: EdgeId) -> Result<f64, RefusalReason> {
        let ends = mesh.connectivity.ends(edge);
        let free = |v: &VertexId| mesh.lock(*v) == VertexLock::Free;
        if self.has_single_wedges(ends) && ends.iter().all(free) {
            let [a, b] = ends.map(|v| &self.quadrics[self.summaries[v.index()].only_wedge as usize]);
            let together = a.sum(b);
            let places = ends.map(|v| mesh.point(v));
            let (place, error) = best_position(&together, places);
            let cost = error + self.input_error(ends, &place) + length_cost(together.area, places);
            return Ok(self.penalty_factor(ends, 2) * cost);
        }
        let mut plan = self.plan.borrow_mut();
        self.plan_collapse(mesh, edge, &mut plan)?;
        Ok(plan.candidates[0].cost)
    }

    fn propose(&mut self, mesh: &Mesh<3>, star: &EdgeStar<3>) -> Result<Proposal<3, ()>, RefusalReason> {
        self.propose_if_allowed(mesh, star, |_| Ok(()))
    }

    fn judge(&mut self, _: &Mesh<3>, _: &EdgeStar<3>, _: &mut Proposal<3, ()>) -> Result<(), RefusalReason> {
        Ok(())
    }

    fn commit(&mut self, mesh: &Mesh<3>, star: &EdgeStar<3>, collapsed: &CollapseChange, (): ()) {
        let connectivity = &mesh.connectivity;
        let survivor = collapsed.survivor;
        let plan = self.plan.take();
        let moves_seam = self.is_seam[star.edge.index()] || star.ends.into_iter().any(|v| self.is_tip(v));
        self.remove_vanished(connectivity, star);
        self.store_moved_corners(connectivity, star, survivor);
        self.merge_wedges(connectivity, star, survivor, &plan);
        self.update_quadrics(mesh);
        for run in plan.runs.into_iter().flatten() {
            self.drifts.raise(run.next, run.drift);
        }
        for (kept, gone) in collapsed.merged.into_iter().flatten() {
            self.is_seam[kept.index()] |= self.is_seam[gone.index()];
            self.drifts.raise(kept, self.drifts.drift_of(gone));
        }
        if moves_seam {
            self.recompute_seams(connectivity, survivor);
        }
        self.invalidate_shape(connectivity, survivor);
        let [a, b] = star.ends.map(|v| self.history[v.index()]);
        self.history[survivor.index()] = a.sum(&b);
        self.update_summaries(connectivity, star, survivor, plan.is_plain);
        self.plan.replace(plan);
    }

    fn cost(&self, _: &Proposal<3, ()>) -> f64 {
        self.plan.borrow().candidates.first().map_or(f64::NEG_INFINITY, |chosen| chosen.cost)
    }
}
