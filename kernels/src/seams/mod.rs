//! Simplification of surfaces whose vertices are doubled: along texture seams, between materials and parts.
//!
//! Feng, Ni and Luo, "Improved surface simplification with multi-attributes", 2012. A file doubles a vertex that has
//! two texture coordinates; collapses that know nothing of its copies tear the surface open. Here the copies are
//! one vertex of the connectivity ([`weld`]) with several *wedges* (Hoppe 1999): runs of corners around it with equal
//! attributes ([`wedges`]). So all copies move together, and an edge that runs along a seam collapses on both
//! sides in one step, because it is one edge. Of the two quadrics of the paper, that of the shape belongs to
//! the vertex and takes in the triangles of all its copies; that of shape and attributes belongs to the wedge
//! ([`measure`]).
//!
//! The texture is held to more than the paper asks ([`texture`]): no triangle turns over in the image, a seam keeps its
//! image within a bound, and a texture coordinate never leaves the chart it came from.

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
