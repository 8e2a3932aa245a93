//! No triangle of a level may turn over, or be a needle.
//!
//! Turned over is a triangle that looks away from the surface at its corners, or from the input's triangle next to its
//! middle. Where the input is crumpled, neither says much: unless the normals at the corners agree, it is enough to look
//! where the triangle does that it is a part of, and a triangle of the input that is itself turned is not asked. New
//! vertices of a triangle that is turned are tried at other places of the surface: on the line from the unrelaxed point,
//! where they are expected, near the mean of their neighbours and near the middle of their edge; on the boundary elsewhere
//! along it. What makes the worst triangle around better is taken. Where that is not enough, a closer search takes what
//! makes the triangles around better together.

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

/// Turns over all triangles that are not sound.
const TURNS: usize = 12;
const THOROUGH_TURNS: usize = 4;
/// Least cosine between a triangle and the surface's mean normal at its corners.
const LEAST_COSINE: f64 = 0.02;
/// Least height of a triangle in lengths of its longest side.
const LEAST_FLATNESS: f64 = 1e-3;

/// Length of the sum of a triangle's three normals from which the surface is smooth there beyond doubt.
const SMOOTH: f64 = 2.9;
/// Where else on a boundary, in shares of its part of the chain.
const SHARES: [f64; 6] = [0.5, 0.4, 0.6, 0.3, 0.7, 0.2];
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
/// Where that has not helped, points of a square, closer together towards its middle: how many along a side, and how far
/// away they are at most.
const SIDE: usize = 9;
const ASIDE_AT_MOST: f64 = 0.6;
/// Shares of a chain that are tried then, less one.
const FINE_SHARES: usize = 32;
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

/// In order, each once.
fn sorted(mut triangles: Vec<usize>) -> Vec<usize> {
    triangles.sort_unstable();
    triangles.dedup();
    triangles
}

/// Whether a triangle may stay as it is.
fn is_sound(soundness: f64) -> bool {
    soundness >= LEAST_COSINE
}

/// How sound a triangle is by the surface at its corners and next to its middle; no more than needed to tell that it is
/// not above `enough`. Triangles of the slots `near` may be near; `parent` is the normal of the triangle it is a part of, if it is one.
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

/// Whether a triangle of these vertices is one of the input, wherever it starts.
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

/// The triangles of a base mesh that are not sound; `source` are the vertices of the input that its vertices are. What the
/// input has itself is no fault of the base.
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

/// What two triangles lack: the larger of both, or the sum.
type Joined = fn(f64, f64) -> f64;

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

    fn place(&self, v: u32) -> &Place {
        let coarse = &self.search.placed.places;
        coarse.get(v as usize).unwrap_or_else(|| &self.found[v as usize - coarse.len()].place)
    }

    /// How sound a child of triangle `t` of the coarse level is, as far as it is above `enough`.
    fn soundness(&self, t: usize, corners: &[u32; 3], enough: f64) -> f64 {
        let points = corners.map(|v| self.point(v));
        let normals = corners.map(|v| &self.normals[v as usize]);
        let near = corners.map(|v| self.place(v).slot);
        let surface = self.search.original.surface;
        against_surface(surface, points, normals, near, Some(&self.coarse_faces[t]), enough)
    }

    /// The children of triangle `t` of the coarse level that are not sound.
    fn unsound(&self, t: usize) -> impl Iterator<Item = [u32; 3]> {
        let children = self.search.level.topology.children(t).into_iter();
        children.filter(move |corners| !is_sound(self.soundness(t, corners, LEAST_COSINE)))
    }

    /// The same, and where they are.
    fn folds(&self, t: usize) -> impl Iterator<Item = Fold> {
        self.unsound(t)
            .map(move |corners| Fold { triangle: t, middle: middle(&corners.map(|v| *self.point(v))) })
    }

    /// The triangles of the coarse level beside an edge.
    fn beside(&self, edge: usize) -> impl Iterator<Item = usize> + use<> {
        let beside = self.search.level.topology.edge_triangles[edge];
        beside.into_iter().filter(|&t| t != NONE).map(|t| t as usize)
    }

    /// The triangles around the new vertex of an edge, and the ones they are a part of.
    fn around(&self, edge: usize) -> impl Iterator<Item = (usize, [u32; 3])> {
        let v = self.vertex(edge) as u32;
        let children = |t| self.search.level.topology.children(t).into_iter().map(move |child| (t, child));
        self.beside(edge).flat_map(children).filter(move |(_, child)| child.contains(&v))
    }

    /// What the triangles around the new vertex of an edge lack to be sound, as far as it is below `most`.
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

    /// Put the new vertex of an edge where the triangles around it lack least, until they lack nothing; whether that is
    /// elsewhere.
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

    /// Try a few places for the new vertex of an edge; whether one is better for the worst triangle around it.
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

    /// Try many places for the new vertex of an edge; whether one is better for the triangles around it together.
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
                // Where the sets are thin, another triangle's may do.
                let near = std::iter::once_with(move || search.nearest(edge, &target, &direction));
                near.chain(search.anywhere(edge, &target, &direction))
            })
        });
        self.try_out(edge, places.map(|place| search.vector(edge, place)), f64::add)
    }

    /// Mend triangles of the coarse level by moving vertices of their edges; returns those of them, of `open` and of their
    /// neighbours that stay unsound.
    fn mended(
        &mut self,
        mut open: Vec<usize>,
        mut changed: Vec<usize>,
        turns: usize,
        mend: fn(&mut Self, usize) -> bool,
    ) -> Vec<usize> {
        let topology = &self.search.level.topology;
        for _ in 0..turns {
            // What makes one triangle better may turn its neighbour over. Where nothing has changed, nothing will.
            let mut moved = vec![];
            for t in sorted(changed) {
                if self.unsound(t).next().is_none() {
                    continue;
                }
                // A vertex that has a vector already costs no more elsewhere.
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

    /// Take back what was not needed in the end: a vertex that a scalar leads to costs less than one with a vector.
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

/// Mend what can be mended; returns what is not sound then. A `thorough` search takes long where the input is crumpled.
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
