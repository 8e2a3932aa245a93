//! Shape error caused by a colour weight, measured on a sample of the mesh.
//!
//! The input alone does not show how far colours pull vertices away from the best shape. On a machined part
//! with a photographic texture, planes and edges are met exactly unless colours count. So a small mesh, or
//! patches of a large one, are simplified with and without colours.

use crate::base::errors::KernelError;
use crate::base::geometry::{bounding_box, cross, diagonal, norm2, position_of, sub};
use crate::base::parallel::fill;
use crate::base::progress::Progress;
use crate::certify::Surface;
use crate::collapse::rounds::{Goal, REGION_TRIANGLES};
use crate::collapse::whole_mesh::WholeMesh;
use crate::quadric::color_weight::{grid_cell, hash_cell};
use crate::quadric::qem::QemState;
use crate::quadric::simplify::{MIN_LEFT, simplify_in_passes};

/// Maximum ratio of the shape error with colours to the error without.
const MAX_SHAPE_ERROR_RATIO: f64 = 1.2;

/// Number of triangles of the first sample, and of the sample that decides.
const FIRST_SAMPLE_TRIANGLES: usize = 1 << 13;
const DECIDING_SAMPLE_TRIANGLES: usize = 1 << 15;

/// Mean and minimum number of triangles of a patch.
const PATCH_TRIANGLES: usize = 1 << 11;
const MIN_PATCH_TRIANGLES: usize = 1 << 9;

/// Shape errors below this ratio of the diagonal count as zero.
const MIN_SHAPE_ERROR_RATIO: f64 = 1e-6;

/// The distance of every n-th vertex is measured.
const VERTICES_PER_DISTANCE: usize = 4;

/// Maximum number of weights to try. Each next weight assumes that the additional error grows with the
/// weight.
const MAX_TRIALS: usize = 6;

/// Find the largest weight ≤ `weight` whose shape error is acceptable.
///
/// With `target` triangles left, it increases the shape error by at most a fifth. A non-manifold mesh keeps
/// the weight.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn find_max_color_weight<const D: usize, const K: usize>(
    points: &[[f64; D]],
    triangles: &[[u32; 3]],
    target: usize,
    weight: f64,
    threads: usize,
    progress: &mut Progress,
) -> Result<f64, KernelError> {
    let share = target as f64 / triangles.len() as f64;
    let mut tried = |size, trials| {
        take_sample(points, triangles, size, threads)
            .find_max_weight::<K>(share, weight, trials, threads, progress)
    };
    // A small sample may be wrong: if it rejects the weight, a larger one decides.
    if is_larger(triangles, FIRST_SAMPLE_TRIANGLES) && tried(FIRST_SAMPLE_TRIANGLES, 1)? == weight {
        return Ok(weight);
    }
    tried(DECIDING_SAMPLE_TRIANGLES, MAX_TRIALS)
}

/// Test if the mesh is clearly larger than a sample of this size.
fn is_larger(triangles: &[[u32; 3]], size: usize) -> bool {
    triangles.len() > size + size / 2
}

/// A mesh on which weights are tried.
struct MeshSample<const D: usize> {
    points: Vec<[f64; D]>,
    triangles: Vec<[u32; 3]>,
    /// Number of triangles that the passes leave to the collapse engine at least: as in the simplification of
    /// the complete mesh.
    left_by_passes: usize,
}

/// Return the mesh, or patches of it from random grid cells; the result does not depend on the number of
/// threads.
fn take_sample<const D: usize>(
    points: &[[f64; D]],
    triangles: &[[u32; 3]],
    size: usize,
    threads: usize,
) -> MeshSample<D> {
    if !is_larger(triangles, size) {
        return MeshSample {
            points: points.to_vec(),
            triangles: triangles.to_vec(),
            left_by_passes: MIN_LEFT,
        };
    }
    let corner = |t: &[u32; 3]| t.map(|v| &points[v as usize]);
    let stride = triangles.len() / size;
    let area = |t: &[u32; 3]| {
        let [a, b, c] = corner(t).map(position_of);
        0.5 * norm2(&cross(&sub(&b, &a), &sub(&c, &a))).sqrt()
    };
    let seen = triangles.iter().step_by(stride);
    let mean = seen.clone().map(area).sum::<f64>() / seen.len() as f64;
    let side = (mean * PATCH_TRIANGLES as f64).sqrt();
    let [low, _] = bounding_box(points.iter().map(position_of));
    let mut cells = vec![0; triangles.len()];
    fill(&mut cells, threads, |t| grid_cell(corner(&triangles[t]), &low, side));
    let mut chosen: Vec<(u64, u32)> = cells
        .into_iter()
        .zip(0..)
        .filter(|(cell, _)| hash_cell(*cell).is_multiple_of(stride as u64))
        .collect();
    chosen.sort_unstable();
    let large = chosen.chunk_by(|a, b| a.0 == b.0).filter(|piece| piece.len() >= MIN_PATCH_TRIANGLES);
    let kept = large.flatten().take(size).map(|&(_, t)| triangles[t as usize]);
    split_into_fans(points, kept.collect())
}

/// Create a mesh from some triangles, with a separate vertex for each fan.
fn split_into_fans<const D: usize>(points: &[[f64; D]], triangles: Vec<[u32; 3]>) -> MeshSample<D> {
    // Union-find over corners: corners that share an edge are one vertex.
    let mut parent: Vec<u32> = (0..3 * triangles.len() as u32).collect();
    let mut sides: Vec<(u32, u32, u32, u32)> = Vec::with_capacity(parent.len());
    for (t, corners) in triangles.iter().enumerate() {
        for i in 0..3 {
            let (j, first) = ((i + 1) % 3, 3 * t as u32);
            let (a, b) = ((corners[i], first + i as u32), (corners[j], first + j as u32));
            let (a, b) = if a.0 < b.0 { (a, b) } else { (b, a) };
            sides.push((a.0, b.0, a.1, b.1));
        }
    }
    sides.sort_unstable();
    for pair in sides.windows(2).filter(|pair| (pair[0].0, pair[0].1) == (pair[1].0, pair[1].1)) {
        unite(&mut parent, pair[0].2, pair[1].2);
        unite(&mut parent, pair[0].3, pair[1].3);
    }
    let mut number = vec![u32::MAX; parent.len()];
    let mut sample =
        MeshSample { points: vec![], triangles: Vec::with_capacity(triangles.len()), left_by_passes: 0 };
    for (t, corners) in triangles.iter().enumerate() {
        let own = std::array::from_fn(|i| {
            let root = find_root(&mut parent, (3 * t + i) as u32) as usize;
            if number[root] == u32::MAX {
                number[root] = sample.points.len() as u32;
                sample.points.push(points[corners[i] as usize]);
            }
            number[root]
        });
        sample.triangles.push(own);
    }
    sample
}

fn find_root(parent: &mut [u32], mut corner: u32) -> u32 {
    while parent[corner as usize] != corner {
        parent[corner as usize] = parent[parent[corner as usize] as usize];
        corner = parent[corner as usize];
    }
    corner
}

fn unite(parent: &mut [u32], a: u32, b: u32) {
    let (a, b) = (find_root(parent, a), find_root(parent, b));
    parent[a.max(b) as usize] = a.min(b);
}

impl<const D: usize> MeshSample<D> {
    /// Find the largest acceptable weight in `trials` attempts, starting with `weight`.
    ///
    /// `share` is the ratio of triangles that is left.
    fn find_max_weight<const K: usize>(
        &self,
        share: f64,
        weight: f64,
        trials: usize,
        threads: usize,
        progress: &mut Progress,
    ) -> Result<f64, KernelError> {
        let left = ((share * self.triangles.len() as f64) as usize).max(1);
        if left >= self.triangles.len() {
            return Ok(weight);
        }
        let least = MIN_SHAPE_ERROR_RATIO * diagonal(&bounding_box(self.points.iter().map(position_of)));
        // All vertices may be at the same point.
        let alone = self.without_attributes().shape_error::<0>(left, 0.0, threads, progress)?;
        let alone = alone.map(|e| e.max(least)).filter(|e| *e > 0.0);
        let Some(alone) = alone else { return Ok(weight) };
        let mut tried = weight;
        for _ in 0..trials {
            let error = self.shape_error::<K>(left, tried, threads, progress)?;
            let Some(ratio) = error.map(|e| e / alone) else { return Ok(weight) };
            if ratio <= MAX_SHAPE_ERROR_RATIO {
                break;
            }
            tried *= ((MAX_SHAPE_ERROR_RATIO * MAX_SHAPE_ERROR_RATIO - 1.0) / (ratio * ratio - 1.0))
                .sqrt()
                .clamp(0.1, 0.8);
        }
        Ok(tried)
    }

    fn without_attributes(&self) -> MeshSample<3> {
        MeshSample {
            points: self.points.iter().map(position_of).collect(),
            triangles: self.triangles.clone(),
            left_by_passes: self.left_by_passes,
        }
    }

    /// Measure the root mean square distance of some vertices from the simplified sample.
    ///
    /// `None` if the sample is not manifold or nothing is left.
    fn shape_error<const K: usize>(
        &self,
        left: usize,
        weight: f64,
        threads: usize,
        progress: &mut Progress,
    ) -> Result<Option<f64>, KernelError> {
        let whole = WholeMesh::<D, _>::new(self.points.clone(), self.triangles.clone(), vec![])?;
        let records = QemState::<K> { weight, importance: vec![] };
        let goal = Goal {
            triangles: left,
            threads,
            region: REGION_TRIANGLES,
            min_collapse_ratio: 0.0,
            record_positions: false,
        };
        let mesh = match simplify_in_passes(whole, records, self.left_by_passes, &goal, progress) {
            Ok(outcome) => outcome.mesh,
            Err(error) if error.is_aborted() => return Err(error),
            Err(_) => return Ok(None),
        };
        if mesh.triangles.is_empty() {
            return Ok(None);
        }
        let surface = Surface::new(&mesh.points, &mesh.triangles, threads)?;
        let mut squares = vec![0.0; self.points.len().div_ceil(VERTICES_PER_DISTANCE)];
        let vertex = |i| position_of(&self.points[VERTICES_PER_DISTANCE * i]);
        fill(&mut squares, threads, |i| surface.nearest(&vertex(i), 0).distance.powi(2));
        Ok(Some((squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::progress::RunControl;

    /// Build a sheet of n² squares with heights `z` and a fine colour pattern.
    fn sheet(n: u32, z: impl Fn(f64, f64) -> f64) -> (Vec<[f64; 6]>, Vec<[u32; 3]>) {
        let point = |x: u32, y: u32| {
            let (u, v) = (f64::from(x), f64::from(y));
            [u, v, z(u, v), f64::from(x * 7 % 11 + y * 5 % 13) * 20.0, 0.0, 0.0]
        };
        let points = (0..=n).flat_map(|y| (0..=n).map(move |x| (x, y))).map(|(x, y)| point(x, y)).collect();
        let square = |x, y| {
            let a = y * (n + 1) + x;
            [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]
        };
        (points, (0..n).flat_map(|y| (0..n).flat_map(move |x| square(x, y))).collect())
    }

    fn find_weight(mesh: &(Vec<[f64; 6]>, Vec<[u32; 3]>), weight: f64, threads: usize) -> f64 {
        let control = RunControl::default();
        let target = mesh.1.len() / 10;
        find_max_color_weight::<6, 3>(&mesh.0, &mesh.1, target, weight, threads, &mut Progress::new(&control))
            .unwrap()
    }

    #[test]
    fn weight_keeps_the_edges_of_a_folded_sheet() {
        let fold = |u: f64, v: f64| 0.3 * ((u + 0.3 * v) % 16.0 - 8.0).abs();
        let mesh = sheet(60, fold);
        let weight = find_weight(&mesh, 0.1, 1);
        assert!(weight < 0.05, "{weight}");
        let (points, triangles) = mesh;
        let sample = MeshSample { points, triangles, left_by_passes: 0 };
        let control = RunControl::default();
        let error = |weight| {
            let left = sample.triangles.len() / 10;
            sample.shape_error::<3>(left, weight, 1, &mut Progress::new(&control)).unwrap().unwrap()
        };
        assert!(error(0.1) > MAX_SHAPE_ERROR_RATIO * error(0.0));
        assert!(error(weight) <= MAX_SHAPE_ERROR_RATIO * error(0.0));
    }

    #[test]
    fn cheap_weight_is_kept() {
        let bumps = |u: f64, v: f64| (u * 1.7).sin() * (v * 2.3).cos();
        for n in [60, 200] {
            assert_eq!(find_weight(&sheet(n, bumps), 1e-4, 1), 1e-4);
        }
    }

    #[test]
    fn any_number_of_threads_finds_the_same() {
        let fold = |u: f64, v: f64| 0.3 * ((u + 0.3 * v) % 16.0 - 8.0).abs();
        let mesh = sheet(200, fold);
        let one = find_weight(&mesh, 0.1, 1);
        assert!(one < 0.1);
        assert_eq!(one, find_weight(&mesh, 0.1, 2));
    }

    #[test]
    fn fans_get_separate_vertices() {
        let (points, triangles) = sheet(2, |_, _| 0.0);
        // Two squares that share one corner.
        let kept = [&triangles[..2], &triangles[6..]].concat();
        let sample = split_into_fans(&points, kept);
        assert_eq!((sample.points.len(), sample.triangles.len()), (8, 4));
        assert_eq!(split_into_fans(&points, triangles).points.len(), 9);
    }

    #[test]
    fn empty_result_keeps_the_weight() {
        let (points, triangles) = sheet(30, |u, v| (u * v).sin());
        let none = triangles.iter().map(|t| [t[0], t[0], t[1]]).collect();
        assert_eq!(find_weight(&(points, none), 0.5, 1), 0.5);
        assert_eq!(find_weight(&(vec![], vec![]), 0.5, 1), 0.5);
    }

    #[test]
    fn a_mesh_that_is_one_point_keeps_the_weight() {
        let (points, triangles) = sheet(30, |u, v| (u * v).sin());
        let one = points.iter().map(|p| [1.0, 2.0, 3.0, p[3], 0.0, 0.0]).collect();
        assert_eq!(find_weight(&(one, triangles), 0.5, 1), 0.5);
    }

    #[test]
    fn a_mesh_that_is_no_manifold_keeps_the_weight() {
        let (points, mut triangles) = sheet(30, |u, v| (u * v).sin());
        triangles.push([0, 1, 100]);
        triangles.push([1, 0, 200]);
        assert_eq!(find_weight(&(points, triangles), 0.5, 1), 0.5);
    }
}
