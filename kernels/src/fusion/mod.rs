//! Depth maps fused into a signed distance field, and the surface of it.

pub mod cubes;
pub mod field;
pub mod order;
pub mod surface;
