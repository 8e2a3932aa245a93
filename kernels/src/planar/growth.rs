//! One patch: it grows from its seed, layer by layer.
//!
//! It grows with its mean normal, as in the paper. If in the end it does not suit its final plane and colours, its
//! triangles are set free, and it grows again from its seed against these, which no longer change.

use std::ops::Range;

use super::claims::{Claims, Whose};
use super::fit::{Fit, Moments, frame};
use super::ground::Ground;
use super::overlap::{Flat, Sheet};
use super::patches::{Facet, Patch};
use crate::base::geometry::{Vec3, dot, norm2, position, sub};
use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;

/// Until it has so many vertices, noise may tilt the colours of a patch, and their mean will do as well.
const YOUNG: f64 = 16.0;

/// So many triangles are looked around at once. Growth waits for memory more than it computes; what lies beside
/// several triangles comes at the same time.
const AT_ONCE: usize = 8;

/// A patch as it grew, with the fit it is held to.
pub struct Grown<const K: usize> {
    pub patch: Patch,
    pub fit: Fit<K>,
    pub heights: [f64; 2],
    pub residual2: f64,
    /// Whether others may join: not one that has to stay a single triangle.
    pub is_open: bool,
}

/// A triangle that may join, with what decides whether it does.
#[derive(Clone, Copy)]
struct Candidate<const D: usize> {
    from: u32,
    triangle: u32,
    facet: Facet,
    /// The vertex that it would bring with it.
    across: VertexId,
    point: [f64; D],
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
    candidates: Vec<Candidate<D>>,
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
            candidates: vec![],
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
        if !self.join(seed, self.ground.facets[seed as usize].1) {
            self.members.push(seed);
        }
        let corners = self.ground.corners(seed);
        let mut moments = Moments::new(position(corners[0]));
        corners.iter().for_each(|p| moments.add_vertex(p));
        moments.add_normal(&self.ground.facets[seed as usize]);
        moments
    }

    /// Where an earlier patch has just taken the triangle, this one is spoiled.
    #[inline]
    fn join(&mut self, t: u32, area: f64) -> bool {
        let is_own = self.claims.claim(t, self.claim);
        if is_own {
            self.members.push(t);
            self.area += area;
        } else {
            self.claims.spoil(self.turn);
        }
        is_own
    }

    #[inline]
    fn join_with_vertex(&mut self, candidate: &Candidate<D>) -> bool {
        let is_own = self.join(candidate.triangle, candidate.facet.1);
        if is_own {
            self.vertices.push(candidate.across);
        }
        is_own
    }

    /// Look around some members for triangles that may join.
    fn look_around(&mut self, members: Range<usize>) {
        let Ground { mesh, facets, .. } = self.ground;
        self.candidates.clear();
        for i in members {
            let from = self.members[i];
            for h in 3 * from..3 * from + 3 {
                let twin = mesh.connectivity.twin(HalfedgeId(h));
                if twin.is_none() {
                    continue;
                }
                self.looks += 1;
                let triangle = Connectivity::triangle(twin).0;
                if self.is_free(triangle) {
                    let across = mesh.connectivity.origin(Connectivity::prev(twin));
                    let (facet, point) = (facets[triangle as usize], *mesh.point(across));
                    self.candidates.push(Candidate { from, triangle, facet, across, point });
                }
            }
        }
    }

    /// Whether a triangle may join for all that others have.
    #[inline]
    fn is_free(&mut self, t: u32) -> bool {
        let whose = self.claims.whose(t, self.claim);
        if whose == Whose::Earlier {
            self.barred.push(t);
        }
        whose == Whose::Free
    }

    /// The paper's growth: the mean normal, and here the plane and the colours, follow after each layer.
    fn spread_moving(&mut self, moments: &mut Moments<D, K>) -> Fit<K> {
        let ground = self.ground;
        let mut fit = moments.fit();
        let (mut layer, half) = (0, 0.5 * ground.thickness);
        while layer < self.members.len() && !self.claims.is_spoiled(self.turn) {
            let end = self.members.len();
            let is_young = moments.count() < YOUNG;
            for at in (layer..end).step_by(AT_ONCE) {
                self.look_around(at..end.min(at + AT_ONCE));
                let candidates = std::mem::take(&mut self.candidates);
                for candidate in &candidates {
                    let Candidate { from, triangle, facet, point, .. } = candidate;
                    let may_join = self.is_free(*triangle)
                        && !self.claims.is_restless(*triangle)
                        && ground.is_alike(*from, *triangle, facet, &fit.normal);
                    if !may_join {
                        continue;
                    }
                    let suits = K == 0
                        || fit.residual2(point) <= ground.residual2
                        || (is_young && fit.residual2_of_mean(point) <= ground.residual2);
                    let fits = fit.height(point).abs() <= half && suits;
                    if fits && !ground.is_locked(*triangle) && self.join_with_vertex(candidate) {
                        moments.add_vertex(point);
                        moments.add_normal(facet);
                    }
                }
                self.candidates = candidates;
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
        let mut heights = around(ground.corners(self.members[0]).map(|p| fit.height(p)));
        let plane = frame(&fit.normal);
        let mut sheet = self.sheet(&plane);
        let mut at = 0;
        while at < self.members.len() && !self.claims.is_spoiled(self.turn) {
            let end = self.members.len().min(at + AT_ONCE);
            self.look_around(at..end);
            at = end;
            let candidates = std::mem::take(&mut self.candidates);
            for candidate in &candidates {
                let Candidate { from, triangle, facet, point, .. } = candidate;
                let is_alike = if sheet.is_some() {
                    ground.was_alike(*from, *triangle, facet, &fit.normal)
                } else {
                    ground.is_alike(*from, *triangle, facet, &fit.normal)
                };
                if !is_alike || !self.is_free(*triangle) {
                    continue;
                }
                let height = fit.height(point);
                let wider = [heights[0].min(height), heights[1].max(height)];
                let is_flat = wider[1] - wider[0] <= ground.thickness;
                let fits = is_flat && (K == 0 || fit.residual2(point) <= ground.residual2);
                let is_over = |sheet: &mut Sheet| !sheet.add(self.flat(*triangle, &plane));
                if fits
                    && !ground.is_locked(*triangle)
                    && !sheet.as_mut().is_some_and(is_over)
                    && self.join_with_vertex(candidate)
                {
                    heights = wider;
                }
            }
            self.candidates = candidates;
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
