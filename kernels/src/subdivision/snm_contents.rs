//! Contents of an `.snm` file: integers, and the few real units that scale them.

/// Prediction of new vertices.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Scheme {
    /// Edge midpoint.
    #[default]
    Linear,
    /// Modified butterfly (Zorin, Schröder and Sweldens 1996).
    Butterfly,
}

/// Parameters that all levels share.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Header {
    pub scheme: Scheme,
    /// Tangential Laplacian steps applied to predicted vertices.
    pub relaxations: u8,
    /// Offset of base mesh positions, in grid spacings. Needed only for meshes so far from the origin that
    /// positions exceed 32 bits; zeros hardly take space.
    pub origin: [i64; 3],
    /// Grid spacing of base vertices and vectors. This and the numbers below are positive and stored without
    /// trailing mantissa bits, so round numbers are short.
    pub grid: f32,
    /// Step of scalar offsets at the finest level, and the factor from a level to the next coarser one.
    pub step: f32,
    pub step_ratio: f32,
    /// Number of channels per vertex, 0 to 4, and the unit of each channel.
    pub channels: u8,
    pub units: [f32; 4],
    /// Number of refinements that the complete file has.
    pub levels: u8,
    /// Unit up direction, if known.
    pub up: Option<[f64; 3]>,
}

/// Base mesh, numbered in coder order.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct BaseContents {
    pub positions: Vec<[i32; 3]>,
    pub triangles: Vec<[u32; 3]>,
    /// Channels of each vertex in units; only the first `Header::channels` values are used. Empty without
    /// channels.
    pub channels: Vec<[i32; 4]>,
}

/// Displacement of a new vertex from its prediction.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Offset {
    /// Along the normal, in steps.
    Scalar(i32),
    /// Along the normal from the unrelaxed point, in steps.
    Unrelaxed(i32),
    /// Along normal, tangent and third axis, in grid spacings.
    Vector([i32; 3]),
}

/// One refinement: an offset per edge of the coarser level, in the order of its edges. Boundary vertices
/// always have vectors.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Refinement {
    pub offsets: Vec<Offset>,
    /// Residuals of the channels of each new vertex, in units.
    pub channels: Vec<[i32; 4]>,
}
