//! Position of the vertex that replaces an edge, and the order of edges with zero cost.

use crate::base::geometry::{Vec3, distance2, midpoint};
use crate::quadrics::quadric::Quadric;

/// Strength of the spring to the middle of the edge, which determines the position where the error is
/// constant, as along a plane.
const TETHER_STRENGTH: f64 = 1e-9;

/// Factor of the length term that orders edges with zero cost.
const LENGTH_COST_FACTOR: f64 = 1e-10;

/// Find the position of minimum error for the vertex that replaces an edge; also returns the error.
#[inline]
pub fn best_position<const K: usize>(together: &Quadric<K>, ends: [&Vec3; 2]) -> (Vec3, f64) {
    together.minimum(&midpoint(ends[0], ends[1]), TETHER_STRENGTH)
}

/// Compute the cost of the length of an edge, which orders edges without other cost.
///
/// `area` is the area of the quadrics of both ends.
#[inline]
pub fn length_cost(area: f64, ends: [&Vec3; 2]) -> f64 {
    LENGTH_COST_FACTOR * area * distance2(ends[0], ends[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three triangles in the planes x = 1, y = 2 and z = 3.
    #[test]
    fn the_best_place_is_where_the_planes_meet() {
        let mut together = Quadric::<0>::default();
        for axis in 0..3 {
            let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
            let corner = |along: f64, across: f64| {
                let mut p = [1.0, 2.0, 3.0];
                p[next] += along;
                p[last] += across;
                p
            };
            let corners = [corner(5.0, 5.0), corner(6.0, 5.0), corner(5.0, 7.0)];
            together.add(&Quadric::of_triangle(corners.each_ref(), 1.0));
        }
        let (place, error) = best_position(&together, [&[0.0, 0.0, 0.0], &[1.0, 1.0, 2.0]]);
        assert!(distance2(&place, &[1.0, 2.0, 3.0]) < 1e-12, "{place:?}");
        assert!(error < 1e-6, "{error}");
    }

    #[test]
    fn on_a_plane_the_best_place_is_above_the_middle() {
        let corners = [[0.0, 0.0, 1.0], [4.0, 0.0, 1.0], [0.0, 4.0, 1.0]];
        let plane = Quadric::<0>::of_triangle(corners.each_ref(), 1.0);
        let (place, _) = best_position(&plane, [&[8.0, 1.0, 0.0], &[10.0, 3.0, 0.0]]);
        assert!(distance2(&place, &[9.0, 2.0, 1.0]) < 1e-12, "{place:?}");
    }

    #[test]
    fn shorter_edge_without_cost_goes_first() {
        let from = [0.0; 3];
        assert!(length_cost(2.0, [&from, &[1.0, 0.0, 0.0]]) < length_cost(2.0, [&from, &[0.0, 1.1, 0.0]]));
    }
}
