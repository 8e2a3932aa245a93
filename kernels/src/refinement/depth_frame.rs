//! Depth map of a frame with its camera and noise.

use crate::fusion::frame_view::{DepthNoiseModel, FusionCamera};

/// Depth map of one frame.
#[derive(Clone, Copy, Debug)]
pub struct DepthFrame<'a> {
    pub camera: &'a FusionCamera,
    /// Depth in metres row by row, not positive where missing.
    pub depth: &'a [f32],
    pub noise: DepthNoiseModel,
}
