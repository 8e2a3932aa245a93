//! Straight creases where planar patches meet.
//!
//! Vertices move onto their planes. Edges between two planes are split where the planes intersect, so that the
//! crease is a chain of edges on the line of intersection instead of a zigzag. Where three planes meet, one of
//! these points is the corner.

use super::normal_filter::limit_move;
use super::plane_growth::{NO_PLANE, Plane, intersection_direction};
use crate::base::geometry::{Vec3, add_scaled, cross, distance2, dot, norm2, normalize, sub};
use crate::base::ids::{EdgeId, HalfedgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;
use std::collections::{BTreeMap, BTreeSet};

/// Minimum sine of the angle between two planes that form a crease (15°).
const MIN_SINE2: f64 = 0.067;
/// A vertex keeps this part of an edge's length as distance from a crease, so that no triangle vanishes.
const MIN_DISTANCE_RATIO: f64 = 0.05;
/// Maximum length of the path over the crease, relative to the edge it replaces.
const MAX_PATH_RATIO: f64 = 1.6;
/// Minimum number of edges that cross a crease.
const MIN_CROSSINGS: usize = 6;
/// Width of the transition at the border of a patch that is not a crease, in rings of vertices on each side, and
/// iterations of its smoothing.
const BLEND_RINGS: u8 = 4;
const BLEND_ITERATIONS: usize = 24;

/// New vertex on an edge.
#[derive(Clone, Copy, Debug)]
pub struct CreaseVertex {
    /// Ends of the edge, and the position between them from 0 to 1, for attributes.
    pub ends: [u32; 2],
    pub share: f64,
}

/// Result: vertices that were split off follow the others in `points`.
#[derive(Clone, Debug)]
pub struct CreasedMesh {
    pub points: Vec<Vec3>,
    pub created: Vec<CreaseVertex>,
}

/// Line where two planes meet: a point and a unit direction.
struct Line {
    point: Vec3,
    direction: Vec3,
}

impl Line {
    fn between(a: &Plane, b: &Plane) -> Option<Self> {
        let (direction, sine2) = intersection_direction(a, b);
        if sine2 < MIN_SINE2 {
            return None;
        }
        let offsets = [a, b].map(|plane| dot(&plane.normal, &sub(&plane.origin, &a.origin)));
        // Relative to the origin of the first plane: offset 0 there.
        let along_a = cross(&direction, &a.normal);
        let point = add_scaled(&a.origin, offsets[1] / sine2, &along_a);
        Some(Self { point, direction: normalize(&direction) })
    }

    /// Cut an edge between both planes where it crosses the line in the unfolded plane: the point, and its
    /// position between the ends from 0 to 1. None if the line is too far from the edge.
    fn cut(&self, u: &Vec3, v: &Vec3) -> Option<(Vec3, f64)> {
        let (foot_u, foot_v) = (self.foot(u), self.foot(v));
        let (from_u, from_v) = (distance2(&foot_u, u).sqrt(), distance2(&foot_v, v).sqrt());
        let share = if from_u + from_v > 0.0 { from_u / (from_u + from_v) } else { 0.5 };
        let at = add_scaled(&foot_u, share, &sub(&foot_v, &foot_u));
        let is_near = path_length(&at, u, v) <= MAX_PATH_RATIO * distance2(u, v).sqrt();
        is_near.then_some((at, share))
    }

    fn foot(&self, p: &Vec3) -> Vec3 {
        add_scaled(&self.point, dot(&sub(p, &self.point), &self.direction), &self.direction)
    }
}

/// Move labelled vertices onto their planes and cut the edges that cross a crease.
///
/// `points` are moved at most `max_moves` from `origins`.
pub fn snap_to_planes(
    connectivity: &mut Connectivity,
    origins: &[Vec3],
    points: &[Vec3],
    planes: &[Plane],
    labels: &[u32],
    max_moves: &[f64],
) -> CreasedMesh {
    let creases = find_creases(connectivity, points, planes, labels);
    let moves = blend_moves(connectivity, points, planes, labels, &creases);
    let mut snapped: Vec<Vec3> = points
        .iter()
        .zip(&moves)
        .enumerate()
        .map(|(v, (p, step))| limit_move(&origins[v], add_scaled(p, 1.0, step), max_moves[v]))
        .collect();
    let crossing = find_crossing_edges(connectivity, labels, &creases);
    let sides = find_sides(connectivity, planes, labels, &snapped, &crossing);
    let may_reach = |v: usize, to: &Vec3| distance2(to, &origins[v]) <= max_moves[v] * max_moves[v];
    keep_to_sides(connectivity, planes, labels, &sides, &crossing, may_reach, &mut snapped);
    let corners = find_corners(connectivity, planes, labels, &snapped);
    let mut created = vec![];
    for edge in crossing {
        let [u, v] = connectivity.ends(edge).map(|v| v.index());
        let [a, b] = [u, v].map(|v| &planes[labels[v] as usize]);
        let Some(line) = Line::between(a, b) else { continue };
        let Some((mut at, share)) = line.cut(&snapped[u], &snapped[v]) else { continue };
        let length = distance2(&snapped[u], &snapped[v]).sqrt();
        if let Some(corner) = corners.get(&edge.0)
            && path_length(corner, &snapped[u], &snapped[v]) <= MAX_PATH_RATIO * length
        {
            at = *corner;
        }
        connectivity.split(edge);
        snapped.push(at);
        created.push(CreaseVertex { ends: [u as u32, v as u32], share });
    }
    CreasedMesh { points: snapped, created }
}

/// Compute the move of each vertex: onto its plane inside a patch, none far outside, and a smooth transition at
/// the borders that are not creases.
fn blend_moves(
    connectivity: &Connectivity,
    points: &[Vec3],
    planes: &[Plane],
    labels: &[u32],
    creases: &Creases,
) -> Vec<Vec3> {
    let count = points.len();
    let mut moves: Vec<Vec3> = (0..count)
        .map(|v| match labels[v] {
            NO_PLANE => [0.0; 3],
            label => {
                let plane = &planes[label as usize];
                plane.normal.map(|x| -plane.height(&points[v]) * x)
            }
        })
        .collect();
    let is_separate = |a: usize, b: usize| is_crease(creases, labels[a], labels[b]);
    // Rings around the soft borders.
    let mut rings = vec![u8::MAX; count];
    for edge in connectivity.edges() {
        let [u, v] = connectivity.ends(edge).map(|v| v.index());
        if labels[u] != labels[v] && !is_separate(u, v) {
            rings[u] = 0;
            rings[v] = 0;
        }
    }
    for ring in 0..BLEND_RINGS {
        for edge in connectivity.edges() {
            let [u, v] = connectivity.ends(edge).map(|v| v.index());
            for (from, to) in [(u, v), (v, u)] {
                if rings[from] == ring && rings[to] == u8::MAX && !is_separate(u, v) {
                    rings[to] = ring + 1;
                }
            }
        }
    }
    let band: Vec<usize> = (0..count).filter(|&v| rings[v] < BLEND_RINGS).collect();
    for _ in 0..BLEND_ITERATIONS {
        let averaged: Vec<Vec3> = band
            .iter()
            .map(|&v| {
                let (mut sum, mut neighbours) = (moves[v], 1.0);
                for (_, other) in connectivity.vertex_edges(VertexId::from_index(v)) {
                    if !is_separate(v, other.index()) {
                        sum = add_scaled(&sum, 1.0, &moves[other.index()]);
                        neighbours += 1.0;
                    }
                }
                sum.map(|x| x / neighbours)
            })
            .collect();
        band.iter().zip(averaged).for_each(|(&v, step)| moves[v] = step);
    }
    moves
}

fn path_length(at: &Vec3, u: &Vec3, v: &Vec3) -> f64 {
    distance2(at, u).sqrt() + distance2(at, v).sqrt()
}

/// Pairs of planes, smaller label first.
type Creases = BTreeSet<(u32, u32)>;

fn is_crease(creases: &Creases, a: u32, b: u32) -> bool {
    a != b && creases.contains(&(a.min(b), a.max(b)))
}

/// Find the pairs of planes that meet in a crease: most edges between them are near the line of intersection.
fn find_creases(connectivity: &Connectivity, points: &[Vec3], planes: &[Plane], labels: &[u32]) -> Creases {
    let mut counts: BTreeMap<(u32, u32), (usize, usize)> = BTreeMap::new();
    for edge in connectivity.edges() {
        let ends = connectivity.ends(edge).map(|v| v.index());
        let [a, b] = ends.map(|v| labels[v]);
        if a == b || a == NO_PLANE || b == NO_PLANE {
            continue;
        }
        let [u, v] = ends.map(|v| planes[labels[v] as usize].project(&points[v]));
        let near = Line::between(&planes[a as usize], &planes[b as usize])
            .is_some_and(|line| line.cut(&u, &v).is_some());
        let (good, all) = counts.entry((a.min(b), a.max(b))).or_insert((0, 0));
        *good += usize::from(near);
        *all += 1;
    }
    let is_clear = |(good, all): &(usize, usize)| *good >= MIN_CROSSINGS && *good * 4 >= *all * 3;
    counts.into_iter().filter(|(_, count)| is_clear(count)).map(|(pair, _)| pair).collect()
}

/// Edges between vertices of two planes that meet in a crease.
fn find_crossing_edges(connectivity: &Connectivity, labels: &[u32], creases: &Creases) -> Vec<EdgeId> {
    connectivity
        .edges()
        .filter(|&edge| {
            let [a, b] = connectivity.ends(edge).map(|v| labels[v.index()]);
            is_crease(creases, a, b)
        })
        .collect()
}

/// For each ordered pair of planes, the sum of the heights over the second one of the first one's vertices at
/// their crease: its sign is the side on which the first plane continues.
fn find_sides(
    connectivity: &Connectivity,
    planes: &[Plane],
    labels: &[u32],
    points: &[Vec3],
    crossing: &[EdgeId],
) -> BTreeMap<(u32, u32), f64> {
    let mut sides = BTreeMap::new();
    for &edge in crossing {
        let [u, v] = connectivity.ends(edge).map(|v| v.index());
        for (own, other) in [(u, v), (v, u)] {
            let height = planes[labels[other] as usize].height(&points[own]);
            *sides.entry((labels[own], labels[other])).or_insert(0.0) += height;
        }
    }
    sides
}

/// Move vertices that are beyond the crease, or nearly on it, back to their own side, if they may move so far.
fn keep_to_sides(
    connectivity: &Connectivity,
    planes: &[Plane],
    labels: &[u32],
    sides: &BTreeMap<(u32, u32), f64>,
    crossing: &[EdgeId],
    may_reach: impl Fn(usize, &Vec3) -> bool,
    points: &mut [Vec3],
) {
    for &edge in crossing {
        let [u, v] = connectivity.ends(edge).map(|v| v.index());
        let length = distance2(&points[u], &points[v]).sqrt();
        for (own, other) in [(u, v), (v, u)] {
            let (plane, beyond) = (&planes[labels[own] as usize], &planes[labels[other] as usize]);
            let side = if sides[&(labels[own], labels[other])] < 0.0 { -1.0 } else { 1.0 };
            // Direction within the own plane away from the crease, and the height gained per length.
            let inward = sub(&beyond.normal, &plane.normal.map(|x| x * dot(&plane.normal, &beyond.normal)));
            let sine = norm2(&inward).sqrt();
            let distance = side * beyond.height(&points[own]) / sine;
            let least = MIN_DISTANCE_RATIO * length;
            if distance < least && least - distance < 0.5 * length {
                let step = side * (least - distance) / sine;
                let moved = add_scaled(&points[own], step, &inward);
                if may_reach(own, &moved) {
                    points[own] = moved;
                }
            }
        }
    }
}

/// For triangles with three planes: the corner, by the edge whose new vertex takes its place.
fn find_corners(
    connectivity: &Connectivity,
    planes: &[Plane],
    labels: &[u32],
    points: &[Vec3],
) -> BTreeMap<u32, Vec3> {
    let mut corners = BTreeMap::new();
    for t in 0..connectivity.triangle_slots() {
        let vertices = connectivity.corners(TriangleId::from_index(t));
        let own = vertices.map(|v| labels[v.index()]);
        if own.contains(&NO_PLANE) || own[0] == own[1] || own[1] == own[2] || own[2] == own[0] {
            continue;
        }
        let [a, b, c] = own.map(|label| &planes[label as usize]);
        let middle = points[vertices[0].index()];
        let determinant = dot(&a.normal, &cross(&b.normal, &c.normal));
        if determinant.abs() < 0.1 {
            continue;
        }
        let heights = [a, b, c].map(|plane| -plane.height(&middle));
        let sum = [
            (heights[0], cross(&b.normal, &c.normal)),
            (heights[1], cross(&c.normal, &a.normal)),
            (heights[2], cross(&a.normal, &b.normal)),
        ]
        .iter()
        .fold([0.0; 3], |sum, (height, direction)| add_scaled(&sum, *height, direction));
        let corner = add_scaled(&middle, 1.0 / determinant, &sum);
        let edge =
            (0..3).map(|k| connectivity.edge(HalfedgeId(3 * t as u32 + k)).0).min().unwrap_or(u32::MAX);
        corners.entry(edge).or_insert(corner);
    }
    corners
}
