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
//! | [`segmentation`] | patches of a mesh, grown from the flattest triangles first |
//! | [`growth_context`] | shared context and criteria of growth |
//! | [`claims`] | ownership of triangles while patches grow |
//! | [`patch_growth`] | growth of one patch, layer by layer |
//! | [`speculative_growth`] | speculative parallel growth of all patches |
//! | [`absorption`] | absorption of tiny patches by their neighbours |
//! | [`overlap`] | detection of patches that overlap themselves |
//! | [`border`] | borders as loops of halfedges; border edges per vertex |
//! | [`border_straightening`] | straightening of borders |
//! | [`polygon`] | straightened loops of a patch, projected along its normal |
//! | [`polygon_triangulation`] | triangulation of a polygon with holes |
//! | [`assembly_loop`] | assembly of all patches to a manifold mesh |
//! | [`assembly_state`] | state of the assembly |
//! | [`patch_triangulation`] | triangulation of one patch, or the vertices to restore first |
//! | [`conflicts`] | conflicts between patches that make the result non-manifold |
//! | [`separation_reasons`] | reasons why adjacent patches stay separate |

mod absorption;
pub mod assembly_loop;
mod assembly_state;
pub mod border;
pub mod border_straightening;
mod claims;
mod conflicts;
pub mod fit;
mod growth_context;
pub mod overlap;
mod patch_growth;
mod patch_triangulation;
pub mod patches;
pub mod polygon;
pub mod polygon_triangulation;
pub mod segmentation;
pub mod separation_reasons;
mod simplify;
mod speculative_growth;

pub use patches::{Facet, Options, Patch, Patches, PlanarMesh, compute_facets, is_border};
pub use simplify::simplify;
