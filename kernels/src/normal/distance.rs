//! How far a level and the input are apart, from samples of both.

use super::level::Level;
use super::surface::Surface;
use crate::geometry::{Vec3, area};
use crate::parallel::fill;

/// The larger of both directions.
#[derive(Clone, Debug, PartialEq)]
pub struct Distance {
    pub largest: f64,
    pub mean_square: f64,
    /// Squared, from each vertex of the input to the level.
    pub from_input: Vec<f64>,
}

/// Most samples along a side of a triangle.
const MOST: usize = 24;

/// From each vertex of the input, and from about as many points of the level, evenly over each of its triangles.
pub fn distance(
    points: &[Vec3],
    triangles: &[[u32; 3]],
    surface: &Surface,
    level: &Level,
    threads: usize,
) -> Distance {
    let fine = Surface::new(&level.points, &level.topology.triangles, threads);
    let mut from_input = vec![0.0; points.len()];
    fill(&mut from_input, threads, |v| fine.distance2(&points[v]));

    let own = &level.topology.triangles;
    let side = ((triangles.len() as f64 / own.len().max(1) as f64).sqrt().ceil() as usize).clamp(2, MOST);
    let mut from_level = vec![[0.0; 2]; own.len()];
    fill(&mut from_level, threads, |t| {
        let corners = own[t].map(|v| &level.points[v as usize]);
        let (mut sum, mut largest) = (0.0, 0.0f64);
        // Middles of the small triangles that stand upright when each side is cut into so many parts.
        for i in 0..side {
            for j in 0..side - i {
                let [u, v] = [i, j].map(|k| (k as f64 + 1.0 / 3.0) / side as f64);
                let weights = [u, v, 1.0 - u - v];
                let p: Vec3 = std::array::from_fn(|x| (0..3).map(|k| weights[k] * corners[k][x]).sum());
                let distance2 = surface.distance2(&p);
                sum += distance2;
                largest = largest.max(distance2);
            }
        }
        [sum / (side * (side + 1) / 2) as f64, largest]
    });

    let mean = |triangles: &[[u32; 3]], points: &[Vec3], of: &dyn Fn(usize, &[u32; 3]) -> f64| {
        let (mut sum, mut whole) = (0.0, 0.0);
        for (t, corners) in triangles.iter().enumerate() {
            let area = area(corners.map(|v| &points[v as usize]));
            sum += area * of(t, corners);
            whole += area;
        }
        if whole > 0.0 { sum / whole } else { 0.0 }
    };
    let there = mean(triangles, points, &|_, t| t.iter().map(|&v| from_input[v as usize]).sum::<f64>() / 3.0);
    let back = mean(own, &level.points, &|t, _| from_level[t][0]);
    let used = triangles.iter().flatten().map(|&v| from_input[v as usize]);
    let largest2 = used.chain(from_level.iter().map(|[_, largest]| *largest)).fold(0.0, f64::max);
    Distance { largest: largest2.sqrt(), mean_square: there.max(back), from_input }
}
