//! Growth of one patch from its seed, layer by layer.
//!
//! The patch grows with its mean normal, as in the paper. If it violates the bounds of its final plane and
//! colour function, its triangles are released. It then grows again from the seed, with that fit fixed.

use std::ops::Range;

use super::claims::{Claims, Whose};
use super::fit::{Fit, Moments, frame};
use super::ground::Ground;
use super::overlap::{Flat, Sheet};
use super::patches::{Facet, Patch};
use crate::base::geometry::{Vec3, dot, norm2, position, sub};
use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;

/// Vertex count below which colour gradients are unreliable due to noise. Triangles then may fit the mean
/// colour instead.
const YOUNG: f64 = 16.0;

/// Members whose neighbours are fetched at once. Growth is limited by memory latency, and batched fetches
/// overlap.
const AT_ONCE: usize = 8;

/// Grown patch with the fit that bounds it.
pub struct Grown<const K: usize> {
    pub patch: Patch,
    pub fit: Fit<K>,
    pub heights: [f64; 2],
    pub residual2: f64,
    /// True if triangles may be added; false for patches that must stay single triangles.
    pub is_open: bool,
}

/// Candidate triangle with the data that decides whether it joins.
#[derive(Clone, Copy)]
struct Candidate<const D: usize> {
    from: u32,
    triangle: u32,
    facet: Facet,
    /// Vertex that the triangle would add to the patch.
    across: VertexId,
    point: [f64; D],
}

/// Grows one patch after another. Public fields describe the last one.
pub struct Grower<'a, const D: usize, const K: usize> {
    ground: &'a Ground<'a, D>,
    claims: &'a Claims,
    turn: usize,
    claim: u32,
    /// Triangles of the patch, in the order they joined.
    pub members: Vec<u32>,
    /// Vertices of the patch: three of the seed, then one per further triangle.
    vertices: Vec<VertexId>,
    /// Triangles that joined and were released.
    pub released: Vec<u32>,
    /// Triangles that could not join because an earlier turn had claimed them.
    pub barred: Vec<u32>,
    candidates: Vec<Candidate<D>>,
    /// Total area of the members.
    area: f64,
    /// Number of triangles that joined with the moving fit, and their maximum distance from the seed.
    extent: (usize, f64),
    /// Number of faces visited.
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

    /// Grow a patch from a seed under the given claim. None if it was spoiled; all its claims are then
    /// released.
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
        // Keep single triangles whose own colours exceed the bound of the fit.
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
        // The seed may be an outlier of the fit that grew from it; then use the seed's own fit.
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

    /// Claim a triangle for the patch. Spoils the patch if an earlier one has just claimed the triangle.
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

    /// Collect candidate triangles adjacent to some members.
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

    /// Check whether no other patch owns a triangle.
    #[inline]
    fn is_free(&mut self, t: u32) -> bool {
        let whose = self.claims.whose(t, self.claim);
        if whose == Whose::Earlier {
            self.barred.push(t);
        }
        whose == Whose::Free
    }

    /// Grow as in the paper, updating the mean normal, plane and colours after each layer.
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

    /// Grow against a fixed fit, so that all members satisfy it.
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

    /// Create the overlap check for splitting folded patches, with the seed in it. None in normal growth.
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

    /// Build the result. A patch without measured heights is a single triangle, whose bounds are zero.
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
