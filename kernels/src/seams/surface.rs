//! Input surface with attributes per corner.

use crate::base::geometry::Vec3;

/// A surface as stored in a file.
#[derive(Clone, Debug)]
pub struct SeamSurface<const K: usize> {
    pub points: Vec<Vec3>,
    /// By vertex: set of coincident vertices; all members have equal points.
    pub coincident_sets: Vec<u32>,
    pub triangles: Vec<[u32; 3]>,
    /// Attributes of the three corners of each triangle, as lengths. If a triangle is `textured`, the first
    /// two are the texture coordinate.
    pub corners: Vec<[f64; K]>,
    pub textured: Vec<bool>,
    pub materials: Vec<i32>,
    pub parts: Vec<i32>,
    /// Factor on the error, by triangle; empty for 1.
    pub importance: Vec<f64>,
    /// Vertices that must not move.
    pub locked: Vec<bool>,
}
