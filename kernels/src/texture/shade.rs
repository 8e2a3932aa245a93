//! The textured mesh as a camera sees it.

use super::pinhole::Pinhole;
use super::view::Photo;
use super::zbuffer::{NOTHING, ZBuffer};
use crate::base::geometry::{Vec3, cross, dot, norm2, sub};

/// A mesh laid out in images.
#[derive(Clone, Copy, Debug)]
pub struct Textured<'a> {
    pub points: &'a [Vec3],
    pub triangles: &'a [[u32; 3]],
    /// Of each triangle, in pixels of its image; the centre of the first pixel is at (0.5, 0.5).
    pub corners: &'a [[[f64; 2]; 3]],
    /// The image of each triangle, `u16::MAX` for none.
    pub pages: &'a [u16],
    pub images: &'a [Photo],
}

/// Colours of the pixels, and whether each shows a triangle with an image.
pub fn shade(mesh: &Textured<'_>, seen: &ZBuffer, camera: &Pinhole) -> (Vec<[u8; 3]>, Vec<bool>) {
    let mut colors = vec![[0; 3]; seen.depth.len()];
    let mut shown = vec![false; seen.depth.len()];
    let mut last = NOTHING;
    let mut corners = [[0.0; 3]; 3];
    for (i, &triangle) in seen.triangle.iter().enumerate() {
        if triangle == NOTHING {
            continue;
        }
        let Some(image) = mesh.images.get(usize::from(mesh.pages[triangle as usize])) else { continue };
        if triangle != last {
            corners = mesh.triangles[triangle as usize].map(|v| camera.in_camera(&mesh.points[v as usize]));
            last = triangle;
        }
        let point = camera.point(i % camera.width, i / camera.width, f64::from(seen.depth[i]));
        let shares = barycentric(&corners, &point);
        let place = [0, 1]
            .map(|k| (0..3).map(|c| shares[c] * mesh.corners[triangle as usize][c][k]).sum::<f64>() - 0.5);
        colors[i] = image.linear(place).map(|level| (level + 0.5) as u8);
        shown[i] = true;
    }
    (colors, shown)
}

/// What share each corner has of a point in the plane of a triangle.
fn barycentric([a, b, c]: &[Vec3; 3], p: &Vec3) -> [f64; 3] {
    let normal = cross(&sub(b, a), &sub(c, a));
    let area2 = norm2(&normal);
    if area2 == 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let v = dot(&cross(&sub(c, p), &sub(a, p)), &normal) / area2;
    let w = dot(&cross(&sub(a, p), &sub(b, p)), &normal) / area2;
    [1.0 - v - w, v, w].map(|share| share.clamp(0.0, 1.0))
}
