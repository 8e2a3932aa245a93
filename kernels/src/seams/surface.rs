//! What comes in.

use crate::base::geometry::Vec3;

/// A surface as a file gives it.
#[derive(Clone, Debug)]
pub struct Surface<const K: usize> {
    pub points: Vec<Vec3>,
    /// The set of geometrically similar vertices each vertex belongs to; members of a set have equal points.
    pub sets: Vec<u32>,
    pub triangles: Vec<[u32; 3]>,
    /// Attributes of the three corners of each triangle, as lengths. Where triangles are `textured`, the first two
    /// are the texture coordinate.
    pub corners: Vec<[f64; K]>,
    pub textured: Vec<bool>,
    pub materials: Vec<i32>,
    pub parts: Vec<i32>,
    /// Factor of the error around each triangle; empty for 1.
    pub importance: Vec<f64>,
    /// Vertices that stay where they are.
    pub locked: Vec<bool>,
}
