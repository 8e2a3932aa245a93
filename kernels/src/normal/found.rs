//! New vertex of a level with its position on the input.

use super::surface::Place;
use crate::base::geometry::Vec3;
use crate::subdivision::contents::Offset;

/// New vertex of a level.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    pub offset: Offset,
    pub point: Vec3,
    pub place: Place,
    /// Arc length along the chain, for boundary vertices only.
    pub along: f64,
}
