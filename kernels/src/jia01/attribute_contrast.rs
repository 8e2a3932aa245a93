//! Attribute difference between neighbours: T(e), also for the mesh before any collapse.

use crate::mesh::edge_star::EdgeStar;

/// Compute the squared attribute difference of two vertices.
#[inline]
fn squared_contrast<const D: usize>(a: &[f64; D], b: &[f64; D]) -> f64 {
    (3..D).map(|i| (a[i] - b[i]) * (a[i] - b[i])).sum()
}

/// Compute T(e) (3): the largest attribute difference along any edge of the star.
#[inline]
pub fn texture_change<const D: usize>(star: &EdgeStar<D>) -> f64 {
    let [first, second] = &star.end_points;
    let mut largest2 = squared_contrast(first, second);
    for wing in &star.remaining {
        let end = star.end_point(wing.end);
        largest2 = largest2
            .max(squared_contrast(end, &wing.from_point))
            .max(squared_contrast(end, &wing.to_point))
            .max(squared_contrast(&wing.from_point, &wing.to_point));
    }
    // An end may have no wing next to a vanishing triangle.
    for (_, _, apex) in &star.vanishing {
        largest2 = largest2.max(squared_contrast(first, apex)).max(squared_contrast(second, apex));
    }
    largest2.sqrt()
}

/// Compute the largest attribute difference along the edges of each vertex's star.
///
/// On the initial mesh, T(e) is the maximum of both ends, because their stars together are the star of the
/// edge.
pub fn compute_vertex_contrast<const D: usize>(
    points: &[[f64; D]],
    triangles: impl Iterator<Item = [u32; 3]>,
) -> Vec<f64> {
    let mut around = vec![0f64; points.len()];
    for corners in triangles {
        let [a, b, c] = corners.map(|v| &points[v as usize]);
        let largest2 = squared_contrast(a, b).max(squared_contrast(b, c)).max(squared_contrast(c, a));
        for v in corners {
            around[v as usize] = around[v as usize].max(largest2);
        }
    }
    around.iter_mut().for_each(|contrast| *contrast = contrast.sqrt());
    around
}
