//! Photo with the depth maps of its camera; visibility, score and colour of surface points in it.

use std::sync::Arc;

use super::photo_sampling::{ColorPair, PhotoPixels, grid_cell, sample_colors};
use super::pinhole_camera::PinholeCamera;
use crate::base::geometry::{Vec3, dot, norm2, sub};

/// Cosine of the viewing angle below which a photo is used only where no photo shows the surface better (81°
/// from the normal).
const MIN_COSINE: f64 = 0.15;
/// Depth tolerances relative to the depth: between a point and the rendered mesh, and between a point and the
/// measured depth.
const RENDERED_DEPTH_TOLERANCE: f64 = 0.016;
const MEASURED_DEPTH_TOLERANCE: f64 = 0.03;
/// Up to `FULL_WEIGHT_DEPTH_DIFFERENCE`, a relative depth difference does not reduce the weight. The weight then decreases to
/// `MIN_MEASURED_WEIGHT` at the tolerance: an abrupt end would be visible as a border.
const FULL_WEIGHT_DEPTH_DIFFERENCE: f64 = 0.005;
const MIN_MEASURED_WEIGHT: f64 = 0.05;
/// Maximum tangent of the viewing angle in slope corrections; steeper values are noise.
const MAX_TANGENT: f64 = 4.0;
/// Width of the border in which views fade out, relative to the image width.
const FADE_BORDER: f64 = 0.03;
/// Weight factor for a colour with a clipped channel.
const CLIPPED_WEIGHT: f32 = 0.3;
/// Weight factor where the view's depth camera has no measurement.
const UNMEASURED_WEIGHT: f32 = 0.5;

/// Depth image, measured or rendered, with local minima.
#[derive(Debug)]
pub struct DepthImage {
    pub camera: PinholeCamera,
    /// Minimum depth within `reach` pixels; infinite or 0 where missing.
    pub nearest: Vec<f32>,
    /// Depth of each pixel; infinite or 0 where missing.
    pub exact: Vec<f32>,
    pub reach: f64,
}

/// Displacements of the photo in pixels, at the nodes of a grid over it.
#[derive(Debug)]
pub struct PhotoWarp {
    pub columns: usize,
    pub rows: usize,
    pub shifts: Vec<[f32; 2]>,
}

/// Photo of a camera.
#[derive(Debug)]
pub struct PhotoColors {
    pub camera: PinholeCamera,
    pub photo: PhotoPixels,
    /// Low-pass filtered photo.
    pub blurred: PhotoPixels,
    pub warp: Option<PhotoWarp>,
}

impl PhotoColors {
    /// Return the colours at a pixel, and whether a channel of the photo is clipped.
    #[inline(always)]
    pub fn sample(&self, pixel: [f64; 2]) -> (ColorPair, bool) {
        sample_colors(&self.photo, &self.blurred, self.warp_pixel(pixel))
    }

    #[inline(always)]
    fn warp_pixel(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let Some(warp) = &self.warp else { return [x, y] };
        let across = x / (self.camera.width as f64 - 1.0) * (warp.columns - 1) as f64;
        let down = y / (self.camera.height as f64 - 1.0) * (warp.rows - 1) as f64;
        let (i, s) = grid_cell(across, warp.columns);
        let (j, t) = grid_cell(down, warp.rows);
        let at = |i: usize, j: usize| warp.shifts[j * warp.columns + i].map(f64::from);
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)];
        let shift = |k: usize| (1.0 - t) * (a[k] + s * (b[k] - a[k])) + t * (c[k] + s * (d[k] - c[k]));
        [x + shift(0), y + shift(1)]
    }
}

/// Photo with the rendered and the measured depth of its viewpoint.
#[derive(Debug)]
pub struct PhotoView {
    pub colors: Arc<PhotoColors>,
    /// Camera centre in world coordinates.
    pub camera_center: Vec3,
    /// Rendered mesh from the photo's viewpoint, at any resolution, and the triangle at each pixel.
    pub mesh: DepthImage,
    pub triangles: Vec<u32>,
    /// True if the rendered mesh has the resolution of the photo.
    pub is_rendered_at_photo_size: bool,
    /// Measured depth of the frame, if available.
    pub measured: Option<DepthImage>,
    /// Weight relative to other photos; lower for blurred ones.
    pub weight: f32,
    /// Minimum cosine of the viewing angle; below it the photo is not used at all.
    pub min_cosine: f64,
}

/// Best kind of view of a point so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ViewKind {
    #[default]
    None,
    /// Viewing angle below the cosine `MIN_COSINE`.
    Grazing,
    Frontal,
}

/// State of a point from other photos: kind of view, minimum score of its samples, and maximum resolution in
/// pixels per metre.
#[derive(Clone, Copy, Debug)]
pub struct PointState {
    pub look: ViewKind,
    pub score: f32,
    pub density: f32,
}

/// Observation of a point in a photo. The score is 0, without colours, if the photo is not among the best.
#[derive(Clone, Copy, Debug)]
pub struct PointObservation {
    /// Never [`ViewKind::None`].
    pub look: ViewKind,
    pub score: f32,
    pub levels: ColorPair,
    /// Resolution in pixels per metre, perpendicular to the slope.
    pub density: f32,
}

/// Points processed together, so that common arithmetic is vectorised.
pub const POINTS_PER_BATCH: usize = 64;

/// Surface points with normals, one slice per axis.
#[derive(Clone, Copy, Debug)]
pub struct PointSlices<'a> {
    pub origin: Vec3,
    /// Coordinates relative to `origin`.
    pub coordinates: [&'a [f32]; 3],
    pub normals: [&'a [f32]; 3],
}

impl PointSlices<'_> {
    /// Return the position of a point.
    #[inline(always)]
    pub fn position(&self, i: usize) -> Vec3 {
        [0, 1, 2].map(|k| self.origin[k] + f64::from(self.coordinates[k][i]))
    }
}

type BatchValues = [f64; POINTS_PER_BATCH];

/// Projection of a batch of points.
#[derive(Debug)]
pub struct ProjectedPoints {
    /// In front of the camera, inside the photo, and not at a grazing angle.
    is_seen: [bool; POINTS_PER_BATCH],
    /// Coordinates in camera axes, and pixels in the photo.
    points: [BatchValues; 3],
    pixels: [BatchValues; 2],
    cosines: BatchValues,
    /// Score without the weight of the photo.
    values: [f32; POINTS_PER_BATCH],
    densities: [f32; POINTS_PER_BATCH],
    /// Pixel and depth in the measured depth image.
    measured: [BatchValues; 3],
}

impl Default for ProjectedPoints {
    fn default() -> Self {
        let none = [0.0; POINTS_PER_BATCH];
        Self {
            is_seen: [false; POINTS_PER_BATCH],
            points: [none; 3],
            pixels: [none; 2],
            cosines: none,
            values: [0.0; POINTS_PER_BATCH],
            densities: [0.0; POINTS_PER_BATCH],
            measured: [none; 3],
        }
    }
}

impl PhotoView {
    /// Project up to [`POINTS_PER_BATCH`] points.
    #[inline(always)]
    pub fn project_points(&self, points: &PointSlices<'_>, appear: &mut ProjectedPoints) {
        let count = points.coordinates[0].len().min(POINTS_PER_BATCH);
        let [xs, ys, zs] = points.coordinates.map(|axis| &axis[..count]);
        let normals = points.normals.map(|axis| &axis[..count]);
        let camera = &self.colors.camera;
        let (width, height) = (camera.width as f64, camera.height as f64);
        for i in 0..count {
            let place = [0, 1, 2].map(|k| points.origin[k] + f64::from([xs, ys, zs][k][i]));
            let p = camera.to_camera(&place);
            let [x, y] = camera.project(&p);
            let edge = (x + 0.5).min(y + 0.5).min(width - 0.5 - x).min(height - 0.5 - y);
            let towards = sub(&self.camera_center, &place);
            let distance2 = norm2(&towards);
            let cosine = dot(&towards, &normals.map(|axis| f64::from(axis[i]))) / distance2.sqrt();
            let fade = (edge / (FADE_BORDER * width)).min(1.0);
            let density2 = camera.focal[0] * camera.focal[1] / distance2;
            appear.is_seen[i] = (p[2] > 0.0) & (edge >= 1.0) & (cosine >= self.min_cosine);
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
            let p = measured.camera.to_camera(&place);
            let [x, y] = measured.camera.project(&p);
            (appear.measured[0][i], appear.measured[1][i], appear.measured[2][i]) = (x, y, p[2]);
        }
    }

    /// Observe one of the projected points. None if it is occluded, disagrees with the measured depth, or
    /// does not improve the known state.
    #[inline(always)]
    pub fn observe(
        &self,
        appear: &ProjectedPoints,
        i: usize,
        known: &PointState,
    ) -> Option<PointObservation> {
        if !appear.is_seen[i] {
            return None;
        }
        let cosine = appear.cosines[i];
        let look = if cosine < MIN_COSINE { ViewKind::Grazing } else { ViewKind::Frontal };
        let (least, most) = match (look, known.look) {
            (ViewKind::Grazing, ViewKind::Frontal) => return None,
            // Samples from grazing views are replaced.
            (ViewKind::Frontal, ViewKind::Grazing) => (0.0, 0.0),
            _ => (known.score, known.density),
        };
        let (value, density) = (appear.values[i], appear.densities[i]);
        if value * self.weight * self.weight <= least && density <= most {
            return None;
        }
        let tangent = (1.0 - cosine * cosine).max(0.0).sqrt() / cosine;
        let pixel = [appear.pixels[0][i], appear.pixels[1][i]];
        // The mesh was rendered from the photo's viewpoint.
        let p = [0, 1, 2].map(|k| appear.points[k][i]);
        let drawn = if self.is_rendered_at_photo_size { pixel } else { self.mesh.camera.project(&p) };
        if self.mesh.depth_difference(drawn, p[2], tangent, look)? < -RENDERED_DEPTH_TOLERANCE {
            return None;
        }
        let mut worth = self.weight;
        if let Some(measured) = &self.measured {
            let [x, y, depth] = [0, 1, 2].map(|k| appear.measured[k][i]);
            let difference =
                if depth > 0.0 { measured.depth_difference([x, y], depth, tangent, look) } else { None };
            match difference {
                None => worth *= UNMEASURED_WEIGHT,
                Some(difference) if difference.abs() > MEASURED_DEPTH_TOLERANCE => return None,
                Some(difference) => {
                    let rest = (MEASURED_DEPTH_TOLERANCE - difference.abs())
                        / (MEASURED_DEPTH_TOLERANCE - FULL_WEIGHT_DEPTH_DIFFERENCE);
                    worth *= rest.clamp(MIN_MEASURED_WEIGHT, 1.0) as f32;
                }
            }
        }
        let mut score = value * worth * worth;
        if score <= least {
            return Some(PointObservation { look, score: 0.0, levels: [[0; 4]; 2], density });
        }
        let (levels, is_cut_off) = self.colors.sample(pixel);
        if is_cut_off {
            score *= CLIPPED_WEIGHT;
        }
        Some(PointObservation { look, score, levels, density })
    }
}

impl DepthImage {
    /// Compute the relative depth difference between the nearest surface around a pixel and a point at depth
    /// `sample`; negative if the surface occludes the point. None without depth there. The slope of the point's
    /// own surface is compensated.
    ///
    /// At a grazing angle, the point's own surface is much nearer within the neighbourhood. Only the depth of
    /// the pixel itself is used there, if it is known.
    #[inline(always)]
    fn depth_difference(&self, pixel: [f64; 2], at: f64, tangent: f64, look: ViewKind) -> Option<f64> {
        let pixel = self.camera.nearest_pixel(pixel)?;
        let [nearest, exact] = [&self.nearest, &self.exact].map(|depths| f64::from(depths[pixel]));
        let is_there = |depth: f64| depth > 0.0 && depth.is_finite();
        if !is_there(nearest) {
            return None;
        }
        let focal = self.camera.focal[0];
        if look == ViewKind::Grazing {
            let (depth, pixels) = if is_there(exact) { (exact, 1.0) } else { (nearest, self.reach + 0.5) };
            let difference = depth / at - 1.0;
            let slope = pixels / focal * tangent;
            // In both directions, because the surface covers the whole depth range within the pixel.
            return Some(difference.signum() * (difference.abs() - slope).max(0.0));
        }
        let slope = (self.reach + 0.5) / focal * tangent.min(MAX_TANGENT);
        let difference = nearest / at - 1.0;
        Some(if difference < 0.0 { (difference + slope).min(0.0) } else { difference })
    }
}
