//! Growth of one patch from its seed, layer by layer.
//!
//! The patch grows with its mean normal, as in the paper. If it violates the bounds of its final plane and
//! colour function, its triangles are released. It then grows again from the seed, with that fit fixed.

use std::ops::Range;

use super::claims::{ClaimState, Claims};
use super::fit::{Fit, Moments, complete_frame};
use super::growth_context::GrowthContext;
use super::overlap::{OverlapGrid, PlaneTriangle};
use super::patches::{Facet, Patch};
use crate::base::geometry::{Vec3, dot, norm2, position_of, sub};
use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;

/// Vertex count below which colour gradients are unreliable due to noise. Triangles then may fit the mean
/// colour instead.
const MIN_GRADIENT_VERTICES: f64 = 16.0;

/// Members whose neighbours are fetched at once. Growth is limited by memory latency, and batched fetches
/// overlap.
const BATCH_MEMBERS: usize = 8;

/// Grown patch with the fit that bounds it.
pub struct GrownPatch<const K: usize> {
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
    opposite: VertexId,
    point: [f64; D],
}

/// Grows one patch after another. Public fields describe the last one.
pub struct Grower<'a, const D: usize, const K: usize> {
    ground: &'a GrowthContext<'a, D>,
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
    pub blocked: Vec<u32>,
    candidates: Vec<Candidate<D>>,
    /// Total area of the members.
    area: f64,
    /// Number of triangles that joined with the moving fit, and their maximum distance from the seed.
    extent: (usize, f64),
    /// Number of faces visited.
    pub visited_faces: u64,
}

impl<'a, const D: usize, const K: usize> Grower<'a, D, K> {
    pub fn new(ground: &'a GrowthContext<'a, D>, claims: &'a Claims) -> Self {
        Self {
            ground,
            claims,
            turn: 0,
            claim: 0,
            members: vec![],
            vertices: vec![],
            released: vec![],
            blocked: vec![],
            candidates: vec![],
            area: 0.0,
            extent: (0, 0.0),
            visited_faces: 0,
        }
    }

    /// Grow a patch from a seed under the given claim. None if it was spoiled; all its claims are then
    /// released.
    pub fn grow(&mut self, seed: u32, turn: usize, claim: u32, is_alone: bool) -> Option<GrownPatch<K>> {
        (self.turn, self.claim, self.visited_faces) = (turn, claim, 0);
        self.released.clear();
        self.blocked.clear();
        self.claims.restart(turn);
        let stays_alone = self.ground.is_locked(seed) || self.ground.facets[seed as usize].1 == 0.0;
        let grown = self.grow_from(seed, is_alone || stays_alone);
        if self.claims.is_spoiled(turn) {
            self.members.iter().for_each(|&t| self.claims.release(t, claim));
            return None;
        }
        Some(grown)
    }

    fn grow_from(&mut self, seed: u32, is_alone: bool) -> GrownPatch<K> {
        let mut moments = self.start(seed);
        let own = moments.fit();
        let own_measured = self.measure(&own);
        // Keep single triangles whose own colours exceed the bound of the fit.
        if is_alone || own_measured.is_none() {
            return self.build_patch(seed, own, None);
        }
        self.extent = (1, self.ground.facets[seed as usize].1.sqrt());
        if self.claims.is_release_limited(seed) {
            self.grow_with_fixed_fit(&own);
            let measured = self.measure(&own);
            return self.build_patch(seed, own, measured);
        }
        let fit = self.grow_with_moving_fit(&mut moments);
        let measured = self.measure(&fit);
        if self.ground.previous_patches.is_empty() && measured.is_some() {
            return self.build_patch(seed, fit, measured);
        }
        if !self.ground.previous_patches.is_empty() {
            let at = |t: u32| position_of(self.ground.corners(t)[0]);
            let away = self.members.iter().map(|&t| norm2(&sub(&at(t), &at(seed)))).fold(0.0, f64::max);
            self.extent = (self.members.len(), away.sqrt());
        }
        std::mem::swap(&mut self.members, &mut self.released);
        self.released.iter().for_each(|&t| self.claims.release(t, self.claim));
        self.start(seed);
        // The seed may be an outlier of the fit that grew from it; then use the seed's own fit.
        let fit = if self.measure(&fit).is_some() { fit } else { own };
        self.grow_with_fixed_fit(&fit);
        let measured = self.measure(&fit);
        self.build_patch(seed, fit, measured)
    }

    fn start(&mut self, seed: u32) -> Moments<D, K> {
        self.members.clear();
        self.vertices.clear();
        self.area = 0.0;
        self.vertices.extend(self.ground.mesh.connectivity.corners(TriangleId(seed)));
        if !self.claim_triangle(seed, self.ground.facets[seed as usize].1) {
            self.members.push(seed);
        }
        let corners = self.ground.corners(seed);
        let mut moments = Moments::new(position_of(corners[0]));
        corners.iter().for_each(|p| moments.add_vertex(p));
        moments.add_normal(&self.ground.facets[seed as usize]);
        moments
    }

    /// Claim a triangle for the patch. Spoils the patch if an earlier one has just claimed the triangle.
    #[inline]
    fn claim_triangle(&mut self, t: u32, area: f64) -> bool {
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
        let is_own = self.claim_triangle(candidate.triangle, candidate.facet.1);
        if is_own {
            self.vertices.push(candidate.opposite);
        }
        is_own
    }

    /// Collect candidate triangles adjacent to some members.
    fn collect_candidates(&mut self, members: Range<usize>) {
        let GrowthContext { mesh, facets, .. } = self.ground;
        self.candidates.clear();
        for i in members {
            let from = self.members[i];
            for h in 3 * from..3 * from + 3 {
                let twin = mesh.connectivity.twin(HalfedgeId(h));
                if twin.is_none() {
                    continue;
                }
                self.visited_faces += 1;
                let triangle = Connectivity::triangle(twin).0;
                if self.is_unowned(triangle) {
                    let across = mesh.connectivity.origin(Connectivity::prev(twin));
                    let (facet, point) = (facets[triangle as usize], *mesh.point(across));
                    self.candidates.push(Candidate { from, triangle, facet, opposite: across, point });
                }
            }
        }
    }

    /// Check whether no other patch owns a triangle.
    #[inline]
    fn is_unowned(&mut self, t: u32) -> bool {
        let whose = self.claims.claim_state(t, self.claim);
        if whose == ClaimState::Earlier {
            self.blocked.push(t);
        }
        whose == ClaimState::Free
    }

    /// Grow as in the paper, updating the mean normal, plane and colours after each layer.
    fn grow_with_moving_fit(&mut self, moments: &mut Moments<D, K>) -> Fit<K> {
        let ground = self.ground;
        let mut fit = moments.fit();
        let (mut layer, half) = (0, 0.5 * ground.thickness);
        while layer < self.members.len() && !self.claims.is_spoiled(self.turn) {
            let end = self.members.len();
            let is_young = moments.count() < MIN_GRADIENT_VERTICES;
            for at in (layer..end).step_by(BATCH_MEMBERS) {
                self.collect_candidates(at..end.min(at + BATCH_MEMBERS));
                let candidates = std::mem::take(&mut self.candidates);
                for candidate in &candidates {
                    let Candidate { from, triangle, facet, point, .. } = candidate;
                    let may_join = self.is_unowned(*triangle)
                        && !self.claims.is_release_limited(*triangle)
                        && ground.may_join(*from, *triangle, facet, &fit.normal);
                    if !may_join {
                        continue;
                    }
                    let suits = K == 0
                        || fit.residual2(point) <= ground.residual2
                        || (is_young && fit.mean_residual2(point) <= ground.residual2);
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
    fn grow_with_fixed_fit(&mut self, fit: &Fit<K>) {
        let ground = self.ground;
        let mut heights = height_range(ground.corners(self.members[0]).map(|p| fit.height(p)));
        let plane = complete_frame(&fit.normal);
        let mut sheet = self.make_overlap_grid(&plane);
        let mut at = 0;
        while at < self.members.len() && !self.claims.is_spoiled(self.turn) {
            let end = self.members.len().min(at + BATCH_MEMBERS);
            self.collect_candidates(at..end);
            at = end;
            let candidates = std::mem::take(&mut self.candidates);
            for candidate in &candidates {
                let Candidate { from, triangle, facet, point, .. } = candidate;
                let is_alike = if sheet.is_some() {
                    ground.were_joined(*from, *triangle, facet, &fit.normal)
                } else {
                    ground.may_join(*from, *triangle, facet, &fit.normal)
                };
                if !is_alike || !self.is_unowned(*triangle) {
                    continue;
                }
                let height = fit.height(point);
                let wider = [heights[0].min(height), heights[1].max(height)];
                let is_flat = wider[1] - wider[0] <= ground.thickness;
                let fits = is_flat && (K == 0 || fit.residual2(point) <= ground.residual2);
                let is_over = |sheet: &mut OverlapGrid| !sheet.try_add(self.project(*triangle, &plane));
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
    fn make_overlap_grid(&self, plane: &[Vec3; 2]) -> Option<OverlapGrid> {
        if self.ground.previous_patches.is_empty() {
            return None;
        }
        let seed = self.project(self.members[0], plane);
        let count = self.extent.0.max(1);
        let reach = self.extent.1;
        let [low, high] = [-reach, reach].map(|r| seed[0].map(|x| x + r));
        let mut sheet = OverlapGrid::new(low, high, count);
        sheet.try_add(seed);
        Some(sheet)
    }

    fn project(&self, t: u32, [e, f]: &[Vec3; 2]) -> PlaneTriangle {
        self.ground.corners(t).map(|p| [dot(e, &position_of(p)), dot(f, &position_of(p))])
    }

    fn measure(&self, fit: &Fit<K>) -> Option<([f64; 2], f64)> {
        self.ground.measure(&self.members, &self.vertices, fit)
    }

    /// Build the result. A patch without measured heights is a single triangle, whose bounds are zero.
    fn build_patch(&self, seed: u32, fit: Fit<K>, measured: Option<([f64; 2], f64)>) -> GrownPatch<K> {
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
            gradient: fit.gradient_norm(),
        };
        GrownPatch { patch, fit, heights, residual2, is_open }
    }
}

fn height_range(heights: [f64; 3]) -> [f64; 2] {
    [heights.into_iter().fold(f64::MAX, f64::min), heights.into_iter().fold(f64::MIN, f64::max)]
}
