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

use super::distance::middle;
use super::fold::Fold;
use super::found::Found;
use super::level::Level;
use super::place::{Placed, Search};
use super::surface::{Place, Surface};
use crate::base::geometry::{Vec3, add_scaled, cross, distance2, dot, midpoint, norm2, sub, unit};
use crate::base::parallel::fill;
use crate::subdivision::contents::Offset;
use crate::subdivision::topology::NONE;

/// Maximum number of passes over all folds, for the first and the thorough search.
const TURNS: usize = 12;
const THOROUGH_TURNS: usize = 4;
/// Minimum cosine between a triangle and the mean surface normal at its corners.
const LEAST_COSINE: f64 = 0.02;
/// Minimum height of a triangle, in lengths of its longest side.
const LEAST_FLATNESS: f64 = 1e-3;

/// Minimum length of the sum of a triangle's three corner normals for a certainly smooth surface; the maximum
/// is 3.
const SMOOTH: f64 = 2.9;
/// Candidate positions on a boundary, as fractions of the span.
const SHARES: [f64; 6] = [0.5, 0.4, 0.6, 0.3, 0.7, 0.2];
/// Candidate displacements, in edge lengths along and across the edge.
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
/// Square of candidates for the thorough search, denser towards its centre: candidates per side, and the
/// maximum displacement in edge lengths.
const SIDE: usize = 9;
const ASIDE_AT_MOST: f64 = 0.6;
/// Number of intervals of a boundary span in the thorough search.
const FINE_SHARES: usize = 32;
/// Minimum improvement; smaller changes are rounding noise.
const LEAST_GAIN: f64 = 1e-6;

/// Compute the cosine between a triangle and the mean surface normal at its corners; −2 for a needle.
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

/// Sort and deduplicate.
fn sorted(mut triangles: Vec<usize>) -> Vec<usize> {
    triangles.sort_unstable();
    triangles.dedup();
    triangles
}

/// Check whether a triangle is neither flipped nor a needle.
fn is_sound(soundness: f64) -> bool {
    soundness >= LEAST_COSINE
}

/// Compute the agreement of a triangle with the surface at its corners and next to its centroid, as a cosine.
/// Values up to `enough` may be upper bounds. `near` are candidate slots; `parent` is the normal of the
/// parent triangle, if any.
pub fn against_surface(
    surface: &Surface,
    points: [&Vec3; 3],
    normals: [&Vec3; 3],
    near: impl IntoIterator<Item = u32>,
    parent: Option<&Vec3>,
    enough: f64,
) -> f64 {
    let mut at_corners = soundness(points, normals);
    if let Some(parent) = parent.filter(|_| norm2(&sum(normals)) < SMOOTH * SMOOTH) {
        at_corners = at_corners.max(soundness(points, [parent; 3]));
    }
    if at_corners <= enough {
        return at_corners;
    }
    let [a, b, c] = points;
    let facing = surface.least_facing(&middle(&[*a, *b, *c]), &cross(&sub(b, a), &sub(c, a)), near);
    at_corners.min(facing)
}

/// Check whether the triangle of these vertices is an input triangle, with any first corner.
fn is_of_input(
    surface: &Surface,
    points: [&Vec3; 3],
    vertices: [u32; 3],
    near: impl IntoIterator<Item = u32>,
) -> bool {
    let (slot, _) = surface.nearest_slot(&middle(&points.map(|p| *p)), near);
    let [a, b, c] = surface.vertices(slot);
    [[a, b, c], [b, c, a], [c, a, b]].contains(&vertices)
}

/// Find the folds of a base mesh. `source` gives the input vertex of each base vertex. Triangles of the input
/// are not counted.
pub fn unsound_in_base(
    level: &Level,
    placed: &Placed,
    source: &[u32],
    surface: &Surface,
    threads: usize,
) -> Vec<Fold> {
    let normals: Vec<Vec3> = placed.places.iter().map(|place| surface.normal_at(place)).collect();
    let mut sound = vec![true; level.topology.triangles.len()];
    fill(&mut sound, threads, |t| {
        let corners = level.topology.triangles[t].map(|v| v as usize);
        let (points, normals) = (corners.map(|v| &level.points[v]), corners.map(|v| &normals[v]));
        let near = corners.map(|v| placed.places[v].slot);
        is_sound(against_surface(surface, points, normals, near, None, LEAST_COSINE))
            || is_of_input(surface, points, corners.map(|v| source[v]), near)
    });
    let fold = |triangle: usize| {
        let corners = level.topology.triangles[triangle].map(|v| level.points[v as usize]);
        Fold { triangle, middle: middle(&corners) }
    };
    (0..sound.len()).filter(|&t| !sound[t]).map(fold).collect()
}

/// Combination of the deficits of two triangles: maximum or sum.
type Joined = fn(f64, f64) -> f64;

/// State of the repair of one new level.
struct Fine<'a> {
    search: &'a Search<'a>,
    found: &'a mut [Found],
    /// Surface normals at all vertices, coarser level first; and the face normals of the coarser level.
    normals: Vec<Vec3>,
    coarse_faces: Vec<Vec3>,
}

impl Fine<'_> {
    /// Index of the new vertex of an edge.
    fn vertex(&self, edge: usize) -> usize {
        self.search.level.points.len() + edge
    }

    fn point(&self, v: u32) -> &Vec3 {
        let coarse = &self.search.level.points;
        coarse.get(v as usize).unwrap_or_else(|| &self.found[v as usize - coarse.len()].point)
    }

    fn place(&self, v: u32) -> &Place {
        let coarse = &self.search.placed.places;
        coarse.get(v as usize).unwrap_or_else(|| &self.found[v as usize - coarse.len()].place)
    }

    /// Compute the agreement of a child of coarse triangle `t` with the surface. Values up to `enough` may be
    /// upper bounds.
    fn soundness(&self, t: usize, corners: &[u32; 3], enough: f64) -> f64 {
        let points = corners.map(|v| self.point(v));
        let normals = corners.map(|v| &self.normals[v as usize]);
        let near = corners.map(|v| self.place(v).slot);
        let surface = self.search.original.surface;
        against_surface(surface, points, normals, near, Some(&self.coarse_faces[t]), enough)
    }

    /// List the folded children of coarse triangle `t`.
    fn unsound(&self, t: usize) -> impl Iterator<Item = [u32; 3]> {
        let children = self.search.level.topology.children(t).into_iter();
        children.filter(move |corners| !is_sound(self.soundness(t, corners, LEAST_COSINE)))
    }

    /// List the folds in coarse triangle `t`, with their centroids.
    fn folds(&self, t: usize) -> impl Iterator<Item = Fold> {
        self.unsound(t)
            .map(move |corners| Fold { triangle: t, middle: middle(&corners.map(|v| *self.point(v))) })
    }

    /// List the coarse triangles adjacent to an edge.
    fn beside(&self, edge: usize) -> impl Iterator<Item = usize> + use<> {
        let beside = self.search.level.topology.edge_triangles[edge];
        beside.into_iter().filter(|&t| t != NONE).map(|t| t as usize)
    }

    /// List the triangles around the new vertex of an edge, with their coarse triangles.
    fn around(&self, edge: usize) -> impl Iterator<Item = (usize, [u32; 3])> {
        let v = self.vertex(edge) as u32;
        let children = |t| self.search.level.topology.children(t).into_iter().map(move |child| (t, child));
        self.beside(edge).flat_map(children).filter(move |(_, child)| child.contains(&v))
    }

    /// Compute the deficit of the triangles around an edge's new vertex; 0 if none folds. Stops at `most`.
    fn lack_around(&self, edge: usize, most: f64, joined: Joined) -> f64 {
        let mut lack = 0.0;
        for (t, corners) in self.around(edge) {
            let of_one = LEAST_COSINE - self.soundness(t, &corners, LEAST_COSINE - most);
            lack = joined(lack, of_one.max(0.0));
            if lack >= most {
                break;
            }
        }
        lack
    }

    fn put(&mut self, edge: usize, found: Found) {
        let v = self.vertex(edge);
        self.found[edge] = found;
        self.normals[v] = self.search.original.surface.normal_at(&found.place);
    }

    /// Move the new vertex of an edge to the candidate with the smallest deficit, stopping at 0. Returns true
    /// if it moved.
    fn try_out(&mut self, edge: usize, places: impl IntoIterator<Item = Found>, joined: Joined) -> bool {
        let mut lack = self.lack_around(edge, f64::INFINITY, joined);
        let mut moved = false;
        for to in places {
            if lack == 0.0 {
                break;
            }
            let kept = self.found[edge];
            self.put(edge, to);
            let now = self.lack_around(edge, lack, joined);
            if now == 0.0 || now < lack - LEAST_GAIN {
                (lack, moved) = (now, true);
            } else {
                self.put(edge, kept);
            }
        }
        moved
    }

    /// Try a few candidates that improve the worst triangle around an edge's vertex. Returns true if the
    /// vertex moved.
    fn mend(&mut self, edge: usize) -> bool {
        let search = self.search;
        if search.level.topology.is_boundary_edge(edge) {
            return self.try_out(
                edge,
                SHARES.iter().filter_map(|&share| search.on_rim(edge, share)),
                f64::max,
            );
        }
        let moved = self.try_out(edge, search.unrelaxed(edge), f64::max);
        let frame = &search.predicted.frames[edge];
        let directions = [self.normals[self.vertex(edge)], frame[0]];
        let targets = self.targets(edge, frame);
        let near = targets.iter().flat_map(|p| directions.map(|n| search.nearest(edge, p, &n)));
        let places = search.expected_place(edge).into_iter().chain(near);
        self.try_out(edge, places.map(|place| search.vector(edge, place)), f64::max) || moved
    }

    /// Try many candidates that improve the sum over the triangles around an edge's vertex. Returns true if
    /// it moved.
    fn search_around(&mut self, edge: usize) -> bool {
        let search = self.search;
        if search.level.topology.is_boundary_edge(edge) {
            let shares = (1..FINE_SHARES).map(|k| k as f64 / FINE_SHARES as f64);
            return self.try_out(edge, shares.filter_map(|share| search.on_rim(edge, share)), f64::add);
        }
        let [normal, tangent, third] = &search.predicted.frames[edge];
        let [a, b] = search.level.topology.edges[edge].map(|v| *self.point(v));
        let (middle, length) = (midpoint(&a, &b), distance2(&a, &b).sqrt());
        let directions = [self.normals[self.vertex(edge)], *normal];
        let places = (0..SIDE * SIDE).flat_map(|i| {
            let [x, y] = [i % SIDE, i / SIDE].map(|k| {
                let from_middle = 2.0 * k as f64 / (SIDE - 1) as f64 - 1.0;
                ASIDE_AT_MOST * length * from_middle * from_middle.abs()
            });
            let target = add_scaled(&add_scaled(&middle, x, tangent), y, third);
            directions.into_iter().flat_map(move |direction| {
                // Points outside the associated sets are candidates, too, because sets can be sparse.
                let near = std::iter::once_with(move || search.nearest(edge, &target, &direction));
                near.chain(search.anywhere(edge, &target, &direction))
            })
        });
        self.try_out(edge, places.map(|place| search.vector(edge, place)), f64::add)
    }

    /// Repair coarse triangles by moving the vertices of their edges. Returns the triangles that still fold,
    /// among `open` and the neighbours of moved vertices.
    fn mended(
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
            for t in sorted(changed) {
                if self.unsound(t).next().is_none() {
                    continue;
                }
                // Vertices that already store a vector come first, because moving them costs no additional
                // bits.
                let mut edges = topology.triangle_edges[t];
                edges.sort_by_key(|&edge| !matches!(self.found[edge as usize].offset, Offset::Vector(_)));
                for edge in edges {
                    if mend(self, edge as usize) {
                        moved.extend(self.beside(edge as usize));
                    }
                }
            }
            if moved.is_empty() {
                break;
            }
            open.extend(&moved);
            changed = moved;
        }
        open = sorted(open);
        open.retain(|&t| self.unsound(t).next().is_some());
        open
    }

    /// Replace a vector by a scalar offset, which is shorter, if that creates no fold.
    fn take_back(&mut self, edge: usize) {
        let search = self.search;
        let is_vector = matches!(self.found[edge].offset, Offset::Vector(_));
        if !is_vector || search.level.topology.is_boundary_edge(edge) {
            return;
        }
        let (kept, lack) = (self.found[edge], self.lack_around(edge, f64::INFINITY, f64::add));
        for to in [search.scalar(edge), search.unrelaxed(edge)].into_iter().flatten() {
            self.put(edge, to);
            if self.lack_around(edge, f64::INFINITY, f64::add) <= lack {
                return;
            }
        }
        self.put(edge, kept);
    }

    /// List target points near which the new vertex of an edge may fold less.
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

    /// Compute the mean of the six neighbours of a new vertex.
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

/// Repair folds of a new level and return the remaining ones. A `thorough` search is slow on crumpled input.
pub fn unfold(search: &Search<'_>, found: &mut [Found], thorough: bool) -> Vec<Fold> {
    let (topology, points) = (&search.level.topology, &search.level.points);
    let places = search.placed.places.iter().chain(found.iter().map(|f| &f.place));
    let normals = places.map(|place| search.original.surface.normal_at(place)).collect();
    let face = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|v| &points[v as usize]);
        unit(&cross(&sub(b, a), &sub(c, a)))
    };
    let coarse_faces = topology.triangles.iter().map(face).collect();
    let mut fine = Fine { search, found, normals, coarse_faces };
    let mut counts = vec![0; topology.triangles.len()];
    fill(&mut counts, search.original.threads, |t| fine.unsound(t).count());
    let unsound: Vec<usize> = (0..counts.len()).filter(|&t| counts[t] > 0).collect();
    let mut open = fine.mended(unsound.clone(), unsound, TURNS, Fine::mend);
    if thorough {
        open = fine.mended(open.clone(), open, THOROUGH_TURNS, Fine::search_around);
    }
    (0..topology.edges.len()).for_each(|edge| fine.take_back(edge));
    open.iter().flat_map(|&t| fine.folds(t)).collect()
}
