//! What a normal mesh is made with.

use super::coarsening::Target;
use crate::subdivision::contents::Scheme;

#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// At most. If not given, so many that the finest has about as many triangles as the input, or four if `max_error`
    /// says how many.
    pub levels: Option<u8>,
    pub target: Target,
    /// Stop at the first level that is nowhere farther from the input; 0 not to stop.
    pub max_error: f64,
    pub scheme: Scheme,
    pub relaxations: u8,
    /// How far quantisation may take a vertex from the surface, in diagonals of the bounding box. If not given, it follows
    /// from the mesh.
    pub tolerance: Option<f64>,
    /// How far it may take a level of colour.
    pub color_tolerance: f64,
    /// What is up in the mesh, of length 1, where that is known: kept in the file, and of no effect.
    pub up: Option<[f64; 3]>,
    pub threads: usize,
}

impl Settings {
    /// Whether the base is all there is.
    pub fn is_alone(&self) -> bool {
        self.levels == Some(0)
    }
}
