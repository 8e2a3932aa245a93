//! Simplification of surfaces with duplicated vertices, along texture seams and between materials and parts.
//!
//! Feng, Ni and Luo, "Improved surface simplification with multi-attributes", 2012. A file duplicates a
//! vertex that has two texture coordinates, and collapses that ignore the copies tear the surface open. Here
//! the copies are one vertex of the connectivity ([`welding`]) with several *wedges* (Hoppe 1999): runs of
//! corners with equal attributes ([`wedges`]). All copies therefore move together, and a seam edge collapses
//! on both sides in one step. Of the two quadrics in the paper, the shape quadric belongs to the vertex and
//! covers the triangles of all its copies. The quadric of shape and attributes belongs to the wedge
//! ([`measure`]).
//!
//! The constraints on the texture are stricter than in the paper ([`texture_space`]): no triangle folds in the
//! texture, a seam stays within a drift bound, and a texture coordinate never leaves its chart.

mod chunked_list;
mod collapse_planning;
mod measure;
mod merge_plan;
pub mod progressive_record;
mod quadrics;
pub mod region_state;
mod simplify;
mod surface;
pub mod surface_state;
mod texture_legality;
pub mod texture_space;
pub mod wedges;
pub mod welding;

pub use region_state::CostParameters;
pub use simplify::{SeamGoal, SeamRefusals, SimplifiedSurface, simplify, simplify_with};
pub use surface::SeamSurface;
