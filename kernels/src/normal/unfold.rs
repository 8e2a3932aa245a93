//! No triangle of a level may turn over, or be a needle.
//!
//! Turned over is a triangle that looks away both from the surface at its corners and from the triangle it is a part
//! of: where the input is crumpled, one of the two is no measure. New vertices of such a triangle are tried at other
//! places of the surface: on the line from the unrelaxed point, where they are expected, near the mean of their
//! neighbours and near the middle of their edge. What makes the worst triangle around better is taken. Where the
//! input is not crumpled and a triangle looks away from the surface alone, only the line is tried: a vector costs more.

use super::found::Found;
use super::place::Search;
use crate::base::geometry::{Vec3, add_scaled, cross, distance2, dot, midpoint, norm2, sub, unit};
use crate::subdivision::topology::NONE;

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
pub fn soundness([a, b, c]: [&Vec3; 3], normals: [&Vec3; 3]) -> f64 {
    let (ab, ac, bc) = (sub(b, a), sub(c, a), sub(c, b));
    let normal = cross(&ab, &ac);
    let area = norm2(&normal).sqrt();
    let longest = norm2(&ab).max(norm2(&ac)).max(norm2(&bc));
    if area <= LEAST_FLATNESS * longest {
        return -2.0;
    }
    let sum = sum(normals);
    let length = norm2(&sum).sqrt();
    if length > 0.0 { dot(&normal, &sum) / (area * length) } else { 1.0 }
}

fn sum(vectors: [&Vec3; 3]) -> Vec3 {
    std::array::from_fn(|i| vectors.iter().map(|v| v[i]).sum())
}

/// Whether a triangle may stay as it is.
fn is_sound(soundness: f64) -> bool {
    soundness >= LEAST_COSINE
}

/// The next level while it is being mended.
struct Fine<'a> {
    search: &'a Search<'a>,
    found: &'a mut [Found],
    /// Of the surface at all vertices, those of the level before first; and of the triangles of that level.
    normals: Vec<Vec3>,
    coarse_faces: Vec<Vec3>,
}

impl Fine<'_> {
    /// The number of the new vertex of an edge.
    fn vertex(&self, edge: usize) -> usize {
        self.search.level.points.len() + edge
    }

    fn point(&self, v: u32) -> &Vec3 {
        let coarse = &self.search.level.points;
        coarse.get(v as usize).unwrap_or_else(|| &self.found[v as usize - coarse.len()].point)
    }

    /// How sound a child of triangle `t` of the coarse level is: by the surface, or by the triangle too where the
    /// surface is crumpled, or, if `lenient`, wherever it is not smooth beyond doubt.
    fn soundness(&self, t: usize, corners: &[u32; 3], lenient: bool) -> f64 {
        let points = corners.map(|v| self.point(v));
        let normals = corners.map(|v| &self.normals[v as usize]);
        let along_surface = soundness(points, normals);
        let enough = if lenient { SMOOTH } else { COHERENT };
        if norm2(&sum(normals)) >= enough * enough {
            return along_surface;
        }
        along_surface.max(soundness(points, [&self.coarse_faces[t]; 3]))
    }

    /// The children of triangle `t` of the coarse level that are not sound.
    fn unsound(&self, t: usize, lenient: bool) -> usize {
        let children = self.search.level.topology.children(t);
        children.iter().filter(|corners| !is_sound(self.soundness(t, corners, lenient))).count()
    }

    /// The worst of the triangles around the new vertex of an edge.
    fn worst_around(&self, edge: usize, lenient: bool) -> f64 {
        let v = self.vertex(edge) as u32;
        let topology = &self.search.level.topology;
        let beside = topology.edge_triangles[edge].into_iter().filter(|&t| t != NONE).map(|t| t as usize);
        let around = beside.flat_map(|t| topology.children(t).map(|corners| (t, corners)));
        let around = around.filter(|(_, corners)| corners.contains(&v));
        around.map(|(t, corners)| self.soundness(t, &corners, lenient)).fold(f64::INFINITY, f64::min)
    }

    /// Put the new vertex of an edge elsewhere if that makes the worst triangle around it better; whether it did.
    fn try_out(&mut self, edge: usize, to: Found, worst: &mut f64) -> bool {
        let v = self.vertex(edge);
        let kept = (self.found[edge], self.normals[v]);
        self.found[edge] = to;
        self.normals[v] = self.search.original.surface.normal_at(&to.place);
        let now = self.worst_around(edge, false);
        let better = now > *worst + LEAST_GAIN;
        if better {
            *worst = now;
        } else {
            (self.found[edge], self.normals[v]) = kept;
        }
        better
    }

    /// Try other places for the new vertex of an edge; whether one is better.
    fn mend(&mut self, edge: usize) -> bool {
        let search = self.search;
        let mut worst = self.worst_around(edge, false);
        if search.level.topology.is_boundary_edge(edge) || is_sound(worst) {
            return false;
        }
        let mut moved = search.unrelaxed(edge).is_some_and(|to| self.try_out(edge, to, &mut worst));
        // A vector costs more: only where a triangle looks away from all.
        if is_sound(self.worst_around(edge, true)) {
            return moved;
        }
        let frame = &search.predicted.frames[edge];
        let directions = [self.normals[self.vertex(edge)], frame[0]];
        let targets = self.targets(edge, frame);
        let near = targets.iter().flat_map(|p| directions.map(|n| search.nearest(edge, p, &n)));
        for place in search.expected_place(edge).into_iter().chain(near) {
            if is_sound(worst) {
                break;
            }
            moved |= self.try_out(edge, search.vector(edge, place), &mut worst);
        }
        moved
    }

    /// Points near which the new vertex of an edge may do better.
    fn targets(&self, edge: usize, [_, tangent, third]: &[Vec3; 3]) -> Vec<Vec3> {
        let [a, b] = self.search.level.topology.edges[edge].map(|v| self.point(v));
        let (middle, mean) = (midpoint(a, b), self.mean_around(edge));
        let length = distance2(a, b).sqrt();
        let aside =
            |&[x, y]: &[f64; 2]| add_scaled(&add_scaled(&middle, x * length, tangent), y * length, third);
        let mut targets =
            vec![mean, middle, midpoint(&mean, &middle), midpoint(&mean, &self.found[edge].point)];
        targets.extend(ASIDE.iter().map(aside));
        targets
    }

    /// The mean of the six neighbours of a new vertex.
    fn mean_around(&self, edge: usize) -> Vec3 {
        let topology = &self.search.level.topology;
        let beside = topology.edge_triangles[edge].into_iter().filter(|&t| t != NONE);
        let others = beside.flat_map(|t| topology.triangle_edges[t as usize]).map(|e| e as usize);
        let others = others.filter(|&e| e != edge).map(|e| self.vertex(e) as u32);
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        for v in topology.edges[edge].into_iter().chain(others) {
            sum = add_scaled(&sum, 1.0, self.point(v));
            count += 1.0;
        }
        sum.map(|x| x / count)
    }
}

/// Mend what can be mended; returns the triangles of the level before with children that are not sound, once for each
/// of these.
pub fn unfold(search: &Search<'_>, found: &mut [Found]) -> Vec<usize> {
    let (topology, points) = (&search.level.topology, &search.level.points);
    let places = search.placed.places.iter().chain(found.iter().map(|f| &f.place));
    let normals = places.map(|place| search.original.surface.normal_at(place)).collect();
    let face = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|v| &points[v as usize]);
        unit(&cross(&sub(b, a), &sub(c, a)))
    };
    let coarse_faces = topology.triangles.iter().map(face).collect();
    let mut fine = Fine { search, found, normals, coarse_faces };
    let mut open: Vec<usize> = (0..topology.triangles.len()).collect();
    for _ in 0..TURNS {
        open.retain(|&t| fine.unsound(t, false) > 0);
        // What makes one triangle better may turn its neighbour over.
        let mut beside = vec![];
        for &t in &open {
            for edge in topology.triangle_edges[t] {
                if fine.mend(edge as usize) {
                    beside.extend(topology.edge_triangles[edge as usize].into_iter().filter(|&t| t != NONE));
                }
            }
        }
        if beside.is_empty() {
            break;
        }
        open.extend(beside.into_iter().map(|t| t as usize));
        open.sort_unstable();
        open.dedup();
    }
    open.iter().flat_map(|&t| std::iter::repeat_n(t, fine.unsound(t, true))).collect()
}
