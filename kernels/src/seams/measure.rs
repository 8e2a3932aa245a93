//! What a collapse costs, where it leads and what it may not do, on a surface with seams.
//!
//! Two quadrics (Feng, Ni and Luo 2012): one of shape alone for each vertex, from the triangles of all its copies
//! and from the walls that stand on seams and boundaries; one of shape and attributes for each wedge, from the
//! wedge's own triangles. Away from seams the second says all. Where a seam is near, the place comes from the first,
//! the attributes of each wedge from its own second, and the cost is the weighted sum of both.
//!
//! A seam is a curve of edges. What lies beside it collapses into it, and an edge of it shrinks along it, to the
//! texture coordinates that one of its ends has on each side: so they remain on the chart's border. Where that end
//! goes from lies in further charts, as where three meet, it keeps its place in those.

use std::cell::RefCell;

use super::Surface;
use super::record::Log;
use super::texture::{Charts, Drifts, from_segment, keeps_side, seam_after, seam_before};
use super::wedges::{NONE, Wedges, seams, uv_of};
use super::weld::UNTIED;
use crate::connectivity::Connectivity;
use crate::engine::{Collapsed, Measure, Proposal, Reach};
use crate::geometry::{Vec3, distance2, midpoint, position};
use crate::ids::{EdgeId, HalfedgeId, TriangleId, VertexId};
use crate::legality::keeps_triangles;
use crate::mesh::{Mesh, Pin};
use crate::quadric::Quadric;
use crate::star::Star;

/// Strength of the spring that holds a vertex at the middle of its edge where the error does not: on a plane.
const TETHER: f64 = 1e-9;

/// The same for the choice among edges that cost nothing: shorter ones go first.
const SHORTER_FIRST: f64 = 1e-10;

/// Weight of the walls on seams and boundaries, against the area of the square over the edge.
const WALL: f64 = 1.0;

/// A penalty for valence counts from here.
const HIGH_VALENCE: u32 = 8;

/// What a user can set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knobs {
    /// Share of itself by which the cost of a collapse grows that meets several materials.
    pub across_materials: f64,
    /// The same for several parts.
    pub across_parts: f64,
    /// The same for each edge a vertex would have beyond eight.
    pub valence: f64,
    /// The same for each wedge of the ends beyond two.
    pub wedges: f64,
    /// Weight of the quadric of shape against that of shape and attributes, near seams.
    pub shape: f64,
    /// Largest distance in the image between a seam and what it was, as a length.
    pub seam_drift: f64,
}

/// A refusal of this measure.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Standing {
    /// Both ends must stay where they are.
    Pinned,
    /// A triangle would turn over, or lose its area.
    Fold,
    /// A seam would be cut, joined with another, or left.
    Seam,
    /// A triangle of the image would turn over, or a texture coordinate leave its chart.
    Chart,
    /// The image of a seam would be too far from what it was.
    Drift,
}

/// Where the star of an edge may go.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    place: Vec3,
    /// The end whose texture coordinates are kept; none if the quadrics tell them.
    keep: Option<usize>,
    cost: f64,
    /// How far the image of the seam would be from what it was.
    drift: f64,
}

/// A seam edge that takes in the place of one that shrinks.
#[derive(Clone, Copy, Debug)]
struct Run {
    next: EdgeId,
    /// How far its image is then from what it was in the input, at the most.
    drift: f64,
    /// The square of its length in space.
    length2: f64,
}

/// A wedge at an end of the edge, and what it becomes part of.
#[derive(Clone, Copy, Debug)]
struct Member {
    wedge: u32,
    end: usize,
    class: usize,
}

/// What several wedges become.
#[derive(Clone, Copy, Debug)]
struct Class<const K: usize> {
    quadric: Quadric<K>,
    /// A wedge of it at each end, if there is one.
    at_end: [u32; 2],
    /// Whether it has several wedges at an end that differ in their place in the image.
    is_torn: [bool; 2],
    is_merged: bool,
    value: [f64; K],
    home: u32,
}

impl<const K: usize> Class<K> {
    /// Whether nothing but one wedge, of the end that is kept, is in it.
    fn is_only_at(&self, keep: Option<usize>) -> bool {
        !self.is_merged && keep.is_some_and(|end| self.at_end[end] != NONE)
    }
}

/// What is worked out about one edge.
#[derive(Clone, Debug)]
struct Plan<const K: usize> {
    members: Vec<Member>,
    classes: Vec<Class<K>>,
    candidates: Vec<Candidate>,
    /// Wedges of the two sides of the edge, at its first and second end; none on a boundary.
    sides: [Option<[u32; 2]>; 2],
    is_plain: bool,
    runs: [Option<Run>; 2],
}

impl<const K: usize> Default for Plan<K> {
    fn default() -> Self {
        Self {
            members: vec![],
            classes: vec![],
            candidates: vec![],
            sides: [None; 2],
            is_plain: true,
            runs: [None; 2],
        }
    }
}

/// Materials, or parts, that differ.
const SEVERAL: i32 = i32::MIN;

/// What is looked at together of a vertex, and kept together for it.
#[derive(Clone, Copy, Debug)]
struct Spot {
    /// The wedge of all its corners, or none.
    only: u32,
    /// Its seam and boundary edges.
    seam_degree: u32,
    valence: u32,
    /// Of all triangles around it, or [`SEVERAL`].
    material: i32,
    part: i32,
}

/// What two have in common.
#[inline]
fn common(a: i32, b: i32) -> i32 {
    if a == b { a } else { SEVERAL }
}

pub struct Seams<const D: usize, const K: usize> {
    knobs: Knobs,
    wedges: Wedges<K>,
    shape: Vec<Quadric<0>>,
    quadrics: Vec<Quadric<K>>,
    spots: Vec<Spot>,
    is_seam: Vec<bool>,
    /// The set of each vertex that must stay with others; see [`super::weld`].
    tie: Vec<u32>,
    has_ties: bool,
    charts: Charts,
    drifts: Drifts,
    plan: RefCell<Plan<K>>,
    log: Option<Log<K>>,
}

impl<const D: usize, const K: usize> Seams<D, K> {
    pub fn new(mesh: &Mesh<3>, surface: &Surface<K>, tie: Vec<u32>, knobs: Knobs, record: bool) -> Self {
        const { assert!(D == K + 3) };
        let connectivity = &mesh.connectivity;
        let slots = connectivity.vertex_slots();
        let is_seam = seams(mesh, surface);
        let wedges = Wedges::new(mesh, surface, &is_seam);
        let mut quadrics = vec![Quadric::default(); wedges.attributes.len()];
        let mut shape = vec![Quadric::default(); slots];
        let nothing = Spot { only: NONE, seam_degree: 0, valence: 0, material: SEVERAL, part: SEVERAL };
        let mut spots = vec![nothing; slots];
        for t in connectivity.triangles() {
            let source = mesh.triangle_source[t.index()] as usize;
            let (material, part) = (surface.materials[source], surface.parts[source]);
            let halfedges = [0, 1, 2].map(|i| HalfedgeId(3 * t.0 + i));
            let points = halfedges.map(|h| {
                let place = mesh.point(connectivity.origin(h));
                let attributes = &wedges.attributes[wedges.of(h) as usize];
                std::array::from_fn::<f64, D, _>(|i| if i < 3 { place[i] } else { attributes[i - 3] })
            });
            let quadric = Quadric::<K>::of_triangle(points.each_ref(), 1.0);
            let plane = Quadric::<0>::of_triangle(points.map(|p| position(&p)).each_ref(), 0.0);
            for h in halfedges {
                let v = connectivity.origin(h).index();
                quadrics[wedges.of(h) as usize].add(&quadric);
                shape[v].add(&plane);
                let spot = &mut spots[v];
                let is_first = h == connectivity.outgoing[v];
                (spot.material, spot.part) = if spot.valence == 0 {
                    (material, part)
                } else {
                    (common(spot.material, material), common(spot.part, part))
                };
                spot.valence += 1 + u32::from(is_first && connectivity.twin(h).is_none());
            }
        }
        for edge in connectivity.edges().filter(|e| is_seam[e.index()]) {
            let first = connectivity.halfedge(edge);
            let ends = connectivity.ends(edge);
            for h in [first, connectivity.twin(first)].into_iter().filter(|h| h.is_some()) {
                let across = mesh.point(connectivity.origin(Connectivity::prev(h)));
                let [a, b] = ends.map(|v| mesh.point(v));
                ends.iter().for_each(|v| shape[v.index()].add_wall(WALL, [a, b, across]));
            }
            ends.iter().for_each(|v| spots[v.index()].seam_degree += 1);
        }
        for v in connectivity.vertices() {
            spots[v.index()].only = wedges.only(connectivity, v).unwrap_or(NONE);
        }
        let log = record.then(|| {
            let left_out = vec![NONE; 3 * surface.triangles.len()];
            let mut log = Log { corner_wedge: left_out.clone(), corner_vertex: left_out, ..Log::default() };
            for h in (0..3 * connectivity.triangle_slots() as u32).map(HalfedgeId) {
                let corner = (3 * mesh.triangle_source[h.index() / 3] + h.0 % 3) as usize;
                log.corner_wedge[corner] = wedges.of(h);
                log.corner_vertex[corner] = connectivity.origin(h).0;
            }
            log
        });
        Self {
            knobs,
            charts: Charts::new(mesh, &wedges, &is_seam),
            drifts: Drifts::new(connectivity.edge_slots()),
            plan: RefCell::default(),
            wedges,
            shape,
            quadrics,
            is_seam,
            spots,
            has_ties: tie.iter().any(|&set| set != UNTIED),
            tie,
            log,
        }
    }

    /// Attributes of a corner, and the corner of the input that has the same.
    pub fn corner(&self, t: TriangleId, corner: u32) -> ([f64; K], u32) {
        let wedge = self.wedges.of(HalfedgeId(3 * t.0 + corner)) as usize;
        (self.wedges.attributes[wedge], self.wedges.source[wedge])
    }

    pub fn largest_drift(&self) -> f64 {
        self.drifts.largest
    }

    pub fn into_log(self) -> Option<Log<K>> {
        self.log
    }

    /// Whether the ends have one wedge each and no seam: the most there is of a surface.
    #[inline]
    fn is_plain(&self, ends: [VertexId; 2]) -> bool {
        ends.map(|v| &self.spots[v.index()]).iter().all(|spot| spot.only != NONE && spot.seam_degree == 0)
    }

    /// The factor that the penalties come to.
    fn penalty(&self, ends: [VertexId; 2], wedges: usize) -> f64 {
        let [a, b] = ends.map(|v| &self.spots[v.index()]);
        let valence = (a.valence + b.valence).saturating_sub(4 + HIGH_VALENCE);
        let mut factor = 1.0 + self.knobs.valence * f64::from(valence);
        if common(a.material, b.material) == SEVERAL {
            factor += self.knobs.across_materials;
        }
        if common(a.part, b.part) == SEVERAL {
            factor += self.knobs.across_parts;
        }
        factor + self.knobs.wedges * wedges.saturating_sub(2) as f64
    }

    /// Work out what wedges become and where the edge may go, the cheapest place first.
    fn plan(&self, mesh: &Mesh<3>, edge: EdgeId, plan: &mut Plan<K>) -> Result<(), Standing> {
        let connectivity = &mesh.connectivity;
        let ends = connectivity.ends(edge);
        let stays = mesh.staying_ends(edge);
        if stays == [true, true] {
            return Err(Standing::Pinned);
        }
        let on_seam = self.is_seam[edge.index()];
        // Beside a seam, what lies on it stays there.
        let may_go = |end: usize| !stays[end] && (on_seam || self.spots[ends[end].index()].seam_degree == 0);
        if !may_go(0) && !may_go(1) {
            return Err(Standing::Seam);
        }
        let first = connectivity.halfedge(edge);
        plan.is_plain = self.is_plain(ends);
        self.group(connectivity, ends, [first, connectivity.twin(first)], plan);
        // The tip of a seam has one wedge for both sides: nothing tells which side it would go to.
        let [goes_to_first, goes_to_second] =
            [0, 1].map(|end| may_go(1 - end) && plan.classes.iter().all(|class| !class.is_torn[end]));

        let places = ends.map(|v| *mesh.point(v));
        let shape = self.shape[ends[0].index()].sum(&self.shape[ends[1].index()]);
        plan.candidates.clear();
        let has_image = plan.sides.iter().flatten().any(|&[wedge, _]| self.is_textured(wedge));
        let mut wanted = [None; 4];
        if goes_to_first && goes_to_second {
            let middle = midpoint(&places[0], &places[1]);
            if plan.is_plain {
                // No place is better; its ends are for where that one is not legal.
                let best = plan.classes[0].quadric.minimum(&middle, TETHER).0;
                plan.candidates.push(self.priced(mesh, edge, plan, best, None));
                return Ok(());
            }
            let best = shape.minimum(&middle, TETHER).0;
            if on_seam && has_image {
                wanted[..2].copy_from_slice(&[Some((best, Some(0))), Some((best, Some(1)))]);
            } else {
                wanted[0] = Some((best, None));
            }
        }
        wanted[2] = goes_to_first.then_some((places[0], Some(0)));
        wanted[3] = goes_to_second.then_some((places[1], Some(1)));
        for (place, keep) in wanted.into_iter().flatten() {
            plan.candidates.push(self.priced(mesh, edge, plan, place, keep));
        }
        plan.candidates.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        if plan.candidates.is_empty() { Err(Standing::Seam) } else { Ok(()) }
    }

    /// A place for the edge's vertex, and what it costs.
    fn priced(
        &self,
        mesh: &Mesh<3>,
        edge: EdgeId,
        plan: &Plan<K>,
        place: Vec3,
        keep: Option<usize>,
    ) -> Candidate {
        let ends = mesh.connectivity.ends(edge);
        let places = ends.map(|v| mesh.point(v));
        let exact = keep.filter(|&end| place == *places[end]);
        let [a, b] = ends.map(|v| &self.shape[v.index()]);
        let mut cost = SHORTER_FIRST * (a.area + b.area) * distance2(places[0], places[1]);
        for class in plan.classes.iter().filter(|class| !class.is_only_at(exact)) {
            cost += class.quadric.error_with(&place, &self.value(plan, class, &place, keep));
        }
        if !plan.is_plain {
            cost += self.knobs.shape * (a.error(&place) + b.error(&place));
        }
        let mut drift: f64 = 0.0;
        if let Some(end) = keep.filter(|_| self.is_seam[edge.index()]) {
            for run in self.follow_seam(mesh, edge, plan.sides, end) {
                drift = drift.max(run.drift);
                cost += run.drift * run.drift * run.length2;
            }
        }
        Candidate { place, keep, cost: self.penalty(ends, plan.members.len()) * cost, drift }
    }

    fn is_textured(&self, wedge: u32) -> bool {
        self.wedges.is_textured[wedge as usize]
    }

    /// Put the wedges of both ends into classes: those that meet along the edge, on one side of it, become one.
    fn group(
        &self,
        connectivity: &Connectivity,
        ends: [VertexId; 2],
        [first, second]: [HalfedgeId; 2],
        plan: &mut Plan<K>,
    ) {
        let wedges = &self.wedges;
        plan.members.clear();
        plan.classes.clear();
        plan.sides = [
            Some([wedges.of(first), wedges.of(Connectivity::next(first))]),
            second.is_some().then(|| [wedges.of(Connectivity::next(second)), wedges.of(second)]),
        ];
        for (end, &v) in ends.iter().enumerate() {
            let own = plan.members.len();
            let mut join = |wedge: u32| {
                if !plan.members[own..].iter().any(|m| m.wedge == wedge) {
                    plan.members.push(Member { wedge, end, class: plan.members.len() });
                }
            };
            match self.spots[v.index()].only {
                NONE => connectivity.fan(v).for_each(|h| join(wedges.of(h))),
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
        // Classes without gaps, in the order of their first member.
        for i in 0..plan.members.len() {
            let Member { wedge, end, class } = plan.members[i];
            let quadric = &self.quadrics[wedge as usize];
            if class == i {
                let mut at_end = [NONE; 2];
                at_end[end] = wedge;
                plan.members[i].class = plan.classes.len();
                plan.classes.push(Class {
                    quadric: *quadric,
                    at_end,
                    is_torn: [false; 2],
                    is_merged: false,
                    value: wedges.attributes[wedge as usize],
                    home: wedges.home[wedge as usize],
                });
            } else {
                let class = plan.members[class].class;
                plan.members[i].class = class;
                let class = &mut plan.classes[class];
                class.quadric.add(quadric);
                class.is_merged = true;
                match class.at_end[end] {
                    NONE => class.at_end[end] = wedge,
                    other => class.is_torn[end] |= !wedges.is_same_place(other, wedge),
                }
            }
        }
    }

    /// Attributes of a class at a place.
    fn value(&self, plan: &Plan<K>, class: &Class<K>, place: &Vec3, keep: Option<usize>) -> [f64; K] {
        let attributes = &self.wedges.attributes;
        let some = if class.at_end[0] != NONE { class.at_end[0] } else { class.at_end[1] };
        let mut value = class.quadric.attributes_at(place, &attributes[some as usize]);
        if !self.is_textured(some) {
            return value;
        }
        let uv = match keep {
            Some(end) if class.at_end[end] != NONE => Some(self.wedges.uv(class.at_end[end])),
            Some(end) => {
                // A wedge of the other end alone may differ by colour or normal only from one that meets the
                // edge. Where it is in another chart, it stays at its place in there.
                let own = class.at_end[1 - end];
                let meets = |side: &&[u32; 2]| self.wedges.is_same_place(side[1 - end], own);
                let beside = plan.sides.iter().flatten().find(meets).map(|side| side[end]);
                Some(self.wedges.uv(beside.unwrap_or(own)))
            }
            None => {
                let [a, b] = class.at_end;
                let is_one = a != NONE && b != NONE && self.wedges.uv(a) == self.wedges.uv(b);
                is_one.then(|| self.wedges.uv(a))
            }
        };
        if let Some(uv) = uv {
            value[..2].copy_from_slice(&uv);
        }
        // To the bit, so that what has not changed is known for it.
        if let Some(end) = keep.filter(|&end| K == 2 && class.at_end[end] != NONE) {
            value = attributes[class.at_end[end] as usize];
        }
        value
    }

    /// Whether a candidate leaves all triangles of space and image their sides up, every texture coordinate in its
    /// chart and seams near where they were; completes the plan.
    fn try_candidate(
        &self,
        mesh: &Mesh<3>,
        star: &Star<3>,
        plan: &mut Plan<K>,
        candidate: Candidate,
    ) -> Result<(), Standing> {
        keeps_triangles(star, &candidate.place).map_err(|_| Standing::Fold)?;
        let exact = candidate.keep.filter(|&end| candidate.place == star.end_points[end]);
        for i in 0..plan.classes.len() {
            let class = plan.classes[i];
            plan.classes[i].value = match exact.filter(|_| class.is_only_at(exact)) {
                Some(end) => self.wedges.attributes[class.at_end[end] as usize],
                None => self.value(plan, &class, &candidate.place, candidate.keep),
            };
        }
        for wing in &star.wings {
            let v = star.ends[wing.end];
            let first = HalfedgeId(3 * wing.triangle.0);
            let corners = [first, Connectivity::next(first), Connectivity::prev(first)];
            let wedges = corners.map(|h| self.wedges.of(h));
            if !self.is_textured(wedges[0]) {
                continue;
            }
            let moved = if mesh.connectivity.origin(corners[0]) == v {
                0
            } else if mesh.connectivity.origin(corners[1]) == v {
                1
            } else {
                2
            };
            let before = wedges.map(|w| self.wedges.uv(w));
            let mut after = before;
            let Some(to) = plan.members.iter().find(|m| m.end == wing.end && m.wedge == wedges[moved]) else {
                continue;
            };
            after[moved] = uv_of(&plan.classes[to.class].value);
            if !keeps_side(before, after) {
                return Err(Standing::Chart);
            }
        }
        for class in plan.classes.iter_mut() {
            let mut homes = class.at_end.iter().filter(|&&w| w != NONE);
            let Some(&some) = homes.clone().next() else { continue };
            let uv = uv_of(&class.value);
            class.home = if !self.is_textured(some) {
                self.wedges.home[some as usize]
            } else if let Some(&w) = homes.find(|&&w| self.wedges.uv(w) == uv) {
                self.wedges.home[w as usize]
            } else {
                let start = self.wedges.home[some as usize];
                let at_seam = candidate.keep.is_some();
                match self.charts.locate(start, uv) {
                    Some(home) => home,
                    // A coordinate taken from the seam is in the chart; only the way there leaves it.
                    None if at_seam => start,
                    None => return Err(Standing::Chart),
                }
            };
        }
        plan.runs = [None; 2];
        if let Some(end) = candidate.keep.filter(|_| self.is_seam[star.edge.index()]) {
            if candidate.drift > self.knobs.seam_drift {
                return Err(Standing::Drift);
            }
            let mut runs = self.follow_seam(mesh, star.edge, plan.sides, end);
            let runs = [runs.next(), runs.next()];
            plan.runs = runs;
        }
        Ok(())
    }

    /// The runs of seam that change when a seam edge shrinks to its end `keep`: on each side of it the next seam
    /// edge beyond the other end, and how far the image is then from what it was.
    fn follow_seam<'a>(
        &'a self,
        mesh: &'a Mesh<3>,
        edge: EdgeId,
        sides: [Option<[u32; 2]>; 2],
        keep: usize,
    ) -> impl Iterator<Item = Run> + 'a {
        let connectivity = &mesh.connectivity;
        let first = connectivity.halfedge(edge);
        let halfedges = [first, connectivity.twin(first)].into_iter().enumerate();
        halfedges.zip(sides).filter_map(move |((side, h), wedges)| {
            let uvs = wedges?.map(|w| if self.is_textured(w) { self.wedges.uv(w) } else { [0.0; 2] });
            // Halfedges of the second side run from the second end to the first.
            let beyond = if side == keep {
                Connectivity::next(seam_after(mesh, &self.is_seam, h))
            } else {
                seam_before(mesh, &self.is_seam, h)
            };
            let next = connectivity.edge(if side == keep { Connectivity::prev(beyond) } else { beyond });
            let (kept, gone) = (uvs[keep], uvs[1 - keep]);
            let wedge = self.wedges.of(beyond);
            let far = if self.is_textured(wedge) { self.wedges.uv(wedge) } else { kept };
            let before = self.drifts.of(edge).max(self.drifts.of(next));
            let length2 =
                distance2(mesh.point(connectivity.origin(beyond)), mesh.point(connectivity.ends(edge)[keep]));
            Some(Run { next, drift: before + from_segment(gone, kept, far), length2 })
        })
    }

    /// Find the seams around a vertex again: where a chart has vanished between two others, they may be one.
    fn look_again(&mut self, connectivity: &Connectivity, v: VertexId) {
        for (edge, _) in connectivity.spokes(v) {
            self.is_seam[edge.index()] = self.wedges.is_seam(connectivity, edge);
        }
        for (_, other) in connectivity.spokes(v) {
            let seams = connectivity.spokes(other).filter(|(edge, _)| self.is_seam[edge.index()]).count();
            self.spots[other.index()].seam_degree = seams as u32;
        }
    }

    /// Whether a collapse would lay an edge where there is one already that the link condition does not see, since one
    /// of its ends is another fan of the same set: a new spoke of the survivor, to or from a tied vertex.
    fn meets_another_sheet(&self, mesh: &Mesh<3>, star: &Star<3>, survivor: usize) -> bool {
        if !self.has_ties {
            return false;
        }
        let (kept, gone) = (star.ends[survivor], star.ends[1 - survivor]);
        let own = self.tie[kept.index()];
        let is_apex = |v: VertexId| star.vanishing.iter().any(|(_, apex, _)| *apex == v);
        // Whether a vertex has a neighbour in a set, beside one it is known to have.
        let reaches = |from: VertexId, set: u32, known: VertexId| {
            mesh.connectivity.spokes(from).any(|(_, v)| v != known && self.tie[v.index()] == set)
        };
        mesh.connectivity.spokes(gone).filter(|(_, v)| *v != kept).any(|(_, v)| {
            let tie = self.tie[v.index()];
            if tie != UNTIED {
                (own != UNTIED && (own == tie || !is_apex(v))) || reaches(kept, tie, v)
            } else {
                own != UNTIED && !is_apex(v) && reaches(v, own, kept)
            }
        })
    }
}

impl<const D: usize, const K: usize> Measure<3> for Seams<D, K> {
    type Bound = Standing;
    type Change = ();

    const REACH: Reach = Reach::Spokes;

    fn priority(&self, mesh: &Mesh<3>, edge: EdgeId) -> Result<f64, Standing> {
        let ends = mesh.connectivity.ends(edge);
        let free = |v: &VertexId| mesh.pin(*v) == Pin::Free;
        if self.is_plain(ends) && ends.iter().all(free) {
            let [a, b] = ends.map(|v| &self.quadrics[self.spots[v.index()].only as usize]);
            let together = a.sum(b);
            let places = ends.map(|v| mesh.point(v));
            let (_, error) = together.minimum(&midpoint(places[0], places[1]), TETHER);
            let cost = error + SHORTER_FIRST * together.area * distance2(places[0], places[1]);
            return Ok(self.penalty(ends, 2) * cost);
        }
        let mut plan = self.plan.borrow_mut();
        self.plan(mesh, edge, &mut plan)?;
        Ok(plan.candidates[0].cost)
    }

    fn propose(&mut self, mesh: &Mesh<3>, star: &Star<3>) -> Result<Proposal<3, ()>, Standing> {
        let mut plan = self.plan.take();
        let proposal = self.proposal(mesh, star, &mut plan);
        self.plan.replace(plan);
        proposal
    }

    fn judge(&mut self, _: &Mesh<3>, _: &Star<3>, _: &mut Proposal<3, ()>) -> Result<(), Standing> {
        Ok(())
    }

    fn commit(&mut self, mesh: &Mesh<3>, star: &Star<3>, collapsed: &Collapsed, (): ()) {
        let connectivity = &mesh.connectivity;
        let survivor = collapsed.survivor;
        let end = usize::from(star.ends[1] == survivor);
        let plan = self.plan.take();
        let kept = |class: &Class<K>| match class.at_end[end] {
            NONE => class.at_end[1 - end],
            wedge => wedge,
        };
        for class in &plan.classes {
            let wedge = kept(class) as usize;
            self.quadrics[wedge] = class.quadric;
            self.wedges.home[wedge] = class.home;
            if self.wedges.attributes[wedge] != class.value {
                let same = class
                    .at_end
                    .into_iter()
                    .find(|&w| w != NONE && self.wedges.attributes[w as usize] == class.value);
                self.wedges.source[wedge] = same.map_or(NONE, |w| self.wedges.source[w as usize]);
                self.wedges.attributes[wedge] = class.value;
                if let Some(log) = &mut self.log {
                    log.changed.push(wedge as u32);
                    log.changed_to.push(class.value);
                    log.changed_source.push(self.wedges.source[wedge]);
                    log.changed_when.push(log.removed.len() as u32);
                }
            }
        }
        for wing in &star.wings {
            let first = HalfedgeId(3 * wing.triangle.0);
            let corners = [first, Connectivity::next(first), Connectivity::prev(first)];
            for h in corners.into_iter().filter(|&h| connectivity.origin(h) == survivor) {
                let old = self.wedges.of(h);
                if let Some(to) = plan.members.iter().find(|m| m.end == wing.end && m.wedge == old) {
                    self.wedges.of_corner[h.index()] = kept(&plan.classes[to.class]);
                }
            }
        }
        if let Some(log) = &mut self.log {
            for member in &plan.members {
                let into = kept(&plan.classes[member.class]);
                if into != member.wedge {
                    log.wedge_removed.push(member.wedge);
                    log.wedge_survivor.push(into);
                    log.wedge_when.push(log.removed.len() as u32);
                }
            }
            log.removed.push(collapsed.removed.0);
            log.survivor.push(survivor.0);
            log.places.push(*mesh.point(survivor));
        }

        let [a, b] = star.ends.map(|v| v.index());
        self.shape[survivor.index()] = self.shape[a].sum(&self.shape[b]);
        for run in plan.runs.into_iter().flatten() {
            self.drifts.raise(run.next, run.drift);
        }
        for (kept, gone) in collapsed.merged.into_iter().flatten() {
            self.is_seam[kept.index()] |= self.is_seam[gone.index()];
            self.drifts.raise(kept, self.drifts.of(gone));
        }
        if self.is_seam[star.edge.index()] {
            self.look_again(connectivity, survivor);
        }
        let (mut valence, mut seam_degree) = (0, 0);
        for (edge, _) in connectivity.spokes(survivor) {
            valence += 1;
            seam_degree += u32::from(self.is_seam[edge.index()]);
        }
        let only = match plan.classes.as_slice() {
            [class] => kept(class),
            _ => self.wedges.only(connectivity, survivor).unwrap_or(NONE),
        };
        let (material, part) = {
            let [a, b] = [a, b].map(|v| &self.spots[v]);
            (common(a.material, b.material), common(a.part, b.part))
        };
        self.spots[survivor.index()] = Spot { only, seam_degree, valence, material, part };
        for &(_, apex, _) in &star.vanishing {
            let spot = &mut self.spots[apex.index()];
            spot.valence -= 1;
            if spot.only == NONE {
                spot.only = self.wedges.only(connectivity, apex).unwrap_or(NONE);
            }
        }
        self.plan.replace(plan);
    }

    fn cost(&self, _: &Proposal<3, ()>) -> f64 {
        self.plan.borrow().candidates.first().map_or(f64::NEG_INFINITY, |chosen| chosen.cost)
    }
}

impl<const D: usize, const K: usize> Seams<D, K> {
    fn proposal(
        &self,
        mesh: &Mesh<3>,
        star: &Star<3>,
        plan: &mut Plan<K>,
    ) -> Result<Proposal<3, ()>, Standing> {
        self.plan(mesh, star.edge, plan)?;
        let refusal = match self.first_legal(mesh, star, plan) {
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
        self.first_legal(mesh, star, plan)
    }

    /// The cheapest candidate that is legal, first in the plan; or why the last one is not.
    fn first_legal(
        &self,
        mesh: &Mesh<3>,
        star: &Star<3>,
        plan: &mut Plan<K>,
    ) -> Result<Proposal<3, ()>, Standing> {
        let mut refusal = Standing::Fold;
        for i in 0..plan.candidates.len() {
            let candidate = plan.candidates[i];
            let survivor = candidate.keep.unwrap_or_else(|| {
                let [a, b] = star.end_points.map(|p| distance2(&p, &candidate.place));
                usize::from(b < a)
            });
            if self.meets_another_sheet(mesh, star, survivor) {
                refusal = Standing::Pinned;
                continue;
            }
            match self.try_candidate(mesh, star, plan, candidate) {
                Ok(()) => {
                    plan.candidates.swap(0, i);
                    return Ok(Proposal { survivor, point: candidate.place, change: () });
                }
                Err(standing) => refusal = standing,
            }
        }
        Err(refusal)
    }
}
