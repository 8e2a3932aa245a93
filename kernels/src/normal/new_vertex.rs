//! New vertex of a level with its position on the input.

use super::surface::SurfacePoint;
use crate::base::geometry::Vec3;
use crate::subdivision::snm_contents::Offset;

/// New vertex of a level.
#[derive(Clone, Copy, Debug)]
pub struct NewVertex {
    pub offset: Offset,
    pub point: Vec3,
    pub surface_point: SurfacePoint,
    /// Arc length along the chain, for boundary vertices only.
    pub arc_length: f64,
}
