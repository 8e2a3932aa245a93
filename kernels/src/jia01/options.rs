//! What a user can set.

/// One value each for edge length (in the unit of the mesh), shape change (same) and texture change (levels).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    pub length: f64,
    pub shape: f64,
    pub texture: f64,
}

impl Limits {
    pub const NONE: Self = Self { length: f64::INFINITY, shape: f64::INFINITY, texture: f64::INFINITY };
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// L, S_max and T_max as bounds; infinite for none. Edges are split only for a finite length.
    pub bounds: Limits,
    /// L, S_max and T_max in the order (7): finite and positive, also where there is no bound.
    pub scales: Limits,
    /// Length that counts as much as one level of an attribute in the placement (4)–(6).
    pub attribute_scale: f64,
    /// As in the paper: check the sums after a collapse instead of before, and look at vertices only.
    pub paper_rule: bool,
    /// Refuse to split beyond this.
    pub triangle_limit: usize,
}
