//! Folds: triangles of a level that are flipped or needles.

use crate::base::geometry::Vec3;

/// A flipped triangle or needle at some level.
#[derive(Clone, Copy, Debug)]
pub struct Fold {
    /// Index of the ancestor triangle: on the coarser level during refinement, on the base afterwards.
    pub triangle: usize,
    pub middle: Vec3,
}
