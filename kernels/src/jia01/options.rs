//! Parameters of JIA01.

/// Edge length and shape change (both in the unit of the mesh), and texture change (levels).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    pub length: f64,
    pub shape: f64,
    pub texture: f64,
}

impl Limits {
    pub const NONE: Self = Self { length: f64::INFINITY, shape: f64::INFINITY, texture: f64::INFINITY };
}

/// Parameters of JIA01.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Bounds L, S_max and T_max; infinite for none. Edges are split only if the length is finite.
    pub bounds: Limits,
    /// Scales of L, S_max and T_max in the order (7): finite and positive, even without a bound.
    pub scales: Limits,
    /// Long edges are split, but may collapse: beyond the length bound, their priority grows steeply with their
    /// length. For a triangle count, which a strict bound might not reach.
    pub soft_length: bool,
    /// Length that counts as much as one level of an attribute in the placement (4)–(6).
    pub attribute_scale: f64,
    /// Follow the paper: check the sums after a collapse instead of before, and only at vertices.
    pub paper_rule: bool,
    /// Maximum number of triangles after splitting.
    pub triangle_limit: usize,
}
