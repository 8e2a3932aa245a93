//! Fitting a simplified mesh to its input by least squares, connectivity as it is.
//!
//! Samples of the input go to the nearest point of the result; vertices then move along their normals, and their
//! attributes change, until the squared differences at the samples are least: the inner problem of Hoppe, DeRose,
//! Duchamp, McDonald and Stuetzle, "Mesh optimization", 1993, with one unknown a vertex instead of three.
//! Samples are the centres of the input's triangles, each with the triangle's area; where there are few of
//! them to a triangle of the result, the corners count too, a twelfth of the area each and three quarters for
//! the centre: exact for the integral of what is quadratic on the triangle.

use crate::connectivity::Connectivity;
use crate::error::KernelError;
use crate::geometry::{Vec3, add_scaled, cross, dot, nearest_on_triangle, norm2, position, sub};
use crate::ids::{HalfedgeId, TriangleId, VertexId};
use crate::mesh::{Mesh, Pin};
use crate::parallel::map;
use crate::progress::Progress;

/// Strength of the spring that holds every unknown, as a share of the samples' weight at a vertex: without it
/// a vertex with few samples would follow their noise.
const SPRING: f64 = 0.05;

/// Steps of the conjugate gradient method; the systems are well conditioned.
const STEPS: usize = 24;

/// No triangle may turn by more than 60° (cosine).
const LEAST_COSINE: f64 = 0.5;

/// Samples a thread takes at a time.
const CHUNK: usize = 1 << 14;

/// The input, and which vertex of the result each of its vertices became part of.
pub struct Input<'a, const D: usize> {
    pub points: &'a [[f64; D]],
    pub triangles: &'a [[u32; 3]],
    pub became: &'a [VertexId],
}

/// With this many triangles of the input to one of the result, their centres are samples enough.
const ENOUGH_CENTRES: usize = 6;

/// Samples of the input: the centres of its triangles, and then perhaps its vertices.
struct Samples<'a, const D: usize> {
    input: &'a Input<'a, D>,
    with_vertices: bool,
}

impl<const D: usize> Samples<'_, D> {
    fn len(&self) -> usize {
        self.input.triangles.len() + if self.with_vertices { self.input.points.len() } else { 0 }
    }

    /// The place and attributes of a sample, and a vertex of the result to start the search from.
    fn get(&self, i: usize) -> ([f64; D], VertexId) {
        let Some(corners) = self.input.triangles.get(i) else {
            let v = i - self.input.triangles.len();
            return (self.input.points[v], self.input.became[v]);
        };
        let corners = corners.map(|v| v as usize);
        let [a, b, c] = corners.map(|v| &self.input.points[v]);
        let near = corners.into_iter().map(|v| self.input.became[v]).find(|v| v.is_some());
        (std::array::from_fn(|i| (a[i] + b[i] + c[i]) / 3.0), near.unwrap_or(VertexId::NONE))
    }

    fn weights(&self) -> Vec<f64> {
        let triangles = self.input.triangles;
        let mut weights = vec![0.0; self.len()];
        for (t, corners) in triangles.iter().enumerate() {
            let [a, b, c] = corners.map(|v| position(&self.input.points[v as usize]));
            weights[t] = 0.5 * norm2(&cross(&sub(&b, &a), &sub(&c, &a))).sqrt();
            if self.with_vertices {
                corners.iter().for_each(|&v| weights[triangles.len() + v as usize] += weights[t] / 12.0);
                weights[t] *= 0.75;
            }
        }
        weights
    }
}

/// The nearest point of a sample on the result; single precision is enough for weights.
#[derive(Clone, Copy)]
struct Hit {
    triangle: TriangleId,
    at: [f32; 2],
}

impl Hit {
    fn weights(&self) -> [f64; 3] {
        let [b, c] = self.at.map(f64::from);
        [1.0 - b - c, b, c]
    }
}

/// Look for the nearest point from vertex to vertex: around `start`, then around the corners of the nearest triangle
/// so far, as long as that helps.
fn nearest<const D: usize>(mesh: &Mesh<D>, p: &Vec3, start: VertexId) -> Option<Hit> {
    let mut best: Option<(f64, TriangleId, [f64; 3])> = None;
    let mut from = start;
    loop {
        let mut closer = false;
        for h in mesh.connectivity.fan(from) {
            let triangle = Connectivity::triangle(h);
            let corners = mesh.connectivity.corners(triangle).map(|v| position(mesh.point(v)));
            let (at, distance2) = nearest_on_triangle(p, corners.each_ref());
            if best.is_none_or(|(least, _, _)| distance2 < least) {
                best = Some((distance2, triangle, at));
                closer = true;
            }
        }
        let (_, triangle, at) = best?;
        let corners = mesh.connectivity.corners(triangle);
        // On a side or a corner, the surface may come closer beyond it.
        let beyond = (0..3).find(|&i| at[i] > EDGE && corners[i] != from);
        match beyond {
            Some(i) if closer && at.iter().any(|&x| x <= EDGE) => from = corners[i],
            _ => return Some(Hit { triangle, at: [at[1] as f32, at[2] as f32] }),
        }
    }
}

/// A weight below this lies on the side across.
const EDGE: f64 = 1e-9;

/// Fit `mesh` to `input`. Fixed vertices stay as they are, those on the boundary keep their place.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn fit<const D: usize>(
    mesh: &mut Mesh<D>,
    input: &Input<'_, D>,
    threads: usize,
    progress: &Progress,
) -> Result<(), KernelError> {
    let with_vertices = input.triangles.len() < ENOUGH_CENTRES * mesh.connectivity.triangle_count();
    let samples = Samples { input, with_vertices };
    let count = samples.len();
    let find = |(): &mut (), chunk: usize| -> Result<Vec<Option<Hit>>, KernelError> {
        progress.check()?;
        let chunk = CHUNK * chunk..(CHUNK * (chunk + 1)).min(count);
        let one = |i| {
            let (point, near) = samples.get(i);
            if near.is_none() { None } else { nearest(mesh, &position(&point), near) }
        };
        Ok(chunk.map(one).collect())
    };
    let hits = map(count.div_ceil(CHUNK), threads, || (), find).into_iter().collect::<Result<Vec<_>, _>>()?;
    progress.check()?;
    let normals = vertex_normals(mesh);
    let system = System::new(mesh, &samples, hits.iter().flatten(), &normals);
    progress.check()?;
    let solution = system.solve();
    for (point, step) in mesh.points.iter_mut().zip(&solution) {
        (3..D).for_each(|j| point[j] += step[j]);
    }
    move_along_normals(mesh, &normals, &solution);
    Ok(())
}

/// The normal equations: unknown 0 of a vertex is its way along the normal, the others its attributes.
struct System<const D: usize> {
    /// Of shape and of any attribute; infinite where the unknown is held.
    diagonal: Vec<[f64; 2]>,
    /// Edge by edge.
    across: Vec<([u32; 2], [f64; 2])>,
    right: Vec<[f64; D]>,
}

impl<const D: usize> System<D> {
    fn new<'h>(
        mesh: &Mesh<D>,
        samples: &Samples<'_, D>,
        hits: impl Iterator<Item = &'h Option<Hit>>,
        normals: &[Vec3],
    ) -> Self {
        let connectivity = &mesh.connectivity;
        let mut diagonal = vec![[0.0; 2]; mesh.points.len()];
        let mut across = vec![[0.0; 2]; connectivity.edge_slots()];
        let mut right = vec![[0.0; D]; mesh.points.len()];
        for (i, (hit, weight)) in hits.zip(samples.weights()).enumerate() {
            let Some(hit) = hit else { continue };
            let (sample, at) = (samples.get(i).0, hit.weights());
            let corners = connectivity.corners(hit.triangle);
            let points = corners.map(|v| mesh.point(v));
            let off: [f64; D] = std::array::from_fn(|j| {
                sample[j] - (at[0] * points[0][j] + at[1] * points[1][j] + at[2] * points[2][j])
            });
            let [a, b, c] = points.map(position);
            let is_inside = at.iter().all(|&x| x > EDGE);
            let away = position(&off);
            // Beyond a side, the distance is not along the normal of the triangle.
            let towards =
                if is_inside || norm2(&away) == 0.0 { cross(&sub(&b, &a), &sub(&c, &a)) } else { away };
            let length = norm2(&towards).sqrt();
            if length == 0.0 {
                continue;
            }
            let towards = towards.map(|x| x / length);
            let distance = dot(&away, &towards);
            let lever: [f64; 3] =
                std::array::from_fn(|k| at[k] * dot(&towards, &normals[corners[k].index()]));
            for k in 0..3 {
                let v = corners[k].index();
                diagonal[v][0] += weight * (lever[k] * lever[k] + SPRING * at[k] * at[k]);
                diagonal[v][1] += weight * (1.0 + SPRING) * at[k] * at[k];
                right[v][0] += weight * lever[k] * distance;
                (3..D).for_each(|j| right[v][j] += weight * at[k] * off[j]);
                let next = (k + 1) % 3;
                let edge = connectivity.edge(HalfedgeId(3 * hit.triangle.0 + k as u32)).index();
                across[edge][0] += weight * lever[k] * lever[next];
                across[edge][1] += weight * at[k] * at[next];
            }
        }
        for v in connectivity.vertices() {
            let (is_fixed, i) = (mesh.pin(v) == Pin::Fixed, v.index());
            if is_fixed || connectivity.is_boundary_vertex(v) {
                (diagonal[i][0], right[i][0]) = (f64::INFINITY, 0.0);
            }
            if is_fixed {
                (diagonal[i][1], right[i]) = (f64::INFINITY, [0.0; D]);
            }
        }
        let across = connectivity.edges().map(|e| (connectivity.ends(e).map(|v| v.0), across[e.index()]));
        Self { diagonal, across: across.collect(), right }
    }

    /// The conjugate gradient method, preconditioned with the diagonal, for all unknowns side by side.
    fn solve(&self) -> Vec<[f64; D]> {
        let n = self.right.len();
        let matrix = |j: usize| usize::from(j > 0);
        let scaled = |v: usize, r: &[f64; D]| -> [f64; D] {
            let d = self.diagonal[v];
            std::array::from_fn(|j| if d[matrix(j)] > 0.0 { r[j] / d[matrix(j)] } else { 0.0 })
        };
        let mut x = vec![[0.0; D]; n];
        let mut r = self.right.clone();
        let mut z: Vec<[f64; D]> = (0..n).map(|v| scaled(v, &r[v])).collect();
        let mut p = z.clone();
        let mut q = vec![[0.0; D]; n];
        let mut rz = inner(&r, &z);
        for _ in 0..STEPS {
            self.times(&p, &mut q);
            let pq = inner(&p, &q);
            let alpha: [f64; D] = std::array::from_fn(|j| if pq[j] > 0.0 { rz[j] / pq[j] } else { 0.0 });
            for v in 0..n {
                for j in 0..D {
                    x[v][j] += alpha[j] * p[v][j];
                    r[v][j] -= alpha[j] * q[v][j];
                }
                z[v] = scaled(v, &r[v]);
            }
            let next = inner(&r, &z);
            let beta: [f64; D] = std::array::from_fn(|j| if rz[j] > 0.0 { next[j] / rz[j] } else { 0.0 });
            for v in 0..n {
                (0..D).for_each(|j| p[v][j] = z[v][j] + beta[j] * p[v][j]);
            }
            rz = next;
        }
        x
    }

    fn times(&self, p: &[[f64; D]], q: &mut [[f64; D]]) {
        for (v, diagonal) in self.diagonal.iter().enumerate() {
            // What is held has no share in any direction.
            let d = diagonal.map(|d| if d.is_finite() { d } else { 0.0 });
            (0..D).for_each(|j| q[v][j] = d[usize::from(j > 0)] * p[v][j]);
        }
        for &([a, b], m) in &self.across {
            let (a, b) = (a as usize, b as usize);
            for j in 0..D {
                let m = m[usize::from(j > 0)];
                q[a][j] += m * p[b][j];
                q[b][j] += m * p[a][j];
            }
        }
    }
}

fn inner<const D: usize>(a: &[[f64; D]], b: &[[f64; D]]) -> [f64; D] {
    let mut sum = [0.0; D];
    for (a, b) in a.iter().zip(b) {
        (0..D).for_each(|j| sum[j] += a[j] * b[j]);
    }
    sum
}

fn vertex_normals<const D: usize>(mesh: &Mesh<D>) -> Vec<Vec3> {
    let mut normals = vec![[0.0; 3]; mesh.points.len()];
    for t in mesh.connectivity.triangles() {
        let [a, b, c] = mesh.triangle_points(t).map(|q| position(&q));
        let normal = cross(&sub(&b, &a), &sub(&c, &a));
        for v in mesh.connectivity.corners(t) {
            normals[v.index()] = add_scaled(&normals[v.index()], 1.0, &normal);
        }
    }
    for normal in &mut normals {
        let length = norm2(normal).sqrt();
        if length > 0.0 {
            *normal = normal.map(|x| x / length);
        }
    }
    normals
}

/// Move every vertex as the solution says, and put back the corners of triangles that would turn too far.
fn move_along_normals<const D: usize>(mesh: &mut Mesh<D>, normals: &[Vec3], solution: &[[f64; D]]) {
    let before: Vec<Vec3> = mesh.points.iter().map(position).collect();
    for v in 0..mesh.points.len() {
        (0..3).for_each(|i| mesh.points[v][i] += solution[v][0] * normals[v][i]);
    }
    loop {
        let mut undone = false;
        for t in mesh.connectivity.triangles() {
            let corners = mesh.connectivity.corners(t);
            let [a, b, c] = corners.map(|v| before[v.index()]);
            let old = cross(&sub(&b, &a), &sub(&c, &a));
            let [a, b, c] = corners.map(|v| position(mesh.point(v)));
            let new = cross(&sub(&b, &a), &sub(&c, &a));
            if dot(&old, &new) < LEAST_COSINE * (norm2(&old) * norm2(&new)).sqrt() {
                for v in corners {
                    undone |= position(mesh.point(v)) != before[v.index()];
                    mesh.points[v.index()][..3].copy_from_slice(&before[v.index()]);
                }
            }
        }
        if !undone {
            break;
        }
    }
}
