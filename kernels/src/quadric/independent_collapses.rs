//! Collapse of independent edges in passes: the fast first part of a simplification to few triangles.
//!
//! ```text
//! until few enough triangles are left, or little is removed:
//!     each vertex, on any thread: find its edge whose collapse has the smallest error
//!     from the cheapest edge on: collapse it, unless an end of it is already the end of another collapse
//! ```
//!
//! The measure is the one of the collapse engine. But there is no queue, no halfedge and no region, and a
//! quadric is a single cache line, so a collapse is cheaper than in the engine.

use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, add_scaled, cross, distance2, position_of, sub};
use crate::base::ids::VertexId;
use crate::base::parallel::update;
use crate::base::progress::Progress;
use crate::collapse::collapse_log::RegionLog;
use crate::collapse::engine::Merge;
use crate::collapse::rounds::Goal;
use crate::collapse::whole_mesh::WholeMesh;
use crate::mesh::collapse_legality::keeps_triangle;
use crate::mesh::vertex_triangles::VertexTriangles;
use crate::quadric::qem::{BOUNDARY_WEIGHT, QemState};
use crate::quadrics::lanes::Lanes;
use crate::quadrics::local_quadric::{EdgeMinimum, LaneQuadric, LocalQuadric, find_minimum, transpose};

/// A pass considers this ratio of the vertices, each with its cheapest edge. A larger ratio needs fewer
/// passes, but removes detail while flat places still have vertices to remove. Near the goal this matters more.
const CONSIDERED_RATIO: f64 = 0.8;
const CONSIDERED_RATIO_NEAR_GOAL: f64 = 0.5;

/// With more than this many triangles per triangle of the goal, the goal is far.
const FAR_FROM_GOAL: usize = 3;

/// Number of parts of a queue that are collapsed one after another, the cheapest first.
const ORDERED_PARTS: usize = 4;

/// A pass that removes a smaller ratio of the triangles is the last one.
const MIN_REMOVED_RATIO: f64 = 0.02;

/// Vertices with more neighbours are left to the collapse engine.
const MAX_VALENCE: usize = 16;

/// Triangles or edges that are processed together.
const LANES: usize = 4;

const NONE: u32 = u32::MAX;

/// The cheapest edge of a vertex.
#[derive(Clone, Copy)]
struct Candidate {
    error: f32,
    /// The other end, with a larger index; [`NONE`] if there is no such edge.
    to: u32,
}

const NO_CANDIDATE: Candidate = Candidate { error: f32::INFINITY, to: NONE };

/// Collapse edges until about `left` triangles are left.
///
/// Locked vertices and places that are not manifold stay unchanged. Also returns the collapses, one log per
/// pass. The result does not depend on the number of threads.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn collapse_independent_edges<const D: usize, const K: usize>(
    mut mesh: WholeMesh<D, ()>,
    mut state: QemState<K>,
    left: usize,
    goal: &Goal,
    progress: &mut Progress,
) -> Result<(WholeMesh<D, ()>, QemState<K>, Vec<RegionLog<D>>), KernelError> {
    let at_start = mesh.triangles.len();
    let mut logs = vec![];
    if at_start <= left {
        return Ok((mesh, state, logs));
    }
    let scale = 1.0 / mean_side(&mesh);
    if !scale.is_normal() {
        return Ok((mesh, state, logs));
    }
    // Without the scale, fourth powers of very small lengths would underflow.
    let units = std::array::from_fn(|j| if j < 3 { scale } else { scale * state.weight });
    let mut of_triangles = vec![[LocalQuadric::UNUSABLE; LANES]; at_start.div_ceil(LANES)];
    let mut quadrics = vec![LocalQuadric::UNUSABLE; mesh.points.len()];
    let mut candidates = vec![NO_CANDIDATE; mesh.points.len()];
    let mut refused = vec![NONE; mesh.points.len()];
    while mesh.triangles.len() > left && !progress.is_stopping_early() {
        let (before, vertices) = (mesh.triangles.len(), mesh.points.len());
        progress.report((at_start - before) as u64, (at_start - goal.triangles) as u64)?;
        of_triangles.truncate(before.div_ceil(LANES));
        quadrics.truncate(vertices);
        candidates.truncate(vertices);
        let stars = VertexTriangles::new(vertices, &mesh.triangles);
        let into = (0..vertices as u32).collect();
        let mut pass = Pass { mesh: &mut mesh, state: &mut state, stars, units, into };
        update(&mut of_triangles, goal.threads, |i, quadrics| {
            *quadrics = pass.compute_triangle_quadrics(LANES * i);
        });
        update(&mut quadrics, goal.threads, |v, quadric| {
            *quadric = pass.compute_quadric(v as u32, &of_triangles);
        });
        update(&mut candidates, goal.threads, |v, candidate| {
            *candidate = pass.find_candidate(v as u32, &quadrics, refused[v]);
        });
        let queue = find_cheapest(&candidates, before, left);
        let merges = pass.collapse_queue(&queue, &candidates, &quadrics, left, &mut refused);
        let into = pass.into;
        logs.push(log_merges(&mesh, merges, logs.len()));
        redirect_corners(&mut mesh, &into);
        drop_unused_vertices(&mut mesh, &mut state, &mut refused);
        if ((before - mesh.triangles.len()) as f64) < MIN_REMOVED_RATIO * before as f64 {
            break;
        }
    }
    Ok((mesh, state, logs))
}

/// Compute the root mean square length of the sides.
fn mean_side<const D: usize>(mesh: &WholeMesh<D, ()>) -> f64 {
    let square = |[a, b]: [u32; 2]| {
        distance2(&position_of(&mesh.points[a as usize]), &position_of(&mesh.points[b as usize]))
    };
    let sum: f64 =
        mesh.triangles.iter().map(|&[a, b, c]| square([a, b]) + square([b, c]) + square([c, a])).sum();
    (sum / (3 * mesh.triangles.len()) as f64).sqrt()
}

/// Neighbours of a vertex, counter-clockwise.
struct Ring {
    vertices: [u32; MAX_VALENCE],
    len: usize,
    /// True if the vertex is on the boundary: no triangle joins the last neighbour to the first.
    is_open: bool,
}

impl Ring {
    fn vertices(&self) -> &[u32] {
        &self.vertices[..self.len]
    }

    /// Number of triangles.
    fn triangles(&self) -> usize {
        self.len - usize::from(self.is_open)
    }

    fn next(&self, i: usize) -> usize {
        if i + 1 == self.len { 0 } else { i + 1 }
    }

    /// Iterate over the sides opposite to the vertex.
    fn sides(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        (0..self.triangles()).map(|i| [self.vertices[i], self.vertices[self.next(i)]])
    }

    fn position(&self, v: u32) -> Option<usize> {
        self.vertices().iter().position(|&u| u == v)
    }

    /// Return the corners opposite to the edge to neighbour `i`; [`NONE`] for one that does not exist.
    fn beside(&self, i: usize) -> [u32; 2] {
        let previous = match i {
            0 if self.is_open => NONE,
            0 => self.vertices[self.len - 1],
            _ => self.vertices[i - 1],
        };
        let next = if self.is_open && i + 1 == self.len { NONE } else { self.vertices[self.next(i)] };
        [previous, next]
    }
}

/// Mesh during a pass, with everything that the collapse of an edge depends on.
struct Pass<'a, const D: usize, const K: usize> {
    mesh: &'a mut WholeMesh<D, ()>,
    state: &'a mut QemState<K>,
    /// Triangles at the start of the pass.
    stars: VertexTriangles,
    /// Factor on each coordinate and attribute.
    units: [f64; D],
    /// By vertex: the vertex into which it has collapsed.
    into: Vec<u32>,
}

impl<const D: usize, const K: usize> Pass<'_, D, K> {
    /// Compute the quadric of a vertex from the quadrics of its triangles.
    fn compute_quadric(&self, v: u32, of_triangles: &[[LocalQuadric<K>; LANES]]) -> LocalQuadric<K> {
        let star = self.stars.around(v);
        if star.is_empty() || star.len() > MAX_VALENCE || self.mesh.locked.get(v as usize) == Some(&true) {
            return LocalQuadric::UNUSABLE;
        }
        let mut sum = LocalQuadric::ZERO;
        // Around an interior vertex, each neighbour starts one side of the ring and ends another one.
        let mut balance = 0u32;
        for &t in star {
            sum.add(&of_triangles[t as usize / LANES][t as usize % LANES]);
            let [from, to] = opposite_side(&self.mesh.triangles[t as usize], v);
            balance = balance.wrapping_add(to).wrapping_sub(from);
        }
        if balance != 0 {
            let Some(ring) = self.find_ring(v) else { return LocalQuadric::UNUSABLE };
            self.add_walls(&mut sum, v, &ring);
        }
        sum
    }

    /// Return the way from a vertex to another one, scaled, in coordinates and attributes.
    #[inline]
    fn way(&self, from: u32, to: u32) -> [f32; D] {
        let [from, to] = [from, to].map(|v| &self.mesh.points[v as usize]);
        std::array::from_fn(|j| (self.units[j] * (to[j] - from[j])) as f32)
    }

    /// Compute the quadrics of [`LANES`] triangles.
    fn compute_triangle_quadrics(&self, first: usize) -> [LocalQuadric<K>; LANES] {
        let triangles = &self.mesh.triangles;
        let corners: [[u32; 3]; LANES] =
            std::array::from_fn(|lane| triangles[(first + lane).min(triangles.len() - 1)]);
        let [u, v] = [1, 2].map(|to| transpose(&corners.map(|corners| self.way(corners[0], corners[to]))));
        let half = Lanes(corners.map(|corners| 0.5 * self.triangle_importance(corners)));
        let quadrics = LaneQuadric::of_triangles(&u, &v, half);
        std::array::from_fn(|lane| quadrics.lane(lane))
    }

    /// Compute the quadric of a vertex from its ring.
    fn quadric_of_ring(&self, centre: u32, ring: &Ring) -> LocalQuadric<K> {
        let mut sides = [[0.0f32; D]; MAX_VALENCE + LANES];
        for (&to, side) in ring.vertices().iter().chain(&ring.vertices[..1]).zip(&mut sides) {
            *side = self.way(centre, to);
        }
        let mut sum = LaneQuadric::<LANES, K>::ZERO;
        for first in (0..ring.triangles()).step_by(LANES) {
            let [u, v] = [first, first + 1]
                .map(|first| transpose::<LANES, D>(&std::array::from_fn(|lane| sides[first + lane])));
            let half = Lanes(std::array::from_fn(|lane| match first + lane {
                i if i >= ring.triangles() => 0.0,
                i => 0.5 * self.triangle_importance([centre, ring.vertices[i], ring.vertices[ring.next(i)]]),
            }));
            sum.add(&LaneQuadric::of_triangles(&u, &v, half));
        }
        let mut quadric = sum.lane(0);
        (1..LANES).for_each(|lane| quadric.add(&sum.lane(lane)));
        self.add_walls(&mut quadric, centre, ring);
        quadric
    }

    /// Add the walls of the boundary edges.
    fn add_walls(&self, quadric: &mut LocalQuadric<K>, centre: u32, ring: &Ring) {
        if !ring.is_open {
            return;
        }
        let last = ring.len - 1;
        for places in [[0, 1], [last, last - 1]] {
            let [end, across] = places.map(|i| {
                let way = self.way(centre, ring.vertices[i]);
                [way[0], way[1], way[2]]
            });
            quadric.add_wall(self.edge_importance([centre, ring.vertices[places[0]]]), end, across);
        }
    }

    /// Return the factor on the error of a triangle.
    #[inline]
    fn triangle_importance(&self, corners: [u32; 3]) -> f32 {
        if self.state.importance.is_empty() {
            return 1.0;
        }
        (corners.iter().map(|&v| self.state.importance[v as usize]).sum::<f64>() / 3.0) as f32
    }

    /// Return the factor on the error of a boundary edge.
    fn edge_importance(&self, ends: [u32; 2]) -> f32 {
        if self.state.importance.is_empty() {
            return BOUNDARY_WEIGHT as f32;
        }
        (BOUNDARY_WEIGHT * 0.5 * ends.iter().map(|&v| self.state.importance[v as usize]).sum::<f64>()) as f32
    }

    /// Find the cheapest edge from a vertex to one with a larger index, except to `refused`.
    fn find_candidate(&self, v: u32, quadrics: &[LocalQuadric<K>], refused: u32) -> Candidate {
        let own = &quadrics[v as usize];
        let mut best = NO_CANDIDATE;
        if !own.is_usable() {
            return best;
        }
        let mut ends = [NONE; LANES];
        let mut count = 0;
        let mut flush = |ends: &[u32; LANES], count: usize| {
            let ends: [u32; LANES] = std::array::from_fn(|i| ends[if i < count { i } else { 0 }]);
            let ways = ends.map(|end| self.way(v, end));
            let others = ends.map(|end| &quadrics[end as usize]);
            let error = find_minimum(own, others, &transpose(&ways)).error;
            for (&to, &error) in ends.iter().zip(&error.0) {
                if error < best.error || (error == best.error && to < best.to) {
                    best = Candidate { error, to };
                }
            }
        };
        let mut consider = |to: u32| {
            if to > v && to != refused && quadrics[to as usize].is_usable() {
                ends[count] = to;
                count += 1;
                if count == LANES {
                    flush(&ends, count);
                    count = 0;
                }
            }
        };
        let star = self.stars.around(v);
        let mut targets = [NONE; MAX_VALENCE];
        let mut balance = 0u32;
        for (&t, target) in star.iter().zip(&mut targets) {
            let [from, to] = opposite_side(&self.mesh.triangles[t as usize], v);
            consider(from);
            *target = to;
            balance = balance.wrapping_add(to).wrapping_sub(from);
        }
        // On the boundary, one neighbour starts no side.
        if balance != 0 {
            let starts =
                |to: u32| star.iter().any(|&t| opposite_side(&self.mesh.triangles[t as usize], v)[0] == to);
            targets[..star.len()].iter().filter(|&&to| !starts(to)).for_each(|&to| consider(to));
        }
        if count > 0 {
            flush(&ends, count);
        }
        best
    }

    /// Collapse the edges of a queue in turn; returns the merges.
    ///
    /// No vertex is an end of two collapses of a pass. Therefore, the triangles of both ends follow from the
    /// triangles before the pass, with the corners at collapsed vertices redirected. Updates `into` and
    /// `refused`. Stops when about `left` triangles are left.
    fn collapse_queue(
        &mut self,
        queue: &[u32],
        candidates: &[Candidate],
        quadrics: &[LocalQuadric<K>],
        left: usize,
        refused: &mut [u32],
    ) -> Vec<Merge> {
        let to_remove = self.mesh.triangles.len() - left;
        let mut removed = 0;
        let mut is_end = vec![false; self.into.len()];
        let mut changed = vec![false; self.into.len()];
        let mut merges: Vec<Merge> = vec![];
        let limit = queue.iter().map(|&v| candidates[v as usize].error).fold(0.0, f32::max);
        for &v in queue {
            if removed >= to_remove {
                break;
            }
            let ends = [v, candidates[v as usize].to];
            if ends.iter().any(|&end| is_end[end as usize]) {
                continue;
            }
            let [Some(first), Some(second)] = ends.map(|end| self.find_ring(end)) else { continue };
            let rings = [first, second];
            let own = [0, 1].map(|i| {
                let end = ends[i] as usize;
                if changed[end] { self.quadric_of_ring(ends[i], &rings[i]) } else { quadrics[end] }
            });
            let minimum =
                find_minimum::<1, D, K>(&own[0], [&own[1]], &transpose(&[self.way(ends[0], ends[1])]));
            let error = minimum.error.0[0];
            if error > limit {
                continue;
            }
            let point = self.point_at(ends, &own, &minimum);
            let Some(vanishing) =
                self.check_topology(ends, &rings).filter(|_| self.keeps_triangles(ends, &rings, &point))
            else {
                refused[v as usize] = ends[1];
                continue;
            };
            let distance =
                |end: u32| distance2(&position_of(&self.mesh.points[end as usize]), &position_of(&point));
            let [survivor, gone] =
                if distance(ends[1]) < distance(ends[0]) { [ends[1], ends[0]] } else { ends };
            self.mesh.points[survivor as usize] = point;
            self.into[gone as usize] = survivor;
            if !self.state.importance.is_empty() {
                let importance = &mut self.state.importance;
                importance[survivor as usize] = importance[survivor as usize].max(importance[gone as usize]);
            }
            for &end in &ends {
                is_end[end as usize] = true;
            }
            for &corner in rings.iter().flat_map(|ring| ring.vertices()) {
                changed[corner as usize] = true;
                refused[corner as usize] = NONE;
            }
            removed += vanishing;
            let highest = merges.last().map_or(0.0, |last| last.priority);
            merges.push(Merge {
                removed: VertexId(gone),
                survivor: VertexId(survivor),
                priority: highest.max(f64::from(error)),
                triangles: vanishing as u8,
            });
        }
        merges
    }

    /// Return the neighbours of a vertex; `None` where the mesh is not manifold, and for a large valence.
    ///
    /// Corners at collapsed vertices are redirected, and triangles that have vanished do not count.
    fn find_ring(&self, v: u32) -> Option<Ring> {
        let star = self.stars.around(v);
        if star.is_empty() || star.len() > MAX_VALENCE {
            return None;
        }
        let mut sides = [[NONE; 2]; MAX_VALENCE];
        let mut count = 0;
        for &t in star {
            let [from, to] =
                opposite_side(&self.mesh.triangles[t as usize], v).map(|corner| self.into[corner as usize]);
            sides[count] = [from, to];
            count += usize::from(from != to);
        }
        let sides = &sides[..count];
        let is_first = |at: u32| sides.iter().all(|side| side[1] != at);
        let mut first = None;
        if sides.iter().fold(0u32, |sum, side| sum.wrapping_add(side[0]).wrapping_sub(side[1])) != 0 {
            first = Some(sides.iter().position(|side| is_first(side[0]))?);
        }
        let (start, is_open) = (first.unwrap_or(0), first.is_some());
        if count == 0 || count + usize::from(is_open) > MAX_VALENCE || (!is_open && count < 3) {
            return None;
        }
        let mut ring = Ring { vertices: [NONE; MAX_VALENCE], len: count + usize::from(is_open), is_open };
        let mut at = sides[start][0];
        for place in 0..count {
            // A vertex that comes again closes the ring too early: the vertex has several fans.
            if place > 0 && at == ring.vertices[0] {
                return None;
            }
            ring.vertices[place] = at;
            let here = at;
            let mut leaving = sides.iter().filter(|side| side[0] == here);
            at = leaving.next()?[1];
            if leaving.next().is_some() {
                return None;
            }
        }
        if is_open {
            if ring.vertices[..count].contains(&at) {
                return None;
            }
            ring.vertices[count] = at;
            return Some(ring);
        }
        (at == ring.vertices[0]).then_some(ring)
    }

    /// Return the position and attributes of the vertex that replaces an edge.
    fn point_at(&self, ends: [u32; 2], own: &[LocalQuadric<K>; 2], minimum: &EdgeMinimum<1, K>) -> [f64; D] {
        let [from, to] = ends.map(|end| &self.mesh.points[end as usize]);
        let has_attributes = own[0].area + own[1].area > 0.0 && self.state.weight > 0.0;
        std::array::from_fn(|j| {
            if j < 3 {
                from[j] + f64::from(minimum.position[j].0[0]) / self.units[j]
            } else if has_attributes {
                from[j] + f64::from(minimum.attributes[j - 3].0[0]) / self.units[j]
            } else {
                0.5 * (from[j] + to[j])
            }
        })
    }

    /// Check the link condition; returns the number of triangles that vanish.
    ///
    /// As [`crate::mesh::collapse_legality::can_collapse`].
    fn check_topology(&self, ends: [u32; 2], rings: &[Ring; 2]) -> Option<usize> {
        let beside = rings[0].beside(rings[0].position(ends[1])?);
        let vanishing = beside.iter().filter(|&&apex| apex != NONE).count();
        let is_open = rings.each_ref().map(|ring| ring.is_open);
        let lengths = rings.each_ref().map(|ring| ring.len);
        let bridge = vanishing == 2 && is_open == [true, true];
        let lone_triangle = vanishing == 1 && lengths == [2, 2];
        let tetrahedron = lengths == [3, 3] && is_open == [false, false];
        let shared = rings[0].vertices().iter().filter(|v| rings[1].vertices().contains(v)).count();
        (!bridge && !lone_triangle && !tetrahedron && shared == vanishing).then_some(vanishing)
    }

    fn keeps_triangles(&self, ends: [u32; 2], rings: &[Ring; 2], point: &[f64; D]) -> bool {
        let position = |v: u32| position_of(&self.mesh.points[v as usize]);
        let target = position_of(point);
        if !target.iter().all(|x| x.is_finite()) || !point.iter().all(|x| x.is_finite()) {
            return false;
        }
        let mean_normal = || {
            ends.iter().zip(rings).fold([0.0; 3], |sum, (&end, ring)| {
                let from = position(end);
                ring.sides().fold(sum, |sum, side| {
                    // Both rings have the triangles of the edge.
                    if end == ends[1] && side.contains(&ends[0]) {
                        return sum;
                    }
                    let [a, b] = side.map(position);
                    add_scaled(&sum, 1.0, &cross(&sub(&a, &from), &sub(&b, &from)))
                })
            })
        };
        ends.iter().zip(rings).all(|(&end, ring)| {
            let from = position(end);
            ring.sides().filter(|side| !side.iter().any(|corner| ends.contains(corner))).all(|side| {
                let [a, b]: [Vec3; 2] = side.map(position);
                keeps_triangle([&from, &target], [&a, &b], mean_normal)
            })
        })
    }
}

/// Return the side of a triangle opposite to its corner `v`.
#[inline]
fn opposite_side(&[a, b, c]: &[u32; 3], v: u32) -> [u32; 2] {
    if a == v {
        [b, c]
    } else if b == v {
        [c, a]
    } else {
        [a, b]
    }
}

/// Find the vertices whose candidates a pass considers, and their order.
///
/// The cheapest go first. Within a quarter, the order is the one in memory, because most of the time of a
/// collapse would otherwise be spent waiting for memory.
fn find_cheapest(candidates: &[Candidate], triangles: usize, left: usize) -> Vec<u32> {
    // The bits of numbers that are not negative have their order.
    let mut queue: Vec<u64> = (0..)
        .zip(candidates)
        .filter(|(_, candidate)| candidate.to != NONE)
        .map(|(v, candidate): (u64, _)| u64::from(candidate.error.to_bits()) << 32 | v)
        .collect();
    let is_far = triangles > FAR_FROM_GOAL * left;
    let ratio = if is_far { CONSIDERED_RATIO } else { CONSIDERED_RATIO_NEAR_GOAL };
    let considered = (ratio * triangles as f64 / 2.0) as usize;
    if considered < queue.len() {
        queue.select_nth_unstable(considered);
        queue.truncate(considered);
    }
    let mut rest = &mut queue[..];
    for parts in (1..=ORDERED_PARTS).rev() {
        let size = rest.len() / parts;
        if size < rest.len() {
            rest.select_nth_unstable(size);
        }
        let (cheapest, others) = rest.split_at_mut(size);
        cheapest.sort_unstable_by_key(|&key| key as u32);
        rest = others;
    }
    queue.into_iter().map(|key| key as u32).collect()
}

fn log_merges<const D: usize>(mesh: &WholeMesh<D, ()>, mut merges: Vec<Merge>, round: usize) -> RegionLog<D> {
    let source = |v: VertexId| VertexId(mesh.vertex_source[v.index()]);
    for merge in &mut merges {
        (merge.removed, merge.survivor) = (source(merge.removed), source(merge.survivor));
    }
    RegionLog { round, merges, survivor_points: vec![] }
}
/// Move corners to the vertices into which theirs collapse, and drop the triangles that vanish.
fn redirect_corners<const D: usize>(mesh: &mut WholeMesh<D, ()>, into: &[u32]) {
    let mut kept = 0;
    for t in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.triangles[t].map(|v| into[v as usize]);
        if a != b && b != c && c != a {
            mesh.triangles[kept] = [a, b, c];
            mesh.triangle_source[kept] = mesh.triangle_source[t];
            kept += 1;
        }
    }
    mesh.triangles.truncate(kept);
    mesh.triangle_source.truncate(kept);
}

/// Drop the vertices without triangles, and renumber the others.
///
/// `refused` holds a vertex index per vertex.
fn drop_unused_vertices<const D: usize, const K: usize>(
    mesh: &mut WholeMesh<D, ()>,
    state: &mut QemState<K>,
    refused: &mut Vec<u32>,
) {
    let mut is_used = vec![false; mesh.points.len()];
    mesh.triangles.as_flattened().iter().for_each(|&v| is_used[v as usize] = true);
    let mut number = vec![NONE; mesh.points.len()];
    let used = is_used.iter().enumerate().filter(|(_, used)| **used);
    for (new, (v, _)) in used.enumerate() {
        number[v] = new as u32;
    }
    mesh.triangles.iter_mut().for_each(|corners| *corners = corners.map(|v| number[v as usize]));
    keep_used(&mut mesh.points, &is_used);
    keep_used(&mut mesh.vertex_source, &is_used);
    keep_used(&mut mesh.locked, &is_used);
    keep_used(&mut state.importance, &is_used);
    keep_used(refused, &is_used);
    refused.iter_mut().for_each(|v| *v = number.get(*v as usize).copied().unwrap_or(NONE));
}

fn keep_used<T>(values: &mut Vec<T>, is_used: &[bool]) {
    let mut used = is_used.iter();
    values.retain(|_| used.next() == Some(&true));
}
