//! A new vertex, and where it was found.

use super::surface::Place;
use crate::base::geometry::Vec3;
use crate::subdivision::contents::Offset;

/// A new vertex.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    pub offset: Offset,
    pub point: Vec3,
    pub place: Place,
    /// How far along its chain, of a vertex on the boundary.
    pub along: f64,
}
