//! Rounding of a mesh without levels to the grid, optimised for distance and file size.
//!
//! Rounding to the nearest grid point displaces vertices off the surface as much as along it, though only the
//! former matters. Among the surrounding grid points, one is nearly always much nearer to the surface. A grid
//! several times as coarse is therefore sufficient. Vertices are processed in coder order. Each goes where
//! the squared distances of surface samples plus the weighted bit cost are minimal, given the current
//! positions of all others. This is mesh optimisation (Hoppe, DeRose, Duchamp, McDonald and Stuetzle, 1993)
//! on a grid with a rate term.

use super::surface::Surface;
use crate::base::geometry::{
    Vec3, add_scaled, area, cross, dot, nearest_on_triangle, norm2, normalize, sub, triangle_distance2,
};
use crate::base::parallel::fill;
use crate::subdivision::topology::{NONE, Topology};

/// Search radius on the grid, in spacings.
const SEARCH_RADIUS: i32 = 2;
/// Weight of one bit for a vertex with mean surrounding area, in squared spacings.
const BIT_WEIGHT: f64 = 0.002;
/// Regularisation weights, because samples do not constrain every vertex in every direction. They apply to
/// the planes around a vertex, to constraint planes on boundary edges, and to the distance from the current
/// position.
const PLANE_WEIGHT: f64 = 0.02;
const WALL_WEIGHT: f64 = 0.01;
const STAY_WEIGHT: f64 = 3e-5;
/// Minimum cosine between a triangle before and after rounding.
const MIN_COSINE: f64 = 0.3;
/// Barycentric weights up to this count as zero: the point is on the opposite side.
const ZERO_WEIGHT: f64 = 1e-9;
/// Surface triangles per mesh triangle from which one sample at each centroid suffices.
const CENTROID_SAMPLING_RATIO: usize = 6;

type Matrix = [Vec3; 3];

/// Sample points of a surface, and the area that each represents.
#[derive(Clone, Debug, Default)]
pub struct Samples {
    points: Vec<Vec3>,
    areas: Vec<f64>,
}

impl Samples {
    /// Sample a surface for a mesh of `mesh_verdicts` triangles. Each triangle gets three points, which integrate
    /// quadratics exactly, or only its centroid if triangles are small.
    pub fn new(points: &[Vec3], triangles: &[[u32; 3]], of_mesh: usize) -> Self {
        let mut samples = Self::default();
        let middles = triangles.len() >= CENTROID_SAMPLING_RATIO * of_mesh;
        for corners in triangles {
            let corners = corners.map(|v| &points[v as usize]);
            let [a, b, c] = corners;
            let (near, rest): (&[&Vec3], f64) =
                if middles { (&[a], 1.0 / 3.0) } else { (&[a, b, c], 1.0 / 6.0) };
            for p in near {
                let at = |i: usize| (1.0 - 3.0 * rest) * p[i] + rest * (a[i] + b[i] + c[i]);
                samples.points.push(std::array::from_fn(at));
                samples.areas.push(area(corners) / near.len() as f64);
            }
        }
        samples
    }

    pub fn len(&self) -> usize {
        self.points.len()
    }

    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Scale the samples to other length units.
    pub fn to_scale(&self, factor: f64) -> Self {
        Self {
            points: self.points.iter().map(|p| p.map(|x| factor * x)).collect(),
            areas: self.areas.iter().map(|a| factor * factor * a).collect(),
        }
    }

    /// Compute the area-weighted mean squared distance of the samples from a surface.
    pub fn measure_mean_square(&self, surface: &Surface, threads: usize) -> f64 {
        let mut distance2 = vec![0.0; self.points.len()];
        fill(&mut distance2, threads, |i| surface.find_nearest_slot(&self.points[i], []).1);
        let sum: f64 = distance2.iter().zip(&self.areas).map(|(d, area)| d * area).sum();
        sum / self.areas.iter().sum::<f64>().max(f64::MIN_POSITIVE)
    }
}

/// A sample with its nearest triangle. The sample is at coordinate `coordinate` in the direction `direction`;
/// `weights` are the barycentric coordinates of the nearest point.
#[derive(Clone, Copy, Default)]
struct SampleConstraint {
    triangle: u32,
    weights: [f64; 3],
    direction: Vec3,
    coordinate: f64,
    area: f64,
}

/// Lists in compressed form; list `i` is `items[starts[i]..starts[i + 1]]`.
struct Lists {
    starts: Vec<u32>,
    items: Vec<u32>,
}

impl Lists {
    /// Group the positions of `keys` by key, for keys in `0..count`. Positions are divided by `part`.
    fn new(count: usize, keys: impl Iterator<Item = u32> + Clone, part: u32) -> Self {
        let mut starts = vec![0u32; count + 1];
        keys.clone().for_each(|key| starts[key as usize + 1] += 1);
        (0..count).for_each(|i| starts[i + 1] += starts[i]);
        let (mut next, mut items) = (starts.clone(), vec![0; starts[count] as usize]);
        for (place, key) in (0..).zip(keys) {
            items[next[key as usize] as usize] = place / part;
            next[key as usize] += 1;
        }
        Self { starts, items }
    }

    fn list_of(&self, i: u32) -> &[u32] {
        &self.items[self.starts[i as usize] as usize..self.starts[i as usize + 1] as usize]
    }
}

/// State of the rounding of one mesh. All lengths are in grid spacings.
pub struct Rounding<'a> {
    triangles: &'a [[u32; 3]],
    exact_points: &'a [Vec3],
    /// Current positions of the vertices.
    points: Vec<Vec3>,
    /// Triangles around each vertex, and samples nearest to each triangle.
    vertex_triangles: Lists,
    triangle_samples: Lists,
    constraints: Vec<SampleConstraint>,
    /// Neighbours of each boundary vertex along the boundary.
    boundary: Vec<[u32; 2]>,
    /// Maximum distance from the exact mesh. None if only the samples determine positions.
    tolerance: Option<f64>,
    /// Weight of one bit in the objective.
    bit_weight: f64,
}

impl<'a> Rounding<'a> {
    /// Set up the rounding of a mesh with vertices at `exact_points` and current positions `points`.
    pub fn new(
        topology: &'a Topology,
        exact: &'a [Vec3],
        points: Vec<Vec3>,
        samples: &Samples,
        tolerance: Option<f64>,
        threads: usize,
    ) -> Self {
        let triangles = &topology.triangles;
        let mut boundary = vec![[NONE; 2]; points.len()];
        for (ends, beside) in topology.edges.iter().zip(&topology.edge_triangles) {
            for (v, w) in [(ends[0], ends[1]), (ends[1], ends[0])].into_iter().filter(|_| beside[1] == NONE) {
                let both = &mut boundary[v as usize];
                both[usize::from(both[0] != NONE)] = w;
            }
        }
        let surface = Surface::new(&points, triangles, threads);
        let mut pulls = vec![SampleConstraint::default(); samples.points.len()];
        fill(&mut pulls, threads, |i| {
            attach_sample(&surface, triangles, &points, &samples.points[i], samples.areas[i])
        });
        let total: f64 = samples.areas.iter().sum();
        Self {
            triangles,
            exact_points: exact,
            vertex_triangles: Lists::new(points.len(), triangles.iter().flatten().copied(), 3),
            triangle_samples: Lists::new(triangles.len(), pulls.iter().map(|pull| pull.triangle), 1),
            bit_weight: BIT_WEIGHT * 3.0 * total / points.len().max(1) as f64,
            points,
            constraints: pulls,
            boundary,
            tolerance,
        }
    }

    /// Return the rounded positions, in grid spacings.
    pub fn into_points(self) -> Vec<Vec3> {
        self.points
    }

    /// Choose the grid point for a vertex. `bits` estimates the file size of a position.
    pub fn round_vertex(&mut self, v: u32, bits: &dyn Fn(&[i32; 3]) -> f64) -> [i32; 3] {
        let now = self.points[v as usize];
        let (shape, slope) = self.build_quadratic(v);
        // Minimiser of the distances, clamped to the search radius.
        let best =
            solve(&shape, &slope).map(|x| x.clamp(-f64::from(SEARCH_RADIUS), f64::from(SEARCH_RADIUS)));
        let middle: [i32; 3] = std::array::from_fn(|i| (now[i] + best[i]).round() as i32);
        let mut candidates = vec![];
        for x in -SEARCH_RADIUS..=SEARCH_RADIUS {
            for y in -SEARCH_RADIUS..=SEARCH_RADIUS {
                for z in -SEARCH_RADIUS..=SEARCH_RADIUS {
                    let p = [middle[0] + x, middle[1] + y, middle[2] + z];
                    let way = sub(&p.map(f64::from), &now);
                    let error: f64 = (0..3).map(|i| way[i] * (dot(&shape[i], &way) - 2.0 * slope[i])).sum();
                    candidates.push((error + self.bit_weight * bits(&p), p));
                }
            }
        }
        candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
        let found = candidates.iter().map(|c| c.1).find(|p| self.is_allowed(v, &p.map(f64::from)));
        let found = found.unwrap_or_else(|| self.exact_points[v as usize].map(|x| x.round() as i32));
        self.points[v as usize] = found.map(f64::from);
        found
    }

    /// Compute M and r of the squared distances around a vertex, x·Mx − 2r·x plus a constant, for a
    /// displacement x.
    fn build_quadratic(&self, v: u32) -> (Matrix, Vec3) {
        let now = self.points[v as usize];
        let back = sub(&self.exact_points[v as usize], &now);
        let (mut shape, mut slope) = ([[0.0; 3]; 3], [0.0; 3]);
        let mut add = |weight: f64, along: &Vec3, distance: f64| {
            for (row, x) in shape.iter_mut().zip(along) {
                *row = add_scaled(row, weight * x, along);
            }
            slope = add_scaled(&slope, weight * distance, along);
        };
        let (mut normals, mut total) = ([0.0; 3], 0.0);
        for &t in self.vertex_triangles.list_of(v) {
            let corners = self.triangles[t as usize];
            let twice = compute_normal(corners.map(|w| self.exact_points[w as usize]));
            normals = add_scaled(&normals, 1.0, &twice);
            let (along, area) = (normalize(&twice), 0.5 * norm2(&twice).sqrt());
            total += area;
            add(PLANE_WEIGHT * area, &along, dot(&along, &back));
            let points = corners.map(|w| &self.points[w as usize]);
            for &i in self.triangle_samples.list_of(t) {
                let SampleConstraint { weights, direction: towards, coordinate: along, area, .. } =
                    &self.constraints[i as usize];
                let there: f64 = (0..3).map(|k| weights[k] * dot(towards, points[k])).sum();
                let weight: f64 = (0..3).map(|k| if corners[k] == v { weights[k] } else { 0.0 }).sum();
                // The sample is weighted by its area, and moves with the vertex in proportion to its
                // barycentric weight.
                add(area * weight * weight, towards, (along - there) / weight.max(ZERO_WEIGHT));
            }
        }
        let normal = normalize(&normals);
        for w in self.boundary[v as usize].into_iter().filter(|&w| w != NONE) {
            let side = sub(&self.exact_points[w as usize], &self.exact_points[v as usize]);
            let out = normalize(&cross(&side, &normal));
            add(WALL_WEIGHT * norm2(&side), &out, dot(&out, &back));
        }
        (0..3).for_each(|i| shape[i][i] += STAY_WEIGHT * total);
        (shape, slope)
    }

    /// Check whether a position is within the tolerance and turns no triangle.
    fn is_allowed(&self, v: u32, p: &Vec3) -> bool {
        let mut least = f64::INFINITY;
        for &t in self.vertex_triangles.list_of(v) {
            let corners = self.triangles[t as usize];
            let exact = corners.map(|w| self.exact_points[w as usize]);
            least = least.min(triangle_distance2(p, exact.each_ref()));
            let (before, after) = (
                compute_normal(exact),
                compute_normal(corners.map(|w| if w == v { *p } else { self.points[w as usize] })),
            );
            if dot(&before, &after) <= MIN_COSINE * (norm2(&before) * norm2(&after)).sqrt() {
                return false;
            }
        }
        self.tolerance.is_none_or(|most| least <= most * most)
    }
}

/// Attach a sample to its nearest triangle.
fn attach_sample(
    surface: &Surface,
    triangles: &[[u32; 3]],
    points: &[Vec3],
    sample: &Vec3,
    area: f64,
) -> SampleConstraint {
    let triangle = surface.triangle(surface.find_nearest_slot(sample, []).0);
    let corners = triangles[triangle as usize].map(|v| points[v as usize]);
    let (weights, _) = nearest_on_triangle(sample, corners.each_ref());
    let nearest: Vec3 = std::array::from_fn(|i| (0..3).map(|k| weights[k] * corners[k][i]).sum());
    let off = sub(sample, &nearest);
    // Nearest to an edge or corner, the direction to the sample is not the triangle's normal.
    let is_inside = weights.iter().all(|&w| w > ZERO_WEIGHT) || norm2(&off) <= ZERO_WEIGHT * ZERO_WEIGHT;
    let towards = normalize(&if is_inside { compute_normal(corners) } else { off });
    SampleConstraint { triangle, weights, direction: towards, coordinate: dot(&towards, sample), area }
}

/// Compute the normal of a triangle, with twice its area as length.
fn compute_normal([a, b, c]: [Vec3; 3]) -> Vec3 {
    cross(&sub(&b, &a), &sub(&c, &a))
}

/// Solve M x = r by Cramer's rule. Zero if M is singular.
fn solve(m: &Matrix, r: &Vec3) -> Vec3 {
    let columns = [cross(&m[1], &m[2]), cross(&m[2], &m[0]), cross(&m[0], &m[1])];
    let determinant = dot(&m[0], &columns[0]);
    if determinant > 0.0 {
        [0, 1, 2].map(|i| (0..3).map(|k| columns[k][i] * r[k]).sum::<f64>() / determinant)
    } else {
        [0.0; 3]
    }
}
