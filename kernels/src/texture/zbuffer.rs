//! Z-buffer rendering: visible triangle and depth of each pixel.

use super::mesh_clusters::MeshClusters;
use super::pinhole_camera::PinholeCamera;
use crate::base::by_processor::by_processor;
use crate::base::geometry::{Vec3, add_scaled, sub};

/// Triangle index of a pixel that sees nothing.
pub const NO_TRIANGLE: u32 = u32::MAX;

/// Depth along the optical axis and index of the nearest triangle, row by row.
#[derive(Clone, Debug)]
pub struct ZBuffer {
    /// Infinite where nothing is visible.
    pub depth: Vec<f32>,
    pub triangle: Vec<u32>,
}

by_processor! {
    /// Render a mesh without back-face culling. At equal depth the lower triangle index wins. Parts nearer
    /// than `near` are clipped.
    pub fn render_zbuffer(mesh: &MeshClusters, camera: &PinholeCamera, near: f64) -> ZBuffer = render_scalar
}

#[inline(always)]
fn render_scalar(mesh: &MeshClusters, camera: &PinholeCamera, near: f64) -> ZBuffer {
    let corner = |p: Vec3| ProjectedCorner { pixel: camera.project(&p), depth: p[2] };
    let pixels = camera.width * camera.height;
    let mut buffer = ZBuffer { depth: vec![f32::INFINITY; pixels], triangle: vec![NO_TRIANGLE; pixels] };
    let (mut seen, mut appear) = (vec![], vec![]);
    for (points, triangles, numbers) in mesh.visible_clusters(camera, near) {
        seen.clear();
        seen.extend(points.iter().map(|p| camera.to_camera(p)));
        // Projections of points behind the camera are meaningless, and are not used.
        appear.clear();
        appear.extend(seen.iter().map(|&p| corner(p)));
        for (corners, &number) in triangles.iter().zip(numbers) {
            let drawn = corners.map(|v| appear[v as usize]);
            let behind = drawn.iter().filter(|p: &&ProjectedCorner| p.depth < near).count();
            if behind == 0 {
                buffer.draw_triangle(&drawn, number, camera);
            } else if behind < 3 {
                let (cut, count) = clip_near(&corners.map(|v| seen[v as usize]), near);
                for k in 2..count {
                    buffer.draw_triangle(&[cut[0], cut[k - 1], cut[k]].map(corner), number, camera);
                }
            }
        }
    }
    buffer
}

/// Projected corner of a triangle, with its depth.
#[derive(Clone, Copy)]
struct ProjectedCorner {
    pixel: [f64; 2],
    depth: f64,
}

/// Clip a triangle at the plane z = `near`; returns a polygon and its number of corners.
fn clip_near(corners: &[Vec3; 3], near: f64) -> ([Vec3; 4], usize) {
    let (mut cut, mut count) = ([[0.0; 3]; 4], 0);
    let mut push = |p| {
        cut[count] = p;
        count += 1;
    };
    for k in 0..3 {
        let (a, b) = (&corners[k], &corners[(k + 1) % 3]);
        if a[2] >= near {
            push(*a);
        }
        if (a[2] >= near) != (b[2] >= near) {
            push(add_scaled(a, (near - a[2]) / (b[2] - a[2]), &sub(b, a)));
        }
    }
    (cut, count)
}

impl ZBuffer {
    #[inline(always)]
    fn draw_triangle(&mut self, corners: &[ProjectedCorner; 3], number: u32, camera: &PinholeCamera) {
        let [a, b, c] = corners.map(|corner| corner.pixel);
        let between = |axis: usize, size: usize| {
            let low = a[axis].min(b[axis]).min(c[axis]).ceil().max(0.0);
            // End of the range (exclusive); 0 if the triangle is outside.
            let end = (a[axis].max(b[axis]).max(c[axis]).floor() + 1.0).clamp(0.0, size as f64);
            low.min(size as f64) as usize..end as usize
        };
        // Most triangles contain no pixel centre.
        let (columns, rows) = (between(0, camera.width), between(1, camera.height));
        if columns.is_empty() || rows.is_empty() {
            return;
        }
        let twice = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if twice == 0.0 || !twice.is_finite() {
            return;
        }
        // Inverse depth is linear in the image.
        let [za, zb, zc] = corners.map(|corner| 1.0 / corner.depth);
        let edge = |p: [f64; 2], q: [f64; 2]| {
            let (along, up) = (-(q[1] - p[1]) / twice, (q[0] - p[0]) / twice);
            [along, up, -along * p[0] - up * p[1]]
        };
        let edges = [edge(b, c), edge(c, a), edge(a, b)];
        let inverse = [0, 1, 2].map(|i| edges[0][i] * za + edges[1][i] * zb + edges[2][i] * zc);
        for y in rows {
            // Intersect the row with the half-plane of each edge.
            let (mut first, mut last) = (columns.start as f64, columns.end as f64 - 1.0);
            for [along, up, rest] in edges {
                let at = up * y as f64 + rest;
                if along > 0.0 {
                    first = first.max((-at / along).ceil());
                } else if along < 0.0 {
                    last = last.min((-at / along).floor());
                } else if at < 0.0 {
                    last = f64::NEG_INFINITY;
                }
            }
            if first > last {
                continue;
            }
            let row = y * camera.width;
            for x in first as usize..=last as usize {
                let z = (1.0 / (inverse[0] * x as f64 + inverse[1] * y as f64 + inverse[2])) as f32;
                let (depth, triangle) = (&mut self.depth[row + x], &mut self.triangle[row + x]);
                if z < *depth || (z == *depth && z.is_finite() && number < *triangle) {
                    (*depth, *triangle) = (z, number);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> PinholeCamera {
        PinholeCamera {
            focal: [100.0; 2],
            centre: [50.0, 40.0],
            width: 101,
            height: 81,
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [0.0; 3],
        }
    }

    #[test]
    fn the_nearest_triangle_is_seen_and_a_square_of_two_has_no_gap() {
        let square = |z: f64, r: f64| [[-r, -r, z], [r, -r, z], [r, r, z], [-r, r, z]];
        let points: Vec<Vec3> = square(2.0, 0.5).into_iter().chain(square(1.0, 0.1)).collect();
        let triangles = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let seen = render_zbuffer(&MeshClusters::new(&points, &triangles), &camera(), 1e-3);
        let count = |depth: f32| seen.depth.iter().filter(|&&z| (z - depth).abs() < 1e-6).count();
        // 0.1 m at 1 m and 0.5 m at 2 m, with both borders.
        assert_eq!((count(1.0), count(2.0)), (21 * 21, 51 * 51 - 21 * 21));
        assert_eq!(seen.triangle.iter().filter(|&&t| t == NO_TRIANGLE).count(), 101 * 81 - 51 * 51);
    }

    #[test]
    fn a_floor_under_the_camera_is_cut_off_where_it_begins() {
        let points = [[-50.0, 1.0, -50.0], [50.0, 1.0, -50.0], [0.0, 1.0, 100.0]];
        let seen = render_zbuffer(&MeshClusters::new(&points, &[[0, 1, 2]]), &camera(), 0.1);
        // Below the horizon, the depth of a floor 1 m down is 100 / rows below the horizon.
        assert!(seen.depth[..40 * 101].iter().all(|z| z.is_infinite()));
        for row in 45..81 {
            assert!((seen.depth[row * 101 + 50] - 100.0 / (row as f32 - 40.0)).abs() < 1e-3, "{row}");
        }
    }
}
