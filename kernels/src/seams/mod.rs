//! Simplification of surfaces with duplicated vertices, along texture seams and between materials and parts.
//!
//! Feng, Ni and Luo, "Improved surface simplification with multi-attributes", 2012. A file duplicates a
//! vertex that has two texture coordinates, and collapses that ignore the copies tear the surface open. Here
//! the copies are one vertex of the connectivity ([`weld`]) with several *wedges* (Hoppe 1999): runs of
//! corners with equal attributes ([`wedges`]). All copies therefore move together, and a seam edge collapses
//! on both sides in one step. Of the two quadrics in the paper, the shape quadric belongs to the vertex and
//! covers the triangles of all its copies. The quadric of shape and attributes belongs to the wedge
//! ([`measure`]).
//!
//! The constraints on the texture are stricter than in the paper ([`texture`]): no triangle folds in the
//! texture, a seam stays within a drift bound, and a texture coordinate never leaves its chart.

mod classes;
mod joined;
mod legal;
mod measure;
mod plan;
mod quadrics;
pub mod record;
pub mod records;
mod simplify;
pub mod state;
mod surface;
pub mod texture;
pub mod wedges;
pub mod weld;

pub use simplify::{Goal, Outcome, Refused, simplify, simplify_by};
pub use state::Knobs;
pub use surface::Surface;
