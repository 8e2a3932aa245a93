//! Patches, the options that limit them, and the simplified mesh.

use crate::base::geometry::{Vec3, cross, norm2, position_of, sub};
use crate::base::ids::{HalfedgeId, TriangleId};
use crate::base::parallel::collect;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::Mesh;

/// Limits of patches. Angles are given as minimum cosines: the paper's ε is 1 − cosine.
#[derive(Clone, Debug)]
pub struct Options {
    /// Label of each input triangle. Patches do not cross labels. Empty if there are no labels.
    pub labels: Vec<u32>,
    /// Minimum cosine between a face and the patch it joins (ε_fidelity).
    pub fidelity: f64,
    /// Minimum cosine between a face and the adjacent face of the patch (ε_detail).
    pub detail: f64,
    /// Minimum cosine between a face of a tiny patch and the patch that absorbs it. Values above 1 disable
    /// absorption.
    pub noise: f64,
    /// Maximum two-sided distance between both surfaces, in mesh units.
    pub max_distance: f64,
    /// Maximum colour difference between a point and its counterpart, in levels; infinite for no limit.
    pub max_color: f64,
    pub threads: usize,
}

/// Patch with its plane and the residuals of its fit.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    pub seed: u32,
    pub faces: u32,
    /// Area of its input triangles.
    pub area: f64,
    pub normal: Vec3,
    /// Point on its plane.
    pub origin: Vec3,
    /// Minimum and maximum signed height of its vertices over that plane.
    pub heights: [f64; 2],
    /// Maximum difference between a vertex colour and the linear colour function.
    pub residual: f64,
    /// Norm of the colour gradient, in levels per mesh unit.
    pub gradient: f64,
}

impl Patch {
    /// Distance between the two parallel planes that enclose all its vertices.
    pub fn thickness(&self) -> f64 {
        self.heights[1] - self.heights[0]
    }
}

/// Patches of a mesh, largest area first.
#[derive(Clone, Debug)]
pub struct Patches {
    pub patches: Vec<Patch>,
    /// Patch of each triangle.
    pub patch_of_triangle: Vec<u32>,
    /// Number of faces visited during growth, as a measure of cost.
    pub visited_faces: u64,
}

/// Check whether a halfedge is on the border of its patch.
#[inline]
pub fn is_border(connectivity: &Connectivity, of: &[u32], h: HalfedgeId) -> bool {
    let twin = connectivity.twin(h);
    twin.is_none() || of[Connectivity::triangle(twin).index()] != of[Connectivity::triangle(h).index()]
}

/// Simplified mesh.
#[derive(Clone, Debug)]
pub struct PlanarMesh {
    pub triangles: Vec<[u32; 3]>,
    /// Input vertex of each vertex, ascending. Positions and attributes are unchanged.
    pub vertex_source: Vec<u32>,
    /// For each triangle, an input triangle of the same patch at its first corner.
    pub triangle_source: Vec<u32>,
    pub triangle_patch: Vec<u32>,
    pub patches: Patches,
    /// Upper bounds of the deviation in each patch: distance and colour difference.
    pub bounds: Vec<[f64; 2]>,
    /// True for patches that kept all their triangles.
    pub keeps_triangles: Vec<bool>,
    /// Number of input edges between two patches, by the reason that separates them
    /// ([`super::separation_reasons::REASONS`]).
    pub separation_counts: [u64; 4],
    pub rounds: usize,
}

/// Unit normal and area of a triangle; the normal of a degenerate triangle is zero.
pub type Facet = (Vec3, f64);

/// Compute the normal and area of each triangle.
pub fn compute_facets<const D: usize>(mesh: &Mesh<D>, threads: usize) -> Vec<Facet> {
    collect(mesh.connectivity.triangle_slots(), threads, |t| {
        let [a, b, c] = mesh.triangle_points(TriangleId::from_index(t)).map(|p| position_of(&p));
        let normal = cross(&sub(&b, &a), &sub(&c, &a));
        let twice = norm2(&normal).sqrt();
        let inverse = if twice > 0.0 { 1.0 / twice } else { 0.0 };
        (normal.map(|x| x * inverse), 0.5 * twice)
    })
}
