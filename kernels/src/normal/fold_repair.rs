//! Repair of folds: triangles of a new level that are flipped or needles.
//!
//! A triangle is flipped if it faces away from the surface at its corners, or from the input triangle nearest
//! to its centroid. Crumpled input makes both tests unreliable, hence two exceptions. If the corner normals
//! disagree, agreement with the parent triangle suffices. Input triangles that are flipped themselves are
//! ignored.
//!
//! New vertices of a fold are tried at other surface points. Interior candidates are on the line through the
//! unrelaxed point and at the expected position. Others are near the mean of the neighbours and near the edge
//! midpoint. Boundary candidates are elsewhere along the boundary. The first search improves the worst
//! triangle around a vertex. If that fails, a thorough search improves the sum over all triangles around it.

use std::ops::Add;

use super::distance::centroid;
use super::fold::Fold;
use super::level::Level;
use super::new_vertex::NewVertex;
use super::surface::{Surface, SurfacePoint};
use super::vertex_search::{LevelPositions, VertexSearch};
use crate::base::geometry::{Vec3, add_scaled, cross, distance2, dot, midpoint, norm2, normalize, sub};
use crate::base::parallel::fill;
use crate::subdivision::snm_contents::Offset;
use crate::subdivision::topology::NONE;

/// Maximum number of passes over all folds, for the first and the thorough search.
const MAX_PASSES: usize = 12;
const MAX_THOROUGH_PASSES: usize = 4;
/// Minimum cosine between a triangle and the mean surface normal at its corners.
const MIN_COSINE: f64 = 0.02;
/// Minimum height of a triangle, in lengths of its longest side.
const MIN_HEIGHT_RATIO: f64 = 1e-3;

/// Minimum length of the sum of a triangle's three corner normals for a certainly smooth surface; the maximum
/// is 3.
const MIN_SMOOTH_NORMAL_SUM: f64 = 2.9;
/// Candidate positions on a boundary, as fractions of the span.
const BOUNDARY_FRACTIONS: [f64; 6] = [0.5, 0.4, 0.6, 0.3, 0.7, 0.2];
/// Candidate displacements, in edge lengths along and across the edge.
const CANDIDATE_OFFSETS: [[f64; 2]; 12] = [
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
/// Square of candidates for the thorough search, denser towards its centre: candidates per side, and the
/// maximum displacement in edge lengths.
const THOROUGH_GRID_SIDE: usize = 9;
const MAX_THOROUGH_OFFSET: f64 = 0.6;
/// Number of intervals of a boundary span in the thorough search.
const BOUNDARY_INTERVALS: usize = 32;
/// Minimum improvement; smaller changes are rounding noise.
const MIN_GAIN: f64 = 1e-6;

/// Compute the cosine between a triangle and the mean surface normal at its corners; −2 for a needle.
pub fn compute_normal_cosine([a, b, c]: [&Vec3; 3], normals: [&Vec3; 3]) -> f64 {
    let (ab, ac, bc) = (sub(b, a), sub(c, a), sub(c, b));
    let normal = cross(&ab, &ac);
    let area = norm2(&normal).sqrt();
    let longest = norm2(&ab).max(norm2(&ac)).max(norm2(&bc));
    if area <= MIN_HEIGHT_RATIO * longest {
        return -2.0;
    }
    let sum = add_vectors(normals);
    let length = norm2(&sum).sqrt();
    if length > 0.0 { dot(&normal, &sum) / (area * length) } else { 1.0 }
}

fn add_vectors(vectors: [&Vec3; 3]) -> Vec3 {
    std::array::from_fn(|i| vectors.iter().map(|v| v[i]).sum())
}

/// Sort and deduplicate.
fn sort_unique(mut triangles: Vec<usize>) -> Vec<usize> {
    triangles.sort_unstable();
    triangles.dedup();
    triangles
}

/// Check whether a triangle is neither flipped nor a needle.
fn is_unfolded(soundness: f64) -> bool {
    soundness >= MIN_COSINE
}

/// Compute the agreement of a triangle with the surface at its corners and next to its centroid, as a cosine.
/// Values up to `enough` may be upper bounds. `near` are candidate slots; `parent` is the normal of the
/// parent triangle, if any.
pub fn compute_surface_cosine(
    surface: &Surface,
    points: [&Vec3; 3],
    normals: [&Vec3; 3],
    near: impl IntoIterator<Item = u32>,
    parent: Option<&Vec3>,
    enough: f64,
) -> f64 {
    let mut at_corners = compute_normal_cosine(points, normals);
    if let Some(parent) =
        parent.filter(|_| norm2(&add_vectors(normals)) < MIN_SMOOTH_NORMAL_SUM * MIN_SMOOTH_NORMAL_SUM)
    {
        at_corners = at_corners.max(compute_normal_cosine(points, [parent; 3]));
    }
    if at_corners <= enough {
        return at_corners;
    }
    let [a, b, c] = points;
    let facing = surface.compute_min_cosine(&centroid(&[*a, *b, *c]), &cross(&sub(b, a), &sub(c, a)), near);
    at_corners.min(facing)
}

/// Check whether the triangle of these vertices is an input triangle, with any first corner.
fn is_input_triangle(
    surface: &Surface,
    points: [&Vec3; 3],
    vertices: [u32; 3],
    near: impl IntoIterator<Item = u32>,
) -> bool {
    let (slot, _) = surface.find_nearest_slot(&centroid(&points.map(|p| *p)), near);
    let [a, b, c] = surface.vertices(slot);
    [[a, b, c], [b, c, a], [c, a, b]].contains(&vertices)
}

/// Find the folds of a base mesh. `source` gives the input vertex of each base vertex. Triangles of the input
/// are not counted.
pub fn find_base_folds(
    level: &Level,
    placed: &LevelPositions,
    source: &[u32],
    surface: &Surface,
    threads: usize,
) -> Vec<Fold> {
    let normals: Vec<Vec3> = placed.surface_points.iter().map(|place| surface.normal_at(place)).collect();
    let mut sound = vec![true; level.topology.triangles.len()];
    fill(&mut sound, threads, |t| {
        let corners = level.topology.triangles[t].map(|v| v as usize);
        let (points, normals) = (corners.map(|v| &level.points[v]), corners.map(|v| &normals[v]));
        let near = corners.map(|v| placed.surface_points[v].slot);
        is_unfolded(compute_surface_cosine(surface, points, normals, near, None, MIN_COSINE))
            || is_input_triangle(surface, points, corners.map(|v| source[v]), near)
    });
    let fold = |triangle: usize| {
        let corners = level.topology.triangles[triangle].map(|v| level.points[v as usize]);
        Fold { triangle, middle: centroid(&corners) }
    };
    (0..sound.len()).filter(|&t| !sound[t]).map(fold).collect()
}

/// Combination of the deficits of two triangles: maximum or sum.
type CombineDeficits = fn(f64, f64) -> f64;

/// State of the repair of one new level.
struct FoldRepair<'a> {
    search: &'a VertexSearch<'a>,
    new_vertices: &'a mut [NewVertex],
    /// Surface normals at all vertices, coarser level first; and the face normals of the coarser level.
    normals: Vec<Vec3>,
    coarse_faces: Vec<Vec3>,
}

impl FoldRepair<'_> {
    /// Index of the new vertex of an edge.
    fn new_vertex_index(&self, edge: usize) -> usize {
        self.search.level.points.len() + edge
    }

    fn point(&self, v: u32) -> &Vec3 {
        let coarse = &self.search.level.points;
        coarse.get(v as usize).unwrap_or_else(|| &self.new_vertices[v as usize - coarse.len()].point)
    }

    fn place(&self, v: u32) -> &SurfacePoint {
        let coarse = &self.search.positions.surface_points;
        coarse.get(v as usize).unwrap_or_else(|| &self.new_vertices[v as usize - coarse.len()].surface_point)
    }

    /// Compute the agreement of a child of coarse triangle `t` with the surface. Values up to `enough` may be
    /// upper bounds.
    fn compute_child_cosine(&self, t: usize, corners: &[u32; 3], enough: f64) -> f64 {
        let points = corners.map(|v| self.point(v));
        let normals = corners.map(|v| &self.normals[v as usize]);
        let near = corners.map(|v| self.place(v).slot);
        let surface = self.search.context.surface;
        compute_surface_cosine(surface, points, normals, near, Some(&self.coarse_faces[t]), enough)
    }

    /// List the folded children of coarse triangle `t`.
    fn list_folded_children(&self, t: usize) -> impl Iterator<Item = [u32; 3]> {
        let children = self.search.level.topology.children(t).into_iter();
        children.filter(move |corners| !is_unfolded(self.compute_child_cosine(t, corners, MIN_COSINE)))
    }

    /// List the folds in coarse triangle `t`, with their centroids.
    fn list_folds(&self, t: usize) -> impl Iterator<Item = Fold> {
        self.list_folded_children(t)
            .map(move |corners| Fold { triangle: t, middle: centroid(&corners.map(|v| *self.point(v))) })
    }

    /// List the coarse triangles adjacent to an edge.
    fn adjacent_triangles(&self, edge: usize) -> impl Iterator<Item = usize> + use<> {
        let beside = self.search.level.topology.edge_triangles[edge];
        beside.into_iter().filter(|&t| t != NONE).map(|t| t as usize)
    }

    /// List the triangles around the new vertex of an edge, with their coarse triangles.
    fn triangles_around(&self, edge: usize) -> impl Iterator<Item = (usize, [u32; 3])> {
        let v = self.new_vertex_index(edge) as u32;
        let children = |t| self.search.level.topology.children(t).into_iter().map(move |child| (t, child));
        self.adjacent_triangles(edge).flat_map(children).filter(move |(_, child)| child.contains(&v))
    }

    /// Compute the deficit of the triangles around an edge's new vertex; 0 if none folds. Stops at `most`.
    fn compute_deficit_around(&self, edge: usize, most: f64, joined: CombineDeficits) -> f64 {
        let mut lack = 0.0;
        for (t, corners) in self.triangles_around(edge) {
            let of_one = MIN_COSINE - self.compute_child_cosine(t, &corners, MIN_COSINE - most);
            lack = joined(lack, of_one.max(0.0));
            if lack >= most {
                break;
            }
        }
        lack
    }

    fn move_vertex(&mut self, edge: usize, found: NewVertex) {
        let v = self.new_vertex_index(edge);
        self.new_vertices[edge] = found;
        self.normals[v] = self.search.context.surface.normal_at(&found.surface_point);
    }

    /// Move the new vertex of an edge to the candidate with the smallest deficit, stopping at 0. Returns true
    /// if it moved.
    fn try_candidates(
        &mut self,
        edge: usize,
        places: impl IntoIterator<Item = NewVertex>,
        joined: CombineDeficits,
    ) -> bool {
        let mut lack = self.compute_deficit_around(edge, f64::INFINITY, joined);
        let mut moved = false;
        for to in places {
            if lack == 0.0 {
                break;
            }
            let kept = self.new_vertices[edge];
            self.move_vertex(edge, to);
            let now = self.compute_deficit_around(edge, lack, joined);
            if now == 0.0 || now < lack - MIN_GAIN {
                (lack, moved) = (now, true);
            } else {
                self.move_vertex(edge, kept);
            }
        }
        moved
    }

    /// Try a few candidates that improve the worst triangle around an edge's vertex. Returns true if the
    /// vertex moved.
    fn repair_edge(&mut self, edge: usize) -> bool {
        let search = self.search;
        if search.level.topology.is_boundary_edge(edge) {
            return self.try_candidates(
                edge,
                BOUNDARY_FRACTIONS.iter().filter_map(|&share| search.find_on_boundary(edge, share)),
                f64::max,
            );
        }
        let moved = self.try_candidates(edge, search.find_by_unrelaxed_scalar(edge), f64::max);
        let frame = &search.predicted.frames[edge];
        let directions = [self.normals[self.new_vertex_index(edge)], frame[0]];
        let targets = self.target_points(edge, frame);
        let near = targets.iter().flat_map(|p| directions.map(|n| search.find_nearest(edge, p, &n)));
        let places = search.find_expected_point(edge).into_iter().chain(near);
        self.try_candidates(edge, places.map(|place| search.encode_as_vector(edge, place)), f64::max) || moved
    }

    /// Try many candidates that improve the sum over the triangles around an edge's vertex. Returns true if
    /// it moved.
    fn search_thoroughly(&mut self, edge: usize) -> bool {
        let search = self.search;
        if search.level.topology.is_boundary_edge(edge) {
            let shares = (1..BOUNDARY_INTERVALS).map(|k| k as f64 / BOUNDARY_INTERVALS as f64);
            return self.try_candidates(
                edge,
                shares.filter_map(|share| search.find_on_boundary(edge, share)),
                f64::add,
            );
        }
        let [normal, tangent, third] = &search.predicted.frames[edge];
        let [a, b] = search.level.topology.edges[edge].map(|v| *self.point(v));
        let (middle, length) = (midpoint(&a, &b), distance2(&a, &b).sqrt());
        let directions = [self.normals[self.new_vertex_index(edge)], *normal];
        let places = (0..THOROUGH_GRID_SIDE * THOROUGH_GRID_SIDE).flat_map(|i| {
            let [x, y] = [i % THOROUGH_GRID_SIDE, i / THOROUGH_GRID_SIDE].map(|k| {
                let from_middle = 2.0 * k as f64 / (THOROUGH_GRID_SIDE - 1) as f64 - 1.0;
                MAX_THOROUGH_OFFSET * length * from_middle * from_middle.abs()
            });
            let target = add_scaled(&add_scaled(&middle, x, tangent), y, third);
            directions.into_iter().flat_map(move |direction| {
                // Points outside the associated sets are candidates, too, because sets can be sparse.
                let near = std::iter::once_with(move || search.find_nearest(edge, &target, &direction));
                near.chain(search.find_nearest_anywhere(edge, &target, &direction))
            })
        });
        self.try_candidates(edge, places.map(|place| search.encode_as_vector(edge, place)), f64::add)
    }

    /// Repair coarse triangles by moving the vertices of their edges. Returns the triangles that still fold,
    /// among `open` and the neighbours of moved vertices.
    fn repair_triangles(
        &mut self,
        mut open: Vec<usize>,
        mut changed: Vec<usize>,
        turns: usize,
        mend: fn(&mut Self, usize) -> bool,
    ) -> Vec<usize> {
        let topology = &self.search.level.topology;
        for _ in 0..turns {
            // A repair may fold a neighbouring triangle. Only triangles that changed need another pass.
            let mut moved = vec![];
            for t in sort_unique(changed) {
                if self.list_folded_children(t).next().is_none() {
                    continue;
                }
                // Vertices that already store a vector come first, because moving them costs no additional
                // bits.
                let mut edges = topology.triangle_edges[t];
                edges.sort_by_key(|&edge| {
                    !matches!(self.new_vertices[edge as usize].offset, Offset::Vector(_))
                });
                for edge in edges {
                    if mend(self, edge as usize) {
                        moved.extend(self.adjacent_triangles(edge as usize));
                    }
                }
            }
            if moved.is_empty() {
                break;
            }
            open.extend(&moved);
            changed = moved;
        }
        open = sort_unique(open);
        open.retain(|&t| self.list_folded_children(t).next().is_some());
        open
    }

    /// Replace a vector by a scalar offset, which is shorter, if that creates no fold.
    fn restore_scalar(&mut self, edge: usize) {
        let search = self.search;
        let is_vector = matches!(self.new_vertices[edge].offset, Offset::Vector(_));
        if !is_vector || search.level.topology.is_boundary_edge(edge) {
            return;
        }
        let (kept, lack) =
            (self.new_vertices[edge], self.compute_deficit_around(edge, f64::INFINITY, f64::add));
        for to in [search.find_by_scalar(edge), search.find_by_unrelaxed_scalar(edge)].into_iter().flatten() {
            self.move_vertex(edge, to);
            if self.compute_deficit_around(edge, f64::INFINITY, f64::add) <= lack {
                return;
            }
        }
        self.move_vertex(edge, kept);
    }

    /// List target points near which the new vertex of an edge may fold less.
    fn target_points(&self, edge: usize, [_, tangent, third]: &[Vec3; 3]) -> Vec<Vec3> {
        let [a, b] = self.search.level.topology.edges[edge].map(|v| self.point(v));
        let (middle, mean) = (midpoint(a, b), self.neighbour_mean(edge));
        let length = distance2(a, b).sqrt();
        let aside =
            |&[x, y]: &[f64; 2]| add_scaled(&add_scaled(&middle, x * length, tangent), y * length, third);
        let mut targets =
            vec![mean, middle, midpoint(&mean, &middle), midpoint(&mean, &self.new_vertices[edge].point)];
        targets.extend(CANDIDATE_OFFSETS.iter().map(aside));
        targets
    }

    /// Compute the mean of the six neighbours of a new vertex.
    fn neighbour_mean(&self, edge: usize) -> Vec3 {
        let topology = &self.search.level.topology;
        let beside = topology.edge_triangles[edge].into_iter().filter(|&t| t != NONE);
        let others = beside.flat_map(|t| topology.triangle_edges[t as usize]).map(|e| e as usize);
        let others = others.filter(|&e| e != edge).map(|e| self.new_vertex_index(e) as u32);
        let (mut sum, mut count) = ([0.0; 3], 0.0);
        for v in topology.edges[edge].into_iter().chain(others) {
            sum = add_scaled(&sum, 1.0, self.point(v));
            count += 1.0;
        }
        sum.map(|x| x / count)
    }
}

/// Repair folds of a new level and return the remaining ones. A `thorough` search is slow on crumpled input.
pub fn repair_folds(search: &VertexSearch<'_>, found: &mut [NewVertex], thorough: bool) -> Vec<Fold> {
    let (topology, points) = (&search.level.topology, &search.level.points);
    let places = search.positions.surface_points.iter().chain(found.iter().map(|f| &f.surface_point));
    let normals = places.map(|place| search.context.surface.normal_at(place)).collect();
    let face = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|v| &points[v as usize]);
        normalize(&cross(&sub(b, a), &sub(c, a)))
    };
    let coarse_faces = topology.triangles.iter().map(face).collect();
    let mut fine = FoldRepair { search, new_vertices: found, normals, coarse_faces };
    let mut counts = vec![0; topology.triangles.len()];
    fill(&mut counts, search.context.threads, |t| fine.list_folded_children(t).count());
    let unsound: Vec<usize> = (0..counts.len()).filter(|&t| counts[t] > 0).collect();
    let mut open = fine.repair_triangles(unsound.clone(), unsound, MAX_PASSES, FoldRepair::repair_edge);
    if thorough {
        open = fine.repair_triangles(open.clone(), open, MAX_THOROUGH_PASSES, FoldRepair::search_thoroughly);
    }
    (0..topology.edges.len()).for_each(|edge| fine.restore_scalar(edge));
    open.iter().flat_map(|&t| fine.list_folds(t)).collect()
}
