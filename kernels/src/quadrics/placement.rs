//! Where the vertex goes that an edge becomes, and which of the edges that cost nothing goes first.

use crate::base::geometry::{Vec3, distance2, midpoint};
use crate::quadrics::quadric::Quadric;

/// Strength of the spring that holds a vertex at the middle of its edge where the error does not: on a plane.
const TETHER: f64 = 1e-9;

/// The same for the choice among edges that cost nothing: shorter ones go first.
const SHORTER_FIRST: f64 = 1e-10;

/// The place of least error for the vertex that the edge between two ends becomes, and the error there.
#[inline]
pub fn best_place<const K: usize>(together: &Quadric<K>, ends: [&Vec3; 2]) -> (Vec3, f64) {
    together.minimum(&midpoint(ends[0], ends[1]), TETHER)
}

/// What an edge costs for its length alone, which tells those apart that cost nothing else; `area` is that of the quadrics
/// of its ends.
#[inline]
pub fn shorter_first(area: f64, ends: [&Vec3; 2]) -> f64 {
    SHORTER_FIRST * area * distance2(ends[0], ends[1])
}
