//! State of the whole surface between rounds: wedges and seam drift.
//!
//! Quadrics are not stored: a region computes them from its current triangles when it is loaded.

use std::cell::RefCell;

use super::joined::Joined;
use super::record::Changes;
use super::state::{Knobs, SEVERAL, Seams, Spot, common};
use super::surface::Surface;
use super::texture::{Charts, Drifts};
use super::wedges::{NONE, Wedge, Wedges};
use super::weld::TOUCHES_NONE;
use crate::base::geometry::Vec3;
use crate::base::ids::{EdgeId, HalfedgeId, VertexId};
use crate::collapse::records::Records;
use crate::collapse::region::SHARED;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::{Lock, Mesh};
use crate::quadrics::quadric::Quadric;

/// Marks the wedge of a vertex on the rim, which keeps its index on the whole surface.
const ON_RIM: u32 = 1 << 31;

/// State of a vertex between rounds.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Set of touching vertices that must stay together; see [`super::weld`].
    pub touching: u32,
    /// Common value of all triangles that the vertex represents, or [`SEVERAL`].
    pub material: i32,
    pub part: i32,
    /// Shape quadric of the input triangles that the vertex represents.
    pub history: Quadric<0>,
}

/// Drift of a seam edge: triangle, corner and drift.
type Drift = (u32, u8, f64);

/// The surface before any collapse.
pub struct Given<'a, const K: usize> {
    pub surface: &'a Surface<K>,
    pub charts: &'a Charts,
    /// Bounding box that no vertex may leave.
    pub bounds: [Vec3; 2],
}

/// State of the whole surface between rounds.
pub struct SeamRecords<'a, const D: usize, const K: usize> {
    knobs: Knobs,
    given: Given<'a, K>,
    places: Joined<Place>,
    pub wedges: Joined<Wedge<K>>,
    /// Wedges of the corners, by triangle.
    pub corners: Joined<[u32; 3]>,
    /// Factor on the error, by triangle; empty for 1.
    importance: Joined<f64>,
    /// By part of the triangle list, with local triangle indices.
    drifts: Vec<Vec<Drift>>,
    pub largest_drift: f64,
    has_touching: bool,
    /// By region of each round, if recorded.
    pub changes: Option<Vec<Changes<K>>>,
}

/// State that a region returns after simplification.
pub struct Remains<const K: usize> {
    places: Vec<Place>,
    wedges: Vec<Wedge<K>>,
    corners: Vec<[u32; 3]>,
    importance: Vec<f64>,
    drifts: Vec<Drift>,
    largest_drift: f64,
    changes: Option<Changes<K>>,
}

impl<'a, const D: usize, const K: usize> SeamRecords<'a, D, K> {
    pub fn new(
        knobs: Knobs,
        given: Given<'a, K>,
        places: Vec<Place>,
        wedges: Vec<Wedge<K>>,
        corners: Vec<[u32; 3]>,
        importance: Vec<f64>,
        is_recorded: bool,
    ) -> Self {
        const { assert!(D == K + 3) };
        let has_touching = places.iter().any(|place| place.touching != TOUCHES_NONE);
        Self {
            knobs,
            given,
            places: Joined::of(places),
            wedges: Joined::of(wedges),
            corners: Joined::of(corners),
            importance: Joined::of(importance),
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
        let mut last = vec![NONE; connectivity.vertex_slots()];
        let mut before: Vec<u32> = Vec::with_capacity(some);
        for (local, &t) in region.triangle_source.iter().enumerate() {
            for (corner, &number) in self.corners.at(t).iter().enumerate() {
                let v = connectivity.origin(HalfedgeId((3 * local + corner) as u32));
                let mut wedge = last[v.index()];
                while wedge != NONE && numbers[wedge as usize] != number {
                    wedge = before[wedge as usize];
                }
                if wedge == NONE {
                    wedge = numbers.len() as u32;
                    wedges.all.push(*self.wedges.at(number));
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
        region.triangle_source.iter().map(|&t| *self.importance.at(t)).collect()
    }

    fn load_spots(&self, region: &Mesh<3>, wedges: &Wedges<K>, is_seam: &[bool]) -> Vec<Spot> {
        const NOT_SEEN: u32 = NONE - 1;
        let connectivity = &region.connectivity;
        let spot = |&v: &u32| {
            let &Place { material, part, .. } = self.places.at(v);
            Spot { only: NOT_SEEN, seam_degree: 0, valence: 0, material, part }
        };
        let mut spots: Vec<Spot> = region.vertex_source.iter().map(spot).collect();
        for (h, &wedge) in wedges.of_corner.iter().enumerate() {
            let only = &mut spots[connectivity.origin(HalfedgeId::from_index(h)).index()].only;
            *only = if *only == NOT_SEEN || *only == wedge { wedge } else { NONE };
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

    fn load_drifts(&self, region: &Mesh<3>) -> Drifts {
        let mut drifts = Drifts::new(region.connectivity.edge_slots());
        for (local, &t) in region.triangle_source.iter().enumerate() {
            let part = self.corners.part(t);
            let (known, own) = (&self.drifts[part], t - self.corners.start(part));
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
fn drifts_left(connectivity: &Connectivity, drifts: &Drifts) -> Vec<Drift> {
    let mut left = vec![];
    for (number, t) in connectivity.triangles().enumerate() {
        for corner in 0..3 {
            let drift = drifts.of(connectivity.edge(HalfedgeId(3 * t.0 + corner)));
            if drift > 0.0 {
                left.push((number as u32, corner as u8, drift));
            }
        }
    }
    left
}

impl<'a, const D: usize, const K: usize> Records<3> for SeamRecords<'a, D, K> {
    type Measure = Seams<'a, D, K>;
    type Remains = Remains<K>;

    /// Put touching vertices into the same region, or onto the rim.
    fn keep_together(&self, owner: &mut [u32]) {
        if !self.has_touching {
            return;
        }
        let mut touching: Vec<(u32, u32)> = self.places.iter().map(|place| place.touching).zip(0..).collect();
        touching.retain(|(touching, _)| *touching != TOUCHES_NONE);
        touching.sort_unstable();
        for set in touching.chunk_by(|a, b| a.0 == b.0) {
            let first = owner[set[0].1 as usize];
            if set.iter().any(|&(_, v)| owner[v as usize] != first) {
                set.iter().for_each(|&(_, v)| owner[v as usize] = SHARED);
            }
        }
    }

    fn load(&self, region: &Mesh<3>) -> Seams<'a, D, K> {
        let connectivity = &region.connectivity;
        let (wedges, numbers) = self.load_wedges(region);
        let is_seam: Vec<bool> = (0..connectivity.edge_slots())
            .map(|e| wedges.is_seam(connectivity, EdgeId::from_index(e)))
            .collect();
        let touching: Vec<u32> = if self.has_touching {
            region.vertex_source.iter().map(|&v| self.places.at(v).touching).collect()
        } else {
            vec![]
        };
        let vertices = (0..touching.len()).map(VertexId::from_index);
        let mut sheets: Vec<(u32, VertexId)> = touching
            .iter()
            .copied()
            .zip(vertices)
            .filter(|(touching, _)| *touching != TOUCHES_NONE)
            .collect();
        sheets.sort_unstable();
        let mut seams = Seams {
            knobs: self.knobs,
            charts: self.given.charts,
            bounds: self.given.bounds,
            spots: self.load_spots(region, &wedges, &is_seam),
            drifts: self.load_drifts(region),
            plan: RefCell::default(),
            changes: self.changes.is_some().then(Changes::default),
            importance: self.load_importance(region),
            shape: RefCell::new(vec![None; connectivity.vertex_slots()]),
            quadrics: vec![Quadric::default(); wedges.all.len()],
            history: region.vertex_source.iter().map(|&v| self.places.at(v).history).collect(),
            moved: vec![],
            wedges,
            is_seam,
            touching,
            sheets,
            numbers,
        };
        seams.compute_quadrics(region);
        seams
    }

    fn unload(measure: Seams<'a, D, K>, region: &Mesh<3>) -> Remains<K> {
        let connectivity = &region.connectivity;
        let is_rim = |v: VertexId| region.lock(v) == Lock::Rim;
        let inside = connectivity.vertices().filter(|&v| !is_rim(v)).count();
        let mut remains = Remains {
            places: Vec::with_capacity(inside),
            wedges: Vec::with_capacity(inside),
            corners: Vec::with_capacity(connectivity.triangle_count()),
            importance: vec![],
            drifts: drifts_left(connectivity, &measure.drifts),
            largest_drift: measure.drifts.largest,
            changes: None,
        };
        let mut number: Vec<u32> = measure.numbers.iter().map(|wedge| wedge | ON_RIM).collect();
        for v in connectivity.vertices().filter(|&v| !is_rim(v)) {
            let spot = &measure.spots[v.index()];
            remains.places.push(Place {
                touching: measure.touching(v),
                material: spot.material,
                part: spot.part,
                history: measure.history[v.index()],
            });
            for wedge in connectivity.fan(v).map(|h| measure.wedges.of(h)) {
                if number[wedge as usize] & ON_RIM != 0 {
                    number[wedge as usize] = remains.wedges.len() as u32;
                    remains.wedges.push(*measure.wedges.at(wedge));
                }
            }
        }
        for t in connectivity.triangles() {
            let wedges = [0, 1, 2].map(|corner| measure.wedges.of(HalfedgeId(3 * t.0 + corner)));
            remains.corners.push(wedges.map(|wedge| number[wedge as usize]));
            remains.importance.extend(measure.importance.get(t.index()));
        }
        remains.changes = measure.changes;
        remains
    }

    fn join(self, rim: &[u32], mut pieces: Vec<Remains<K>>) -> Self {
        // Wedges on the rim that are still used, in order.
        let mut new_number = vec![NONE; self.wedges.len()];
        for &wedge in pieces.iter().flat_map(|piece| &piece.corners).flatten().filter(|w| *w & ON_RIM != 0) {
            new_number[(wedge & !ON_RIM) as usize] = 0;
        }
        let kept: Vec<u32> =
            (0..).zip(&new_number).filter(|(_, n)| **n == 0).map(|(wedge, _)| wedge).collect();
        kept.iter().zip(0..).for_each(|(&wedge, new)| new_number[wedge as usize] = new);

        let mut next = Self {
            places: Joined::default(),
            wedges: Joined::default(),
            corners: Joined::default(),
            importance: Joined::default(),
            drifts: vec![],
            ..self
        };
        next.places.push(rim.iter().map(|&v| *self.places.at(v)).collect());
        next.wedges.push(kept.iter().map(|&wedge| *self.wedges.at(wedge)).collect());
        for piece in &mut pieces {
            let first = next.wedges.len() as u32;
            let number =
                |w: u32| if w & ON_RIM != 0 { new_number[(w & !ON_RIM) as usize] } else { first + w };
            piece.corners.iter_mut().for_each(|corners| *corners = corners.map(number));
            next.largest_drift = next.largest_drift.max(piece.largest_drift);
            next.places.push(std::mem::take(&mut piece.places));
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

/// Create the initial state of each vertex; `touching` is its set, or [`TOUCHES_NONE`].
pub fn places<const K: usize>(mesh: &Mesh<3>, surface: &Surface<K>, touching: &[u32]) -> Vec<Place> {
    let history = Quadric::default();
    let place = |&touching: &u32| Place { touching, material: SEVERAL, part: SEVERAL, history };
    let mut places: Vec<Place> = touching.iter().map(place).collect();
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
        let all = kinds.reduce(|a, b| (common(a.0, b.0), common(a.1, b.1)));
        (place.material, place.part) = all.unwrap_or((SEVERAL, SEVERAL));
    }
    places
}
