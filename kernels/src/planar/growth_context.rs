//! Shared, read-only context of growing patches, with the criteria for adjacent triangles.

use super::fit::Fit;
use super::patches::{Facet, Options};
use crate::base::geometry::{Vec3, dot};
use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::{Mesh, VertexLock};

/// Part of the maximum distance available to a patch's thickness. At least 0.6 of it remains for the border,
/// since 0.8² + 0.6² = 1.
pub const THICKNESS_RATIO: f64 = 0.8;

/// Part of the colour bound available to a vertex's residual, which counts twice.
const RESIDUAL_RATIO: f64 = 0.4;

/// Minimum cosine between a triangle and its patch normal (80°): no triangle may flip or nearly flip in the
/// projection.
pub const MIN_COSINE: f64 = 0.173_648;

/// Read-only context of growing patches.
pub struct GrowthContext<'a, const D: usize> {
    pub mesh: &'a Mesh<D>,
    pub facets: &'a [Facet],
    pub options: &'a Options,
    /// Previous patch of each triangle while folded patches are split. Triangles of the same patch may join,
    /// but must not overlap. Empty otherwise.
    pub previous_patches: &'a [u32],
    has_locks: bool,
    pub thickness: f64,
    pub residual2: f64,
}

impl<'a, const D: usize> GrowthContext<'a, D> {
    pub fn new(mesh: &'a Mesh<D>, facets: &'a [Facet], options: &'a Options, were: &'a [u32]) -> Self {
        Self {
            mesh,
            facets,
            options,
            previous_patches: were,
            has_locks: mesh.locks.iter().any(|lock| *lock != VertexLock::Free),
            thickness: THICKNESS_RATIO * options.max_distance,
            residual2: (RESIDUAL_RATIO * options.max_color).powi(2),
        }
    }

    /// List the triangles adjacent to a triangle.
    pub fn adjacent_triangles(&self, t: u32) -> impl Iterator<Item = u32> + '_ {
        let connectivity = &self.mesh.connectivity;
        (3 * t..3 * t + 3)
            .map(move |h| connectivity.twin(HalfedgeId(h)))
            .filter(|twin| twin.is_some())
            .map(|twin| Connectivity::triangle(twin).0)
    }

    pub fn corners(&self, t: u32) -> [&[f64; D]; 3] {
        self.mesh.connectivity.corners(TriangleId(t)).map(|v| self.mesh.point(v))
    }

    /// Check whether a triangle has a locked vertex.
    #[inline]
    pub fn is_locked(&self, t: u32) -> bool {
        let is_locked = |&v: &VertexId| self.mesh.lock(v) != VertexLock::Free;
        self.has_locks && self.mesh.connectivity.corners(TriangleId(t)).iter().any(is_locked)
    }

    /// Check whether two triangles have the same label.
    #[inline]
    pub fn have_same_label(&self, a: u32, b: u32) -> bool {
        let label = |t: u32| self.options.labels.get(self.mesh.triangle_source[t as usize] as usize);
        self.options.labels.is_empty() || label(a) == label(b)
    }

    /// Check the paper's two criteria (fidelity and detail) and the labels. `to` is given with its normal and
    /// area. A degenerate triangle has no normal and passes the criteria.
    #[inline]
    pub fn may_join(&self, from: u32, to: u32, (normal, area): &Facet, mean: &Vec3) -> bool {
        let fidelity = self.options.fidelity.max(MIN_COSINE);
        let is_flat = *area == 0.0
            || (dot(normal, mean) > fidelity
                && (self.facets[from as usize].1 == 0.0
                    || dot(normal, &self.facets[from as usize].0) > self.options.detail));
        is_flat && self.have_same_label(from, to)
    }

    /// Check whether two triangles were in the same patch and the second, given with its normal and area, is
    /// not flipped.
    #[inline]
    pub fn were_joined(&self, from: u32, to: u32, (normal, area): &Facet, mean: &Vec3) -> bool {
        self.previous_patches[from as usize] == self.previous_patches[to as usize]
            && (*area == 0.0 || dot(normal, mean) > MIN_COSINE)
    }

    /// Compute minimum and maximum height and the maximum squared residual over a fit. None if a bound is
    /// exceeded.
    pub fn measure<const K: usize>(
        &self,
        triangles: &[u32],
        vertices: &[VertexId],
        fit: &Fit<K>,
    ) -> Option<([f64; 2], f64)> {
        for &t in triangles {
            let (normal, area) = &self.facets[t as usize];
            if *area > 0.0 && dot(normal, &fit.normal) <= MIN_COSINE {
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

    /// Check whether heights or a squared residual exceed the bounds of a patch.
    #[inline]
    pub fn exceeds(&self, heights: [f64; 2], residual2: f64, has_colors: bool) -> bool {
        heights[1] - heights[0] > self.thickness || (has_colors && residual2 > self.residual2)
    }
}
