//! A triangle that is not sound.

use crate::base::geometry::Vec3;

/// A triangle of some level that is turned over or a needle.
#[derive(Clone, Copy, Debug)]
pub struct Fold {
    /// The base triangle, or that of the level before, that it is or is a part of.
    pub triangle: usize,
    pub middle: Vec3,
}
