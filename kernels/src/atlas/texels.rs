//! Triangle and barycentric weights of each texel, also for texels just outside a chart.

use std::ops::Range;

use super::triangle_adjacency::NO_TRIANGLE;
use crate::base::geometry::Vec3;
use crate::base::parallel::{collect, resolve_thread_count};

/// Texels beyond the border of a chart that get its colours, so that bilinear filtering is correct at the
/// border.
const GUTTER_TEXELS: f64 = 1.5;

/// Iterate over rows, each with the columns whose texel centres are inside a triangle. Both triangles at an
/// edge compute the same crossings, so they share no texel and leave no gap.
pub fn scanline_spans(
    corners: &[[f64; 2]; 3],
    width: usize,
    height: usize,
) -> impl Iterator<Item = (usize, Range<usize>)> + use<> {
    let mut sorted = *corners;
    sorted.sort_by(|a, b| a[1].total_cmp(&b[1]).then(a[0].total_cmp(&b[0])));
    let [a, b, c] = sorted;
    let rows = pixel_range(a[1], c[1], height);
    rows.map(move |row| {
        let y = row as f64 + 0.5;
        let (p, q) = if y >= b[1] { (b, c) } else { (a, b) };
        let (long, short) = (crossing_x(a, c, y), crossing_x(p, q, y));
        (row, pixel_range(long.min(short), long.max(short), width))
    })
}

fn pixel_range(low: f64, high: f64, size: usize) -> Range<usize> {
    // Rounded up by hand, because `ceil` is a function call without SSE4.1.
    let bound = |at: f64| {
        let at = (at - 0.5).clamp(0.0, size as f64);
        at as usize + usize::from(at > (at as usize) as f64)
    };
    bound(low)..bound(high).max(bound(low))
}

fn crossing_x(a: [f64; 2], b: [f64; 2], y: f64) -> f64 {
    let height = b[1] - a[1];
    if height > 0.0 { a[0] + (y - a[1]) / height * (b[0] - a[0]) } else { a[0] }
}

/// Texels of one image, sorted by triangle.
#[derive(Debug, Default)]
pub struct Texels {
    /// Pixel index: row × width + column.
    pub pixels: Vec<u32>,
    pub triangles: Vec<u32>,
    /// Barycentric weights in the triangle.
    pub weights: Vec<[f32; 3]>,
}

/// Find the texels of one image: inside the triangles, and up to [`GUTTER_TEXELS`] texels outside their borders.
///
/// `corners` are in texels; the centre of the first texel is at (0.5, 0.5). Triangles of other images are
/// skipped.
pub fn rasterize_texels(
    corners: &[[[f64; 2]; 3]],
    is_here: impl Fn(usize) -> bool,
    width: usize,
    height: usize,
) -> Texels {
    let mut owner = vec![NO_TRIANGLE; width * height];
    let here: Vec<usize> = (0..corners.len()).filter(|&t| is_here(t)).collect();
    for &t in &here {
        for (row, columns) in scanline_spans(&corners[t], width, height) {
            owner[row * width..][columns].fill(t as u32);
        }
    }
    let inside: Vec<bool> = owner.iter().map(|&t| t != NO_TRIANGLE).collect();
    let mut nearest = vec![f32::INFINITY; width * height];
    for &t in &here {
        let place =
            |k: usize, by: fn(f64, f64) -> f64| corners[t].iter().map(|p| p[k]).reduce(by).unwrap_or(0.0);
        let range = |k: usize, size: usize| {
            let low = (place(k, f64::min) - GUTTER_TEXELS).floor().max(0.0) as usize;
            low..((place(k, f64::max) + GUTTER_TEXELS).ceil().max(0.0) as usize).min(size)
        };
        for y in range(1, height) {
            for x in range(0, width) {
                let i = y * width + x;
                if inside[i] {
                    continue;
                }
                let centre = [x as f64 + 0.5, y as f64 + 0.5];
                let distance = (distance2(&corners[t], centre) as f32).sqrt();
                if distance <= GUTTER_TEXELS as f32 && distance < nearest[i] {
                    (nearest[i], owner[i]) = (distance, t as u32);
                }
            }
        }
    }
    drop((inside, nearest));
    // Start index of each triangle's texels (counting sort).
    let mut next = vec![0usize; corners.len() + 1];
    owner.iter().filter(|&&t| t != NO_TRIANGLE).for_each(|&t| next[t as usize + 1] += 1);
    (0..corners.len()).for_each(|t| next[t + 1] += next[t]);
    let count = next[corners.len()];
    let (mut pixels, mut triangles) = (vec![0; count], vec![0; count]);
    for (i, &t) in (0..).zip(&owner).filter(|&(_, &t)| t != NO_TRIANGLE) {
        let place = &mut next[t as usize];
        (pixels[*place], triangles[*place]) = (i, t);
        *place += 1;
    }
    let shares = collect(count, resolve_thread_count(0), |k| {
        let i = pixels[k] as usize;
        let centre = [(i % width) as f64 + 0.5, (i / width) as f64 + 0.5];
        barycentric_weights(&corners[triangles[k] as usize], centre).map(|share| share as f32)
    });
    Texels { pixels, triangles, weights: shares }
}

/// Compute the barycentric weights of the point of a triangle nearest to a point.
pub fn barycentric_weights(corners: &[[f64; 2]; 3], p: [f64; 2]) -> [f64; 3] {
    let [a, b, c] = corners;
    let area = doubled_area(a, b, c);
    if area != 0.0 {
        let inside =
            [doubled_area(b, c, &p) / area, doubled_area(c, a, &p) / area, doubled_area(a, b, &p) / area];
        if inside.iter().all(|&share| share >= 0.0) {
            return inside;
        }
    }
    let mut best = ([1.0, 0.0, 0.0], f64::INFINITY);
    for k in 0..3 {
        let (t, distance) = nearest_on_segment(&corners[k], &corners[(k + 1) % 3], p);
        if distance < best.1 {
            let mut found = [0.0; 3];
            (found[k], found[(k + 1) % 3]) = (1.0 - t, t);
            best = (found, distance);
        }
    }
    best.0
}

/// Compute the squared distance from a point to the border of a triangle.
pub fn distance2(corners: &[[f64; 2]; 3], p: [f64; 2]) -> f64 {
    (0..3).map(|k| nearest_on_segment(&corners[k], &corners[(k + 1) % 3], p).1).fold(f64::INFINITY, f64::min)
}

/// Find the position along a segment (0 to 1) nearest to a point, and the squared distance.
fn nearest_on_segment(a: &[f64; 2], b: &[f64; 2], p: [f64; 2]) -> (f64, f64) {
    let (d, e) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let length2 = d[0] * d[0] + d[1] * d[1];
    let t = if length2 > 0.0 { ((d[0] * e[0] + d[1] * e[1]) / length2).clamp(0.0, 1.0) } else { 0.0 };
    (t, (e[0] - t * d[0]).powi(2) + (e[1] - t * d[1]).powi(2))
}

fn doubled_area(a: &[f64; 2], b: &[f64; 2], c: &[f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Compute the surface point (in mesh coordinates) of each texel.
pub fn texel_positions(texels: &Texels, points: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    texels
        .triangles
        .iter()
        .zip(&texels.weights)
        .map(|(&t, shares)| interpolate(shares, &triangles[t as usize].map(|v| points[v as usize])))
        .collect()
}

/// Interpolate three values with barycentric weights.
pub fn interpolate(shares: &[f32; 3], values: &[Vec3; 3]) -> Vec3 {
    [0, 1, 2].map(|k| (0..3).map(|c| f64::from(shares[c]) * values[c][k]).sum())
}
