//! Boundaries at the outlines that the depth maps show.
//!
//! Fusion ends a surface where the voxels around it are incomplete: up to a voxel before the outline of the
//! object, or beyond it, where depth is wrong next to a discontinuity. Points on a line across the boundary get
//! the votes of all frames. The boundary belongs where the votes change from surface to free space: there, the
//! sum of the votes that it contradicts is smallest. Where no frame sees the surface end, it stays.

use super::boundary::MIN_COSINE;
use super::depth_frame::DepthFrame;
use super::folds::undo_folds;
use super::normal_filter::{area_normals, vertex_normals};
use super::refiner::mean_edge;
use super::votes::Votes;
use crate::base::geometry::{Vec3, add_scaled, cross, normalize, sub};
use crate::base::parallel::{collect, update};
use crate::mesh::connectivity::Connectivity;

/// Points of a line: on each side, and per mean edge length.
const SIDE_POINTS: usize = 8;
const POINTS_PER_EDGE: f64 = 4.0;
const POINTS: usize = 2 * SIDE_POINTS + 1;

/// Measurements up to this many mean edge lengths from the surface may belong to it whatever the noise.
const REACH_EDGES: f64 = 1.0;
/// Maximum move of a boundary vertex, in mean edge lengths.
const MAX_MOVE_EDGES: f64 = 1.0;

/// Iterations that average along the boundary: its direction, its normals, and its moves.
const DIRECTION_ITERATIONS: usize = 8;
const NORMAL_ITERATIONS: usize = 3;
const MOVE_ITERATIONS: usize = 2;

/// Votes for staying, per mean edge length of a move, relative to the typical votes on a point; and the weight of
/// staying relative to a vertex with typical votes on both sides.
const STAY_RATIO: f64 = 0.02;
const PRIOR_RATIO: f64 = 1e-3;

/// Boundaries of a mesh, with the votes of depth maps.
#[derive(Debug)]
pub struct Outlines {
    connectivity: Connectivity,
    points: Vec<Vec3>,
    mean_edge: f64,
    rim: Vec<RimVertex>,
    votes: Vec<[Votes; POINTS]>,
    threads: usize,
}

/// Vertex of the boundary.
#[derive(Clone, Copy, Debug)]
struct RimVertex {
    vertex: usize,
    /// Previous and next vertex on the boundary, as indices of rim vertices.
    neighbours: [usize; 2],
    normal: Vec3,
    /// Unit vector within the surface, away from it; zero if it is not known.
    outwards: Vec3,
}

impl Outlines {
    /// Find the boundaries of a mesh.
    pub fn new(connectivity: Connectivity, points: Vec<Vec3>, threads: usize) -> Self {
        let rim = find_rim(&connectivity, &points, threads);
        let mean_edge = mean_edge(&connectivity, &points);
        Self {
            votes: vec![[Votes::default(); POINTS]; rim.len()],
            connectivity,
            points,
            mean_edge,
            rim,
            threads,
        }
    }

    /// Return the number of vertices plus triangles.
    pub fn row_count(&self) -> usize {
        self.points.len() + self.connectivity.triangle_slots()
    }

    /// Add the votes of a frame.
    pub fn observe(&mut self, frame: DepthFrame<'_>) {
        let (rim, points, spacing) = (&self.rim, &self.points, self.mean_edge / POINTS_PER_EDGE);
        let reach = REACH_EDGES * self.mean_edge;
        update(&mut self.votes, self.threads, |i, votes| {
            let one = &rim[i];
            for (k, votes) in votes.iter_mut().enumerate() {
                let offset = (k as f64 - SIDE_POINTS as f64) * spacing;
                let at = add_scaled(&points[one.vertex], offset, &one.outwards);
                votes.add(frame, reach, &at, &one.normal);
            }
        });
    }

    /// Move the boundaries to the outlines. Returns the vertices; no triangle folds.
    pub fn finish(self) -> Vec<Vec3> {
        let typical = typical_votes(&self.votes);
        if typical == 0.0 {
            return self.points;
        }
        let mut points = self.points.clone();
        for (one, step) in self.rim.iter().zip(self.find_moves(typical)) {
            points[one.vertex] = add_scaled(&points[one.vertex], step, &one.outwards);
        }
        let references = area_normals(&self.connectivity, &self.points, self.threads);
        undo_folds(
            &self.connectivity,
            &self.points,
            &mut points,
            &references,
            MIN_COSINE,
            |_, to| to,
            self.threads,
        );
        points
    }

    /// Find the move of each rim vertex outwards, in metres: the mean along the boundary of the moves to the outline.
    fn find_moves(&self, typical: f64) -> Vec<f64> {
        let outlines = collect(self.rim.len(), self.threads, |i| find_outline(&self.votes[i], typical));
        // Weighted offsets and weights are averaged separately: their ratio is a mean in which clear outlines count
        // more.
        let sums = outlines
            .iter()
            .map(|&(offset, weight)| [weight * offset / POINTS_PER_EDGE, weight + PRIOR_RATIO])
            .collect();
        let sums = average_along(&self.rim, sums, MOVE_ITERATIONS);
        let limit = MAX_MOVE_EDGES * self.mean_edge;
        sums.iter().map(|[sum, weight]| (sum / weight * self.mean_edge).clamp(-limit, limit)).collect()
    }
}

/// Find the vertices of all boundaries, in ascending order.
fn find_rim(connectivity: &Connectivity, points: &[Vec3], threads: usize) -> Vec<RimVertex> {
    let normals = vertex_normals(connectivity, &area_normals(connectivity, points, threads), threads);
    // A boundary edge is directed along its triangle, which is on the left.
    let mut links: Vec<[usize; 2]> = connectivity
        .edges()
        .filter(|&edge| connectivity.is_boundary_edge(edge))
        .map(|edge| {
            let halfedge = connectivity.halfedge(edge);
            [connectivity.origin(halfedge).index(), connectivity.target(halfedge).index()]
        })
        .collect();
    links.sort_unstable();
    let index_of = |v: usize| links.binary_search_by_key(&v, |link| link[0]).ok();
    let mut rim: Vec<RimVertex> = links
        .iter()
        .enumerate()
        .map(|(i, &[vertex, next])| RimVertex {
            vertex,
            neighbours: [i, index_of(next).unwrap_or(i)],
            normal: normals[vertex],
            outwards: [0.0; 3],
        })
        .collect();
    for i in 0..rim.len() {
        let next = rim[i].neighbours[1];
        rim[next].neighbours[0] = i;
    }
    let along = rim
        .iter()
        .map(|one| {
            let [a, b] = one.neighbours.map(|i| points[rim[i].vertex]);
            sub(&b, &a)
        })
        .collect();
    let along = average_along(&rim, along, DIRECTION_ITERATIONS);
    let normals = average_along(&rim, rim.iter().map(|one| one.normal).collect(), NORMAL_ITERATIONS);
    for (one, (along, normal)) in rim.iter_mut().zip(along.iter().zip(&normals)) {
        one.normal = normalize(normal);
        one.outwards = normalize(&cross(along, &one.normal));
    }
    rim
}

/// Average values along the boundaries with weights 1, 2, 1, several times.
fn average_along<const D: usize>(
    rim: &[RimVertex],
    mut values: Vec<[f64; D]>,
    iterations: usize,
) -> Vec<[f64; D]> {
    for _ in 0..iterations {
        values = rim
            .iter()
            .enumerate()
            .map(|(i, one)| {
                let [a, b] = one.neighbours.map(|k| values[k]);
                std::array::from_fn(|d| 0.25 * (a[d] + b[d]) + 0.5 * values[i][d])
            })
            .collect();
    }
    values
}

/// Compute the median of the votes on the boundary, where there are any; 0 without votes.
fn typical_votes(votes: &[[Votes; POINTS]]) -> f64 {
    let mut totals: Vec<f64> = votes
        .iter()
        .map(|line| f64::from(line[SIDE_POINTS].surface + line[SIDE_POINTS].free_space))
        .filter(|&total| total > 0.0)
        .collect();
    if totals.is_empty() {
        return 0.0;
    }
    let middle = totals.len() / 2;
    *totals.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Find the outline on a line of points: its offset outwards in point spacings, and its weight relative to an outline
/// with typical votes on both sides. The weight is 0 if the line has no outline.
fn find_outline(line: &[Votes; POINTS], typical: f64) -> (f64, f64) {
    let strongest = |of: fn(&Votes) -> f32| f64::from(line.iter().map(of).fold(0.0, f32::max));
    let weight = strongest(|votes| votes.surface).min(strongest(|votes| votes.free_space)) / typical;
    // The surface ends between two points: as many votes as possible are for surface before, for free space behind.
    let (mut sum, mut best) = (0.0, (f64::NEG_INFINITY, 0));
    for end in 0..=POINTS {
        let offset = end as f64 - 0.5 - SIDE_POINTS as f64;
        let score = sum - STAY_RATIO * typical * offset.abs() / POINTS_PER_EDGE;
        if score > best.0 {
            best = (score, end);
        }
        if let Some(votes) = line.get(end) {
            sum += f64::from(votes.surface) - f64::from(votes.free_space);
        }
    }
    if best.1 == 0 || best.1 == POINTS {
        return (0.0, 0.0);
    }
    (best.1 as f64 - 0.5 - SIDE_POINTS as f64, weight)
}
