//! Planning of a collapse: classes of wedges around an edge, candidate positions, and their cost.

use super::merge_plan::{Candidate, ClassMember, GrowingSeam, MergePlan, WedgeClass};
use super::region_state::{PENALTY_VALENCE, RefusalReason, SEVERAL, SeamMeasure, common_value};
use super::texture_space::{next_seam_halfedge, previous_seam_halfedge, segment_distance, uv_distance};
use super::wedges::{ABSENT, Wedge, uv_of};
use crate::base::geometry::Vec3;
use crate::base::ids::{EdgeId, HalfedgeId, VertexId};
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::Mesh;
use crate::quadrics::placement::{best_position, length_cost};

impl<const D: usize, const K: usize> SeamMeasure<'_, D, K> {
    /// Compute the cost factor of all penalties.
    pub(super) fn penalty_factor(&self, ends: [VertexId; 2], wedges: usize) -> f64 {
        let [a, b] = ends.map(|v| &self.summaries[v.index()]);
        let valence = (a.valence + b.valence).saturating_sub(4 + PENALTY_VALENCE);
        let mut factor = 1.0 + self.knobs.valence * f64::from(valence);
        if common_value(a.material, b.material) == SEVERAL {
            factor += self.knobs.material_border_penalty;
        }
        if common_value(a.part, b.part) == SEVERAL {
            factor += self.knobs.part_border_penalty;
        }
        factor + self.knobs.wedges * wedges.saturating_sub(2) as f64
    }

    /// Compute the classes of wedges and the candidate positions, cheapest first.
    pub(super) fn plan_collapse(
        &self,
        mesh: &Mesh<3>,
        edge: EdgeId,
        plan: &mut MergePlan<K>,
    ) -> Result<(), RefusalReason> {
        let connectivity = &mesh.connectivity;
        let ends = connectivity.ends(edge);
        let stays = mesh.fixed_ends(edge);
        if stays == [true, true] {
            return Err(RefusalReason::Locked);
        }
        plan.is_plain = self.has_single_wedges(ends);
        if plan.is_plain && stays == [false, false] {
            // No other position is cheaper; the ends are only tried if this one is not legal.
            self.group_single_wedges(ends, plan);
            let best = best_position(&plan.classes[0].quadric, ends.map(|v| mesh.point(v))).0;
            plan.candidates.clear();
            plan.candidates.push(self.price_candidate(mesh, edge, plan, best, None));
            return Ok(());
        }
        let on_seam = self.is_seam[edge.index()];
        // A vertex on a seam must not move along an edge that is not part of the seam.
        let may_go = |end: usize| {
            let is_beside = || self.summaries[ends[end].index()].seam_degree == 0;
            !stays[end] && (on_seam || is_beside() || self.may_tip_move(mesh, edge, end))
        };
        if !may_go(0) && !may_go(1) {
            return Err(RefusalReason::Seam);
        }
        let first = connectivity.halfedge(edge);
        self.group_wedges(connectivity, ends, [first, connectivity.twin(first)], plan);
        // The tip of a seam has one wedge for both sides, so its target side would be ambiguous.
        let [goes_to_first, goes_to_second] = [0, 1]
            .map(|end| may_go(1 - end) && plan.classes.iter().all(|class| !class.has_different_uvs[end]));

        let places = ends.map(|v| *mesh.point(v));
        plan.shape = self.shape_quadric(mesh, ends[0]).sum(&self.shape_quadric(mesh, ends[1]));
        plan.candidates.clear();
        let has_image = plan.sides.iter().flatten().any(|&[wedge, _]| self.is_textured(wedge));
        let mut wanted = [None; 4];
        if goes_to_first && goes_to_second {
            let best = best_position(&plan.shape, places.each_ref()).0;
            if on_seam && has_image {
                wanted[..2].copy_from_slice(&[Some((best, Some(0))), Some((best, Some(1)))]);
            } else {
                wanted[0] = Some((best, None));
            }
        }
        wanted[2] = goes_to_first.then_some((places[0], Some(0)));
        wanted[3] = goes_to_second.then_some((places[1], Some(1)));
        for (place, keep) in wanted.into_iter().flatten() {
            plan.candidates.push(self.price_candidate(mesh, edge, plan, place, keep));
        }
        plan.candidates.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        if plan.candidates.is_empty() { Err(RefusalReason::Seam) } else { Ok(()) }
    }

    /// Compute the cost of a candidate position.
    pub(super) fn price_candidate(
        &self,
        mesh: &Mesh<3>,
        edge: EdgeId,
        plan: &MergePlan<K>,
        place: Vec3,
        keep: Option<usize>,
    ) -> Candidate {
        let ends = mesh.connectivity.ends(edge);
        let places = ends.map(|v| mesh.point(v));
        let exact = keep.filter(|&end| place == *places[end]);
        let area = if plan.is_plain { plan.classes[0].quadric.area } else { plan.shape.area };
        let mut cost = length_cost(area, places);
        for class in plan.classes.iter().filter(|class| !class.is_only_at(exact)) {
            cost += class.quadric.error_with(&place, &self.class_attributes(plan, class, &place, keep));
        }
        if !plan.is_plain {
            cost += self.knobs.shape * plan.shape.error(&place);
        }
        cost += self.input_error(ends, &place);
        // Seam drift is bounded, but costs nothing: its visible part, the shift of the texture next to the
        // seam, is in the quadrics of the wedges.
        Candidate {
            position: place,
            kept_end: keep,
            cost: self.penalty_factor(ends, plan.members.len()) * cost,
        }
    }

    /// Group the wedges of both ends: those that meet along the edge, on the same side, form one class.
    fn group_wedges(
        &self,
        connectivity: &Connectivity,
        ends: [VertexId; 2],
        [first, second]: [HalfedgeId; 2],
        plan: &mut MergePlan<K>,
    ) {
        let wedges = &self.wedges;
        plan.members.clear();
        plan.classes.clear();
        plan.sides = [
            Some([wedges.wedge_of(first), wedges.wedge_of(Connectivity::next(first))]),
            second.is_some().then(|| [wedges.wedge_of(Connectivity::next(second)), wedges.wedge_of(second)]),
        ];
        for (end, &v) in ends.iter().enumerate() {
            let own = plan.members.len();
            let mut join = |wedge: u32| {
                if !plan.members[own..].iter().any(|m| m.wedge == wedge) {
                    plan.members.push(ClassMember { wedge, end, class: plan.members.len() });
                }
            };
            match self.summaries[v.index()].only_wedge {
                ABSENT => connectivity.fan(v).for_each(|h| join(wedges.wedge_of(h))),
                wedge => join(wedge),
            }
        }
        for [a, b] in plan.sides.into_iter().flatten() {
            let class = |end: usize, wedge: u32| {
                plan.members.iter().find(|m| m.end == end && m.wedge == wedge).map_or(0, |m| m.class)
            };
            let (one, other) = (class(0, a), class(1, b));
            let (kept, gone) = (one.min(other), one.max(other));
            plan.members.iter_mut().filter(|m| m.class == gone).for_each(|m| m.class = kept);
        }
        // Renumber the classes without gaps, in the order of their first member.
        for i in 0..plan.members.len() {
            let ClassMember { wedge, end, class } = plan.members[i];
            let quadric = &self.quadrics[wedge as usize];
            if class == i {
                let mut at_end = [ABSENT; 2];
                at_end[end] = wedge;
                plan.members[i].class = plan.classes.len();
                plan.classes.push(WedgeClass {
                    quadric: *quadric,
                    at_end,
                    has_different_uvs: [false; 2],
                    is_merged: false,
                    value: wedges.get(wedge).attributes,
                    home_triangle: wedges.get(wedge).home_triangle,
                });
            } else {
                let class = plan.members[class].class;
                plan.members[i].class = class;
                let class = &mut plan.classes[class];
                class.quadric.add(quadric);
                class.is_merged = true;
                match class.at_end[end] {
                    ABSENT => class.at_end[end] = wedge,
                    other => class.has_different_uvs[end] |= !wedges.has_same_uv(other, wedge),
                }
            }
        }
    }

    /// As [`Self::group_wedges`] if each end has one wedge: they form one class.
    fn group_single_wedges(&self, ends: [VertexId; 2], plan: &mut MergePlan<K>) {
        let at_end = ends.map(|v| self.summaries[v.index()].only_wedge);
        let [a, b] = at_end.map(|wedge| &self.quadrics[wedge as usize]);
        let &Wedge { attributes, home_triangle: home, .. } = self.wedges.get(at_end[0]);
        plan.sides = [None; 2];
        plan.members.clear();
        plan.members.extend([0, 1].map(|end| ClassMember { wedge: at_end[end], end, class: 0 }));
        plan.classes.clear();
        plan.classes.push(WedgeClass {
            quadric: a.sum(b),
            at_end,
            has_different_uvs: [false; 2],
            is_merged: true,
            value: attributes,
            home_triangle: home,
        });
    }

    /// Compute the attributes of a class at a position.
    pub(super) fn class_attributes(
        &self,
        plan: &MergePlan<K>,
        class: &WedgeClass<K>,
        place: &Vec3,
        keep: Option<usize>,
    ) -> [f64; K] {
        let some = class.any_wedge();
        let mut value = class.quadric.attributes_at(place, &self.wedges.get(some).attributes);
        if !self.is_textured(some) {
            return value;
        }
        let uv = match keep {
            Some(end) if class.at_end[end] != ABSENT => Some(self.wedges.uv(class.at_end[end])),
            Some(end) => {
                // A wedge only at the other end may differ only by colour or normal from a wedge that meets
                // the edge. If it is in another chart, it keeps its texture coordinate.
                let own = class.at_end[1 - end];
                let meets = |side: &&[u32; 2]| self.wedges.has_same_uv(side[1 - end], own);
                let beside = plan.sides.iter().flatten().find(meets).map(|side| side[end]);
                Some(self.wedges.uv(beside.unwrap_or(own)))
            }
            None => {
                let [a, b] = class.at_end;
                let is_one = a != ABSENT && b != ABSENT && self.wedges.uv(a) == self.wedges.uv(b);
                is_one.then(|| self.wedges.uv(a))
            }
        };
        if let Some(uv) = uv {
            value[..2].copy_from_slice(&uv);
        }
        // Exact copy, so that unchanged attributes are recognised.
        if let Some(end) = keep.filter(|&end| K == 2 && class.at_end[end] != ABSENT) {
            value = self.wedges.get(class.at_end[end]).attributes;
        }
        value
    }

    /// Test if a vertex is the tip of a seam that ends inside a chart.
    ///
    /// One wedge covers both sides there.
    #[inline]
    pub(super) fn is_tip(&self, v: VertexId) -> bool {
        let spot = &self.summaries[v.index()];
        spot.seam_degree == 1 && spot.only_wedge != ABSENT
    }

    /// Test if the tip of a seam may move along an edge off the seam.
    ///
    /// It may move on inside the chart, or merge with the seam of the other end. An example is the pole of a
    /// globe, which emits one seam for each triangle of its fan.
    fn may_tip_move(&self, mesh: &Mesh<3>, edge: EdgeId, end: usize) -> bool {
        let connectivity = &mesh.connectivity;
        let ends = connectivity.ends(edge);
        if !self.is_tip(ends[end]) {
            return false;
        }
        let other = &self.summaries[ends[1 - end].index()];
        if other.seam_degree == 0 && other.only_wedge != ABSENT {
            return true;
        }
        let first = connectivity.halfedge(edge);
        let is_seam = |h: HalfedgeId| self.is_seam[connectivity.edge(h).index()];
        let closes = |h: HalfedgeId| is_seam(Connectivity::next(h)) && is_seam(Connectivity::prev(h));
        [first, connectivity.twin(first)].into_iter().any(|h| h.is_some() && closes(h))
    }

    /// Find the seams whose tips are ends of a collapsing edge.
    ///
    /// The edge itself is no seam. Returns their texture drift after the collapse.
    pub(super) fn find_moved_tips(
        &self,
        mesh: &Mesh<3>,
        edge: EdgeId,
        plan: &MergePlan<K>,
        place: &Vec3,
        keep: Option<usize>,
    ) -> [Option<GrowingSeam>; 2] {
        let connectivity = &mesh.connectivity;
        let ends = connectivity.ends(edge);
        [0, 1].map(|end| {
            let v = ends[end];
            if plan.is_plain || !self.is_tip(v) {
                return None;
            }
            let wedge = self.summaries[v.index()].only_wedge;
            let class = plan.class_of(end, wedge)?;
            let (next, _) = connectivity.vertex_edges(v).find(|(edge, _)| self.is_seam[edge.index()])?;
            let mut drift = self.drifts.drift_of(next);
            if self.is_textured(wedge) {
                let [to, from] =
                    [uv_of(&self.class_attributes(plan, class, place, keep)), self.wedges.uv(wedge)];
                drift += uv_distance(to, from);
            }
            Some(GrowingSeam { next, drift })
        })
    }

    /// Find the seam edges that grow when a seam edge shrinks to its end `keep`.
    ///
    /// On each side of the edge, this is the next seam edge beyond the other end. Returns their texture drift
    /// after the collapse.
    pub(super) fn find_growing_seams<'a>(
        &'a self,
        mesh: &'a Mesh<3>,
        edge: EdgeId,
        sides: [Option<[u32; 2]>; 2],
        keep: usize,
    ) -> impl Iterator<Item = GrowingSeam> + 'a {
        let connectivity = &mesh.connectivity;
        let first = connectivity.halfedge(edge);
        let halfedges = [first, connectivity.twin(first)].into_iter().enumerate();
        halfedges.zip(sides).filter_map(move |((side, h), wedges)| {
            let uvs = wedges?.map(|w| if self.is_textured(w) { self.wedges.uv(w) } else { [0.0; 2] });
            // Halfedges of the second side run from the second end to the first.
            let beyond = if side == keep {
                Connectivity::next(next_seam_halfedge(mesh, &self.is_seam, h))
            } else {
                previous_seam_halfedge(mesh, &self.is_seam, h)
            };
            let next = connectivity.edge(if side == keep { Connectivity::prev(beyond) } else { beyond });
            let (kept, gone) = (uvs[keep], uvs[1 - keep]);
            let wedge = self.wedges.wedge_of(beyond);
            let far = if self.is_textured(wedge) { self.wedges.uv(wedge) } else { kept };
            let before = self.drifts.drift_of(edge).max(self.drifts.drift_of(next));
            Some(GrowingSeam { next, drift: before + segment_distance(gone, kept, far) })
        })
    }
}
