//! Simplification by near-planar patches (Chen and Qin, "3-D surface reduction new algorithm"): patches grow over the
//! surface while it stays flat, their borders are straightened once for both neighbours, and what is within is
//! triangulated anew.
//!
//! The paper bounds normals only. Here each patch also stays between two parallel planes, and a border may leave its
//! chord only so far; together they bound the distance. With `w` the distance of the planes and `t` that of the
//! border from its chords, both surfaces are within `sqrt(w² + t²)` of each other, for every point: seen along the
//! patch's normal, a point has a counterpart in the other surface, or lies between a chord and its border, at most
//! `t` from both. Likewise for colour: within `r` of a linear function on all vertices of the patch, with a gradient
//! `g`, the counterpart's colour differs by `2r + gt` at most.
//!
//! | module | what |
//! | --- | --- |
//! | [`fit`] | the plane of a patch and the linear function of its colours |
//! | [`propagate`] | growing patches |
//! | [`overlap`] | patches that lie over themselves |
//! | [`border`] | their borders as loops of halfedges; which vertices are corners |
//! | [`straighten`] | the vertices a border can do without |
//! | [`polygon`] | what is left of a patch's loops, seen along its normal |
//! | [`retriangulate`] | triangles for a polygon with holes |
//! | [`assemble`] | all patches together, until the result is a manifold |
//! | [`reasons`] | what keeps patches apart |

pub mod assemble;
pub mod border;
pub mod fit;
pub mod overlap;
pub mod polygon;
pub mod propagate;
pub mod reasons;
pub mod retriangulate;
pub mod straighten;

use assemble::{Assembled, Known};

use crate::connectivity::Connectivity;
use crate::error::KernelError;
use crate::geometry::Vec3;
use crate::ids::{HalfedgeId, TriangleId};
use crate::mesh::Mesh;
use crate::progress::Progress;

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
    /// Edges of the input between two patches, by what keeps these apart ([`reasons::REASONS`]).
    pub refused: [u64; 4],
    pub rounds: usize,
}

/// Simplify a mesh. Triangles around pinned vertices stay as they are.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn simplify<const D: usize, const K: usize>(
    mesh: &Mesh<D>,
    options: &Options,
    progress: &mut Progress,
) -> Result<Planar, KernelError> {
    let facets = facets(mesh, options.threads);
    let mut patches = propagate::propagate::<D, K>(mesh, &facets, options, progress)?;
    let mut known = None;
    loop {
        match assemble::assemble(mesh, patches, options, known, progress)? {
            Assembled::Whole(planar) => return Ok(*planar),
            Assembled::Folded { patches: found, is_folded, first } => {
                let was;
                (patches, was) =
                    propagate::separate::<D, K>(mesh, &facets, &found, &is_folded, options, progress)?;
                known = Some(Known { was, first });
            }
        }
    }
}

/// Unit normal and area of a triangle; one without area has the normal 0.
pub type Facet = (Vec3, f64);

/// Of each triangle.
pub fn facets<const D: usize>(mesh: &Mesh<D>, threads: usize) -> Vec<Facet> {
    use crate::geometry::{cross, norm2, position, sub};
    let mut facets = vec![([0.0; 3], 0.0); mesh.connectivity.triangle_slots()];
    crate::parallel::fill(&mut facets, threads, |t| {
        let [a, b, c] = mesh.triangle_points(TriangleId::from_index(t)).map(|p| position(&p));
        let normal = cross(&sub(&b, &a), &sub(&c, &a));
        let twice = norm2(&normal).sqrt();
        let inverse = if twice > 0.0 { 1.0 / twice } else { 0.0 };
        (normal.map(|x| x * inverse), 0.5 * twice)
    });
    facets
}
