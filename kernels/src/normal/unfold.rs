//! No triangle of a level may turn over, or be a needle.
//!
//! Turned over is a triangle that looks away both from the surface at its corners and from the triangle it is a part
//! of: where the input is crumpled, one of the two is no measure. New vertices of such a triangle are tried at other
//! places of the surface: on the line from the unrelaxed point, where they are expected, near the mean of their
//! neighbours and near the middle of their edge. What makes the worst triangle around better is taken. Where the
//! input is not crumpled and a triangle looks away from the surface alone, only the line is tried: a vector costs more.

use super::grid::Steps;
use super::place::{Found, Original, Placed, vector_to};
use super::predict::Predicted;
use super::surface::unit;
use super::topology::{NONE, Topology};
use crate::geometry::{Vec3, add_scaled, cross, dot, midpoint, norm2, sub};
use crate::snm::contents::Offset;

/// Turns over all triangles that are not sound.
const TURNS: usize = 12;
/// Least cosine between a triangle and the surface's mean normal at its corners.
const LEAST_COSINE: f64 = 0.02;
/// Least height of a triangle in lengths of its longest side.
const LEAST_FLATNESS: f64 = 1e-3;

/// Length of the sum of a triangle's three normals below which the surface is crumpled there, and from which it is smooth.
const COHERENT: f64 = 2.0;
const SMOOTH: f64 = 2.9;
/// Where else to look, in lengths of the edge along it and across.
const ASIDE: [[f64; 2]; 12] = [
    [0.2, 0.0],
    [-0.2, 0.0],
    [0.0, 0.2],
    [0.0, -0.2],
    [0.35, 0.0],
    [-0.35, 0.0],
    [0.0, 0.4],
    [0.0, -0.4],
    [0.25, 0.25],
    [0.25, -0.25],
    [-0.25, 0.25],
    [-0.25, -0.25],
];
/// What is not better by this is not better.
const LEAST_GAIN: f64 = 1e-6;

/// How sound a triangle is: the cosine between it and the surface at its corners; below −1 for a needle.
pub fn soundness(points: [&Vec3; 3], normals: [&Vec3; 3]) -> f64 {
    let [a, b, c] = points;
    let (ab, ac, bc) = (sub(b, a), sub(c, a), sub(c, b));
    let normal = cross(&ab, &ac);
    let area = norm2(&normal).sqrt();
    let longest = norm2(&ab).max(norm2(&ac)).max(norm2(&bc));
    if area <= LEAST_FLATNESS * longest {
        return -2.0;
    }
    let sum: Vec3 = [0, 1, 2].map(|i| normals.iter().map(|n| n[i]).sum());
    let length = norm2(&sum).sqrt();
    if length > 0.0 { dot(&normal, &sum) / (area * length) } else { 1.0 }
}

/// How much three normals agree: the length of their sum.
fn agreement(normals: [&Vec3; 3]) -> f64 {
    let sum: Vec3 = std::array::from_fn(|i| normals.iter().map(|n| n[i]).sum());
    norm2(&sum).sqrt()
}

/// Whether a triangle may stay as it is.
fn is_sound(soundness: f64) -> bool {
    soundness >= LEAST_COSINE
}

/// The next level while it is being mended.
struct Fine<'a> {
    topology: &'a Topology,
    coarse: &'a Placed,
    coarse_normals: Vec<Vec3>,
    coarse_faces: Vec<Vec3>,
    found: &'a mut [Found],
    normals: Vec<Vec3>,
}

impl Fine<'_> {
    fn point(&self, v: u32) -> &Vec3 {
        match (v as usize).checked_sub(self.topology.vertices) {
            Some(edge) => &self.found[edge].point,
            None => &self.coarse.points[v as usize],
        }
    }

    fn normal(&self, v: u32) -> &Vec3 {
        match (v as usize).checked_sub(self.topology.vertices) {
            Some(edge) => &self.normals[edge],
            None => &self.coarse_normals[v as usize],
        }
    }

    /// How sound a child of triangle `t` of the coarse level is: by the surface, or by the triangle too where the
    /// surface is crumpled.
    fn soundness(&self, t: u32, corners: &[u32; 3]) -> f64 {
        let normals = corners.map(|v| self.normal(v));
        if agreement(normals) >= COHERENT {
            return soundness(corners.map(|v| self.point(v)), normals);
        }
        self.lenient(t, corners)
    }

    /// The same by the surface or by the triangle, unless the surface is smooth beyond doubt.
    fn lenient(&self, t: u32, corners: &[u32; 3]) -> f64 {
        let points = corners.map(|v| self.point(v));
        let normals = corners.map(|v| self.normal(v));
        let along_surface = soundness(points, normals);
        if agreement(normals) >= SMOOTH {
            return along_surface;
        }
        along_surface.max(soundness(points, [&self.coarse_faces[t as usize]; 3]))
    }

    /// The children of triangle `t` of the coarse level.
    fn children(&self, t: u32) -> [[u32; 3]; 4] {
        let n = self.topology.vertices as u32;
        let [a, b, c] = self.topology.triangles[t as usize];
        let [ab, bc, ca] = self.topology.triangle_edges[t as usize].map(|e| n + e);
        [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    }

    /// The worst of the triangles around the new vertex of an edge.
    fn worst_around(&self, edge: usize, of: impl Fn(&Self, u32, &[u32; 3]) -> f64) -> f64 {
        let v = (self.topology.vertices + edge) as u32;
        let beside = self.topology.edge_triangles[edge].iter().filter(|&&t| t != NONE);
        let around = beside.flat_map(|&t| self.children(t).map(|corners| (t, corners)));
        let around = around.filter(|(_, corners)| corners.contains(&v));
        around.map(|(t, corners)| of(self, t, &corners)).fold(f64::INFINITY, f64::min)
    }

    /// Put the new vertex of an edge elsewhere if that makes the worst triangle around it better; whether it did.
    fn try_out(&mut self, original: &Original<'_>, edge: usize, to: Found, worst: &mut f64) -> bool {
        let kept = (self.found[edge], self.normals[edge]);
        self.found[edge] = to;
        self.normals[edge] = original.surface.normal_at(&to.place);
        let now = self.worst_around(edge, Self::soundness);
        let better = now > *worst + LEAST_GAIN;
        if better {
            *worst = now;
        } else {
            (self.found[edge], self.normals[edge]) = kept;
        }
        better
    }

    /// The mean of the six neighbours of a new vertex.
    fn mean_around(&self, edge: usize) -> Vec3 {
        let n = self.topology.vertices as u32;
        let ends = self.topology.edges[edge].iter().copied();
        let beside = self.topology.edge_triangles[edge].iter().filter(|&&t| t != NONE);
        let others = beside.flat_map(|&t| self.topology.triangle_edges[t as usize]);
        let others = others.filter(|&e| e as usize != edge).map(|e| n + e);
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        for v in ends.chain(others) {
            sum = add_scaled(&sum, 1.0, self.point(v));
            count += 1.0;
        }
        sum.map(|x| x / count)
    }
}

/// Mend what can be mended; returns the triangles of `topology` with children that are not sound, once for
/// each of these.
pub fn unfold(
    original: &Original<'_>,
    topology: &Topology,
    level: usize,
    coarse: &Placed,
    predicted: &Predicted,
    steps: &Steps,
    found: &mut [Found],
) -> Vec<u32> {
    let normals = found.iter().map(|f| original.surface.normal_at(&f.place)).collect();
    let coarse_normals = coarse.places.iter().map(|place| original.surface.normal_at(place)).collect();
    let coarse_faces = topology.triangles.iter().map(|corners| {
        let [a, b, c] = corners.map(|v| &coarse.points[v as usize]);
        unit(&cross(&sub(b, a), &sub(c, a)))
    });
    let coarse_faces = coarse_faces.collect();
    let mut fine = Fine { topology, coarse, coarse_normals, coarse_faces, found, normals };
    let mut open: Vec<u32> = (0..topology.triangles.len() as u32).collect();
    for _ in 0..TURNS {
        open.retain(|&t| fine.children(t).iter().any(|corners| !is_sound(fine.soundness(t, corners))));
        if open.is_empty() {
            break;
        }
        let mut moved = false;
        for &t in &open {
            for edge in topology.triangle_edges[t as usize].map(|e| e as usize) {
                let mut worst = fine.worst_around(edge, Fine::soundness);
                if topology.is_boundary_edge(edge) || is_sound(worst) {
                    continue;
                }
                let from = &predicted.unrelaxed[edge];
                let near = if predicted.points[edge] == *from {
                    None
                } else {
                    original.scalar(topology, level, coarse, predicted, steps, edge, from, Offset::Unrelaxed)
                };
                if let Some(near) = near {
                    moved |= fine.try_out(original, edge, near, &mut worst);
                }
                // A vector costs more: only where a triangle looks away from all.
                if is_sound(fine.worst_around(edge, Fine::lenient)) {
                    continue;
                }
                let [a, b] = topology.edges[edge].map(|v| *fine.point(v));
                let (middle, mean) = (midpoint(&a, &b), fine.mean_around(edge));
                let before = fine.found[edge].point;
                let [_, tangent, third] = &predicted.frames[edge];
                let length = norm2(&sub(&b, &a)).sqrt();
                let aside = ASIDE
                    .iter()
                    .map(|[x, y]| add_scaled(&add_scaled(&middle, x * length, tangent), y * length, third));
                let towards = [mean, middle, midpoint(&mean, &middle), midpoint(&mean, &before)];
                let direction = *fine.normal((topology.vertices + edge) as u32);
                let expected = original.expected_place(topology, level, coarse, edge);
                let near = towards.into_iter().chain(aside).flat_map(|target| {
                    [direction, predicted.frames[edge][0]]
                        .map(|normal| original.nearest(topology, level, coarse, edge, &target, &normal))
                });
                for place in expected.into_iter().chain(near) {
                    if is_sound(worst) {
                        break;
                    }
                    moved |= fine.try_out(
                        original,
                        edge,
                        vector_to(place, predicted, steps, edge, false),
                        &mut worst,
                    );
                }
            }
        }
        if !moved {
            break;
        }
    }
    let unsound = |t: &u32| {
        let count = fine.children(*t).iter().filter(|c| !is_sound(fine.lenient(*t, c))).count();
        std::iter::repeat_n(*t, count)
    };
    open.iter().flat_map(unsound).collect()
}
