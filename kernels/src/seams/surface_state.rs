//! State of the whole surface between rounds: wedges and seam drift.
//!
//! Quadrics are not stored: a region computes them from its current triangles when it is loaded.

use std::cell::RefCell;

use super::chunked_list::ChunkedList;
use super::progressive_record::WedgeChanges;
use super::region_state::{CostParameters, SEVERAL, SeamMeasure, VertexSummary, common_value};
use super::surface::SeamSurface;
use super::texture_space::{Charts, SeamDrifts};
use super::wedges::{ABSENT, Wedge, Wedges};
use super::welding::NO_SET;
use crate::base::geometry::Vec3;
use crate::base::ids::{EdgeId, HalfedgeId, VertexId};
use crate::collapse::method_state::MethodState;
use crate::collapse::region::SHARED;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::{Mesh, VertexLock};
use crate::quadrics::quadric::Quadric;

/// Marks the wedge of a vertex on the rim, which keeps its index on the whole surface.
const RIM_FLAG: u32 = 1 << 31;

/// State of a vertex between rounds.
#[derive(Clone, Copy, Debug)]
pub struct VertexState {
    /// Set of touching vertices that must stay together; see [`super::welding`].
    pub touching: u32,
    /// Common value of all triangles that the vertex represents, or [`SEVERAL`].
    pub material: i32,
    pub part: i32,
    /// Shape quadric of the input triangles that the vertex represents.
    pub history: Quadric<0>,
}

/// Drift of a seam edge: triangle, corner and drift.
type CornerDrift = (u32, u8, f64);

/// The surface before any collapse.
pub struct InitialSurface<'a, const K: usize> {
    pub surface: &'a SeamSurface<K>,
    pub charts: &'a Charts,
    /// Bounding box that no vertex may leave.
    pub bounds: [Vec3; 2],
}

/// State of the whole surface between rounds.
pub struct SurfaceState<'a, const D: usize, const K: usize> {
    knobs: CostParameters,
    initial: InitialSurface<'a, K>,
    vertex_states: ChunkedList<VertexState>,
    pub wedges: ChunkedList<Wedge<K>>,
    /// Wedges of the corners, by triangle.
    pub corners: ChunkedList<[u32; 3]>,
    /// Factor on the error, by triangle; empty for 1.
    importance: ChunkedList<f64>,
    /// By part of the triangle list, with local triangle indices.
    drifts: Vec<Vec<CornerDrift>>,
    pub largest_drift: f64,
    has_touching: bool,
    /// By region of each round, if recorded.
    pub changes: Option<Vec<WedgeChanges<K>>>,
}

/// State that a region returns after simplification.
pub struct SeamRegion<const K: usize> {
    vertex_states: Vec<VertexState>,
    wedges: Vec<Wedge<K>>,
    corners: Vec<[u32; 3]>,
    importance: Vec<f64>,
    drifts: Vec<CornerDrift>,
    largest_drift: f64,
    changes: Option<WedgeChanges<K>>,
}

impl<'a, const D: usize, const K: usize> SurfaceState<'a, D, K> {
    pub fn new(
        knobs: CostParameters,
        given: InitialSurface<'a, K>,
        places: Vec<VertexState>,
        wedges: Vec<Wedge<K>>,
        corners: Vec<[u32; 3]>,
        importance: Vec<f64>,
        is_recorded: bool,
    ) -> Self {
        const { assert!(D == K + 3) };
        let has_touching = places.iter().any(|place| place.touching != NO_SET);
        Self {
            knobs,
            initial: given,
            vertex_states: ChunkedList::from_part(places),
            wedges: ChunkedList::from_part(wedges),
            corners: ChunkedList::from_part(corners),
            importance: ChunkedList::from_part(importance),
            drifts: vec![vec![]],
            largest_drift: 0.0,
            has_touching,
            changes: is_recorded.then(Vec::new),
        }
    }

    /// Load the wedges of a region; also returns their indices on the whole surface.
    fn load_wedges(&self, region: &Mesh<3>) -> (Wedges<K>, Vec<u32>) {
        let connectivity = &region.connectivity;
        let some = connectivity.vertex_slots() + connectivity.vertex_slots() / 4;
        let mut wedges = Wedges {
            of_corner: Vec::with_capacity(3 * connectivity.triangle_slots()),
            all: Vec::with_capacity(some),
        };
        let mut numbers = Vec::with_capacity(some);
        // Linked list of the wedges found at each vertex: last one per vertex, previous one per wedge.
        let mut last = vec![ABSENT; connectivity.vertex_slots()];
        let mut before: Vec<u32> = Vec::with_capacity(some);
        for (local, &t) in region.triangle_source.iter().enumerate() {
            for (corner, &number) in self.corners.get(t).iter().enumerate() {
                let v = connectivity.origin(HalfedgeId((3 * local + corner) as u32));
                let mut wedge = last[v.index()];
                while wedge != ABSENT && numbers[wedge as usize] != number {
                    wedge = before[wedge as usize];
                }
                if wedge == ABSENT {
                    wedge = numbers.len() as u32;
                    wedges.all.push(*self.wedges.get(number));
                    numbers.push(number);
                    before.push(std::mem::replace(&mut last[v.index()], wedge));
                }
                wedges.of_corner.push(wedge);
            }
        }
        (wedges, numbers)
    }

    /// Load the importance of each triangle of a region; empty for 1.
    fn load_importance(&self, region: &Mesh<3>) -> Vec<f64> {
        if self.importance.is_empty() {
            return vec![];
        }
        region.triangle_source.iter().map(|&t| *self.importance.get(t)).collect()
    }

    fn load_summaries(&self, region: &Mesh<3>, wedges: &Wedges<K>, is_seam: &[bool]) -> Vec<VertexSummary> {
        const NOT_SEEN: u32 = ABSENT - 1;
        let connectivity = &region.connectivity;
        let spot = |&v: &u32| {
            let &VertexState { material, part, .. } = self.vertex_states.get(v);
            VertexSummary { only_wedge: NOT_SEEN, seam_degree: 0, valence: 0, material, part }
        };
        let mut spots: Vec<VertexSummary> = region.vertex_source.iter().map(spot).collect();
        for (h, &wedge) in wedges.of_corner.iter().enumerate() {
            let only = &mut spots[connectivity.origin(HalfedgeId::from_index(h)).index()].only_wedge;
            *only = if *only == NOT_SEEN || *only == wedge { wedge } else { ABSENT };
        }
        for edge in connectivity.edges() {
            for v in connectivity.ends(edge) {
                let spot = &mut spots[v.index()];
                spot.valence += 1;
                spot.seam_degree += u32::from(is_seam[edge.index()]);
            }
        }
        spots
    }

    fn load_drifts(&self, region: &Mesh<3>) -> SeamDrifts {
        let mut drifts = SeamDrifts::new(region.connectivity.edge_slots());
        for (local, &t) in region.triangle_source.iter().enumerate() {
            let part = self.corners.part_index(t);
            let (known, own) = (&self.drifts[part], t - self.corners.part_start(part));
            let first = known.partition_point(|&(triangle, ..)| triangle < own);
            for &(_, corner, drift) in known[first..].iter().take_while(|(triangle, ..)| *triangle == own) {
                let h = HalfedgeId(3 * local as u32 + u32::from(corner));
                drifts.raise(region.connectivity.edge(h), drift);
            }
        }
        drifts
    }
}

/// Collect the drift of the seams at the corners of a region's triangles.
fn collect_drifts(connectivity: &Connectivity, drifts: &SeamDrifts) -> Vec<CornerDrift> {
    let mut left = vec![];
    for (number, t) in connectivity.triangles().enumerate() {
        for corner in 0..3 {
            let drift = drifts.drift_of(connectivity.edge(HalfedgeId(3 * t.0 + corner)));
            if drift > 0.0 {
                left.push((number as u32, corner as u8, drift));
            }
        }
    }
    left
}

impl<'a, const D: usize, const K: usize> MethodState<3> for SurfaceState<'a, D, K> {
    type Measure = SeamMeasure<'a, D, K>;
    type RegionState = SeamRegion<K>;

    /// Put touching vertices into the same region, or onto the rim.
    fn share_linked_vertices(&self, owner: &mut [u32]) {
        if !self.has_touching {
            return;
        }
        let mut touching: Vec<(u32, u32)> =
            self.vertex_states.iter().map(|place| place.touching).zip(0..).collect();
        touching.retain(|(touching, _)| *touching != NO_SET);
        touching.sort_unstable();
        for set in touching.chunk_by(|a, b| a.0 == b.0) {
            let first = owner[set[0].1 as usize];
            if set.iter().any(|&(_, v)| owner[v as usize] != first) {
                set.iter().for_each(|&(_, v)| owner[v as usize] = SHARED);
            }
        }
    }

    fn load_region(&self, region: &Mesh<3>) -> SeamMeasure<'a, D, K> {
        let connectivity = &region.connectivity;
        let (wedges, numbers) = self.load_wedges(region);
        let is_seam: Vec<bool> = (0..connectivity.edge_slots())
            .map(|e| wedges.is_seam(connectivity, EdgeId::from_index(e)))
            .collect();
        let touching: Vec<u32> = if self.has_touching {
            region.vertex_source.iter().map(|&v| self.vertex_states.get(v).touching).collect()
        } else {
            vec![]
        };
        let vertices = (0..touching.len()).map(VertexId::from_index);
        let mut sheets: Vec<(u32, VertexId)> =
            touching.iter().copied().zip(vertices).filter(|(touching, _)| *touching != NO_SET).collect();
        sheets.sort_unstable();
        let mut seams = SeamMeasure {
            knobs: self.knobs,
            charts: self.initial.charts,
            bounds: self.initial.bounds,
            summaries: self.load_summaries(region, &wedges, &is_seam),
            drifts: self.load_drifts(region),
            plan: RefCell::default(),
            changes: self.changes.is_some().then(WedgeChanges::default),
            importance: self.load_importance(region),
            shape: RefCell::new(vec![None; connectivity.vertex_slots()]),
            quadrics: vec![Quadric::default(); wedges.all.len()],
            history: region.vertex_source.iter().map(|&v| self.vertex_states.get(v).history).collect(),
            moved: vec![],
            wedges,
            is_seam,
            touching,
            touching_vertices: sheets,
            surface_wedge_indices: numbers,
        };
        seams.compute_quadrics(region);
        seams
    }

    fn unload_region(measure: SeamMeasure<'a, D, K>, region: &Mesh<3>) -> SeamRegion<K> {
        let connectivity = &region.connectivity;
        let is_rim = |v: VertexId| region.lock(v) == VertexLock::Rim;
        let inside = connectivity.vertices().filter(|&v| !is_rim(v)).count();
        let mut remains = SeamRegion {
            vertex_states: Vec::with_capacity(inside),
            wedges: Vec::with_capacity(inside),
            corners: Vec::with_capacity(connectivity.triangle_count()),
            importance: vec![],
            drifts: collect_drifts(connectivity, &measure.drifts),
            largest_drift: measure.drifts.largest,
            changes: None,
        };
        let mut number: Vec<u32> =
            measure.surface_wedge_indices.iter().map(|wedge| wedge | RIM_FLAG).collect();
        for v in connectivity.vertices().filter(|&v| !is_rim(v)) {
            let spot = &measure.summaries[v.index()];
            remains.vertex_states.push(VertexState {
                touching: measure.touching_set(v),
                material: spot.material,
                part: spot.part,
                history: measure.history[v.index()],
            });
            for wedge in connectivity.fan(v).map(|h| measure.wedges.wedge_of(h)) {
                if number[wedge as usize] & RIM_FLAG != 0 {
                    number[wedge as usize] = remains.wedges.len() as u32;
                    remains.wedges.push(*measure.wedges.get(wedge));
                }
            }
        }
        for t in connectivity.triangles() {
            let wedges = [0, 1, 2].map(|corner| measure.wedges.wedge_of(HalfedgeId(3 * t.0 + corner)));
            remains.corners.push(wedges.map(|wedge| number[wedge as usize]));
            remains.importance.extend(measure.importance.get(t.index()));
        }
        remains.changes = measure.changes;
        remains
    }

    fn join_regions(self, rim: &[u32], mut pieces: Vec<SeamRegion<K>>) -> Self {
        // Wedges on the rim that are still used, in order.
        let mut new_number = vec![ABSENT; self.wedges.len()];
        for &wedge in pieces.iter().flat_map(|piece| &piece.corners).flatten().filter(|w| *w & RIM_FLAG != 0)
        {
            new_number[(wedge & !RIM_FLAG) as usize] = 0;
        }
        let kept: Vec<u32> =
            (0..).zip(&new_number).filter(|(_, n)| **n == 0).map(|(wedge, _)| wedge).collect();
        kept.iter().zip(0..).for_each(|(&wedge, new)| new_number[wedge as usize] = new);

        let mut next = Self {
            vertex_states: ChunkedList::default(),
            wedges: ChunkedList::default(),
            corners: ChunkedList::default(),
            importance: ChunkedList::default(),
            drifts: vec![],
            ..self
        };
        next.vertex_states.push(rim.iter().map(|&v| *self.vertex_states.get(v)).collect());
        next.wedges.push(kept.iter().map(|&wedge| *self.wedges.get(wedge)).collect());
        for piece in &mut pieces {
            let first = next.wedges.len() as u32;
            let number =
                |w: u32| if w & RIM_FLAG != 0 { new_number[(w & !RIM_FLAG) as usize] } else { first + w };
            piece.corners.iter_mut().for_each(|corners| *corners = corners.map(number));
            next.largest_drift = next.largest_drift.max(piece.largest_drift);
            next.vertex_states.push(std::mem::take(&mut piece.vertex_states));
            next.wedges.push(std::mem::take(&mut piece.wedges));
            next.corners.push(std::mem::take(&mut piece.corners));
            next.importance.push(std::mem::take(&mut piece.importance));
            next.drifts.push(std::mem::take(&mut piece.drifts));
            if let Some((all, changes)) = next.changes.as_mut().zip(piece.changes.take()) {
                all.push(changes);
            }
        }
        next
    }
}

/// Create the initial state of each vertex; `touching` is its set, or [`NO_SET`].
pub fn create_vertex_states<const K: usize>(
    mesh: &Mesh<3>,
    surface: &SeamSurface<K>,
    touching: &[u32],
) -> Vec<VertexState> {
    let history = Quadric::default();
    let place = |&touching: &u32| VertexState { touching, material: SEVERAL, part: SEVERAL, history };
    let mut places: Vec<VertexState> = touching.iter().map(place).collect();
    for t in mesh.connectivity.triangles() {
        let corners = mesh.connectivity.corners(t);
        let mut quadric = Quadric::of_triangle(corners.map(|v| mesh.point(v)), 1.0);
        if let Some(&importance) = surface.importance.get(mesh.triangle_source[t.index()] as usize) {
            quadric.scale(importance);
        }
        corners.iter().for_each(|v| places[v.index()].history.add(&quadric));
    }
    for (v, place) in places.iter_mut().enumerate() {
        let triangles = mesh.connectivity.fan(VertexId::from_index(v));
        let source = |h: HalfedgeId| mesh.triangle_source[h.index() / 3] as usize;
        let kinds = triangles.map(source).map(|t| (surface.materials[t], surface.parts[t]));
        let all = kinds.reduce(|a, b| (common_value(a.0, b.0), common_value(a.1, b.1)));
        (place.material, place.part) = all.unwrap_or((SEVERAL, SEVERAL));
    }
    places
}
