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

use super::classes::Plan;
use super::state::{Rule, Seams, common};
use super::wedges::{NONE, Wedge};
use crate::base::geometry::{Vec3, distance2};
use crate::base::ids::{EdgeId, HalfedgeId, VertexId};
use crate::collapse::engine::{Collapsed, Measure, Proposal, Reach};
use crate::mesh::connectivity::Connectivity;
use crate::mesh::star::Star;
use crate::mesh::triangle_mesh::{Lock, Mesh};
use crate::quadrics::placement::{best_place, shorter_first};
use crate::quadrics::quadric::Quadric;

impl<const D: usize, const K: usize> Seams<'_, D, K> {
    /// Find the cheapest legal position for a star that `allows` accepts.
    pub fn propose_among(
        &mut self,
        mesh: &Mesh<3>,
        star: &Star<3>,
        mut allows: impl FnMut(&Vec3) -> Result<(), Rule>,
    ) -> Result<Proposal<3, ()>, Rule> {
        let mut plan = self.plan.take();
        let proposal = self.proposal(mesh, star, &mut plan, &mut allows);
        self.plan.replace(plan);
        proposal
    }

    /// Find the cheapest legal position.
    ///
    /// Its candidate moves to the front of the plan.
    fn proposal(
        &self,
        mesh: &Mesh<3>,
        star: &Star<3>,
        plan: &mut Plan<K>,
        allows: &mut impl FnMut(&Vec3) -> Result<(), Rule>,
    ) -> Result<Proposal<3, ()>, Rule> {
        self.plan(mesh, star.edge, plan)?;
        let refusal = match self.first_legal(mesh, star, plan, allows) {
            Ok(proposal) => return Ok(proposal),
            Err(refusal) => refusal,
        };
        if !plan.is_plain || star.end_stays != [false, false] {
            return Err(refusal);
        }
        plan.candidates.clear();
        for end in 0..2 {
            let candidate = self.priced(mesh, star.edge, plan, star.end_points[end], Some(end));
            plan.candidates.push(candidate);
        }
        plan.candidates.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        self.first_legal(mesh, star, plan, allows)
    }

    /// Move the cheapest legal candidate to the front of the plan; otherwise return the last refusal.
    fn first_legal(
        &self,
        mesh: &Mesh<3>,
        star: &Star<3>,
        plan: &mut Plan<K>,
        allows: &mut impl FnMut(&Vec3) -> Result<(), Rule>,
    ) -> Result<Proposal<3, ()>, Rule> {
        let mut refusal = Rule::Fold;
        for i in 0..plan.candidates.len() {
            let candidate = plan.candidates[i];
            let survivor = candidate.keep.unwrap_or_else(|| {
                let [a, b] = star.end_points.map(|p| distance2(&p, &candidate.place));
                usize::from(b < a)
            });
            if self.meets_another_sheet(mesh, star, survivor) {
                refusal = Rule::Locked;
                continue;
            }
            let found = self.try_candidate(mesh, star, plan, candidate);
            match found.and_then(|()| allows(&candidate.place)) {
                Ok(()) => {
                    plan.candidates.swap(0, i);
                    return Ok(Proposal { survivor, point: candidate.place, change: () });
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
        star: &Star<3>,
        survivor: VertexId,
        plan: &Plan<K>,
    ) {
        let end = usize::from(star.ends[1] == survivor);
        for class in &plan.classes {
            let wedge = class.kept(end);
            // Recomputed later from the remaining triangles.
            self.quadrics[wedge as usize] = Quadric::default();
            if self.wedges.put(wedge, class.at_end, class.value, class.home)
                && let Some(changes) = &mut self.changes
            {
                let &Wedge { name, source, .. } = self.wedges.at(wedge);
                changes.changed(name, class.value, source);
            }
        }
        for wing in &star.wings {
            let corners = [0, 1, 2].map(|i| HalfedgeId(3 * wing.triangle.0 + i));
            for h in corners.into_iter().filter(|&h| connectivity.origin(h) == survivor) {
                if let Some(class) = plan.class_of(wing.end, self.wedges.of(h)) {
                    self.wedges.of_corner[h.index()] = class.kept(end);
                }
            }
        }
        if let Some(changes) = &mut self.changes {
            for member in &plan.members {
                let into = plan.classes[member.class].kept(end);
                if into != member.wedge {
                    changes.merged(self.wedges.at(member.wedge).name, self.wedges.at(into).name);
                }
            }
            changes.next();
        }
    }

    /// Update the summaries of the survivor and of the apexes.
    fn merge_spots(
        &mut self,
        connectivity: &Connectivity,
        star: &Star<3>,
        survivor: VertexId,
        is_plain: bool,
    ) {
        let [a, b] = star.ends.map(|v| self.spots[v.index()]);
        let own = &mut self.spots[survivor.index()];
        (own.material, own.part) = (common(a.material, b.material), common(a.part, b.part));
        if is_plain {
            // Inside a chart: one wedge remains, and two edges merge on either side.
            own.valence = a.valence + b.valence - 4;
        } else {
            let is_seam = |edge: EdgeId| self.is_seam[edge.index()];
            own.only = self.wedges.only(connectivity, survivor).unwrap_or(NONE);
            own.seam_degree = connectivity.spokes(survivor).filter(|(edge, _)| is_seam(*edge)).count() as u32;
            own.valence = connectivity.spokes(survivor).count() as u32;
        }
        for &(_, apex, _) in &star.vanishing {
            let spot = &mut self.spots[apex.index()];
            spot.valence -= 1;
            if spot.only == NONE {
                spot.only = self.wedges.only(connectivity, apex).unwrap_or(NONE);
            }
        }
    }

    /// Recompute the seams around a vertex.
    ///
    /// A chart between two seams may have vanished.
    fn look_again(&mut self, connectivity: &Connectivity, v: VertexId) {
        for (edge, _) in connectivity.spokes(v) {
            self.is_seam[edge.index()] = self.wedges.is_seam(connectivity, edge);
        }
        for (_, other) in connectivity.spokes(v) {
            let seams = connectivity.spokes(other).filter(|(edge, _)| self.is_seam[edge.index()]).count();
            self.spots[other.index()].seam_degree = seams as u32;
        }
    }
}

impl<const D: usize, const K: usize> Measure<3> for Seams<'_, D, K> {
    type Bound = Rule;
    type Change = ();

    const REACH: Reach = Reach::Ring;

    fn priority(&self, mesh: &Mesh<3>, edge: EdgeId) -> Result<f64, Rule> {
        let ends = mesh.connectivity.ends(edge);
        let free = |v: &VertexId| mesh.lock(*v) == Lock::Free;
        if self.is_plain(ends) && ends.iter().all(free) {
            let [a, b] = ends.map(|v| &self.quadrics[self.spots[v.index()].only as usize]);
            let together = a.sum(b);
            let places = ends.map(|v| mesh.point(v));
            let (place, error) = best_place(&together, places);
            let cost = error + self.input_error(ends, &place) + shorter_first(together.area, places);
            return Ok(self.penalty(ends, 2) * cost);
        }
        let mut plan = self.plan.borrow_mut();
        self.plan(mesh, edge, &mut plan)?;
        Ok(plan.candidates[0].cost)
    }

    fn propose(&mut self, mesh: &Mesh<3>, star: &Star<3>) -> Result<Proposal<3, ()>, Rule> {
        self.propose_among(mesh, star, |_| Ok(()))
    }

    fn judge(&mut self, _: &Mesh<3>, _: &Star<3>, _: &mut Proposal<3, ()>) -> Result<(), Rule> {
        Ok(())
    }

    fn commit(&mut self, mesh: &Mesh<3>, star: &Star<3>, collapsed: &Collapsed, (): ()) {
        let connectivity = &mesh.connectivity;
        let survivor = collapsed.survivor;
        let plan = self.plan.take();
        let moves_seam = self.is_seam[star.edge.index()] || star.ends.into_iter().any(|v| self.is_tip(v));
        self.remove_vanished(connectivity, star);
        self.note_moved(connectivity, star, survivor);
        self.merge_wedges(connectivity, star, survivor, &plan);
        self.update_quadrics(mesh);
        for run in plan.runs.into_iter().flatten() {
            self.drifts.raise(run.next, run.drift);
        }
        for (kept, gone) in collapsed.merged.into_iter().flatten() {
            self.is_seam[kept.index()] |= self.is_seam[gone.index()];
            self.drifts.raise(kept, self.drifts.of(gone));
        }
        if moves_seam {
            self.look_again(connectivity, survivor);
        }
        self.forget_shape(connectivity, survivor);
        let [a, b] = star.ends.map(|v| self.history[v.index()]);
        self.history[survivor.index()] = a.sum(&b);
        self.merge_spots(connectivity, star, survivor, plan.is_plain);
        self.plan.replace(plan);
    }

    fn cost(&self, _: &Proposal<3, ()>) -> f64 {
        self.plan.borrow().candidates.first().map_or(f64::NEG_INFINITY, |chosen| chosen.cost)
    }
}
