//! Rendering of the textured mesh from a camera.

use super::photo_sampling::PhotoPixels;
use super::pinhole_camera::PinholeCamera;
use super::zbuffer::{NO_TRIANGLE, ZBuffer};
use crate::base::by_processor::by_processor;
use crate::base::geometry::{Vec3, cross, dot, norm2, sub};

/// Mesh with texture images.
#[derive(Clone, Copy, Debug)]
pub struct TexturedMesh<'a> {
    pub points: &'a [Vec3],
    pub triangles: &'a [[u32; 3]],
    /// Corners of each triangle in pixels of its image; the centre of the first pixel is at (0.5, 0.5).
    pub corners: &'a [[[f64; 2]; 3]],
    /// Image of each triangle; `u16::MAX` for none.
    pub pages: &'a [u16],
    pub images: &'a [PhotoPixels],
}

/// Colours of the pixels, and mask of the textured ones.
type RenderedColors = (Vec<[u8; 3]>, Vec<bool>);

by_processor! {
    /// Render the colours of the pixels; also returns the mask of pixels that show a textured triangle.
    pub fn render_textured(mesh: &TexturedMesh<'_>, seen: &ZBuffer, camera: &PinholeCamera) -> RenderedColors = render_textured_scalar
}

#[inline(always)]
fn render_textured_scalar(mesh: &TexturedMesh<'_>, seen: &ZBuffer, camera: &PinholeCamera) -> RenderedColors {
    let mut colors = vec![[0; 3]; seen.depth.len()];
    let mut shown = vec![false; seen.depth.len()];
    let mut last = NO_TRIANGLE;
    let mut triangle_there = LinearWeights::default();
    for y in 0..camera.height {
        for x in 0..camera.width {
            let i = y * camera.width + x;
            let triangle = seen.triangle[i];
            if triangle == NO_TRIANGLE {
                continue;
            }
            let Some(image) = mesh.images.get(usize::from(mesh.pages[triangle as usize])) else { continue };
            if triangle != last {
                let corners =
                    mesh.triangles[triangle as usize].map(|v| camera.to_camera(&mesh.points[v as usize]));
                triangle_there = LinearWeights::of_triangle(&corners);
                last = triangle;
            }
            let shares = triangle_there.weights_at(&camera.unproject(x, y, f64::from(seen.depth[i])));
            let corners = &mesh.corners[triangle as usize];
            let place = [0, 1].map(|k| (0..3).map(|c| shares[c] * corners[c][k]).sum::<f64>() - 0.5);
            let [red, green, blue, _] = image.sample_bilinear(place);
            colors[i] = [red, green, blue];
            shown[i] = true;
        }
    }
    (colors, shown)
}

/// Barycentric weights of a triangle's second and third corner, as linear functions of a point in its plane.
#[derive(Default)]
struct LinearWeights([(f64, Vec3); 2]);

impl LinearWeights {
    fn of_triangle([a, b, c]: &[Vec3; 3]) -> Self {
        let normal = cross(&sub(b, a), &sub(c, a));
        let area2 = norm2(&normal);
        if area2 == 0.0 {
            return Self::default();
        }
        // Each weight is the area of the triangle formed by the point and an edge, relative to the triangle's
        // area.
        Self([(c, a), (a, b)].map(|(from, to)| {
            let along = cross(&sub(from, to), &normal);
            (dot(&cross(from, to), &normal) / area2, along.map(|x| x / area2))
        }))
    }

    #[inline]
    fn weights_at(&self, p: &Vec3) -> [f64; 3] {
        let [v, w] = self.0.each_ref().map(|(rest, along)| rest + dot(along, p));
        [1.0 - v - w, v, w].map(|share| share.clamp(0.0, 1.0))
    }
}
