//! Prediction of the next level's vertices, computed by encoder and decoder alike.
//!
//! Results must be identical on all machines. Only additions, multiplications, divisions and square roots are
//! allowed, in a fixed order.

use super::surface::compute_vertex_normals;
use crate::base::geometry::{Vec3, add_scaled, cross, distance2, dot, midpoint, norm2, normalize, sub};
use crate::subdivision::snm_contents::Scheme;
use crate::subdivision::topology::{NONE, Topology};

/// Fraction of a Laplacian step that is applied, and the maximum displacement per step in edge lengths.
const DAMPING: f64 = 0.5;
const MAX_DISPLACEMENT: f64 = 0.1;
/// Cosine of 30°: an edge is a crease if its triangles meet at a larger angle.
const CREASE_COSINE: f64 = 0.866;

/// Local axes at a new vertex: unit normal, unit tangent along the edge, and their cross product.
pub type Frame = [Vec3; 3];

/// Predicted vertices of a level, in the order of the coarser level's edges.
#[derive(Clone, Debug, PartialEq)]
pub struct PredictedVertices {
    pub points: Vec<Vec3>,
    /// Predicted points before relaxation.
    pub unrelaxed: Vec<Vec3>,
    pub frames: Vec<Frame>,
}

/// Predict the new vertices that refine `topology`.
pub fn predict(topology: &Topology, points: &[Vec3], scheme: Scheme, relaxations: u8) -> PredictedVertices {
    let normals = compute_vertex_normals(points, &topology.triangles);
    let mut predicted = match scheme {
        Scheme::Linear => compute_midpoints(topology, points),
        Scheme::Butterfly => crate::subdivision::butterfly::compute_edge_points(topology, points),
    };
    let frames: Vec<Frame> = topology
        .edges
        .iter()
        .enumerate()
        .map(|(edge, ends)| compute_frame(topology, points, &normals, edge, ends))
        .collect();
    let unrelaxed = predicted.clone();
    if relaxations > 0 {
        let creases = detect_creases(topology, points);
        for _ in 0..relaxations {
            predicted = relax(topology, points, &frames, &creases, &predicted);
        }
    }
    PredictedVertices { points: predicted, unrelaxed, frames }
}

fn compute_midpoints(topology: &Topology, points: &[Vec3]) -> Vec<Vec3> {
    topology.edges.iter().map(|e| midpoint(&points[e[0] as usize], &points[e[1] as usize])).collect()
}

/// Compute the axes of an edge. The normal is the mean of the end normals (Li, Li, Xu and Li 2002, section
/// 3.2).
fn compute_frame(
    topology: &Topology,
    points: &[Vec3],
    normals: &[Vec3],
    edge: usize,
    ends: &[u32; 2],
) -> Frame {
    let [a, b] = ends.map(|v| points[v as usize]);
    let [na, nb] = ends.map(|v| normals[v as usize]);
    let along = sub(&b, &a);
    let mut normal = normalize(&add_scaled(&na, 1.0, &nb));
    if norm2(&normal) == 0.0 {
        // Opposite end normals cancel. Use the adjacent triangles instead, or else a fixed direction.
        let beside = topology.edge_triangles[edge].iter().filter(|&&t| t != NONE);
        let sum = beside.fold([0.0; 3], |sum, &t| {
            let [p, q, r] = topology.triangles[t as usize].map(|v| points[v as usize]);
            add_scaled(&sum, 1.0, &cross(&sub(&q, &p), &sub(&r, &p)))
        });
        normal = normalize(&sum);
        if norm2(&normal) == 0.0 {
            normal = [0.0, 0.0, 1.0];
        }
    }
    let mut tangent = normalize(&add_scaled(&along, -dot(&along, &normal), &normal));
    if norm2(&tangent) == 0.0 {
        // The edge is parallel to the normal. Use the coordinate axis with the smallest component along it.
        let least = (0..3).fold(0, |least, i| if normal[i].abs() < normal[least].abs() { i } else { least });
        let axis = [0, 1, 2].map(|i| f64::from(u8::from(i == least)));
        tangent = normalize(&add_scaled(&axis, -dot(&axis, &normal), &normal));
    }
    [normal, tangent, cross(&normal, &tangent)]
}

/// Flag each edge whose adjacent triangles meet at a crease angle.
fn detect_creases(topology: &Topology, points: &[Vec3]) -> Vec<bool> {
    let of_triangle = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|v| points[v as usize]);
        cross(&sub(&b, &a), &sub(&c, &a))
    };
    let normals: Vec<Vec3> = topology.triangles.iter().map(of_triangle).collect();
    let meet = |&[t, u]: &[u32; 2]| {
        let (n, Some(m)) = (&normals[t as usize], normals.get(u as usize)) else { return false };
        dot(n, m) < CREASE_COSINE * (norm2(n) * norm2(m)).sqrt()
    };
    topology.edge_triangles.iter().map(meet).collect()
}

/// Apply one tangential umbrella Laplacian step to the new vertices, equations (2) to (4). Boundary vertices
/// stay. Vertices on a crease move only along it, which keeps the crease sharp.
fn relax(
    topology: &Topology,
    points: &[Vec3],
    frames: &[Frame],
    creases: &[bool],
    middles: &[Vec3],
) -> Vec<Vec3> {
    let moved = |edge: usize| {
        let here = &middles[edge];
        if topology.is_boundary_edge(edge) {
            return *here;
        }
        let [a, b] = topology.edges[edge].map(|v| &points[v as usize]);
        let mut sum = add_scaled(&sub(a, here), 1.0, &sub(b, here));
        for t in topology.edge_triangles[edge] {
            for other in topology.triangle_edges[t as usize] {
                if other as usize != edge {
                    sum = add_scaled(&sum, 1.0, &sub(&middles[other as usize], here));
                }
            }
        }
        let laplacian = sum.map(|x| x / 6.0);
        let [normal, ..] = &frames[edge];
        let tangential = if creases[edge] {
            let along = normalize(&sub(b, a));
            along.map(|x| x * dot(&laplacian, &along))
        } else {
            add_scaled(&laplacian, -dot(&laplacian, normal), normal)
        };
        // Without this limit, vertices of long edges would crowd the ends of other edges.
        let most2 = MAX_DISPLACEMENT * MAX_DISPLACEMENT * distance2(a, b);
        let length2 = norm2(&tangential);
        let share = if length2 > most2 { (most2 / length2).sqrt() } else { 1.0 };
        add_scaled(here, share * DAMPING, &tangential)
    };
    (0..middles.len()).map(moved).collect()
}
