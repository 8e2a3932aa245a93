//! Nearest points of a surface, optionally only on triangles that face a given direction.
//!
//! Consecutive query points are close in space, so each search starts from the previous result.

use crate::base::geometry::{Vec3, cross, dot, nearest_on_triangle, sub};
use crate::base::parallel::map;
use crate::mesh::bvh::Bvh;

/// Queries per run. The first query of a run starts from a fixed triangle, so that results do not depend on
/// the thread count.
const QUERIES_PER_RUN: usize = 512;

/// Triangle mesh with a search tree.
pub struct SearchableSurface {
    tree: Bvh,
    /// Index, corners and normal (not normalised) of the triangle in each slot of the tree.
    numbers: Vec<u32>,
    corners: Vec<[Vec3; 3]>,
    normals: Vec<Vec3>,
}

/// Point on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    pub triangle: u32,
    /// Barycentric weights in the triangle.
    pub weights: [f64; 3],
    pub distance: f64,
    /// True if a nearer point was rejected because it faces away.
    pub replaced: bool,
}

impl SearchableSurface {
    /// Build the surface of a mesh with at least one triangle. Indices must be in range.
    pub fn new(points: &[Vec3], triangles: &[[u32; 3]], threads: usize) -> Self {
        let corners = |t: usize| triangles[t].map(|v| points[v as usize]);
        let (tree, numbers) = Bvh::new(triangles.len(), threads, |t| {
            let [a, b, c] = corners(t);
            let bound = |by: fn(f64, f64) -> f64| [0, 1, 2].map(|i| by(by(a[i], b[i]), c[i]));
            [bound(f64::min), bound(f64::max)]
        });
        let corners: Vec<_> = numbers.iter().map(|&t| corners(t as usize)).collect();
        let normals = corners.iter().map(|[a, b, c]| cross(&sub(b, a), &sub(c, a))).collect();
        Self { tree, numbers, corners, normals }
    }

    /// Find the nearest point to each point.
    pub fn find_nearest_points(&self, points: &[Vec3], threads: usize) -> Vec<SurfacePoint> {
        self.run_queries(points.len(), threads, |i, from| {
            let slot = self.find_nearest_slot(&points[i], from);
            (slot, self.locate(&points[i], slot))
        })
    }

    /// Find the nearest point to each point. If its triangle faces away from the normal there, use the
    /// nearest point along the normal, in either direction up to `reach`, whose triangle does not; if there
    /// is one.
    pub fn find_facing_points(
        &self,
        points: &[Vec3],
        normals: &[Vec3],
        reach: f64,
        threads: usize,
    ) -> Vec<SurfacePoint> {
        self.run_queries(points.len(), threads, |i, from| {
            let slot = self.find_nearest_slot(&points[i], from);
            let found = if dot(&normals[i], &self.normals[slot as usize]) < 0.0 {
                self.find_along_normal(&points[i], &normals[i], reach)
            } else {
                None
            };
            (slot, found.unwrap_or_else(|| self.locate(&points[i], slot)))
        })
    }

    /// Call `work` with each index and the slot of the previous result.
    fn run_queries(
        &self,
        count: usize,
        threads: usize,
        work: impl Fn(usize, u32) -> (u32, SurfacePoint) + Sync,
    ) -> Vec<SurfacePoint> {
        let rows = map(
            count.div_ceil(QUERIES_PER_RUN),
            threads,
            || (),
            |(), row| {
                let mut slot = 0;
                let numbers = row * QUERIES_PER_RUN..((row + 1) * QUERIES_PER_RUN).min(count);
                let find = |i| {
                    let found;
                    (slot, found) = work(i, slot);
                    found
                };
                numbers.map(find).collect::<Vec<_>>()
            },
        );
        rows.concat()
    }

    fn find_nearest_slot(&self, p: &Vec3, from: u32) -> u32 {
        let distance2 = |slot: u32| nearest_on_triangle(p, self.corners[slot as usize].each_ref()).1;
        self.tree.find_nearest(p, (from, distance2(from)), distance2).0
    }

    fn locate(&self, p: &Vec3, slot: u32) -> SurfacePoint {
        let (weights, distance2) = nearest_on_triangle(p, self.corners[slot as usize].each_ref());
        let triangle = self.numbers[slot as usize];
        SurfacePoint { triangle, weights, distance: distance2.sqrt(), replaced: false }
    }

    fn find_along_normal(&self, p: &Vec3, direction: &Vec3, reach: f64) -> Option<SurfacePoint> {
        let mut best = None;
        self.tree.visit_along_line(p, direction, reach, |slot, reach| {
            if dot(direction, &self.normals[slot as usize]) <= 0.0 {
                return reach;
            }
            match intersect_line(p, direction, &self.corners[slot as usize]) {
                Some((distance, weights)) if distance < reach => {
                    let triangle = self.numbers[slot as usize];
                    best = Some(SurfacePoint { triangle, weights, distance, replaced: true });
                    distance
                }
                _ => reach,
            }
        });
        best
    }
}

/// Intersect a line with a triangle: absolute distance along the line, and barycentric weights (Möller and
/// Trumbore 1997, "Fast, minimum storage ray-triangle intersection").
fn intersect_line(p: &Vec3, direction: &Vec3, [a, b, c]: &[Vec3; 3]) -> Option<(f64, [f64; 3])> {
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let across = cross(direction, &ac);
    let along = cross(&ap, &ab);
    let determinant = dot(&ab, &across);
    let (v, w) = (dot(&ap, &across) / determinant, dot(direction, &along) / determinant);
    let u = 1.0 - v - w;
    // A line in the triangle's plane gives NaN, which fails the comparison.
    (u >= 0.0 && v >= 0.0 && w >= 0.0).then(|| ((dot(&ac, &along) / determinant).abs(), [u, v, w]))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two sheets, one above the other: the upper (z = 0) faces down, the lower (z = −1) faces up.
    fn sheets() -> SearchableSurface {
        let mut points = vec![];
        for z in [0.0, -1.0] {
            points.extend([[0.0, 0.0, z], [4.0, 0.0, z], [0.0, 4.0, z], [4.0, 4.0, z]]);
        }
        SearchableSurface::new(&points, &[[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6]], 1)
    }

    #[test]
    fn the_nearest_point_is_found_whatever_was_found_before() {
        let surface = sheets();
        let points: Vec<Vec3> = (0..2000)
            .map(|i| [f64::from(i % 41) / 9.0, f64::from(i % 37) / 8.0, f64::from(i % 7) - 3.0])
            .collect();
        let found = surface.find_nearest_points(&points, 1);
        for (p, one) in points.iter().zip(&found) {
            let all = (0..4).map(|slot| surface.locate(p, slot).distance).fold(f64::INFINITY, f64::min);
            assert_eq!(one.distance, all);
        }
        assert_eq!(found, surface.find_nearest_points(&points, 3));
    }

    #[test]
    fn what_faces_away_is_passed_over_within_reach() {
        let surface = sheets();
        let at = |z: f64, up: f64, reach: f64| {
            let found = surface.find_facing_points(&[[1.0, 1.0, z]], &[[0.0, 0.0, up]], reach, 1)[0];
            (found.triangle, found.replaced, found.distance)
        };
        assert_eq!(at(0.25, 1.0, 2.0), (2, true, 1.25));
        assert_eq!(at(0.25, 1.0, 1.0), (0, false, 0.25));
        assert_eq!(at(0.25, -1.0, 2.0), (0, false, 0.25));
        assert_eq!(at(-1.25, -1.0, 2.0), (0, true, 1.25));
        assert_eq!(at(-0.9, 1.0, 2.0).0, 2);
    }
}
