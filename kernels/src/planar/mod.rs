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
//! | [`simplify`](simplify()) | the loop |
//! | [`patches`] | what patches are, and what limits them |
//! | [`fit`] | the plane of a patch and the linear function of its colours |
//! | [`propagate`] | the patches of a mesh, from the flattest triangles first |
//! | [`ground`] | what patches grow on, and which neighbours are alike |
//! | [`claims`] | whose each triangle is while patches grow |
//! | [`growth`] | one patch, layer by layer |
//! | [`ahead`] | growing all of them, several at the same time |
//! | [`absorb`] | what is left over joins its neighbours |
//! | [`overlap`] | patches that lie over themselves |
//! | [`border`] | their borders as loops of halfedges; which vertices are corners |
//! | [`straighten`] | the vertices a border can do without |
//! | [`polygon`] | what is left of a patch's loops, seen along its normal |
//! | [`retriangulate`] | triangles for a polygon with holes |
//! | [`assemble`] | all patches together, until the result is a manifold |
//! | [`assembly`] | which vertices stay, and what each patch has become |
//! | [`attempt`] | one patch of them: new triangles, or what has to come back first |
//! | [`conflicts`] | what makes them no manifold although each is sound |
//! | [`reasons`] | what keeps patches apart |

mod absorb;
mod ahead;
pub mod assemble;
mod assembly;
mod attempt;
pub mod border;
mod claims;
mod conflicts;
pub mod fit;
mod ground;
mod growth;
pub mod overlap;
pub mod patches;
pub mod polygon;
pub mod propagate;
pub mod reasons;
pub mod retriangulate;
mod simplify;
pub mod straighten;

pub use patches::{Facet, Options, Patch, Patches, Planar, facets, is_border};
pub use simplify::simplify;
