//! Photo with the depth maps of its camera; visibility, score and colour of surface points in it.

use std::sync::Arc;

use super::pinhole::Pinhole;
use super::pixels::{Levels, Photo, cell, colors_at};
use crate::base::geometry::{Vec3, dot, norm2, sub};

/// Cosine of the viewing angle below which a photo is used only where no photo shows the surface better (81°
/// from the normal).
const FLAT: f64 = 0.15;
/// Depth tolerances relative to the depth: between a point and the rendered mesh, and between a point and the
/// measured depth.
const SAME_DEPTH: f64 = 0.016;
const SAME_MEASURED_DEPTH: f64 = 0.03;
/// Up to `SURE_DEPTH`, a relative depth difference does not reduce the weight. The weight then decreases to
/// `LEAST_MEASURED` at the tolerance: an abrupt end would be visible as a border.
const SURE_DEPTH: f64 = 0.005;
const LEAST_MEASURED: f64 = 0.05;
/// Maximum tangent of the viewing angle in slope corrections; steeper values are noise.
const MOST_TANGENT: f64 = 4.0;
/// Width of the border in which views fade out, relative to the image width.
const FADE: f64 = 0.03;
/// Weight factor for a colour with a clipped channel.
const CUT_OFF: f32 = 0.3;
/// Weight factor where the view's depth camera has no measurement.
const UNMEASURED: f32 = 0.5;

/// Depth image, measured or rendered, with local minima.
#[derive(Debug)]
pub struct Depths {
    pub camera: Pinhole,
    /// Minimum depth within `reach` pixels; infinite or 0 where missing.
    pub nearest: Vec<f32>,
    /// Depth of each pixel; infinite or 0 where missing.
    pub exact: Vec<f32>,
    pub reach: f64,
}

/// Displacements of the photo in pixels, at the nodes of a grid over it.
#[derive(Debug)]
pub struct Warp {
    pub columns: usize,
    pub rows: usize,
    pub shifts: Vec<[f32; 2]>,
}

/// Photo of a camera.
#[derive(Debug)]
pub struct Colors {
    pub camera: Pinhole,
    pub photo: Photo,
    /// Low-pass filtered photo.
    pub blurred: Photo,
    pub warp: Option<Warp>,
}

impl Colors {
    /// Return the colours at a pixel, and whether a channel of the photo is clipped.
    #[inline(always)]
    pub fn at(&self, pixel: [f64; 2]) -> (Levels, bool) {
        colors_at(&self.photo, &self.blurred, self.warped(pixel))
    }

    #[inline(always)]
    fn warped(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let Some(warp) = &self.warp else { return [x, y] };
        let across = x / (self.camera.width as f64 - 1.0) * (warp.columns - 1) as f64;
        let down = y / (self.camera.height as f64 - 1.0) * (warp.rows - 1) as f64;
        let (i, s) = cell(across, warp.columns);
        let (j, t) = cell(down, warp.rows);
        let at = |i: usize, j: usize| warp.shifts[j * warp.columns + i].map(f64::from);
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)];
        let shift = |k: usize| (1.0 - t) * (a[k] + s * (b[k] - a[k])) + t * (c[k] + s * (d[k] - c[k]));
        [x + shift(0), y + shift(1)]
    }
}

/// Photo with the rendered and the measured depth of its viewpoint.
#[derive(Debug)]
pub struct View {
    pub colors: Arc<Colors>,
    /// Camera centre in world coordinates.
    pub place: Vec3,
    /// Rendered mesh from the photo's viewpoint, at any resolution, and the triangle at each pixel.
    pub mesh: Depths,
    pub triangles: Vec<u32>,
    /// True if the rendered mesh has the resolution of the photo.
    pub is_drawn_in_size: bool,
    /// Measured depth of the frame, if available.
    pub measured: Option<Depths>,
    /// Weight relative to other photos; lower for blurred ones.
    pub worth: f32,
    /// Minimum cosine of the viewing angle; below it the photo is not used at all.
    pub flattest: f64,
}

/// Best kind of view of a point so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Look {
    #[default]
    None,
    /// Viewing angle below the cosine `FLAT`.
    Flat,
    Straight,
}

/// State of a point from other photos: kind of view, minimum score of its samples, and maximum resolution in
/// pixels per metre.
#[derive(Clone, Copy, Debug)]
pub struct Known {
    pub look: Look,
    pub score: f32,
    pub density: f32,
}

/// Observation of a point in a photo. The score is 0, without colours, if the photo is not among the best.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Never [`Look::None`].
    pub look: Look,
    pub score: f32,
    pub levels: Levels,
    /// Resolution in pixels per metre, perpendicular to the slope.
    pub density: f32,
}

/// Points processed together, so that common arithmetic is vectorised.
pub const TOGETHER: usize = 64;

/// Surface points with normals, one slice per axis.
#[derive(Clone, Copy, Debug)]
pub struct Places<'a> {
    pub origin: Vec3,
    /// Coordinates relative to `origin`.
    pub places: [&'a [f32]; 3],
    pub normals: [&'a [f32]; 3],
}

impl Places<'_> {
    /// Return the position of a point.
    #[inline(always)]
    pub fn of(&self, i: usize) -> Vec3 {
        [0, 1, 2].map(|k| self.origin[k] + f64::from(self.places[k][i]))
    }
}

type Numbers = [f64; TOGETHER];

/// Projection of a batch of points.
#[derive(Debug)]
pub struct Appear {
    /// In front of the camera, inside the photo, and not at a grazing angle.
    is_seen: [bool; TOGETHER],
    /// Coordinates in camera axes, and pixels in the photo.
    points: [Numbers; 3],
    pixels: [Numbers; 2],
    cosines: Numbers,
    /// Score without the weight of the photo.
    values: [f32; TOGETHER],
    densities: [f32; TOGETHER],
    /// Pixel and depth in the measured depth image.
    measured: [Numbers; 3],
}

impl Default for Appear {
    fn default() -> Self {
        let none = [0.0; TOGETHER];
        Self {
            is_seen: [false; TOGETHER],
            points: [none; 3],
            pixels: [none; 2],
            cosines: none,
            values: [0.0; TOGETHER],
            densities: [0.0; TOGETHER],
            measured: [none; 3],
        }
    }
}

impl View {
    /// Project up to [`TOGETHER`] points.
    #[inline(always)]
    pub fn find(&self, points: &Places<'_>, appear: &mut Appear) {
        let count = points.places[0].len().min(TOGETHER);
        let [xs, ys, zs] = points.places.map(|axis| &axis[..count]);
        let normals = points.normals.map(|axis| &axis[..count]);
        let camera = &self.colors.camera;
        let (width, height) = (camera.width as f64, camera.height as f64);
        for i in 0..count {
            let place = [0, 1, 2].map(|k| points.origin[k] + f64::from([xs, ys, zs][k][i]));
            let p = camera.in_camera(&place);
            let [x, y] = camera.pixel(&p);
            let edge = (x + 0.5).min(y + 0.5).min(width - 0.5 - x).min(height - 0.5 - y);
            let towards = sub(&self.place, &place);
            let distance2 = norm2(&towards);
            let cosine = dot(&towards, &normals.map(|axis| f64::from(axis[i]))) / distance2.sqrt();
            let fade = (edge / (FADE * width)).min(1.0);
            let density2 = camera.focal[0] * camera.focal[1] / distance2;
            appear.is_seen[i] = (p[2] > 0.0) & (edge >= 1.0) & (cosine >= self.flattest);
            for (axis, place) in appear.points.iter_mut().zip(p) {
                axis[i] = place;
            }
            (appear.pixels[0][i], appear.pixels[1][i]) = (x, y);
            appear.cosines[i] = cosine;
            appear.values[i] = (cosine * fade * density2) as f32;
            appear.densities[i] = (camera.focal[0] / p[2]) as f32;
        }
        let Some(measured) = &self.measured else { return };
        for i in 0..count {
            let place = [0, 1, 2].map(|k| points.origin[k] + f64::from([xs, ys, zs][k][i]));
            let p = measured.camera.in_camera(&place);
            let [x, y] = measured.camera.pixel(&p);
            (appear.measured[0][i], appear.measured[1][i], appear.measured[2][i]) = (x, y, p[2]);
        }
    }

    /// Observe one of the projected points. None if it is occluded, disagrees with the measured depth, or
    /// does not improve the known state.
    #[inline(always)]
    pub fn of(&self, appear: &Appear, i: usize, known: &Known) -> Option<Seen> {
        if !appear.is_seen[i] {
            return None;
        }
        let cosine = appear.cosines[i];
        let look = if cosine < FLAT { Look::Flat } else { Look::Straight };
        let (least, most) = match (look, known.look) {
            (Look::Flat, Look::Straight) => return None,
            // Samples from grazing views are replaced.
            (Look::Straight, Look::Flat) => (0.0, 0.0),
            _ => (known.score, known.density),
        };
        let (value, density) = (appear.values[i], appear.densities[i]);
        if value * self.worth * self.worth <= least && density <= most {
            return None;
        }
        let tangent = (1.0 - cosine * cosine).max(0.0).sqrt() / cosine;
        let pixel = [appear.pixels[0][i], appear.pixels[1][i]];
        // The mesh was rendered from the photo's viewpoint.
        let p = [0, 1, 2].map(|k| appear.points[k][i]);
        let drawn = if self.is_drawn_in_size { pixel } else { self.mesh.camera.pixel(&p) };
        if self.mesh.difference(drawn, p[2], tangent, look)? < -SAME_DEPTH {
            return None;
        }
        let mut worth = self.worth;
        if let Some(measured) = &self.measured {
            let [x, y, depth] = [0, 1, 2].map(|k| appear.measured[k][i]);
            let difference =
                if depth > 0.0 { measured.difference([x, y], depth, tangent, look) } else { None };
            match difference {
                None => worth *= UNMEASURED,
                Some(difference) if difference.abs() > SAME_MEASURED_DEPTH => return None,
                Some(difference) => {
                    let rest = (SAME_MEASURED_DEPTH - difference.abs()) / (SAME_MEASURED_DEPTH - SURE_DEPTH);
                    worth *= rest.clamp(LEAST_MEASURED, 1.0) as f32;
                }
            }
        }
        let mut score = value * worth * worth;
        if score <= least {
            return Some(Seen { look, score: 0.0, levels: [[0; 4]; 2], density });
        }
        let (levels, is_cut_off) = self.colors.at(pixel);
        if is_cut_off {
            score *= CUT_OFF;
        }
        Some(Seen { look, score, levels, density })
    }
}

impl Depths {
    /// Compute the relative depth difference between the nearest surface around a pixel and a point at depth
    /// `at`; negative if the surface occludes the point. None without depth there. The slope of the point's
    /// own surface is compensated.
    ///
    /// At a grazing angle, the point's own surface is much nearer within the neighbourhood. Only the depth of
    /// the pixel itself is used there, if it is known.
    #[inline(always)]
    fn difference(&self, pixel: [f64; 2], at: f64, tangent: f64, look: Look) -> Option<f64> {
        let pixel = self.camera.nearest(pixel)?;
        let [nearest, exact] = [&self.nearest, &self.exact].map(|depths| f64::from(depths[pixel]));
        let is_there = |depth: f64| depth > 0.0 && depth.is_finite();
        if !is_there(nearest) {
            return None;
        }
        let focal = self.camera.focal[0];
        if look == Look::Flat {
            let (depth, pixels) = if is_there(exact) { (exact, 1.0) } else { (nearest, self.reach + 0.5) };
            let difference = depth / at - 1.0;
            let slope = pixels / focal * tangent;
            // In both directions, because the surface covers the whole depth range within the pixel.
            return Some(difference.signum() * (difference.abs() - slope).max(0.0));
        }
        let slope = (self.reach + 0.5) / focal * tangent.min(MOST_TANGENT);
        let difference = nearest / at - 1.0;
        Some(if difference < 0.0 { (difference + slope).min(0.0) } else { difference })
    }
}
