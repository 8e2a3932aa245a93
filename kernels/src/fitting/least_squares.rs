//! Least-squares fit of a simplified mesh to its input, with fixed connectivity.
//!
//! Samples of the input are assigned to the nearest point of the result. Vertices then move along their
//! normals, and their attributes change, to minimise the squared differences at the samples. This is the
//! inner problem of Hoppe, DeRose, Duchamp, McDonald and Stuetzle, "Mesh optimization", 1993, with one
//! unknown per vertex instead of three.
//!
//! Samples are the centres of the input triangles, weighted by area. If there are few of them per triangle of
//! the result, the corners count too: 1/12 of the area each, and 3/4 for the centre, which integrates
//! quadratic functions exactly.

use crate::base::errors::KernelError;
use crate::base::geometry::{
    SearchTriangle, Vec3, add_scaled, area, bounding_box, cross, dot, enlarge_box, norm2, position_of, sub,
};
use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::base::parallel::{fill, for_each_part};
use crate::base::progress::Progress;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::{Mesh, VertexLock};

/// Strength of the spring on every unknown, relative to the sample weight of a vertex. Without it, vertices
/// with few samples would follow the noise.
const SPRING_RATIO: f64 = 0.05;

/// Iterations of the conjugate gradient method; the systems are well conditioned.
const SOLVER_ITERATIONS: usize = 12;

/// Minimum cosine between old and new normal of a triangle (60°).
const MIN_NORMAL_COSINE: f64 = 0.5;

/// Maximum step of a vertex, relative to the distance of its farthest sample. If vertex normals are nearly
/// perpendicular to all triangle normals, as on a thin prism, samples hardly constrain the vertex. It would
/// become a spike.
const MAX_STEP_RATIO: f64 = 2.0;

/// Margin around the bounding box of the input that vertices must not leave, relative to its diagonal. If one
/// vertex represents a whole side of the object, the least-squares solution is far outside.
pub const BOX_MARGIN_RATIO: f64 = 0.05;

/// Samples per parallel task.
const SAMPLES_PER_TASK: usize = 1 << 14;

/// The input, and the vertex of the result that contains each of its vertices.
pub struct FitInput<'a, const D: usize> {
    pub points: &'a [[f64; D]],
    pub triangles: &'a [[u32; 3]],
    pub vertex_map: &'a [VertexId],
}

/// With this many input triangles per triangle of the result, their centres are enough samples.
const MIN_CENTRES_PER_TRIANGLE: usize = 6;

/// Samples of the input: the centres of its triangles, followed by its vertices if they count.
struct Samples<'a, const D: usize> {
    input: &'a FitInput<'a, D>,
    /// Weights of the vertices; empty if they do not count.
    vertices: Vec<f64>,
}

impl<'a, const D: usize> Samples<'a, D> {
    fn new(input: &'a FitInput<'a, D>, with_vertices: bool) -> Self {
        let mut samples = Self { input, vertices: vec![] };
        if with_vertices {
            samples.vertices = vec![0.0; input.points.len()];
            for corners in input.triangles {
                let share = samples.area(corners) / 12.0;
                corners.iter().for_each(|&v| samples.vertices[v as usize] += share);
            }
        }
        samples
    }

    fn len(&self) -> usize {
        self.input.triangles.len() + self.vertices.len()
    }

    fn area(&self, corners: &[u32; 3]) -> f64 {
        let points = corners.map(|v| position_of(&self.input.points[v as usize]));
        area(points.each_ref())
    }

    fn weight(&self, i: usize) -> f64 {
        match self.input.triangles.get(i) {
            Some(corners) if self.vertices.is_empty() => self.area(corners),
            Some(corners) => 0.75 * self.area(corners),
            None => self.vertices[i - self.input.triangles.len()],
        }
    }

    /// Return the position and attributes of a sample, and its start vertex.
    ///
    /// The search for its nearest point starts at that vertex of the result.
    fn position_and_start(&self, i: usize) -> ([f64; D], VertexId) {
        let Some(corners) = self.input.triangles.get(i) else {
            let v = i - self.input.triangles.len();
            return (self.input.points[v], self.input.vertex_map[v]);
        };
        let corners = corners.map(|v| v as usize);
        let [a, b, c] = corners.map(|v| &self.input.points[v]);
        let near = corners.into_iter().map(|v| self.input.vertex_map[v]).find(|v| v.is_some());
        (std::array::from_fn(|i| (a[i] + b[i] + c[i]) / 3.0), near.unwrap_or(VertexId::NONE))
    }
}

/// Nearest point on the result. Single precision is enough for the barycentric coordinates.
#[derive(Clone, Copy)]
struct NearestResultPoint {
    triangle: TriangleId,
    at: [f32; 2],
}

impl NearestResultPoint {
    fn weights(&self) -> [f64; 3] {
        let [b, c] = self.at.map(f64::from);
        [1.0 - b - c, b, c]
    }
}

/// Find the nearest point by a greedy walk from vertex `start`.
///
/// The walk searches the triangles around a vertex, and continues at a corner of the nearest triangle while
/// that is an improvement.
fn find_nearest<const D: usize>(
    mesh: &Mesh<D>,
    prepared: &[SearchTriangle],
    p: &Vec3,
    start: VertexId,
) -> Option<NearestResultPoint> {
    let mut best: Option<(f64, TriangleId, [f64; 3])> = None;
    let (mut before, mut from) = (VertexId::NONE, start);
    loop {
        let mut closer = false;
        for h in mesh.connectivity.fan(from) {
            let triangle = Connectivity::triangle(h);
            let corners = mesh.connectivity.corners(triangle);
            // Triangles at the previous vertex have been searched.
            if corners.contains(&before) {
                continue;
            }
            let (at, distance2) = prepared[triangle.index()].nearest(p);
            if best.is_none_or(|(least, _, _)| distance2 < least) {
                best = Some((distance2, triangle, at));
                closer = true;
            }
        }
        let (_, triangle, at) = best?;
        let corners = mesh.connectivity.corners(triangle);
        // If the foot is on a side or a corner, a triangle across it may be nearer.
        let beyond = (0..3).find(|&i| at[i] > EDGE_WEIGHT && corners[i] != from);
        match beyond {
            Some(i) if closer && at.iter().any(|&x| x <= EDGE_WEIGHT) => (before, from) = (from, corners[i]),
            _ => return Some(NearestResultPoint { triangle, at: [at[1] as f32, at[2] as f32] }),
        }
    }
}

/// A barycentric coordinate below this counts as on the opposite side.
const EDGE_WEIGHT: f64 = 1e-9;

/// Fit `mesh` to `input`. Locked vertices do not change; boundary vertices keep their position.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn fit<const D: usize>(
    mesh: &mut Mesh<D>,
    input: &FitInput<'_, D>,
    threads: usize,
    progress: &Progress,
) -> Result<(), KernelError> {
    let with_vertices = input.triangles.len() < MIN_CENTRES_PER_TRIANGLE * mesh.connectivity.triangle_count();
    let samples = Samples::new(input, with_vertices);
    // A triangle that has vanished is never searched.
    let prepared: Vec<SearchTriangle> = (0..mesh.connectivity.triangle_slots())
        .map(|t| {
            let corners = mesh.connectivity.corners(TriangleId::from_index(t));
            let corners = corners.map(|v| mesh.points.get(v.index()).map_or([0.0; 3], position_of));
            SearchTriangle::new(corners.each_ref())
        })
        .collect();
    let find = |(chunk, hits): (usize, &mut [Option<NearestResultPoint>])| {
        if progress.check().is_err() {
            return;
        }
        for (i, hit) in (SAMPLES_PER_TASK * chunk..).zip(hits) {
            let (point, near) = samples.position_and_start(i);
            *hit =
                if near.is_none() { None } else { find_nearest(mesh, &prepared, &position_of(&point), near) };
        }
    };
    let mut hits = vec![None; samples.len()];
    for_each_part(hits.chunks_mut(SAMPLES_PER_TASK).enumerate().collect(), threads, find);
    progress.check()?;
    let normals = vertex_normals(mesh);
    let system = NormalEquations::new(mesh, &samples, &hits, &normals, threads);
    progress.check()?;
    let mut solution = system.solve();
    let bounds = enlarge_box(&bounding_box(input.points.iter().map(position_of)), BOX_MARGIN_RATIO);
    for (v, (step, farthest2)) in solution.iter_mut().zip(&system.farthest2).enumerate() {
        let reach = MAX_STEP_RATIO * farthest2.sqrt();
        step[0] = clamp_step_to_box(
            &bounds,
            &position_of(&mesh.points[v]),
            &normals[v],
            step[0].clamp(-reach, reach),
        );
    }
    for (point, step) in mesh.points.iter_mut().zip(&solution) {
        (3..D).for_each(|j| point[j] += step[j]);
    }
    move_along_normals(mesh, &normals, &solution);
    Ok(())
}

/// Shorten the step `way` along a direction so that it stays in a box; 0 for a point outside.
fn clamp_step_to_box([low, high]: &[Vec3; 2], from: &Vec3, direction: &Vec3, way: f64) -> f64 {
    let mut share = 1.0_f64;
    for i in 0..3 {
        let (step, wall) = (way * direction[i], if way * direction[i] > 0.0 { high[i] } else { low[i] });
        if step != 0.0 {
            share = share.min(((wall - from[i]) / step).max(0.0));
        }
    }
    share * way
}

/// Normal equations: unknown 0 of a vertex is its step along the normal, the others are its attributes.
struct NormalEquations<const D: usize> {
    /// Diagonal for shape and for each attribute; infinite if the unknown is fixed.
    diagonal: Vec<[f64; 2]>,
    /// Off-diagonal entries, by edge.
    off_diagonal: Vec<([u32; 2], [f64; 2])>,
    right_hand_side: Vec<[f64; D]>,
    /// By vertex: squared distance of the farthest sample on its triangles.
    farthest2: Vec<f64>,
}

/// Contribution of the samples of one triangle to the system, by corner and by side.
#[derive(Clone, Copy)]
struct TriangleContribution<const D: usize> {
    diagonal: [[f64; 2]; 3],
    across: [[f64; 2]; 3],
    right: [[f64; D]; 3],
    farthest2: f64,
}

/// Triangles whose contributions are buffered at a time.
const CONTRIBUTIONS_PER_BLOCK: usize = 1 << 15;

impl<const D: usize> TriangleContribution<D> {
    const NONE: Self =
        Self { diagonal: [[0.0; 2]; 3], across: [[0.0; 2]; 3], right: [[0.0; D]; 3], farthest2: 0.0 };

    fn add(
        &mut self,
        weight: f64,
        sample: &[f64; D],
        at: [f64; 3],
        points: [&[f64; D]; 3],
        normals: [&Vec3; 3],
    ) {
        let off: [f64; D] = std::array::from_fn(|j| {
            sample[j] - (at[0] * points[0][j] + at[1] * points[1][j] + at[2] * points[2][j])
        });
        let [a, b, c] = points.map(position_of);
        let is_inside = at.iter().all(|&x| x > EDGE_WEIGHT);
        let away = position_of(&off);
        self.farthest2 = self.farthest2.max(norm2(&away));
        // If the foot is on a side, the distance is not along the normal of the triangle.
        let towards = if is_inside || norm2(&away) == 0.0 { cross(&sub(&b, &a), &sub(&c, &a)) } else { away };
        let length = norm2(&towards).sqrt();
        if length == 0.0 {
            return;
        }
        let towards = towards.map(|x| x / length);
        let distance = dot(&away, &towards);
        let lever: [f64; 3] = std::array::from_fn(|k| at[k] * dot(&towards, normals[k]));
        for k in 0..3 {
            let next = (k + 1) % 3;
            self.diagonal[k][0] += weight * (lever[k] * lever[k] + SPRING_RATIO * at[k] * at[k]);
            self.diagonal[k][1] += weight * (1.0 + SPRING_RATIO) * at[k] * at[k];
            self.across[k][0] += weight * lever[k] * lever[next];
            self.across[k][1] += weight * at[k] * at[next];
            self.right[k][0] += weight * lever[k] * distance;
            (3..D).for_each(|j| self.right[k][j] += weight * at[k] * off[j]);
        }
    }
}

/// Group samples by nearest triangle; the samples of `t` are `order[starts[t]..starts[t + 1]]`.
fn group_by_triangle(hits: &[Option<NearestResultPoint>], triangles: usize) -> (Vec<u32>, Vec<u32>) {
    let mut starts = vec![0u32; triangles + 1];
    for hit in hits.iter().flatten() {
        starts[hit.triangle.index() + 1] += 1;
    }
    for t in 0..triangles {
        starts[t + 1] += starts[t];
    }
    let mut next = starts.clone();
    let mut order = vec![0u32; starts[triangles] as usize];
    for (hit, i) in hits.iter().zip(0..) {
        if let Some(hit) = hit {
            let place = &mut next[hit.triangle.index()];
            order[*place as usize] = i;
            *place += 1;
        }
    }
    (order, starts)
}

impl<const D: usize> NormalEquations<D> {
    fn new(
        mesh: &Mesh<D>,
        samples: &Samples<'_, D>,
        hits: &[Option<NearestResultPoint>],
        normals: &[Vec3],
        threads: usize,
    ) -> Self {
        let connectivity = &mesh.connectivity;
        let triangles = connectivity.triangle_slots();
        let (order, starts) = group_by_triangle(hits, triangles);
        let share = |t: usize| {
            let mut share = TriangleContribution::NONE;
            let corners = connectivity.corners(TriangleId::from_index(t));
            let (points, normals) = (corners.map(|v| mesh.point(v)), corners.map(|v| &normals[v.index()]));
            for &i in &order[starts[t] as usize..starts[t + 1] as usize] {
                let at = hits[i as usize].map_or([0.0; 3], |hit| hit.weights());
                share.add(
                    samples.weight(i as usize),
                    &samples.position_and_start(i as usize).0,
                    at,
                    points,
                    normals,
                );
            }
            share
        };
        let mut diagonal = vec![[0.0; 2]; mesh.points.len()];
        let mut across = vec![[0.0; 2]; connectivity.edge_slots()];
        let mut right = vec![[0.0; D]; mesh.points.len()];
        let mut farthest2 = vec![0.0_f64; mesh.points.len()];
        let mut shares = vec![TriangleContribution::<D>::NONE; CONTRIBUTIONS_PER_BLOCK.min(triangles)];
        for block in (0..triangles).step_by(CONTRIBUTIONS_PER_BLOCK) {
            let shares = &mut shares[..CONTRIBUTIONS_PER_BLOCK.min(triangles - block)];
            fill(shares, threads, |i| share(block + i));
            for (share, t) in shares.iter().zip(block..) {
                let corners = connectivity.corners(TriangleId::from_index(t));
                for (k, v) in corners.into_iter().map(VertexId::index).enumerate() {
                    let edge = connectivity.edge(HalfedgeId((3 * t + k) as u32)).index();
                    (0..2).for_each(|i| diagonal[v][i] += share.diagonal[k][i]);
                    (0..2).for_each(|i| across[edge][i] += share.across[k][i]);
                    (0..D).for_each(|j| right[v][j] += share.right[k][j]);
                    farthest2[v] = farthest2[v].max(share.farthest2);
                }
            }
        }
        for v in connectivity.vertices() {
            let (is_locked, i) = (mesh.lock(v) == VertexLock::Locked, v.index());
            if is_locked || connectivity.is_boundary_vertex(v) {
                (diagonal[i][0], right[i][0]) = (f64::INFINITY, 0.0);
            }
            if is_locked {
                (diagonal[i][1], right[i]) = (f64::INFINITY, [0.0; D]);
            }
        }
        let across = connectivity.edges().map(|e| (connectivity.ends(e).map(|v| v.0), across[e.index()]));
        Self { diagonal, off_diagonal: across.collect(), right_hand_side: right, farthest2 }
    }

    /// Solve all unknowns by the preconditioned conjugate gradient method.
    ///
    /// The preconditioner is the diagonal.
    fn solve(&self) -> Vec<[f64; D]> {
        let n = self.right_hand_side.len();
        let matrix = |j: usize| usize::from(j > 0);
        let scaled = |v: usize, r: &[f64; D]| -> [f64; D] {
            let d = self.diagonal[v];
            std::array::from_fn(|j| if d[matrix(j)] > 0.0 { r[j] / d[matrix(j)] } else { 0.0 })
        };
        let mut x = vec![[0.0; D]; n];
        let mut r = self.right_hand_side.clone();
        let mut z: Vec<[f64; D]> = (0..n).map(|v| scaled(v, &r[v])).collect();
        let mut p = z.clone();
        let mut q = vec![[0.0; D]; n];
        let mut rz = inner_products(&r, &z);
        for _ in 0..SOLVER_ITERATIONS {
            self.multiply(&p, &mut q);
            let pq = inner_products(&p, &q);
            let alpha: [f64; D] = std::array::from_fn(|j| if pq[j] > 0.0 { rz[j] / pq[j] } else { 0.0 });
            for v in 0..n {
                for j in 0..D {
                    x[v][j] += alpha[j] * p[v][j];
                    r[v][j] -= alpha[j] * q[v][j];
                }
                z[v] = scaled(v, &r[v]);
            }
            let next = inner_products(&r, &z);
            let beta: [f64; D] = std::array::from_fn(|j| if rz[j] > 0.0 { next[j] / rz[j] } else { 0.0 });
            for v in 0..n {
                (0..D).for_each(|j| p[v][j] = z[v][j] + beta[j] * p[v][j]);
            }
            rz = next;
        }
        x
    }

    fn multiply(&self, p: &[[f64; D]], q: &mut [[f64; D]]) {
        for (v, diagonal) in self.diagonal.iter().enumerate() {
            // Fixed unknowns contribute nothing.
            let d = diagonal.map(|d| if d.is_finite() { d } else { 0.0 });
            (0..D).for_each(|j| q[v][j] = d[usize::from(j > 0)] * p[v][j]);
        }
        for &([a, b], m) in &self.off_diagonal {
            let (a, b) = (a as usize, b as usize);
            for j in 0..D {
                let m = m[usize::from(j > 0)];
                q[a][j] += m * p[b][j];
                q[b][j] += m * p[a][j];
            }
        }
    }
}

/// Compute the inner product of each unknown over all vertices.
fn inner_products<const D: usize>(a: &[[f64; D]], b: &[[f64; D]]) -> [f64; D] {
    let mut sum = [0.0; D];
    for (a, b) in a.iter().zip(b) {
        (0..D).for_each(|j| sum[j] += a[j] * b[j]);
    }
    sum
}

/// Compute area-weighted unit normals by vertex.
fn vertex_normals<const D: usize>(mesh: &Mesh<D>) -> Vec<Vec3> {
    let mut normals = vec![[0.0; 3]; mesh.points.len()];
    for t in mesh.connectivity.triangles() {
        let [a, b, c] = mesh.triangle_points(t).map(|q| position_of(&q));
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

/// Apply the steps along the normals.
///
/// Steps of the corners of a triangle that would turn too far are undone.
fn move_along_normals<const D: usize>(mesh: &mut Mesh<D>, normals: &[Vec3], solution: &[[f64; D]]) {
    let before: Vec<Vec3> = mesh.points.iter().map(position_of).collect();
    for v in 0..mesh.points.len() {
        (0..3).for_each(|i| mesh.points[v][i] += solution[v][0] * normals[v][i]);
    }
    loop {
        let mut undone = false;
        for t in mesh.connectivity.triangles() {
            let corners = mesh.connectivity.corners(t);
            let [a, b, c] = corners.map(|v| before[v.index()]);
            let old = cross(&sub(&b, &a), &sub(&c, &a));
            let [a, b, c] = corners.map(|v| position_of(mesh.point(v)));
            let new = cross(&sub(&b, &a), &sub(&c, &a));
            if dot(&old, &new) < MIN_NORMAL_COSINE * (norm2(&old) * norm2(&new)).sqrt() {
                for v in corners {
                    undone |= position_of(mesh.point(v)) != before[v.index()];
                    mesh.points[v.index()][..3].copy_from_slice(&before[v.index()]);
                }
            }
        }
        if !undone {
            break;
        }
    }
}
