//! The input surface, with nearest points found by walking from a vertex.

use crate::base::geometry::{Vec3, cross, dot, nearest_on_triangle, norm2, position_of, sub};
use crate::mesh::vertex_triangles::VertexTriangles;

/// A nearest point on the surface.
#[derive(Clone, Copy, Debug)]
pub struct NearestPoint<const D: usize> {
    /// Squared distance from the query point.
    pub distance2: f64,
    /// Position and attributes.
    pub point: [f64; D],
    pub triangle: u32,
    /// The corner with the largest barycentric coordinate.
    pub vertex: u32,
}

/// Triangle soup with the triangles around each vertex. The only requirement is that indices are in range.
pub struct InputSurface<const D: usize> {
    pub points: Vec<[f64; D]>,
    pub triangles: Vec<[u32; 3]>,
    stars: VertexTriangles,
}

impl<const D: usize> InputSurface<D> {
    pub fn new(points: Vec<[f64; D]>, triangles: Vec<[u32; 3]>) -> Self {
        let stars = VertexTriangles::new(points.len(), &triangles);
        Self { points, triangles, stars }
    }

    /// Return the triangles around a vertex.
    #[inline]
    pub fn triangles_around(&self, v: u32) -> &[u32] {
        self.stars.around(v)
    }

    /// Find a nearby point of the surface by a greedy walk.
    ///
    /// The walk starts at vertex `start` and searches the triangles around it. It moves to the corner nearest
    /// to the foot, and stops when the distance no longer decreases. `None` if no triangle uses `start`.
    pub fn find_near(&self, p: &Vec3, start: u32) -> Option<NearestPoint<D>> {
        let mut best: Option<NearestPoint<D>> = None;
        let mut from = start;
        loop {
            let before = best.map_or(f64::INFINITY, |b| b.distance2);
            for &t in self.triangles_around(from) {
                let foot = self.nearest_on(p, t);
                if best.is_none_or(|b| foot.distance2 < b.distance2) {
                    best = Some(foot);
                }
            }
            let foot = best?;
            if foot.distance2 >= before || foot.vertex == from {
                return Some(foot);
            }
            from = foot.vertex;
        }
    }

    /// Find where the line from `a` to `b` leaves the prism over a triangle.
    ///
    /// The returned parameter is 0 at `a` and 1 at `b`, not less than `from`, and above 1 if the line ends
    /// inside. Also returns the corner opposite the side that the line crosses.
    pub fn find_prism_exit(&self, triangle: u32, a: &Vec3, b: &Vec3, from: f64) -> (f64, usize) {
        let [p, q, r] = self.triangles[triangle as usize].map(|v| position_of(&self.points[v as usize]));
        let (u, v) = (sub(&q, &p), sub(&r, &p));
        let normal = cross(&u, &v);
        // Barycentric coordinates of both ends of the line, times `area2`.
        let (along_u, along_v) = (cross(&v, &normal), cross(&normal, &u));
        let area2 = norm2(&normal);
        let weights = |x: &Vec3| {
            let off = sub(x, &p);
            let (at_q, at_r) = (dot(&along_u, &off), dot(&along_v, &off));
            [area2 - at_q - at_r, at_q, at_r]
        };
        let (start, end) = (weights(a), weights(b));
        let mut least = (2.0, 0);
        for i in 0..3 {
            let fall = start[i] - end[i];
            if fall > 0.0 {
                let t = (start[i] / fall).max(from);
                if t < least.0 {
                    least = (t, i);
                }
            }
        }
        least
    }

    /// Find the neighbour across the side opposite a corner; any of them on a non-manifold edge.
    pub fn neighbour_across(&self, triangle: u32, opposite: usize) -> Option<u32> {
        let corners = self.triangles[triangle as usize];
        let (u, v) = (corners[(opposite + 1) % 3], corners[(opposite + 2) % 3]);
        let mut around = self.triangles_around(u).iter().copied();
        around.find(|&t| t != triangle && self.triangles[t as usize].contains(&v))
    }

    /// Find the point of one triangle that is nearest to `p`.
    #[inline]
    pub fn nearest_on(&self, p: &Vec3, triangle: u32) -> NearestPoint<D> {
        let corners = self.triangles[triangle as usize];
        let points = corners.map(|v| &self.points[v as usize]);
        let places = points.map(position_of);
        let (at, distance2) = nearest_on_triangle(p, places.each_ref());
        let heaviest = if at[0] >= at[1] && at[0] >= at[2] {
            0
        } else if at[1] >= at[2] {
            1
        } else {
            2
        };
        NearestPoint { distance2, point: interpolate(&at, points), triangle, vertex: corners[heaviest] }
    }
}

/// Interpolate `points` with the barycentric coordinates `at`.
#[inline]
pub fn interpolate<const D: usize>(at: &[f64; 3], points: [&[f64; D]; 3]) -> [f64; D] {
    std::array::from_fn(|i| at[0] * points[0][i] + at[1] * points[1][i] + at[2] * points[2][i])
}
