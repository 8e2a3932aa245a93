//! No folds: vertices move only as far as their triangles keep their side.
//!
//! Smoothing, planes and straight boundaries move vertices by a part of an edge's length, which folds thin
//! triangles over their neighbours. The corners of a folded triangle move more and more alike, so that it keeps
//! the shape that it had. What stays folded returns to where it was.

use crate::base::geometry::{Vec3, add_scaled, cross, dot, norm2, sub};
use crate::base::ids::{TriangleId, VertexId};
use crate::base::parallel::collect;
use crate::mesh::connectivity::Connectivity;

/// Passes in which the corners of folded triangles move alike, and further ones in which their moves are halved.
const ALIGNING_PASSES: usize = 16;
const HALVING_PASSES: usize = 24;

/// A move is halved up to this many times, then the vertex stays.
const MAX_HALVINGS: u8 = 4;

/// Change the moves of points until no triangle turns too far from its reference normal.
///
/// `from` are the positions before. `references` are directions of any length, one per triangle; a triangle
/// whose cosine with its own is smaller than `min_cosine` is folded. Where a triangle was folded before, its
/// vertices return to where they were. `limit` limits the position of a vertex.
pub fn undo_folds(
    connectivity: &Connectivity,
    from: &[Vec3],
    points: &mut [Vec3],
    references: &[Vec3],
    min_cosine: f64,
    limit: impl Fn(usize, Vec3) -> Vec3,
    threads: usize,
) {
    let is_folded = |points: &[Vec3], t: u32| {
        let corners = connectivity.corners(TriangleId(t)).map(|v| points[v.index()]);
        let normal = cross(&sub(&corners[1], &corners[0]), &sub(&corners[2], &corners[0]));
        let reference = &references[t as usize];
        dot(&normal, reference) < min_cosine * (norm2(&normal) * norm2(reference)).sqrt()
    };
    let flags = collect(connectivity.triangle_slots(), threads, |t| is_folded(points, t as u32));
    let mut folded: Vec<u32> = (0..).zip(flags).filter(|(_, is_folded)| *is_folded).map(|(t, _)| t).collect();
    let mut halvings = vec![0u8; from.len()];
    for pass in 0..ALIGNING_PASSES + HALVING_PASSES {
        // Each corner with the mean move of its folded triangle.
        let mut moves: Vec<(u32, Vec3)> = folded
            .iter()
            .flat_map(|&t| {
                let corners = connectivity.corners(TriangleId(t));
                let mean = corners
                    .iter()
                    .map(|v| v.index())
                    .fold([0.0; 3], |mean, v| add_scaled(&mean, 1.0 / 3.0, &sub(&points[v], &from[v])));
                corners.map(|v| (v.0, mean))
            })
            .collect();
        if moves.iter().all(|(v, _)| points[*v as usize] == from[*v as usize]) {
            return;
        }
        moves.sort_by_key(|(v, _)| *v);
        let mut around: Vec<u32> = vec![];
        for corners in moves.chunk_by(|a, b| a.0 == b.0) {
            let v = corners[0].0 as usize;
            let own = sub(&points[v], &from[v]);
            points[v] = if pass < ALIGNING_PASSES {
                let sum = corners.iter().fold([0.0; 3], |sum, (_, mean)| add_scaled(&sum, 1.0, mean));
                let alike = sum.map(|x| 0.5 * x / corners.len() as f64);
                limit(v, add_scaled(&add_scaled(&from[v], 1.0, &alike), 0.5, &own))
            } else {
                halvings[v] += 1;
                if halvings[v] <= MAX_HALVINGS { add_scaled(&from[v], 0.5, &own) } else { from[v] }
            };
            around.extend(connectivity.fan(VertexId(v as u32)).map(|h| Connectivity::triangle(h).0));
        }
        // Only triangles of vertices that have moved can have changed.
        around.sort_unstable();
        around.dedup();
        around.retain(|&t| is_folded(points, t));
        folded = around;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refinement::normal_filter::area_normals;

    /// Build a flat grid of n² squares.
    fn grid(n: u32) -> (Vec<Vec3>, Connectivity) {
        let points: Vec<Vec3> =
            (0..=n).flat_map(|y| (0..=n).map(move |x| [f64::from(x), f64::from(y), 0.0])).collect();
        let square = |x, y| {
            let a = y * (n + 1) + x;
            [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]
        };
        let triangles: Vec<[u32; 3]> = (0..n).flat_map(|y| (0..n).flat_map(move |x| square(x, y))).collect();
        let connectivity = Connectivity::from_triangles(points.len(), &triangles).unwrap();
        (points, connectivity)
    }

    fn count_folds(connectivity: &Connectivity, points: &[Vec3]) -> usize {
        area_normals(connectivity, points, 1).iter().filter(|normal| normal[2] <= 0.0).count()
    }

    #[test]
    fn vertices_beyond_their_neighbours_come_back_and_others_stay() {
        let (from, connectivity) = grid(10);
        let mut points = from.clone();
        points[60] = [points[60][0] + 1.7, points[60][1] + 0.4, 0.0];
        points[12] = [points[12][0], points[12][1], 0.3];
        let far = points[12];
        assert!(count_folds(&connectivity, &points) > 0);
        let references = area_normals(&connectivity, &from, 1);
        undo_folds(&connectivity, &from, &mut points, &references, 0.1, |_, p| p, 1);
        assert_eq!(count_folds(&connectivity, &points), 0);
        assert_eq!(points[12], far);
        assert_ne!(points[60], from[60]);
    }

    #[test]
    fn random_moves_leave_no_fold_whatever_the_number_of_threads() {
        let (from, connectivity) = grid(30);
        let mut seed = 1u64;
        let mut random = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        let moved: Vec<Vec3> = from.iter().map(|p| p.map(|x| x + 1.5 * random())).collect();
        let references = area_normals(&connectivity, &from, 1);
        let [one, two] = [1, 2].map(|threads| {
            let mut points = moved.clone();
            undo_folds(&connectivity, &from, &mut points, &references, 0.05, |_, p| p, threads);
            points
        });
        assert_eq!(one, two);
        assert!(count_folds(&connectivity, &moved) > 0);
        assert_eq!(count_folds(&connectivity, &one), 0);
        let stayed = one.iter().zip(&from).filter(|(a, b)| a == b).count();
        assert!(stayed < from.len() / 3, "{stayed}");
    }
}
