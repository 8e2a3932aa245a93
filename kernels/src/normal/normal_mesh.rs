//! A base mesh, its levels, and the file that they are read from.

use super::level::Level;
use super::predict::Predicted;
use super::tolerance::Tolerance;
use crate::subdivision::contents::{Header, Refinement};

/// How a level was made of the one before.
#[derive(Clone, Debug)]
pub struct Step {
    pub predicted: Predicted,
    pub refinement: Refinement,
}

/// What only the encoder knows.
#[derive(Clone, Debug)]
pub struct Origin {
    pub base_source: Vec<u32>,
    /// The triangle of the input that each vertex of the finest level lies on; coarser levels have the first of them.
    pub triangles: Vec<u32>,
    /// Triangles of each level that look away from the surface or are needles.
    pub unsound: Vec<usize>,
    /// Largest distance of each level from the input, if that was asked for.
    pub reached: Vec<f64>,
    pub tolerance: Tolerance,
}

#[derive(Clone, Debug)]
pub struct NormalMesh {
    pub header: Header,
    pub levels: Vec<Level>,
    /// One less.
    pub steps: Vec<Step>,
    pub file: Vec<u8>,
    /// Bytes of the file up to the end of each level.
    pub ends: Vec<usize>,
    /// None after decoding.
    pub origin: Option<Origin>,
}

impl NormalMesh {
    /// Triangles of all levels that are not sound, as far as that is known.
    pub fn unsound(&self) -> usize {
        self.origin.as_ref().map_or(0, |origin| origin.unsound.iter().sum())
    }
}
