//! What patches grow on, and which neighbours are alike: what is the same for all patches, whenever they grow.

use super::fit::Fit;
use super::patches::{Facet, Options};
use crate::base::geometry::{Vec3, dot};
use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::{Lock, Mesh};

/// Part of the distance that the two planes of a patch may take; 0.6 of it is left for the border, at least.
pub const FOR_THICKNESS: f64 = 0.8;

/// Part of the bound on colour that a vertex may be off the linear function: twice that counts.
const FOR_RESIDUAL: f64 = 0.4;

/// Seen along the normal of its patch, no triangle may be turned over or near to it: cosine of 80°.
pub const LEAST_COSINE: f64 = 0.173_648;

pub struct Ground<'a, const D: usize> {
    pub mesh: &'a Mesh<D>,
    pub facets: &'a [Facet],
    pub options: &'a Options,
    /// The patches that are being separated: triangles that were in the same one are alike, but must not lie over
    /// each other. Empty for none.
    pub were: &'a [u32],
    has_locks: bool,
    pub thickness: f64,
    pub residual2: f64,
}

impl<'a, const D: usize> Ground<'a, D> {
    pub fn new(mesh: &'a Mesh<D>, facets: &'a [Facet], options: &'a Options, were: &'a [u32]) -> Self {
        Self {
            mesh,
            facets,
            options,
            were,
            has_locks: mesh.locks.iter().any(|lock| *lock != Lock::Free),
            thickness: FOR_THICKNESS * options.max_distance,
            residual2: (FOR_RESIDUAL * options.max_color).powi(2),
        }
    }

    /// The triangles beside one.
    pub fn beside(&self, t: u32) -> impl Iterator<Item = u32> + '_ {
        let connectivity = &self.mesh.connectivity;
        (3 * t..3 * t + 3)
            .map(move |h| connectivity.twin(HalfedgeId(h)))
            .filter(|twin| twin.is_some())
            .map(|twin| Connectivity::triangle(twin).0)
    }

    pub fn corners(&self, t: u32) -> [&[f64; D]; 3] {
        self.mesh.connectivity.corners(TriangleId(t)).map(|v| self.mesh.point(v))
    }

    #[inline]
    pub fn is_locked(&self, t: u32) -> bool {
        let is_locked = |&v: &VertexId| self.mesh.lock(v) != Lock::Free;
        self.has_locks && self.mesh.connectivity.corners(TriangleId(t)).iter().any(is_locked)
    }

    #[inline]
    pub fn have_one_label(&self, a: u32, b: u32) -> bool {
        let label = |t: u32| self.options.labels.get(self.mesh.triangle_source[t as usize] as usize);
        self.options.labels.is_empty() || label(a) == label(b)
    }

    /// The paper's two criteria, and what else keeps triangles apart; `to` is given with its
    /// normal and area. A triangle without area has no normal, and goes with any.
    #[inline]
    pub fn is_alike(&self, from: u32, to: u32, (normal, area): &Facet, mean: &Vec3) -> bool {
        let fidelity = self.options.fidelity.max(LEAST_COSINE);
        let is_flat = *area == 0.0
            || (dot(normal, mean) > fidelity
                && (self.facets[from as usize].1 == 0.0
                    || dot(normal, &self.facets[from as usize].0) > self.options.detail));
        is_flat && self.have_one_label(from, to)
    }

    /// Whether two triangles were in the same patch, and the second, given with its normal and area, is not turned over.
    #[inline]
    pub fn was_alike(&self, from: u32, to: u32, (normal, area): &Facet, mean: &Vec3) -> bool {
        self.were[from as usize] == self.were[to as usize]
            && (*area == 0.0 || dot(normal, mean) > LEAST_COSINE)
    }

    /// Least and greatest height, and squared residual, of triangles and their vertices over a fit; none if they are
    /// not within its bounds.
    pub fn measured<const K: usize>(
        &self,
        triangles: &[u32],
        vertices: &[VertexId],
        fit: &Fit<K>,
    ) -> Option<([f64; 2], f64)> {
        for &t in triangles {
            let (normal, area) = &self.facets[t as usize];
            if *area > 0.0 && dot(normal, &fit.normal) <= LEAST_COSINE {
                return None;
            }
        }
        let (mut heights, mut residual2) = ([f64::MAX, f64::MIN], 0.0f64);
        for &v in vertices {
            let p = self.mesh.point(v);
            let height = fit.height(p);
            heights = [heights[0].min(height), heights[1].max(height)];
            residual2 = residual2.max(fit.residual2(p));
            if self.exceeds(heights, residual2, K > 0) {
                return None;
            }
        }
        Some((heights, residual2))
    }

    /// Whether heights and a squared residual are beyond the bounds of a patch.
    #[inline]
    pub fn exceeds(&self, heights: [f64; 2], residual2: f64, has_colors: bool) -> bool {
        heights[1] - heights[0] > self.thickness || (has_colors && residual2 > self.residual2)
    }
}
