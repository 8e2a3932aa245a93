//! What an `.snm` file holds: whole numbers, and the few real ones they are multiples of.

/// How positions of new vertices are predicted.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Scheme {
    /// The middle of the edge.
    #[default]
    Linear,
    /// Modified butterfly (Zorin, Schröder and Sweldens 1996).
    Butterfly,
}

/// What all levels share.
#[derive(Clone, Copy, PartialEq, Debug, Default)]
pub struct Header {
    pub scheme: Scheme,
    /// Turns of the tangential Laplacian on predicted vertices.
    pub relaxations: u8,
    /// What is added to positions of the base mesh, in spacings of the grid. Needed only where the mesh is so
    /// far from the origin that 32 bits do not hold its positions; 0 takes no room.
    pub origin: [i64; 3],
    /// Spacing of the grid for base vertices and vectors. This and the numbers below are positive, and take
    /// as many bits as their mantissas need: round numbers are short.
    pub grid: f32,
    /// One unit of a scalar offset at the finest level, and the factor from a level to the next coarser one.
    pub step: f32,
    pub step_ratio: f32,
    /// Channels a vertex carries, 0 to 4, and one unit of each.
    pub channels: u8,
    pub units: [f32; 4],
    /// Refinements the file was made with.
    pub levels: u8,
    /// What is up, of length 1, where that is known.
    pub up: Option<[f64; 3]>,
}

/// The base mesh, numbered in the order of its coder.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Base {
    pub positions: Vec<[i32; 3]>,
    pub triangles: Vec<[u32; 3]>,
    /// Per vertex: `channels` values.
    pub channels: Vec<[i32; 4]>,
}

/// Where a new vertex is, from where it was predicted.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Offset {
    /// Along the normal, in steps.
    Scalar(i32),
    /// The same from the point as it was before relaxation.
    Unrelaxed(i32),
    /// Along normal, tangent and the third axis, in grid units.
    Vector([i32; 3]),
}

/// One refinement: an offset for every edge of the level before, in the order of its edges. Vertices on the
/// boundary always have vectors.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Refinement {
    pub offsets: Vec<Offset>,
    /// What the channels of each new vertex differ by from their prediction, in units.
    pub channels: Vec<[i32; 4]>,
}
