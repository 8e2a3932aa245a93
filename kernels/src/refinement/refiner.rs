//! State of a refinement: the mesh, where it may move, and what the depth maps say about it.
//!
//! The caller shows all frames three times: to measure the uncertainty of the fused surface, and twice to
//! correct the filtered one.

use super::creases::{CreaseVertex, snap_to_planes};
use super::depth_frame::DepthFrame;
use super::folds::undo_folds;
use super::normal_filter::{area_normals, filter_normals, fit_vertices, limit_move, vertex_normals};
use super::observations::{Observation, observe};
use super::plane_growth::{FilteredSurface, NO_PLANE, PlaneLimits, grow_planes, label_vertices};
use super::plane_merging::{MergeLimits, merge_planes};
use super::residual::smooth_residuals;
use super::short_edges::collapse_short_edges;
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, add_scaled, distance2, norm2, sub};
use crate::base::ids::{TriangleId, VertexId};
use crate::base::parallel::collect;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::{CompactMesh, Mesh};

/// Edges shorter than this part of the mean length are collapsed.
const SHORT_EDGE_RATIO: f64 = 0.25;
/// Vertices move up to this many standard deviations, times the strength.
const MAX_MOVE_DEVIATIONS: f64 = 3.0;
/// Errors of poses and of the sensor are common to many frames: averaging reduces the deviation of a single
/// measurement at most to this part.
const MIN_AVERAGED_RATIO: f64 = 0.25;
/// Deviation of a vertex that no frame measured, relative to the median.
const UNSEEN_DEVIATION_RATIO: f64 = 3.0;

/// Angle beyond which normals are not averaged, in radians: at least the first one; on noisy surfaces
/// NOISE_FACTOR times the angle that the noise causes along an edge, at most the second one.
const MIN_CUTOFF: f64 = 30.0 * DEGREE;
const MAX_CUTOFF: f64 = 60.0 * DEGREE;
const NOISE_FACTOR: f64 = 2.5;
const FILTER_ITERATIONS: usize = 15;

/// Iterations of the smooth correction: it averages over about as many vertices.
const CORRECTION_ITERATIONS: usize = 40;

/// Angle by which a step may turn a triangle.
const MAX_TURN: f64 = 80.0 * DEGREE;

/// Planes: angle of their triangles, heights of their vertices in standard deviations, number of triangles, and
/// RMS angle by which normals may change across.
const PLANE_ANGLE: f64 = 5.0 * DEGREE;
const PLANE_DEVIATIONS: f64 = 4.0;
const MIN_PLANE_TRIANGLES: usize = 150;
const MAX_PLANE_BEND: f64 = 1.5 * DEGREE;
/// Adjacent planes that merge: RMS height over the common plane in standard deviations, and angle to it. Planes
/// at a larger angle form creases.
const MERGE_DEVIATIONS: f64 = 1.5;
const MERGE_ANGLE: f64 = 15.0 * DEGREE;
/// Neighbours of planes that join them: heights, angle, and maximum number of layers.
const JOIN_DEVIATIONS: f64 = 2.5;
const JOIN_ANGLE: f64 = 45.0 * DEGREE;
const JOIN_LAYERS: usize = 40;

/// Measurements up to this many mean edge lengths from the surface may belong to it whatever the noise.
const REACH_EDGES: f64 = 2.0;

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// Mesh under refinement.
#[derive(Debug)]
pub struct Refiner {
    connectivity: Connectivity,
    /// Vertices of the input, and where they are now.
    origins: Vec<Vec3>,
    points: Vec<Vec3>,
    vertex_source: Vec<u32>,
    mean_edge: f64,
    strength: f64,
    threads: usize,
    /// Normals of the current vertices, and the observations made from them.
    normals: Vec<Vec3>,
    observations: Vec<Observation>,
    /// Filtered normals of the triangles.
    filtered: Vec<Vec3>,
    deviations: Vec<f64>,
    max_moves: Vec<f64>,
    best_cosines: Vec<f64>,
    contradicted: Vec<bool>,
    labels: Vec<u32>,
    plane_count: usize,
    created: Vec<CreaseVertex>,
}

/// Result of a refinement.
#[derive(Debug)]
pub struct RefinedMesh {
    /// The last `created.len()` vertices were split off edges of the others.
    pub points: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    /// Input vertex of the others.
    pub vertex_source: Vec<u32>,
    pub created: Vec<CreaseVertex>,
    /// Distance of each vertex from its position in the input; 0 for created ones.
    pub moves: Vec<f64>,
    /// Standard deviation of each vertex along its normal.
    pub deviations: Vec<f64>,
    /// Largest cosine between the normal of each vertex and the direction to a camera that measured it; 0 without
    /// any.
    pub best_cosines: Vec<f64>,
    /// True if more frames have seen free space at the vertex than surface.
    pub contradicted: Vec<bool>,
    /// Plane of each vertex; [`NO_PLANE`] for none.
    pub labels: Vec<u32>,
    pub plane_count: usize,
}

impl Refiner {
    /// Prepare a mesh: short edges are collapsed.
    ///
    /// # Errors
    /// As [`Mesh::new`].
    pub fn new(
        points: Vec<Vec3>,
        triangles: Vec<[u32; 3]>,
        strength: f64,
        threads: usize,
    ) -> Result<Self, KernelError> {
        let mut mesh = Mesh::<3>::new_on(threads, points, &triangles)?;
        // Large meshes need all memory: nothing is kept longer than it is used.
        drop(triangles);
        let input_edge = mean_edge(&mesh.connectivity, &mesh.points);
        collapse_short_edges(&mut mesh, SHORT_EDGE_RATIO * input_edge);
        let CompactMesh { points, triangles, vertex_source, .. } = mesh.compact();
        drop(mesh);
        let connectivity = Connectivity::from_triangles_on(threads, points.len(), &triangles)?;
        drop(triangles);
        let count = points.len();
        let mut refiner = Self {
            mean_edge: mean_edge(&connectivity, &points),
            connectivity,
            origins: points.clone(),
            points,
            vertex_source,
            strength,
            threads,
            normals: vec![],
            observations: vec![],
            filtered: vec![],
            deviations: vec![0.0; count],
            max_moves: vec![0.0; count],
            best_cosines: vec![0.0; count],
            contradicted: vec![false; count],
            labels: vec![NO_PLANE; count],
            plane_count: 0,
            created: vec![],
        };
        refiner.start_observing();
        Ok(refiner)
    }

    /// Return the number of vertices plus triangles.
    pub fn row_count(&self) -> usize {
        self.points.len() + self.connectivity.triangle_slots()
    }

    /// Compare the current surface with a frame.
    pub fn observe(&mut self, frame: DepthFrame<'_>) {
        let reach = REACH_EDGES * self.mean_edge;
        observe(frame, reach, &self.points, &self.normals, &mut self.observations, self.threads);
    }

    /// Measure the deviation of each vertex from the observations, and filter the surface.
    pub fn filter(&mut self) {
        self.measure_deviations();
        self.stop_observing();
        let deviations = &self.deviations;
        let max_chords = collect(self.connectivity.triangle_slots(), self.threads, |t| {
            let corners = self.connectivity.corners(TriangleId::from_index(t));
            let deviation = corners.iter().map(|v| deviations[v.index()]).fold(0.0, f64::max);
            // The chord of a unit circle; for small angles the angle itself.
            let chord = NOISE_FACTOR * deviation / self.mean_edge;
            chord.clamp(chord_of(MIN_CUTOFF), chord_of(MAX_CUTOFF))
        });
        self.filtered =
            filter_normals(&self.connectivity, &self.points, max_chords, FILTER_ITERATIONS, self.threads);
        self.points = fit_vertices(
            &self.connectivity,
            &self.points,
            &self.filtered,
            &self.max_moves,
            FILTER_ITERATIONS,
            self.threads,
        );
        self.undo_folds();
        self.start_observing();
    }

    /// Move the filtered surface to the observations, smoothly.
    pub fn correct(&mut self) {
        let steps = smooth_residuals(
            &self.connectivity,
            &self.filtered,
            &self.observations,
            MIN_CUTOFF,
            CORRECTION_ITERATIONS,
            self.threads,
        );
        self.points = collect(self.points.len(), self.threads, |v| {
            let to = add_scaled(&self.points[v], steps[v], &self.normals[v]);
            limit_move(&self.origins[v], to, self.max_moves[v])
        });
        self.undo_folds();
        // Viewing angles are measured from normals of the filtered surface; input normals are too noisy.
        self.best_cosines = self.observations.iter().map(|one| one.best_cosine).collect();
        self.contradicted = self.observations.iter().map(|one| one.votes.is_contradicted()).collect();
        self.start_observing();
    }

    /// Make planar patches planar and their creases straight.
    pub fn flatten(&mut self) {
        self.observations = vec![];
        let areas: Vec<f64> = {
            let weighted = area_normals(&self.connectivity, &self.points, self.threads);
            collect(weighted.len(), self.threads, |t| 0.5 * norm2(&weighted[t]).sqrt())
        };
        let surface = FilteredSurface {
            connectivity: &self.connectivity,
            points: &self.points,
            normals: &self.filtered,
            areas: &areas,
            deviations: &self.deviations,
        };
        let limits = PlaneLimits {
            min_cosine: PLANE_ANGLE.cos(),
            max_deviations: PLANE_DEVIATIONS * self.strength,
            min_triangles: MIN_PLANE_TRIANGLES,
            max_bend: MAX_PLANE_BEND,
        };
        let (mut planes, triangle_labels) = grow_planes(&surface, &limits, self.threads);
        let join = PlaneLimits {
            min_cosine: JOIN_ANGLE.cos(),
            max_deviations: JOIN_DEVIATIONS * self.strength,
            ..limits
        };
        self.labels = label_vertices(
            &surface,
            &planes,
            &triangle_labels,
            &self.normals,
            &join,
            JOIN_LAYERS,
            self.threads,
        );
        let merge = MergeLimits {
            min_cosine: MERGE_ANGLE.cos(),
            max_rms_deviations: MERGE_DEVIATIONS * self.strength,
            max_bend: MAX_PLANE_BEND,
        };
        merge_planes(&surface, &merge, &triangle_labels, &mut planes, &mut self.labels);
        self.plane_count = planes.len();
        let mut from = std::mem::take(&mut self.points);
        let mut creased = snap_to_planes(
            &mut self.connectivity,
            &self.origins,
            &from,
            &planes,
            &self.labels,
            &self.max_moves,
        );
        for one in &creased.created {
            let [a, b] = one.ends.map(|v| from[v as usize]);
            from.push(add_scaled(&a, one.share, &sub(&b, &a)));
        }
        let references = area_normals(&self.connectivity, &from, self.threads);
        undo_folds(
            &self.connectivity,
            &from,
            &mut creased.points,
            &references,
            MAX_TURN.cos(),
            |v, to| match self.origins.get(v) {
                Some(origin) => limit_move(origin, to, self.max_moves[v]),
                None => to,
            },
            self.threads,
        );
        self.points = creased.points;
        self.created = creased.created;
    }

    /// Finish: the mesh with the values of its vertices.
    pub fn finish(self) -> RefinedMesh {
        let count = self.origins.len();
        let [mut deviations, mut moves] = [self.deviations, vec![0.0; count]];
        moves.iter_mut().enumerate().for_each(|(v, step)| {
            *step = distance2(&self.points[v], &self.origins[v]).sqrt();
        });
        let (mut best_cosines, mut labels) = (self.best_cosines, self.labels);
        let mut contradicted = self.contradicted;
        for one in &self.created {
            let [a, b] = one.ends.map(|v| v as usize);
            deviations.push(deviations[a].max(deviations[b]));
            best_cosines.push(best_cosines[a].max(best_cosines[b]));
            contradicted.push(contradicted[a] && contradicted[b]);
            labels.push(labels[a]);
            moves.push(0.0);
        }
        let triangles = (0..self.connectivity.triangle_slots())
            .map(|t| self.connectivity.corners(TriangleId::from_index(t)).map(|v| v.0))
            .collect();
        RefinedMesh {
            points: self.points,
            triangles,
            vertex_source: self.vertex_source,
            created: self.created,
            moves,
            deviations,
            best_cosines,
            contradicted,
            labels,
            plane_count: self.plane_count,
        }
    }

    /// Shorten the moves of vertices whose triangles turn away from their filtered normals.
    fn undo_folds(&mut self) {
        undo_folds(
            &self.connectivity,
            &self.origins,
            &mut self.points,
            &self.filtered,
            MAX_TURN.cos(),
            |v, to| limit_move(&self.origins[v], to, self.max_moves[v]),
            self.threads,
        );
    }

    fn stop_observing(&mut self) {
        (self.normals, self.observations) = (vec![], vec![]);
    }

    fn start_observing(&mut self) {
        self.stop_observing();
        let weighted = area_normals(&self.connectivity, &self.points, self.threads);
        self.normals = vertex_normals(&self.connectivity, &weighted, self.threads);
        self.observations = vec![Observation::default(); self.points.len()];
    }

    /// Standard deviation of each vertex from the noise of its measurements, their number, and how far a vertex
    /// may move. The edges of the mesh add the uncertainty of a position within a voxel: a uniform distribution
    /// has a standard deviation of its width / √12.
    fn measure_deviations(&mut self) {
        let measured: Vec<f64> = collect(self.observations.len(), self.threads, |v| {
            let one = &self.observations[v];
            if one.frames == 0 {
                return f64::NAN;
            }
            let single = (f64::from(one.frames) / one.weight).sqrt();
            single * (1.0 / f64::from(one.frames).sqrt()).max(MIN_AVERAGED_RATIO)
        });
        let mut known: Vec<f64> = measured.iter().copied().filter(|x| x.is_finite()).collect();
        let unseen = if known.is_empty() {
            0.0
        } else {
            let middle = known.len() / 2;
            UNSEEN_DEVIATION_RATIO * *known.select_nth_unstable_by(middle, f64::total_cmp).1
        };
        self.deviations = measured.iter().map(|&x| if x.is_finite() { x } else { unseen }).collect();
        let within_voxel2 = self.mean_edge * self.mean_edge / 12.0;
        let scale = MAX_MOVE_DEVIATIONS * self.strength;
        self.max_moves = self.deviations.iter().map(|x| scale * (x * x + within_voxel2).sqrt()).collect();
    }
}

fn chord_of(angle: f64) -> f64 {
    2.0 * (0.5 * angle).sin()
}

/// Mean length of the edges; 0 without edges.
pub fn mean_edge(connectivity: &Connectivity, points: &[Vec3]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for edge in connectivity.edges() {
        let [a, b] = connectivity.ends(edge).map(VertexId::index);
        sum += distance2(&points[a], &points[b]).sqrt();
        count += 1.0;
    }
    if count > 0.0 { sum / count } else { 0.0 }
}
