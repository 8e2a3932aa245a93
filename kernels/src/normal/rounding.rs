//! Where the vertices of a mesh without levels go on the grid.
//!
//! The grid point next to a vertex is half a spacing off the surface as often as along it, where that does no harm. Among
//! the points around there is nearly always one that is far nearer to the surface, so that a grid several times as coarse
//! does. Vertices are taken in the order of the coder. Each goes where the squared distances of samples of the surface
//! are least, with those before it where they are by now, and where it takes few bits: mesh optimisation (Hoppe, DeRose,
//! Duchamp, McDonald and Stuetzle, 1993) on a grid, with the rate in the balance.

use super::surface::Surface;
use crate::base::geometry::{
    Vec3, add_scaled, area, cross, dot, nearest_on_triangle, norm2, sub, triangle_distance2, unit,
};
use crate::base::parallel::fill;
use crate::subdivision::topology::{NONE, Topology};

/// How far around in the grid to look, in spacings.
const REACH: i32 = 2;
/// What a bit counts, in squared spacings, for a vertex with as much area as most.
const BIT: f64 = 0.002;
/// Weights beside the samples, which do not hold every vertex in every direction: of the planes around a vertex, of the
/// walls on its boundary edges against the square over the edge, and of staying where it is.
const PLANES: f64 = 0.02;
const WALLS: f64 = 0.01;
const STAYING: f64 = 3e-5;
/// Least cosine between a triangle before and after.
const LEAST_COSINE: f64 = 0.3;
/// A weight below this lies on the side across.
const EDGE: f64 = 1e-9;
/// With so many triangles of the surface to one of the mesh, their middles are samples enough.
const ENOUGH_MIDDLES: usize = 6;

type Matrix = [Vec3; 3];

/// Points that stand for a surface, and the area each stands for.
#[derive(Clone, Debug, Default)]
pub struct Samples {
    points: Vec<Vec3>,
    areas: Vec<f64>,
}

impl Samples {
    /// For a mesh of so many triangles: three on each triangle, which are exact for what is quadratic on it, or its middle.
    pub fn new(points: &[Vec3], triangles: &[[u32; 3]], of_mesh: usize) -> Self {
        let mut samples = Self::default();
        let middles = triangles.len() >= ENOUGH_MIDDLES * of_mesh;
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

    /// The same in other units of length.
    pub fn scaled(&self, factor: f64) -> Self {
        Self {
            points: self.points.iter().map(|p| p.map(|x| factor * x)).collect(),
            areas: self.areas.iter().map(|a| factor * factor * a).collect(),
        }
    }

    /// Their mean squared distance from a surface.
    pub fn mean_square(&self, surface: &Surface, threads: usize) -> f64 {
        let mut distance2 = vec![0.0; self.points.len()];
        fill(&mut distance2, threads, |i| surface.nearest_slot(&self.points[i], []).1);
        let sum: f64 = distance2.iter().zip(&self.areas).map(|(d, area)| d * area).sum();
        sum / self.areas.iter().sum::<f64>().max(f64::MIN_POSITIVE)
    }
}

/// A sample beside its triangle: how far it is `along` a direction, and how much of a corner's way along it the triangle
/// there goes.
#[derive(Clone, Copy, Default)]
struct Pull {
    triangle: u32,
    weights: [f64; 3],
    towards: Vec3,
    along: f64,
    area: f64,
}

/// Lists one after the other: that of `i` is `items[starts[i]..starts[i + 1]]`.
struct Lists {
    starts: Vec<u32>,
    items: Vec<u32>,
}

impl Lists {
    /// For each of `0..count` the places of the keys equal to it, each divided by `part`.
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

    fn of(&self, i: u32) -> &[u32] {
        &self.items[self.starts[i as usize] as usize..self.starts[i as usize + 1] as usize]
    }
}

/// A mesh on its way to the grid. All lengths are in spacings of it.
pub struct Rounding<'a> {
    triangles: &'a [[u32; 3]],
    exact: &'a [Vec3],
    /// Where vertices are by now.
    points: Vec<Vec3>,
    /// The triangles around each vertex, and the samples beside each triangle.
    around: Lists,
    beside: Lists,
    pulls: Vec<Pull>,
    /// The neighbours along the boundary of each vertex on it.
    boundary: Vec<[u32; 2]>,
    /// How far from the exact mesh vertices may go; nothing if samples alone say where they go.
    tolerance: Option<f64>,
    /// What a bit counts.
    bit: f64,
}

impl<'a> Rounding<'a> {
    /// Of a mesh with vertices at `exact`, which may be at other `points` by now.
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
        let mut pulls = vec![Pull::default(); samples.points.len()];
        fill(&mut pulls, threads, |i| {
            pull(&surface, triangles, &points, &samples.points[i], samples.areas[i])
        });
        let total: f64 = samples.areas.iter().sum();
        Self {
            triangles,
            exact,
            around: Lists::new(points.len(), triangles.iter().flatten().copied(), 3),
            beside: Lists::new(triangles.len(), pulls.iter().map(|pull| pull.triangle), 1),
            bit: BIT * 3.0 * total / points.len().max(1) as f64,
            points,
            pulls,
            boundary,
            tolerance,
        }
    }

    pub fn into_points(self) -> Vec<Vec3> {
        self.points
    }

    /// The grid point for a vertex, where `bits` tells what places take in the file.
    pub fn round(&mut self, v: u32, bits: &dyn Fn(&[i32; 3]) -> f64) -> [i32; 3] {
        let now = self.points[v as usize];
        let (shape, slope) = self.distances(v);
        // Where they are least, and no farther than is looked around.
        let best = solved(&shape, &slope).map(|x| x.clamp(-f64::from(REACH), f64::from(REACH)));
        let middle: [i32; 3] = std::array::from_fn(|i| (now[i] + best[i]).round() as i32);
        let mut candidates = vec![];
        for x in -REACH..=REACH {
            for y in -REACH..=REACH {
                for z in -REACH..=REACH {
                    let p = [middle[0] + x, middle[1] + y, middle[2] + z];
                    let way = sub(&p.map(f64::from), &now);
                    let error: f64 = (0..3).map(|i| way[i] * (dot(&shape[i], &way) - 2.0 * slope[i])).sum();
                    candidates.push((error + self.bit * bits(&p), p));
                }
            }
        }
        candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
        let found = candidates.iter().map(|c| c.1).find(|p| self.is_allowed(v, &p.map(f64::from)));
        let found = found.unwrap_or_else(|| self.exact[v as usize].map(|x| x.round() as i32));
        self.points[v as usize] = found.map(f64::from);
        found
    }

    /// Squared distances around a vertex as a function of the way x it goes: x·Mx − 2r·x and what does not depend on it.
    fn distances(&self, v: u32) -> (Matrix, Vec3) {
        let now = self.points[v as usize];
        let back = sub(&self.exact[v as usize], &now);
        let (mut shape, mut slope) = ([[0.0; 3]; 3], [0.0; 3]);
        let mut add = |weight: f64, along: &Vec3, distance: f64| {
            for (row, x) in shape.iter_mut().zip(along) {
                *row = add_scaled(row, weight * x, along);
            }
            slope = add_scaled(&slope, weight * distance, along);
        };
        let (mut normals, mut total) = ([0.0; 3], 0.0);
        for &t in self.around.of(v) {
            let corners = self.triangles[t as usize];
            let twice = normal(corners.map(|w| self.exact[w as usize]));
            normals = add_scaled(&normals, 1.0, &twice);
            let (along, area) = (unit(&twice), 0.5 * norm2(&twice).sqrt());
            total += area;
            add(PLANES * area, &along, dot(&along, &back));
            let points = corners.map(|w| &self.points[w as usize]);
            for &i in self.beside.of(t) {
                let Pull { weights, towards, along, area, .. } = &self.pulls[i as usize];
                let there: f64 = (0..3).map(|k| weights[k] * dot(towards, points[k])).sum();
                let weight: f64 = (0..3).map(|k| if corners[k] == v { weights[k] } else { 0.0 }).sum();
                // The sample counts as its area, and goes along with a share of the vertex.
                add(area * weight * weight, towards, (along - there) / weight.max(EDGE));
            }
        }
        let normal = unit(&normals);
        for w in self.boundary[v as usize].into_iter().filter(|&w| w != NONE) {
            let side = sub(&self.exact[w as usize], &self.exact[v as usize]);
            let out = unit(&cross(&side, &normal));
            add(WALLS * norm2(&side), &out, dot(&out, &back));
        }
        (0..3).for_each(|i| shape[i][i] += STAYING * total);
        (shape, slope)
    }

    /// Whether a place is within the tolerance and turns no triangle.
    fn is_allowed(&self, v: u32, p: &Vec3) -> bool {
        let mut least = f64::INFINITY;
        for &t in self.around.of(v) {
            let corners = self.triangles[t as usize];
            let exact = corners.map(|w| self.exact[w as usize]);
            least = least.min(triangle_distance2(p, exact.each_ref()));
            let (before, after) =
                (normal(exact), normal(corners.map(|w| if w == v { *p } else { self.points[w as usize] })));
            if dot(&before, &after) <= LEAST_COSINE * (norm2(&before) * norm2(&after)).sqrt() {
                return false;
            }
        }
        self.tolerance.is_none_or(|most| least <= most * most)
    }
}

/// What a sample pulls at.
fn pull(surface: &Surface, triangles: &[[u32; 3]], points: &[Vec3], sample: &Vec3, area: f64) -> Pull {
    let triangle = surface.triangle(surface.nearest_slot(sample, []).0);
    let corners = triangles[triangle as usize].map(|v| points[v as usize]);
    let (weights, _) = nearest_on_triangle(sample, corners.each_ref());
    let nearest: Vec3 = std::array::from_fn(|i| (0..3).map(|k| weights[k] * corners[k][i]).sum());
    let off = sub(sample, &nearest);
    // Beyond a side, the distance is not along the normal of the triangle.
    let is_inside = weights.iter().all(|&w| w > EDGE) || norm2(&off) <= EDGE * EDGE;
    let towards = unit(&if is_inside { normal(corners) } else { off });
    Pull { triangle, weights, towards, along: dot(&towards, sample), area }
}

/// Of a triangle, as long as twice its area.
fn normal([a, b, c]: [Vec3; 3]) -> Vec3 {
    cross(&sub(&b, &a), &sub(&c, &a))
}

/// The solution of M x = r by Cramer's rule; 0 if there is none.
fn solved(m: &Matrix, r: &Vec3) -> Vec3 {
    let columns = [cross(&m[1], &m[2]), cross(&m[2], &m[0]), cross(&m[0], &m[1])];
    let determinant = dot(&m[0], &columns[0]);
    if determinant > 0.0 {
        [0, 1, 2].map(|i| (0..3).map(|k| columns[k][i] * r[k]).sum::<f64>() / determinant)
    } else {
        [0.0; 3]
    }
}
