//! Settings of a normal mesh.

use super::coarsening::Target;
use crate::subdivision::snm_contents::Scheme;

/// Settings of [`remesh`](super::remesh::remesh).
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Maximum number of levels. None derives it: the finest level gets about as many triangles as the input.
    /// With `max_error`, at most four levels are built until the error is reached.
    pub levels: Option<u8>,
    pub target: Target,
    /// Stop at the first level whose maximum distance from the input is at most this, in mesh units. 0
    /// disables the check.
    pub max_error: f64,
    pub scheme: Scheme,
    pub relaxations: u8,
    /// Maximum quantisation error of a vertex, in diagonals of the bounding box. None derives it from the
    /// mesh.
    pub tolerance: Option<f64>,
    /// Maximum quantisation error of a colour, in 8-bit levels.
    pub color_tolerance: f64,
    /// Unit up direction of the mesh, if known. It is stored in the file without any other effect.
    pub up: Option<[f64; 3]>,
    pub threads: usize,
}

impl Settings {
    /// True if no levels follow the base.
    pub fn is_base_only(&self) -> bool {
        self.levels == Some(0)
    }
}
