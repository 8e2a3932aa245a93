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

mod legal;
mod plan;

use std::cell::RefCell;

use super::Surface;
use super::record::Log;
use super::texture::{Charts, Drifts};
use super::wedges::{NONE, Wedges, input_corner, seams};
use super::weld::UNTIED;
use crate::connectivity::Connectivity;
use crate::engine::{Collapsed, Measure, Proposal, Reach};
use crate::geometry::{distance2, midpoint, position};
use crate::ids::{EdgeId, HalfedgeId, TriangleId, VertexId};
use crate::mesh::{Mesh, Pin};
use crate::quadric::Quadric;
use crate::star::Star;
use plan::Plan;

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
    /// Tied vertices by their sets, in order.
    sheets: Vec<(u32, VertexId)>,
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
            let mut quadric = Quadric::<K>::of_triangle(points.each_ref(), 1.0);
            let mut plane = Quadric::<0>::of_triangle(points.map(|p| position(&p)).each_ref(), 0.0);
            if let Some(&importance) = surface.importance.get(source) {
                quadric.scale(importance);
                plane.scale(importance);
            }
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
                let source = mesh.triangle_source[Connectivity::triangle(h).index()] as usize;
                let weight = WALL * surface.importance.get(source).unwrap_or(&1.0);
                ends.iter().for_each(|v| shape[v.index()].add_wall(weight, [a, b, across]));
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
                let corner = input_corner(mesh, h);
                log.corner_wedge[corner] = wedges.of(h);
                log.corner_vertex[corner] = connectivity.origin(h).0;
            }
            log
        });
        let tied = connectivity.vertices().filter(|v| tie[v.index()] != UNTIED);
        let mut sheets: Vec<(u32, VertexId)> = tied.map(|v| (tie[v.index()], v)).collect();
        sheets.sort_unstable();
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
            tie,
            sheets,
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

    /// Whether a wedge has a texture coordinate.
    fn is_textured(&self, wedge: u32) -> bool {
        self.wedges.is_textured[wedge as usize]
    }

    /// Whether the ends have one wedge each and no seam: the most there is of a surface.
    #[inline]
    fn is_plain(&self, ends: [VertexId; 2]) -> bool {
        ends.map(|v| &self.spots[v.index()]).iter().all(|spot| spot.only != NONE && spot.seam_degree == 0)
    }

    /// Give every class of a plan to the wedge of it that goes on, and to the corners around the survivor theirs.
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
            self.quadrics[wedge as usize] = class.quadric;
            if self.wedges.put(wedge, class.at_end, class.value, class.home)
                && let Some(log) = &mut self.log
            {
                log.changed(wedge, class.value, self.wedges.source[wedge as usize]);
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
        if let Some(log) = &mut self.log {
            for member in &plan.members {
                let into = plan.classes[member.class].kept(end);
                if into != member.wedge {
                    log.merged(member.wedge, into);
                }
            }
        }
    }

    /// Look at the survivor and the corners across again.
    fn merge_spots(&mut self, connectivity: &Connectivity, star: &Star<3>, survivor: VertexId) {
        let [a, b] = star.ends.map(|v| self.spots[v.index()]);
        let is_seam = |edge: EdgeId| self.is_seam[edge.index()];
        self.spots[survivor.index()] = Spot {
            only: self.wedges.only(connectivity, survivor).unwrap_or(NONE),
            seam_degree: connectivity.spokes(survivor).filter(|(edge, _)| is_seam(*edge)).count() as u32,
            valence: connectivity.spokes(survivor).count() as u32,
            material: common(a.material, b.material),
            part: common(a.part, b.part),
        };
        for &(_, apex, _) in &star.vanishing {
            let spot = &mut self.spots[apex.index()];
            spot.valence -= 1;
            if spot.only == NONE {
                spot.only = self.wedges.only(connectivity, apex).unwrap_or(NONE);
            }
        }
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
        let plan = self.plan.take();
        self.merge_wedges(connectivity, star, survivor, &plan);
        if let Some(log) = &mut self.log {
            log.collapsed(collapsed.removed, survivor, *mesh.point(survivor));
        }
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
        let [a, b] = star.ends.map(|v| v.index());
        self.shape[survivor.index()] = self.shape[a].sum(&self.shape[b]);
        self.merge_spots(connectivity, star, survivor);
        self.plan.replace(plan);
    }

    fn cost(&self, _: &Proposal<3, ()>) -> f64 {
        self.plan.borrow().candidates.first().map_or(f64::NEG_INFINITY, |chosen| chosen.cost)
    }
}
