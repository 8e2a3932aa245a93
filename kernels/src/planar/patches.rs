//! What patches are, and what limits them.

use crate::base::geometry::{Vec3, cross, norm2, position, sub};
use crate::base::ids::{HalfedgeId, TriangleId};
use crate::base::parallel::collect;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::Mesh;

/// What limits the patches. Angles are given as least cosines: the paper's ε is 1 − cosine.
#[derive(Clone, Debug)]
pub struct Options {
    /// What triangles of the input must have in common to be in one patch; empty for nothing.
    pub labels: Vec<u32>,
    /// Between the normals of a face and of the patch it joins (ε_fidelity).
    pub fidelity: f64,
    /// Between the normals of a face and of the one it is reached from (ε_detail).
    pub detail: f64,
    /// Between the normals of a loose face and of the patch that takes it in; none is taken in above 1.
    pub noise: f64,
    /// Largest distance of any point of either surface from the other.
    pub max_distance: f64,
    /// Largest difference of colour between a point and its counterpart; infinite for none.
    pub max_color: f64,
    pub threads: usize,
}

/// A patch: its plane, and how well it suits it.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    pub seed: u32,
    pub faces: u32,
    /// Of its triangles in the input.
    pub area: f64,
    pub normal: Vec3,
    /// A point of its plane.
    pub origin: Vec3,
    /// Of its lowest and its highest vertex above that plane.
    pub heights: [f64; 2],
    /// Largest distance of a vertex' colour from the linear function.
    pub residual: f64,
    /// Norm of that function's gradient, levels per unit of length.
    pub gradient: f64,
}

impl Patch {
    /// Distance of the two planes parallel to its own that hold all its vertices between them.
    pub fn thickness(&self) -> f64 {
        self.heights[1] - self.heights[0]
    }
}

/// The patches of a mesh, largest area first.
#[derive(Clone, Debug)]
pub struct Patches {
    pub patches: Vec<Patch>,
    /// The patch of each triangle of the connectivity.
    pub of: Vec<u32>,
    /// Faces looked at while the patches grew, for the cost.
    pub looks: u64,
}

/// Whether the patch of a halfedge's triangle ends at it.
#[inline]
pub fn is_border(connectivity: &Connectivity, of: &[u32], h: HalfedgeId) -> bool {
    let twin = connectivity.twin(h);
    twin.is_none() || of[Connectivity::triangle(twin).index()] != of[Connectivity::triangle(h).index()]
}

/// The simplified mesh.
#[derive(Clone, Debug)]
pub struct Planar {
    pub triangles: Vec<[u32; 3]>,
    /// Input vertex of each vertex, ascending; nothing else moved or changed.
    pub vertex_source: Vec<u32>,
    /// A triangle of the input in the same patch, at the first corner.
    pub triangle_source: Vec<u32>,
    pub triangle_patch: Vec<u32>,
    pub patches: Patches,
    /// For each patch how far the surfaces are apart at most there, in shape and in colour.
    pub bounds: Vec<[f64; 2]>,
    /// Patches that kept all their triangles.
    pub kept: Vec<bool>,
    /// Edges of the input between two patches, by what keeps these apart ([`super::reasons::REASONS`]).
    pub refused: [u64; 4],
    pub rounds: usize,
}

/// Unit normal and area of a triangle; one without area has the normal 0.
pub type Facet = (Vec3, f64);

/// Of each triangle.
pub fn facets<const D: usize>(mesh: &Mesh<D>, threads: usize) -> Vec<Facet> {
    collect(mesh.connectivity.triangle_slots(), threads, |t| {
        let [a, b, c] = mesh.triangle_points(TriangleId::from_index(t)).map(|p| position(&p));
        let normal = cross(&sub(&b, &a), &sub(&c, &a));
        let twice = norm2(&normal).sqrt();
        let inverse = if twice > 0.0 { 1.0 / twice } else { 0.0 };
        (normal.map(|x| x * inverse), 0.5 * twice)
    })
}
