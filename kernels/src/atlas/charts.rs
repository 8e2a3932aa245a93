//! Charts: parts of the surface with similar normals, each flattened into a plane.
//!
//! A chart grows from a seed triangle across its border, first to triangles whose normals are nearest to the
//! mean normal of the chart. In the chart plane no triangle is flipped or very thin. Overlaps are detected
//! texel by texel; triangles that overlap others are removed and seed new charts. Charts get more texels
//! where the photos have a higher resolution.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::chart_bitmap::ChartBitmap;
use super::triangle_adjacency::{NO_TRIANGLE, find_neighbours};
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, cross, dot, norm2, normalize, sub};
use crate::base::progress::Progress;

/// A triangle may join a chart if the cosine between its normal and the mean normal is above `MIN_JOIN_COSINE`. It is
/// removed again if the final cosine is below `MIN_KEPT_COSINE`.
const MIN_JOIN_COSINE: f64 = 0.72;
pub const MIN_KEPT_COSINE: f64 = 0.4;
/// Factor on the cost of a triangle with two edges on the chart; favours short borders.
const TWO_EDGE_COST_FACTOR: f64 = 0.4;
/// Maximum ratio of texel densities (texels per metre) within a chart.
pub const MAX_DENSITY_RATIO: f64 = 2.5;
/// Triangles with an area below this ratio of their longest edge squared count as degenerate.
const MIN_RELATIVE_AREA: f64 = 1e-9;
/// Number of rotations tried over a quarter turn to minimise the bounding box of a chart.
const ROTATION_COUNT: usize = 18;

/// Charts of a mesh. Every triangle belongs to one, except triangles without area.
#[derive(Debug)]
pub struct Charts {
    /// Chart of each triangle; [`NONE`] for triangles without area.
    pub chart_of_triangle: Vec<u32>,
    pub count: usize,
    /// Corners of each triangle in texels, relative to the origin of its chart's box.
    pub corners: Vec<[[f64; 2]; 3]>,
    /// Texels per metre of each chart.
    pub scales: Vec<f64>,
    pub bitmaps: Vec<ChartBitmap>,
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
pub fn grow_charts<'a>(
    points: &'a [Vec3],
    triangles: &'a [[u32; 3]],
    density: &'a [f32],
    side: usize,
    progress: &mut Progress,
) -> Result<(Charts, ChartGrowth<'a>), KernelError> {
    let mut growth = ChartGrowth::new(points, triangles, density, side);
    let mut seeds: Vec<u32> =
        (0..triangles.len() as u32).filter(|&t| growth.areas[t as usize] > 0.0).collect();
    seeds.sort_by(|&a, &b| growth.areas[b as usize].total_cmp(&growth.areas[a as usize]).then(a.cmp(&b)));
    let mut charts = Charts {
        chart_of_triangle: vec![NO_TRIANGLE; triangles.len()],
        count: 0,
        corners: vec![[[0.0; 2]; 3]; triangles.len()],
        scales: vec![],
        bitmaps: vec![],
    };
    // Triangles that were removed from a chart become seeds again.
    while !seeds.is_empty() {
        let mut again = vec![];
        for seed in seeds {
            if charts.chart_of_triangle[seed as usize] != NO_TRIANGLE {
                continue;
            }
            progress.check_periodically()?;
            let members = growth.grow_chart(seed, &charts);
            charts.flatten_chart(&members, &growth, &mut again);
        }
        seeds = again;
    }
    Ok((charts, growth))
}

/// Working data of chart growth: mesh, normals, areas and neighbours.
pub struct ChartGrowth<'a> {
    pub points: &'a [Vec3],
    pub triangles: &'a [[u32; 3]],
    pub neighbours: Vec<[u32; 3]>,
    normals: Vec<Vec3>,
    /// Area in square metres; 0 for degenerate triangles.
    pub areas: Vec<f64>,
    pub density: &'a [f32],
    pub side: f64,
    /// Seed of the chart that last accepted each triangle.
    last_seed: Vec<u32>,
}

impl<'a> ChartGrowth<'a> {
    fn new(points: &'a [Vec3], triangles: &'a [[u32; 3]], density: &'a [f32], side: usize) -> Self {
        let corners = |t: &[u32; 3]| t.map(|v| points[v as usize]);
        let (mut normals, mut size) = (vec![], vec![]);
        for t in triangles {
            let [a, b, c] = corners(t);
            let normal = cross(&sub(&b, &a), &sub(&c, &a));
            let twice = norm2(&normal).sqrt();
            let longest2 = norm2(&sub(&b, &a)).max(norm2(&sub(&c, &b))).max(norm2(&sub(&a, &c)));
            normals.push(normalize(&normal));
            size.push(if twice > MIN_RELATIVE_AREA * longest2 { twice / 2.0 } else { 0.0 });
        }
        let across = find_neighbours(triangles, &size);
        let looked = vec![NO_TRIANGLE; triangles.len()];
        Self {
            points,
            triangles,
            neighbours: across,
            normals,
            areas: size,
            density,
            side: side as f64,
            last_seed: looked,
        }
    }

    /// Collect the triangles of the chart that grows from a seed, seed first.
    fn grow_chart(&mut self, seed: u32, charts: &Charts) -> Vec<u32> {
        let start = seed as usize;
        let [u, v] = tangent_axes(&self.normals[start]);
        let alike = f64::from(self.density[start]).max(f64::MIN_POSITIVE);
        let mut members = vec![];
        let mut sum = [0.0; 3];
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        let mut front = BinaryHeap::from([Candidate { cost: 0.0, triangle: seed }]);
        while let Some(Candidate { triangle, .. }) = front.pop() {
            let t = triangle as usize;
            if self.last_seed[t] == seed {
                continue;
            }
            let axis = if members.is_empty() { self.normals[t] } else { normalize(&sum) };
            if dot(&self.normals[t], &axis) < MIN_JOIN_COSINE {
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
            self.last_seed[t] = seed;
            members.push(triangle);
            sum = [0, 1, 2].map(|i| sum[i] + self.areas[t] * self.normals[t][i]);
            let axis = normalize(&sum);
            for next in self.neighbours[t] {
                let n = next as usize;
                if next == NO_TRIANGLE
                    || charts.chart_of_triangle[n] != NO_TRIANGLE
                    || self.last_seed[n] == seed
                    || self.areas[n] == 0.0
                {
                    continue;
                }
                let ratio = f64::from(self.density[n]) / alike;
                let cosine = dot(&self.normals[n], &axis);
                if cosine < MIN_JOIN_COSINE || !(1.0 / MAX_DENSITY_RATIO..=MAX_DENSITY_RATIO).contains(&ratio)
                {
                    continue;
                }
                let touching = self.neighbours[n]
                    .iter()
                    .filter(|&&o| o != NO_TRIANGLE && self.last_seed[o as usize] == seed);
                let share = if touching.count() > 1 { TWO_EDGE_COST_FACTOR } else { 1.0 };
                front.push(Candidate { cost: (1.0 - cosine) * share, triangle: next });
            }
        }
        members
    }
}

impl Charts {
    /// Flatten triangles into the plane of a new chart; triangles that do not fit are appended to `again`.
    fn flatten_chart(&mut self, members: &[u32], growth: &ChartGrowth<'_>, again: &mut Vec<u32>) {
        let mut sum = [0.0; 3];
        let (mut area, mut texels) = (0.0, 0.0);
        for &t in members {
            let t = t as usize;
            sum = [0, 1, 2].map(|i| sum[i] + growth.areas[t] * growth.normals[t][i]);
            area += growth.areas[t];
            texels += growth.areas[t] * f64::from(growth.density[t]);
        }
        let axis = normalize(&sum);
        let mut scale = texels / area;
        let mut flat = flatten_to_smallest_box(members, growth, &axis, scale);
        // A triangle may be larger than an image, and densities differ within a chart.
        let longest = flat.iter().flatten().flatten().fold(0.0, |a: f64, &b| a.max(b));
        if longest > growth.side {
            flat.iter_mut().flatten().flatten().for_each(|x| *x *= growth.side / longest);
            scale *= growth.side / longest;
        }
        let mut bitmap = ChartBitmap::covering(&flat);
        let number = self.count as u32;
        for (&t, corners) in members.iter().zip(&flat) {
            let leaves = dot(&growth.normals[t as usize], &axis) < MIN_KEPT_COSINE || !bitmap.claim(corners);
            // The chart of a single triangle always fits.
            if leaves && members.len() > 1 {
                again.push(t);
            } else {
                (self.chart_of_triangle[t as usize], self.corners[t as usize]) = (number, *corners);
            }
        }
        self.scales.push(scale);
        self.bitmaps.push(bitmap);
        self.count += 1;
    }
}

/// Project triangles onto the plane perpendicular to an axis, rotated to the smallest box, and shift the box
/// to the origin.
fn flatten_to_smallest_box(
    members: &[u32],
    growth: &ChartGrowth<'_>,
    axis: &Vec3,
    scale: f64,
) -> Vec<[[f64; 2]; 3]> {
    let [u, v] = tangent_axes(axis);
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
    for step in 0..ROTATION_COUNT {
        let angle = std::f64::consts::FRAC_PI_2 * step as f64 / ROTATION_COUNT as f64;
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
fn tangent_axes(normal: &Vec3) -> [Vec3; 2] {
    let least = (0..3).min_by(|&i, &j| normal[i].abs().total_cmp(&normal[j].abs())).unwrap_or(0);
    let mut other = [0.0; 3];
    other[least] = 1.0;
    let u = normalize(&cross(normal, &other));
    [u, cross(normal, &u)]
}
