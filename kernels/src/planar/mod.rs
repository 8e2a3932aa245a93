//! Simplification by near-planar patches (Chen and Qin, "3-D surface reduction new algorithm").
//!
//! Patches grow over the surface while it stays flat. Their borders are straightened once for both
//! neighbours, and their interiors are retriangulated.
//!
//! The paper only bounds normals. Here, each patch also stays between two parallel planes, and borders stay
//! within a distance of their chords. Together these limits bound the distance. Let `w` be the distance of
//! the planes, and `t` the distance of the border from its chords. Then both surfaces are within `sqrt(w² +
//! t²)` of each other at every point. In the projection along the patch normal, a point usually has a
//! counterpart on the other surface. Otherwise it is between a chord and its border, at most `t` from both.
//! Colours are bounded likewise. If all vertex colours are within `r` of a linear function with gradient `g`,
//! the counterpart's colour differs by at most `2r + gt`.
//!
//! | module | content |
//! | --- | --- |
//! | [`simplify`](simplify()) | main loop |
//! | [`patches`] | patches, options and result |
//! | [`fit`] | plane and linear colour function of a patch |
//! | [`propagate`] | patches of a mesh, grown from the flattest triangles first |
//! | [`ground`] | shared context and criteria of growth |
//! | [`claims`] | ownership of triangles while patches grow |
//! | [`growth`] | growth of one patch, layer by layer |
//! | [`ahead`] | speculative parallel growth of all patches |
//! | [`absorb`] | absorption of tiny patches by their neighbours |
//! | [`overlap`] | detection of patches that overlap themselves |
//! | [`border`] | borders as loops of halfedges; border edges per vertex |
//! | [`straighten`] | straightening of borders |
//! | [`polygon`] | straightened loops of a patch, projected along its normal |
//! | [`retriangulate`] | triangulation of a polygon with holes |
//! | [`assemble`] | assembly of all patches to a manifold mesh |
//! | [`assembly`] | state of the assembly |
//! | [`attempt`] | triangulation of one patch, or the vertices to restore first |
//! | [`conflicts`] | conflicts between patches that make the result non-manifold |
//! | [`reasons`] | reasons why adjacent patches stay separate |

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
