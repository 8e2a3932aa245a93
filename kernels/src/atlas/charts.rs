//! Charts: parts of the surface with similar normals, each flattened into a plane.
//!
//! A chart grows from a seed triangle across its border, first to triangles whose normals are nearest to the
//! mean normal of the chart. In the chart plane no triangle is flipped or very thin. Overlaps are detected
//! texel by texel; triangles that overlap others are removed and seed new charts. Charts get more texels
//! where the photos have a higher resolution.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::bitmap::Bitmap;
use super::neighbours::{NONE, neighbours};
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, cross, dot, norm2, sub, unit};
use crate::base::progress::Progress;

/// A triangle may join a chart if the cosine between its normal and the mean normal is above `JOINS`. It is
/// removed again if the final cosine is below `STAYS`.
const JOINS: f64 = 0.72;
pub const STAYS: f64 = 0.4;
/// Factor on the cost of a triangle with two edges on the chart; favours short borders.
const TOUCHING: f64 = 0.4;
/// Maximum ratio of texel densities (texels per metre) within a chart.
pub const ALIKE: f64 = 2.5;
/// Triangles with an area below this ratio of their longest edge squared count as degenerate.
const FLAT: f64 = 1e-9;
/// Number of rotations tried over a quarter turn to minimise the bounding box of a chart.
const TURNS: usize = 18;

/// Charts of a mesh. Every triangle belongs to one, except triangles without area.
#[derive(Debug)]
pub struct Charts {
    /// Chart of each triangle; [`NONE`] for triangles without area.
    pub of: Vec<u32>,
    pub count: usize,
    /// Corners of each triangle in texels, relative to the origin of its chart's box.
    pub corners: Vec<[[f64; 2]; 3]>,
    /// Texels per metre of each chart.
    pub scales: Vec<f64>,
    pub bitmaps: Vec<Bitmap>,
}

#[derive(PartialEq)]
struct Candidate {
    cost: f64,
    triangle: u32,
}

impl Eq for Candidate {}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        other.cost.total_cmp(&self.cost).then(other.triangle.cmp(&self.triangle))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Grow charts over a surface, none wider or higher than `side` texels. `density` is the desired number of
/// texels per metre of each triangle.
///
/// # Errors
/// As [`Progress::check`].
pub fn grown<'a>(
    points: &'a [Vec3],
    triangles: &'a [[u32; 3]],
    density: &'a [f32],
    side: usize,
    progress: &mut Progress,
) -> Result<(Charts, Growth<'a>), KernelError> {
    let mut growth = Growth::new(points, triangles, density, side);
    let mut seeds: Vec<u32> =
        (0..triangles.len() as u32).filter(|&t| growth.size[t as usize] > 0.0).collect();
    seeds.sort_by(|&a, &b| growth.size[b as usize].total_cmp(&growth.size[a as usize]).then(a.cmp(&b)));
    let mut charts = Charts {
        of: vec![NONE; triangles.len()],
        count: 0,
        corners: vec![[[0.0; 2]; 3]; triangles.len()],
        scales: vec![],
        bitmaps: vec![],
    };
    // Triangles that were removed from a chart become seeds again.
    while !seeds.is_empty() {
        let mut again = vec![];
        for seed in seeds {
            if charts.of[seed as usize] != NONE {
                continue;
            }
            progress.check_now_and_then()?;
            let members = growth.grown(seed, &charts);
            charts.lay_out(&members, &growth, &mut again);
        }
        seeds = again;
    }
    Ok((charts, growth))
}

/// Working data of chart growth: mesh, normals, areas and neighbours.
pub struct Growth<'a> {
    pub points: &'a [Vec3],
    pub triangles: &'a [[u32; 3]],
    pub across: Vec<[u32; 3]>,
    normals: Vec<Vec3>,
    /// Area in square metres; 0 for degenerate triangles.
    pub size: Vec<f64>,
    pub density: &'a [f32],
    pub side: f64,
    /// Seed of the chart that last accepted each triangle.
    looked: Vec<u32>,
}

impl<'a> Growth<'a> {
    fn new(points: &'a [Vec3], triangles: &'a [[u32; 3]], density: &'a [f32], side: usize) -> Self {
        let corners = |t: &[u32; 3]| t.map(|v| points[v as usize]);
        let (mut normals, mut size) = (vec![], vec![]);
        for t in triangles {
            let [a, b, c] = corners(t);
            let normal = cross(&sub(&b, &a), &sub(&c, &a));
            let twice = norm2(&normal).sqrt();
            let longest2 = norm2(&sub(&b, &a)).max(norm2(&sub(&c, &b))).max(norm2(&sub(&a, &c)));
            normals.push(unit(&normal));
            size.push(if twice > FLAT * longest2 { twice / 2.0 } else { 0.0 });
        }
        let across = neighbours(triangles, &size);
        let looked = vec![NONE; triangles.len()];
        Self { points, triangles, across, normals, size, density, side: side as f64, looked }
    }

    /// Collect the triangles of the chart that grows from a seed, seed first.
    fn grown(&mut self, seed: u32, charts: &Charts) -> Vec<u32> {
        let start = seed as usize;
        let [u, v] = plane(&self.normals[start]);
        let alike = f64::from(self.density[start]).max(f64::MIN_POSITIVE);
        let mut members = vec![];
        let mut sum = [0.0; 3];
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        let mut front = BinaryHeap::from([Candidate { cost: 0.0, triangle: seed }]);
        while let Some(Candidate { triangle, .. }) = front.pop() {
            let t = triangle as usize;
            if self.looked[t] == seed {
                continue;
            }
            let axis = if members.is_empty() { self.normals[t] } else { unit(&sum) };
            if dot(&self.normals[t], &axis) < JOINS {
                continue;
            }
            let (mut lower, mut higher) = (low, high);
            for p in self.triangles[t].map(|v| self.points[v as usize]) {
                for (k, direction) in [&u, &v].into_iter().enumerate() {
                    let place = dot(direction, &p) * alike;
                    lower[k] = lower[k].min(place);
                    higher[k] = higher[k].max(place);
                }
            }
            // A box rotated by an eighth turn can be as long as its diagonal.
            if !members.is_empty() && (higher[0] - lower[0]).hypot(higher[1] - lower[1]) > self.side {
                continue;
            }
            (low, high) = (lower, higher);
            self.looked[t] = seed;
            members.push(triangle);
            sum = [0, 1, 2].map(|i| sum[i] + self.size[t] * self.normals[t][i]);
            let axis = unit(&sum);
            for next in self.across[t] {
                let n = next as usize;
                if next == NONE || charts.of[n] != NONE || self.looked[n] == seed || self.size[n] == 0.0 {
                    continue;
                }
                let ratio = f64::from(self.density[n]) / alike;
                let cosine = dot(&self.normals[n], &axis);
                if cosine < JOINS || !(1.0 / ALIKE..=ALIKE).contains(&ratio) {
                    continue;
                }
                let touching =
                    self.across[n].iter().filter(|&&o| o != NONE && self.looked[o as usize] == seed);
                let share = if touching.count() > 1 { TOUCHING } else { 1.0 };
                front.push(Candidate { cost: (1.0 - cosine) * share, triangle: next });
            }
        }
        members
    }
}

impl Charts {
    /// Flatten triangles into the plane of a new chart; triangles that do not fit are appended to `again`.
    fn lay_out(&mut self, members: &[u32], growth: &Growth<'_>, again: &mut Vec<u32>) {
        let mut sum = [0.0; 3];
        let (mut area, mut texels) = (0.0, 0.0);
        for &t in members {
            let t = t as usize;
            sum = [0, 1, 2].map(|i| sum[i] + growth.size[t] * growth.normals[t][i]);
            area += growth.size[t];
            texels += growth.size[t] * f64::from(growth.density[t]);
        }
        let axis = unit(&sum);
        let mut scale = texels / area;
        let mut flat = best_turn(members, growth, &axis, scale);
        // A triangle may be larger than an image, and densities differ within a chart.
        let longest = flat.iter().flatten().flatten().fold(0.0, |a: f64, &b| a.max(b));
        if longest > growth.side {
            flat.iter_mut().flatten().flatten().for_each(|x| *x *= growth.side / longest);
            scale *= growth.side / longest;
        }
        let mut bitmap = Bitmap::around(&flat);
        let number = self.count as u32;
        for (&t, corners) in members.iter().zip(&flat) {
            let leaves = dot(&growth.normals[t as usize], &axis) < STAYS || !bitmap.claim(corners);
            // The chart of a single triangle always fits.
            if leaves && members.len() > 1 {
                again.push(t);
            } else {
                (self.of[t as usize], self.corners[t as usize]) = (number, *corners);
            }
        }
        self.scales.push(scale);
        self.bitmaps.push(bitmap);
        self.count += 1;
    }
}

/// Project triangles onto the plane perpendicular to an axis, rotated to the smallest box, and shift the box
/// to the origin.
fn best_turn(members: &[u32], growth: &Growth<'_>, axis: &Vec3, scale: f64) -> Vec<[[f64; 2]; 3]> {
    let [u, v] = plane(axis);
    let flat: Vec<[[f64; 2]; 3]> = members
        .iter()
        .map(|&t| {
            growth.triangles[t as usize].map(|corner| {
                let p = &growth.points[corner as usize];
                [scale * dot(&u, p), scale * dot(&v, p)]
            })
        })
        .collect();
    let turned = |p: &[f64; 2], [c, s]: [f64; 2]| [c * p[0] - s * p[1], s * p[0] + c * p[1]];
    let extent = |turn: [f64; 2]| {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in flat.iter().flatten().map(|p| turned(p, turn)) {
            for k in 0..2 {
                (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
            }
        }
        (low, high)
    };
    let (mut best, mut least) = ([1.0, 0.0], f64::INFINITY);
    for step in 0..TURNS {
        let angle = std::f64::consts::FRAC_PI_2 * step as f64 / TURNS as f64;
        let (low, high) = extent([angle.cos(), angle.sin()]);
        let room = (high[0] - low[0] + 1.0) * (high[1] - low[1] + 1.0);
        if room < least * (1.0 - 1e-9) {
            let upright = high[1] - low[1] >= high[0] - low[0];
            // Another quarter turn makes the box higher than wide, which suits the packer.
            (best, least) =
                (if upright { [angle.cos(), angle.sin()] } else { [-angle.sin(), angle.cos()] }, room);
        }
    }
    let (low, _) = extent(best);
    flat.iter()
        .map(|corners| {
            corners.map(|p| {
                let p = turned(&p, best);
                [p[0] - low[0], p[1] - low[1]]
            })
        })
        .collect()
}

/// Compute two unit vectors perpendicular to a normal and to each other.
fn plane(normal: &Vec3) -> [Vec3; 2] {
    let least = (0..3).min_by(|&i, &j| normal[i].abs().total_cmp(&normal[j].abs())).unwrap_or(0);
    let mut other = [0.0; 3];
    other[least] = 1.0;
    let u = unit(&cross(normal, &other));
    [u, cross(normal, &u)]
}
