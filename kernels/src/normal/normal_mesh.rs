//! Base mesh, its levels, and the file that encodes them.

use super::level::Level;
use super::prediction::PredictedVertices;
use super::tolerance::Tolerance;
use crate::subdivision::snm_contents::{Header, Refinement};

/// Refinement from one level to the next.
#[derive(Clone, Debug)]
pub struct RefinementStep {
    pub predicted: PredictedVertices,
    pub refinement: Refinement,
}

/// Encoder-only information.
#[derive(Clone, Debug)]
pub struct EncoderInfo {
    pub base_source: Vec<u32>,
    /// Input triangle under each vertex of the finest level. Coarser levels use a prefix of this list.
    pub vertex_triangles: Vec<u32>,
    /// Number of folds (flipped triangles and needles) on each level.
    pub fold_counts: Vec<usize>,
    /// Maximum distance of each level from the input, in mesh units; empty if no `max_error` was given.
    pub max_distances: Vec<f64>,
    pub tolerance: Tolerance,
}

/// Normal mesh with all its levels, and the encoded file.
#[derive(Clone, Debug)]
pub struct NormalMesh {
    pub header: Header,
    pub levels: Vec<Level>,
    /// One refinement fewer than levels.
    pub steps: Vec<RefinementStep>,
    pub file: Vec<u8>,
    /// End of each level in the file, in bytes.
    pub ends: Vec<usize>,
    /// None after decoding.
    pub encoder_info: Option<EncoderInfo>,
}

impl NormalMesh {
    /// Number of folds on all levels; 0 after decoding, where it is unknown.
    pub fn fold_count(&self) -> usize {
        self.encoder_info.as_ref().map_or(0, |origin| origin.fold_counts.iter().sum())
    }
}
