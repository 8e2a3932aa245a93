//! A photo with what its camera sees, and the colour of a point of the surface in it.

use std::sync::Arc;

use super::pinhole::Pinhole;
use super::pixels::{Levels, Photo, cell, colors_at};
use crate::base::geometry::{Vec3, dot, norm2, sub};

/// What a surface shows that is seen flatter than at this cosine is taken only where no photo shows it better.
const FLAT: f64 = 0.15;
/// Surfaces this share of their distance apart are one, and so are the surface and its measured depth.
const SAME_DEPTH: f64 = 0.016;
const SAME_MEASURED_DEPTH: f64 = 0.03;
/// Up to so much a measured depth is that of the surface as well as it can be. From there on the view is worth less and less, and so
/// little at last: where it ended at once, a border would be seen.
const SURE_DEPTH: f64 = 0.005;
const LEAST_MEASURED: f64 = 0.05;
/// Slopes are steeper than this for no reason but noise.
const MOST_TANGENT: f64 = 4.0;
/// Of the image's width, where views begin to fade out.
const FADE: f64 = 0.03;
/// What a view is worth of which a channel is cut off.
const CUT_OFF: f32 = 0.3;
/// What a view is worth where its own camera measured no depth.
const UNMEASURED: f32 = 0.5;

/// What a camera measured or would see: a depth a pixel, the least one around it.
#[derive(Debug)]
pub struct Depths {
    pub camera: Pinhole,
    /// The least depth within `reach` pixels; infinite or 0 where there is none.
    pub nearest: Vec<f32>,
    /// The depth of each pixel alone; infinite or 0 where there is none.
    pub exact: Vec<f32>,
    pub reach: f64,
}

/// Shifts of the photo, in pixels, at the corners of a grid over it.
#[derive(Debug)]
pub struct Warp {
    pub columns: usize,
    pub rows: usize,
    pub shifts: Vec<[f32; 2]>,
}

/// The colours that a camera took.
#[derive(Debug)]
pub struct Colors {
    pub camera: Pinhole,
    pub photo: Photo,
    /// The photo without its details.
    pub blurred: Photo,
    pub warp: Option<Warp>,
}

impl Colors {
    /// The colours at a pixel, and whether a channel of the photo is cut off.
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

#[derive(Debug)]
pub struct View {
    pub colors: Arc<Colors>,
    /// Where the camera stands.
    pub place: Vec3,
    /// The mesh from where the photo was taken, in any size, and the triangle at each pixel.
    pub mesh: Depths,
    pub triangles: Vec<u32>,
    /// Whether that is the photo's size.
    pub is_drawn_in_size: bool,
    /// What the frame measured, if it did.
    pub measured: Option<Depths>,
    /// How much it is worth beside other photos: blurred ones less.
    pub worth: f32,
    /// A surface seen flatter than at this cosine shows nothing at all.
    pub flattest: f64,
}

/// How a point was seen best so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Look {
    #[default]
    None,
    /// Flatter than anybody would want it.
    Flat,
    Straight,
}

/// What is known of a point from other photos: how these see it, the worst score that is remembered, and the most pixels a metre.
#[derive(Clone, Copy, Debug)]
pub struct Known {
    pub look: Look,
    pub score: f32,
    pub density: f32,
}

/// A point in a photo; of score 0, and without colours, where the photo is not among the best.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Not [`Look::None`].
    pub look: Look,
    pub score: f32,
    pub levels: Levels,
    /// Pixels a metre, across the slope.
    pub density: f32,
}

/// Points that are looked at together: what of them is the same sum for all is worked out for several at once.
pub const TOGETHER: usize = 64;

/// Points of the surface with their normals, a slice for each axis.
#[derive(Clone, Copy, Debug)]
pub struct Places<'a> {
    pub origin: Vec3,
    /// From the origin.
    pub places: [&'a [f32]; 3],
    pub normals: [&'a [f32]; 3],
}

impl Places<'_> {
    #[inline(always)]
    pub fn of(&self, i: usize) -> Vec3 {
        [0, 1, 2].map(|k| self.origin[k] + f64::from(self.places[k][i]))
    }
}

type Numbers = [f64; TOGETHER];

/// Where points appear that are looked at together.
#[derive(Debug)]
pub struct Appear {
    /// In front of the camera, within the photo and not seen too flat.
    is_seen: [bool; TOGETHER],
    /// In camera axes, and in the photo.
    points: [Numbers; 3],
    pixels: [Numbers; 2],
    cosines: Numbers,
    /// Of the score, without what the photo is worth.
    values: [f32; TOGETHER],
    densities: [f32; TOGETHER],
    /// In the image that the frame measured: its pixel and depth.
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
    /// Where points appear, [`TOGETHER`] or fewer.
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

    /// How one of the points that were found appears, if it does, in front, not hidden, where it was measured, and tells more than
    /// is known.
    #[inline(always)]
    pub fn of(&self, appear: &Appear, i: usize, known: &Known) -> Option<Seen> {
        if !appear.is_seen[i] {
            return None;
        }
        let cosine = appear.cosines[i];
        let look = if cosine < FLAT { Look::Flat } else { Look::Straight };
        let (least, most) = match (look, known.look) {
            (Look::Flat, Look::Straight) => return None,
            // What flat looks have shown counts no more.
            (Look::Straight, Look::Flat) => (0.0, 0.0),
            _ => (known.score, known.density),
        };
        let (value, density) = (appear.values[i], appear.densities[i]);
        if value * self.worth * self.worth <= least && density <= most {
            return None;
        }
        let tangent = (1.0 - cosine * cosine).max(0.0).sqrt() / cosine;
        let pixel = [appear.pixels[0][i], appear.pixels[1][i]];
        // The mesh was drawn from where the photo was taken.
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
    /// How far behind a point of such a depth the nearest surface around its pixel is, as a share of that: negative where something is in
    /// front. None where nothing is known. A surface of the point's own slope counts as no difference.
    ///
    /// Around a point that is seen flat, its own surface is much nearer: only what is in its pixel tells, if there is anything.
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
            // To both sides: within a pixel there is all between.
            return Some(difference.signum() * (difference.abs() - slope).max(0.0));
        }
        let slope = (self.reach + 0.5) / focal * tangent.min(MOST_TANGENT);
        let difference = nearest / at - 1.0;
        Some(if difference < 0.0 { (difference + slope).min(0.0) } else { difference })
    }
}
