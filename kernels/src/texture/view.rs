//! A photo with what its camera sees, and the colour of a point of the surface in it.

use std::sync::Arc;

use super::pinhole::Pinhole;
use crate::base::geometry::{Vec3, dot, norm2, sub};

/// What a surface shows that is seen flatter than at this cosine is taken only where no photo shows it better.
const FLAT: f64 = 0.15;
/// Surfaces this share of their distance apart are one, and so are the surface and its measured depth.
const SAME_DEPTH: f64 = 0.016;
const SAME_MEASURED_DEPTH: f64 = 0.03;
/// Slopes are steeper than this for no reason but noise.
const MOST_TANGENT: f64 = 4.0;
/// Of the image's width, where views begin to fade out.
const FADE: f64 = 0.03;
/// Levels beyond which a channel is cut off, and what such a view is worth.
const DARK: f32 = 4.0;
const BRIGHT: f32 = 250.0;
const CUT_OFF: f32 = 0.3;
/// What a view is worth where its own camera measured no depth.
const UNMEASURED: f32 = 0.5;

/// An image of three channels, a row after another.
#[derive(Debug)]
pub struct Photo {
    pub width: usize,
    pub height: usize,
    /// Red, green, blue, and nothing: four at a time are read at once.
    pub pixels: Vec<[u8; 4]>,
}

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
    /// The colours of a point that is known to appear.
    pub fn of(&self, place: &Vec3) -> ([f32; 3], [f32; 3]) {
        self.at(self.camera.pixel(&self.camera.in_camera(place)))
    }

    /// The colour at a pixel, and that of the blurred photo.
    fn at(&self, pixel: [f64; 2]) -> ([f32; 3], [f32; 3]) {
        let place = self.warped(pixel);
        (self.photo.cubic(place), self.blurred.linear(place))
    }

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

/// A point in a photo; without colours, and of score 0, where the photo is not among the best.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Not [`Look::None`].
    pub look: Look,
    pub score: f32,
    pub color: [f32; 3],
    pub blurred: [f32; 3],
    /// Pixels a metre, across the slope.
    pub density: f32,
}

impl View {
    /// How a point of the surface appears, if it does, in front, not hidden, where it was measured, and tells more than is known.
    pub fn of(&self, place: &Vec3, normal: &Vec3, known: &Known) -> Option<Seen> {
        let camera = &self.colors.camera;
        let p = camera.in_camera(place);
        if p[2] <= 0.0 {
            return None;
        }
        let pixel @ [x, y] = camera.pixel(&p);
        let (width, height) = (camera.width as f64, camera.height as f64);
        let edge = (x + 0.5).min(y + 0.5).min(width - 0.5 - x).min(height - 0.5 - y);
        if edge < 1.0 {
            return None;
        }
        let towards = sub(&self.place, place);
        let distance2 = norm2(&towards);
        let cosine = dot(&towards, normal) / distance2.sqrt();
        if cosine < self.flattest {
            return None;
        }
        let look = if cosine < FLAT { Look::Flat } else { Look::Straight };
        let (least, most) = match (look, known.look) {
            (Look::Flat, Look::Straight) => return None,
            // What flat looks have shown counts no more.
            (Look::Straight, Look::Flat) => (0.0, 0.0),
            _ => (known.score, known.density),
        };
        let fade = (edge / (FADE * width)).min(1.0);
        let density2 = camera.focal[0] * camera.focal[1] / distance2;
        let value = (cosine * fade * density2) as f32;
        let density = (camera.focal[0] / p[2]) as f32;
        if value * self.worth * self.worth <= least && density <= most {
            return None;
        }
        let tangent = (1.0 - cosine * cosine).max(0.0).sqrt() / cosine;
        // The mesh was drawn from where the photo was taken.
        if self.mesh.difference(&p, tangent, look)? < -SAME_DEPTH {
            return None;
        }
        let mut worth = self.worth;
        match self
            .measured
            .as_ref()
            .and_then(|measured| measured.difference(&measured.camera.in_camera(place), tangent, look))
        {
            None if self.measured.is_some() => worth *= UNMEASURED,
            Some(difference) if difference.abs() > SAME_MEASURED_DEPTH => return None,
            _ => {}
        }
        let mut score = value * worth * worth;
        if score <= least {
            return Some(Seen { look, score: 0.0, density, color: [0.0; 3], blurred: [0.0; 3] });
        }
        let (color, blurred) = self.colors.at(pixel);
        if color.iter().any(|level| !(DARK..=BRIGHT).contains(level)) {
            score *= CUT_OFF;
        }
        Some(Seen { look, score, density, color, blurred })
    }
}

/// The cell of a row of `count` values that a place is in, and how far.
#[inline]
fn cell(place: f64, count: usize) -> (usize, f64) {
    // Of 32 bits, which processors convert at once.
    let i = (place.max(0.0) as i32).min(count as i32 - 2);
    (i as usize, (place - f64::from(i)).clamp(0.0, 1.0))
}

impl Depths {
    /// How far behind a point in camera axes the nearest surface around its pixel is, as a share of its depth: negative where something is
    /// in front. None where nothing is known. A surface of the point's own slope counts as no difference.
    ///
    /// Around a point that is seen flat, its own surface is much nearer: only what is in its pixel tells, if there is anything.
    #[inline]
    fn difference(&self, p: &Vec3, tangent: f64, look: Look) -> Option<f64> {
        if p[2] <= 0.0 {
            return None;
        }
        let pixel = self.camera.nearest(self.camera.pixel(p))?;
        let [nearest, exact] = [&self.nearest, &self.exact].map(|depths| f64::from(depths[pixel]));
        let is_there = |depth: f64| depth > 0.0 && depth.is_finite();
        if !is_there(nearest) {
            return None;
        }
        let focal = self.camera.focal[0];
        if look == Look::Flat {
            let (depth, pixels) = if is_there(exact) { (exact, 1.0) } else { (nearest, self.reach + 0.5) };
            let difference = depth / p[2] - 1.0;
            let slope = pixels / focal * tangent;
            // To both sides: within a pixel there is all between.
            return Some(difference.signum() * (difference.abs() - slope).max(0.0));
        }
        let slope = (self.reach + 0.5) / focal * tangent.min(MOST_TANGENT);
        let difference = nearest / p[2] - 1.0;
        Some(if difference < 0.0 { (difference + slope).min(0.0) } else { difference })
    }
}

impl Photo {
    /// Between four pixels.
    pub fn linear(&self, place: [f64; 2]) -> [f32; 3] {
        let [red, green, blue, _] = self.of_four(place);
        [red, green, blue]
    }

    /// Between sixteen pixels, by Catmull and Rom's cubic, which keeps details that four would blur.
    pub fn cubic(&self, place: [f64; 2]) -> [f32; 3] {
        let [red, green, blue, _] = self.of_sixteen(place);
        [red, green, blue].map(|level| level.clamp(0.0, 255.0))
    }

    /// Not inlined: where it is seen that the fourth channel is not needed, the three are computed one by one.
    #[inline(never)]
    fn of_four(&self, [x, y]: [f64; 2]) -> [f32; 4] {
        let (i, s) = cell(x, self.width);
        let (j, t) = cell(y, self.height);
        let (s, t) = (s as f32, t as f32);
        let mut sum = [0.0; 4];
        for (row, weight) in [(j, 1.0 - t), (j + 1, t)] {
            let pair = &self.pixels[row * self.width + i..][..2];
            add(&mut sum, weight * (1.0 - s), &pair[0].map(f32::from));
            add(&mut sum, weight * s, &pair[1].map(f32::from));
        }
        sum
    }

    /// Likewise.
    #[inline(never)]
    fn of_sixteen(&self, [x, y]: [f64; 2]) -> [f32; 4] {
        let (i, s) = cell(x, self.width);
        let (j, t) = cell(y, self.height);
        let (along, down) = (catmull_rom(s as f32), catmull_rom(t as f32));
        let columns = [0, 1, 2, 3].map(|k| (i + k).saturating_sub(1).min(self.width - 1));
        let mut sum = [0.0; 4];
        for (k, weight) in down.iter().enumerate() {
            let row = (j + k).saturating_sub(1).min(self.height - 1) * self.width;
            let line = &self.pixels[row..row + self.width];
            for (&column, share) in columns.iter().zip(&along) {
                add(&mut sum, weight * share, &line[column].map(f32::from));
            }
        }
        sum
    }
}

/// sum + t·color
#[inline]
fn add(sum: &mut [f32; 4], t: f32, color: &[f32; 4]) {
    for (sum, level) in sum.iter_mut().zip(color) {
        *sum += t * level;
    }
}

fn catmull_rom(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (-t3 + 2.0 * t2 - t),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (-3.0 * t3 + 4.0 * t2 + t),
        0.5 * (t3 - t2),
    ]
}
