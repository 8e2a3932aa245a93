//! One patch: it grows from its seed, layer by layer.
//!
//! It grows with its mean normal, as in the paper. If in the end it does not suit its final plane and colours, its
//! triangles are set free, and it grows again from its seed against these, which no longer change.

use super::claims::{Claims, Whose};
use super::fit::{Fit, Moments, frame};
use super::ground::Ground;
use super::overlap::{Flat, Sheet};
use super::patches::Patch;
use crate::base::geometry::{Vec3, dot, norm2, position, sub};
use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;

/// Until it has so many vertices, noise may tilt the colours of a patch, and their mean will do as well.
const YOUNG: f64 = 16.0;

/// After so many triangles a patch looks whether it is spoiled.
const STRIDE: usize = 256;

/// A patch as it grew, with the fit it is held to.
pub struct Grown<const K: usize> {
    pub patch: Patch,
    pub fit: Fit<K>,
    pub heights: [f64; 2],
    pub residual2: f64,
    /// Whether others may join: not one that has to stay a single triangle.
    pub is_open: bool,
}

/// Grows patches, one after the other. What is public tells of the last.
pub struct Grower<'a, const D: usize, const K: usize> {
    ground: &'a Ground<'a, D>,
    claims: &'a Claims,
    turn: usize,
    claim: u32,
    /// Triangles of the patch, in the order they joined.
    pub members: Vec<u32>,
    /// Their vertices: those of the seed, then the one that each other triangle brought with it.
    vertices: Vec<VertexId>,
    /// Triangles that had joined and were set free.
    pub released: Vec<u32>,
    /// Triangles that did not join, as patches with an earlier turn had claimed them.
    pub barred: Vec<u32>,
    /// Of the members.
    area: f64,
    /// How many triangles joined the patch while its normal moved, and how far from the seed.
    extent: (usize, f64),
    /// Faces looked at.
    pub looks: u64,
}

impl<'a, const D: usize, const K: usize> Grower<'a, D, K> {
    pub fn new(ground: &'a Ground<'a, D>, claims: &'a Claims) -> Self {
        Self {
            ground,
            claims,
            turn: 0,
            claim: 0,
            members: vec![],
            vertices: vec![],
            released: vec![],
            barred: vec![],
            area: 0.0,
            extent: (0, 0.0),
            looks: 0,
        }
    }

    /// Grow from a seed with this claim; nothing comes of it, and it claims nothing, if it is spoiled.
    pub fn grow(&mut self, seed: u32, turn: usize, claim: u32, is_alone: bool) -> Option<Grown<K>> {
        (self.turn, self.claim, self.looks) = (turn, claim, 0);
        self.released.clear();
        self.barred.clear();
        self.claims.start(turn);
        let stays_alone = self.ground.is_locked(seed) || self.ground.facets[seed as usize].1 == 0.0;
        let grown = self.grown(seed, is_alone || stays_alone);
        if self.claims.is_spoiled(turn) {
            self.members.iter().for_each(|&t| self.claims.release(t, claim));
            return None;
        }
        Some(grown)
    }

    fn grown(&mut self, seed: u32, is_alone: bool) -> Grown<K> {
        let mut moments = self.start(seed);
        let own = moments.fit();
        let own_measured = self.measured(&own);
        // A triangle whose own colours are too far from linear over it, as the fit sees it, stays as it is.
        if is_alone || own_measured.is_none() {
            return self.finish(seed, own, None);
        }
        self.extent = (1, self.ground.facets[seed as usize].1.sqrt());
        if self.claims.is_restless(seed) {
            self.spread_fixed(&own);
            let measured = self.measured(&own);
            return self.finish(seed, own, measured);
        }
        let fit = self.spread_moving(&mut moments);
        let measured = self.measured(&fit);
        if self.ground.were.is_empty() && measured.is_some() {
            return self.finish(seed, fit, measured);
        }
        if !self.ground.were.is_empty() {
            let at = |t: u32| position(self.ground.corners(t)[0]);
            let away = self.members.iter().map(|&t| norm2(&sub(&at(t), &at(seed)))).fold(0.0, f64::max);
            self.extent = (self.members.len(), away.sqrt());
        }
        std::mem::swap(&mut self.members, &mut self.released);
        self.released.iter().for_each(|&t| self.claims.release(t, self.claim));
        self.start(seed);
        // The seed need not be typical of what grew from it.
        let fit = if self.measured(&fit).is_some() { fit } else { own };
        self.spread_fixed(&fit);
        let measured = self.measured(&fit);
        self.finish(seed, fit, measured)
    }

    fn start(&mut self, seed: u32) -> Moments<D, K> {
        self.members.clear();
        self.vertices.clear();
        self.area = 0.0;
        self.vertices.extend(self.ground.mesh.connectivity.corners(TriangleId(seed)));
        if !self.join(seed) {
            self.claims.spoil(self.turn);
            self.members.push(seed);
        }
        let corners = self.ground.corners(seed);
        let mut moments = Moments::new(position(corners[0]));
        corners.iter().for_each(|p| moments.add_vertex(p));
        moments.add_normal(&self.ground.facets[seed as usize]);
        moments
    }

    #[inline]
    fn join(&mut self, t: u32) -> bool {
        let is_own = self.claims.claim(t, self.claim);
        if is_own {
            self.members.push(t);
            self.area += self.ground.facets[t as usize].1;
        } else {
            self.barred.push(t);
        }
        is_own
    }

    /// Whether a triangle may join for all that others have.
    #[inline]
    fn is_to_be_had(&mut self, t: u32) -> bool {
        self.looks += 1;
        let whose = self.claims.whose(t, self.claim);
        if whose == Whose::Earlier {
            self.barred.push(t);
        }
        whose == Whose::Free
    }

    /// The paper's growth: the mean normal, and here the plane and the colours, follow after each layer.
    fn spread_moving(&mut self, moments: &mut Moments<D, K>) -> Fit<K> {
        let ground = self.ground;
        let connectivity = &ground.mesh.connectivity;
        let mut fit = moments.fit();
        let (mut layer, half) = (0, 0.5 * ground.thickness);
        while layer < self.members.len() {
            let end = self.members.len();
            let is_young = moments.count() < YOUNG;
            for at in layer..end {
                if at % STRIDE == 0 && self.claims.is_spoiled(self.turn) {
                    return fit;
                }
                let from = self.members[at];
                for h in 3 * from..3 * from + 3 {
                    let twin = connectivity.twin(HalfedgeId(h));
                    if twin.is_none() {
                        continue;
                    }
                    let to = Connectivity::triangle(twin).0;
                    let is_to_be_had = self.is_to_be_had(to) && !self.claims.is_restless(to);
                    if !is_to_be_had || !ground.is_alike(from, to, &fit.normal) {
                        continue;
                    }
                    let across = connectivity.origin(Connectivity::prev(twin));
                    let p = ground.mesh.point(across);
                    let suits = K == 0
                        || fit.residual2(p) <= ground.residual2
                        || (is_young && fit.residual2_of_mean(p) <= ground.residual2);
                    let fits = fit.height(p).abs() <= half && suits;
                    if fits && !ground.is_locked(to) && self.join(to) {
                        self.vertices.push(across);
                        moments.add_vertex(p);
                        moments.add_normal(&ground.facets[to as usize]);
                    }
                }
            }
            layer = end;
            if self.members.len() > end {
                fit = moments.fit();
            }
        }
        fit
    }

    /// Growth against a fit that stays, so that whatever joins suits it in the end.
    fn spread_fixed(&mut self, fit: &Fit<K>) {
        let ground = self.ground;
        let connectivity = &ground.mesh.connectivity;
        let mut heights = around(ground.corners(self.members[0]).map(|p| fit.height(p)));
        let plane = frame(&fit.normal);
        let mut sheet = self.sheet(&plane);
        let mut at = 0;
        while at < self.members.len() {
            if at % STRIDE == 0 && self.claims.is_spoiled(self.turn) {
                return;
            }
            let from = self.members[at];
            at += 1;
            for h in 3 * from..3 * from + 3 {
                let twin = connectivity.twin(HalfedgeId(h));
                if twin.is_none() {
                    continue;
                }
                let to = Connectivity::triangle(twin).0;
                if !self.is_to_be_had(to) {
                    continue;
                }
                let is_alike = if sheet.is_some() {
                    ground.was_alike(from, to, &fit.normal)
                } else {
                    ground.is_alike(from, to, &fit.normal)
                };
                if !is_alike {
                    continue;
                }
                let across = connectivity.origin(Connectivity::prev(twin));
                let p = ground.mesh.point(across);
                let height = fit.height(p);
                let wider = [heights[0].min(height), heights[1].max(height)];
                let is_flat = wider[1] - wider[0] <= ground.thickness;
                let fits =
                    is_flat && (K == 0 || fit.residual2(p) <= ground.residual2) && !ground.is_locked(to);
                let is_over = |sheet: &mut Sheet| !sheet.add(self.flat(to, &plane));
                if fits && !sheet.as_mut().is_some_and(is_over) && self.join(to) {
                    heights = wider;
                    self.vertices.push(across);
                }
            }
        }
    }

    /// What keeps patches that are being separated from lying over themselves, with the first triangle.
    fn sheet(&self, plane: &[Vec3; 2]) -> Option<Sheet> {
        if self.ground.were.is_empty() {
            return None;
        }
        let seed = self.flat(self.members[0], plane);
        let count = self.extent.0.max(1);
        let reach = self.extent.1;
        let [low, high] = [-reach, reach].map(|r| seed[0].map(|x| x + r));
        let mut sheet = Sheet::new(low, high, count);
        sheet.add(seed);
        Some(sheet)
    }

    fn flat(&self, t: u32, [e, f]: &[Vec3; 2]) -> Flat {
        self.ground.corners(t).map(|p| [dot(e, &position(p)), dot(f, &position(p))])
    }

    fn measured(&self, fit: &Fit<K>) -> Option<([f64; 2], f64)> {
        self.ground.measured(&self.members, &self.vertices, fit)
    }

    /// What has no measure is a single triangle, and needs none.
    fn finish(&self, seed: u32, fit: Fit<K>, measured: Option<([f64; 2], f64)>) -> Grown<K> {
        let is_open = measured.is_some();
        let (heights, residual2) = measured.unwrap_or_default();
        let patch = Patch {
            seed,
            faces: self.members.len() as u32,
            area: self.area,
            normal: fit.normal,
            origin: fit.origin,
            heights: [0.0; 2],
            residual: 0.0,
            gradient: fit.gradient(),
        };
        Grown { patch, fit, heights, residual2, is_open }
    }
}

fn around(heights: [f64; 3]) -> [f64; 2] {
    [heights.into_iter().fold(f64::MAX, f64::min), heights.into_iter().fold(f64::MIN, f64::max)]
}
