//! Removal of independent vertices: the fast first part of a simplification to few triangles.
//!
//! ```text
//! until few enough triangles are left, or little is removed:
//!     each vertex, on any thread: find the neighbour into which it collapses with the smallest error
//!     from the cheapest vertex on: collapse it, unless it or its neighbour is the end of another collapse
//! ```
//!
//! There is no heap, no vertex moves and no quadric is updated, so a collapse costs about a quarter of one in
//! the collapse engine. Vertices are not at optimal positions, but the error that this causes is small relative
//! to the error of the collapses that follow, which place vertices freely.

use crate::base::errors::KernelError;
use crate::base::geometry::{add_scaled, cross, distance2, position_of, sub};
use crate::base::ids::VertexId;
use crate::base::parallel::update;
use crate::base::progress::Progress;
use crate::collapse::collapse_log::RegionLog;
use crate::collapse::engine::Merge;
use crate::collapse::rounds::Goal;
use crate::collapse::whole_mesh::WholeMesh;
use crate::mesh::collapse_legality::keeps_triangle;
use crate::mesh::vertex_triangles::VertexTriangles;
use crate::quadric::qem::QemState;
use crate::quadrics::lanes::{self, LaneVec3, Lanes};

/// A pass considers only this ratio of the vertices, the cheapest ones. A larger ratio needs fewer passes, but
/// removes detail while flat places still have vertices to remove.
const CONSIDERED_RATIO: f64 = 0.5;

/// A pass that removes a smaller ratio of the triangles is the last one.
const MIN_REMOVED_RATIO: f64 = 0.02;

/// Vertices with more neighbours are left to the collapse engine.
const MAX_VALENCE: usize = 16;

/// Number of neighbours to try per vertex, the best ones first.
const MAX_TRIES: usize = 3;

/// Factor of the length term that orders collapses without error.
const LENGTH_COST_FACTOR: f32 = 1e-6;

/// Triangles that are processed together.
const LANES: usize = 4;

const NONE: u32 = u32::MAX;

/// The collapse of a vertex into a neighbour.
#[derive(Clone, Copy)]
struct Removal {
    error: f32,
    /// [`NONE`] if the vertex stays.
    into: u32,
}

const STAYS: Removal = Removal { error: f32::INFINITY, into: NONE };

/// Remove vertices until about `left` triangles are left.
///
/// Boundary vertices, locked ones and places that are not manifold stay unchanged. Also returns the collapses,
/// one log per pass. The result does not depend on the number of threads.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn remove_independent_vertices<const D: usize, const K: usize>(
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
    let mut removals = vec![STAYS; mesh.points.len()];
    let mut changed = vec![true; mesh.points.len()];
    let mut into: Vec<u32> = (0..mesh.points.len() as u32).collect();
    while mesh.triangles.len() > left && !progress.is_stopping_early() {
        let before = mesh.triangles.len();
        progress.report((at_start - before) as u64, (at_start - goal.triangles) as u64)?;
        let stars = VertexTriangles::new(mesh.points.len(), &mesh.triangles);
        let pass_mesh = PassMesh { mesh: &mesh, state: &state, stars: &stars, scale };
        update(&mut removals, goal.threads, |v, removal| {
            let is_stale = changed[v] || changed.get(removal.into as usize) == Some(&true);
            if is_stale {
                *removal = pass_mesh.find_best(v as u32);
            }
        });
        let queue = find_cheapest(&removals, before);
        changed.fill(false);
        let chosen = pass_mesh.collapse_independent(&queue, &mut removals, left, &mut into, &mut changed);
        drop(stars);
        logs.push(log_removals(&mesh, &chosen, logs.len()));
        if !state.importance.is_empty() {
            for merge in &chosen {
                let (v, to) = (merge.removed.index(), merge.survivor.index());
                state.importance[to] = state.importance[to].max(state.importance[v]);
            }
        }
        redirect_corners(&mut mesh, &into);
        if ((before - mesh.triangles.len()) as f64) < MIN_REMOVED_RATIO * before as f64 {
            break;
        }
    }
    drop_unused_vertices(&mut mesh, &mut state);
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

/// Neighbours of an interior vertex, counter-clockwise.
struct Ring {
    vertices: [u32; MAX_VALENCE],
    len: usize,
}

impl Ring {
    fn vertices(&self) -> &[u32] {
        &self.vertices[..self.len]
    }

    fn next(&self, i: usize) -> usize {
        if i + 1 == self.len { 0 } else { i + 1 }
    }

    fn previous(&self, i: usize) -> usize {
        if i == 0 { self.len - 1 } else { i - 1 }
    }
}

/// Mesh between two passes, with everything that the removal of a vertex depends on.
struct PassMesh<'a, const D: usize, const K: usize> {
    mesh: &'a WholeMesh<D, ()>,
    state: &'a QemState<K>,
    stars: &'a VertexTriangles,
    /// Factor on lengths, because fourth powers of very small lengths underflow.
    scale: f64,
}

impl<const D: usize, const K: usize> PassMesh<'_, D, K> {
    /// Find the collapse of a vertex with the smallest error; it may be illegal.
    fn find_best(&self, v: u32) -> Removal {
        if self.mesh.locked.get(v as usize) == Some(&true) {
            return STAYS;
        }
        let Some(ring) = self.find_ring(v, |corner| corner) else { return STAYS };
        let errors = self.compute_errors(v, &ring);
        let best = find_smallest(&errors[..ring.len]);
        if errors[best] == f32::INFINITY {
            return STAYS;
        }
        Removal { error: errors[best], into: ring.vertices[best] }
    }

    /// Collapse the vertices of a queue in turn; returns the collapses.
    ///
    /// No vertex is an end of two collapses of a pass. Therefore, the triangles of both ends follow from the
    /// triangles before the pass, with the corners at collapsed vertices redirected. Updates `into`, and marks
    /// the vertices whose triangles change. Stops when about `left` triangles are left.
    fn collapse_independent(
        &self,
        queue: &[u32],
        removals: &mut [Removal],
        left: usize,
        into: &mut [u32],
        changed: &mut [bool],
    ) -> Vec<Merge> {
        let most = (self.mesh.triangles.len() - left).div_ceil(2);
        let mut is_end = vec![false; into.len()];
        let mut chosen: Vec<Merge> = vec![];
        let limit = queue.last().map_or(0.0, |&v| removals[v as usize].error);
        for &v in queue {
            if chosen.len() == most {
                break;
            }
            if is_end[v as usize] {
                continue;
            }
            let Some(ring) = self.find_ring(v, |corner| into[corner as usize]) else { continue };
            let mut errors = self.compute_errors(v, &ring);
            for (error, &to) in errors.iter_mut().zip(ring.vertices()) {
                if is_end[to as usize] {
                    *error = f32::INFINITY;
                }
            }
            let mut found = None;
            for _ in 0..MAX_TRIES {
                let to = find_smallest(&errors[..ring.len]);
                if errors[to] > limit {
                    break;
                }
                if self.preserves_topology(v, &ring, to, into) && self.keeps_triangles(v, &ring, to) {
                    found = Some(to);
                    break;
                }
                errors[to] = f32::INFINITY;
            }
            let Some(to) = found else { continue };
            let survivor = ring.vertices[to];
            into[v as usize] = survivor;
            removals[v as usize] = STAYS;
            is_end[v as usize] = true;
            is_end[survivor as usize] = true;
            ring.vertices().iter().for_each(|&corner| changed[corner as usize] = true);
            let highest = chosen.last().map_or(0.0, |last| last.priority);
            chosen.push(Merge {
                removed: VertexId(v),
                survivor: VertexId(survivor),
                priority: highest.max(f64::from(errors[to])),
                triangles: 2,
            });
        }
        chosen
    }

    /// Return the neighbours of a vertex; `None` on a boundary, where the mesh is not manifold, and for a
    /// large valence.
    ///
    /// `redirect` returns the vertex into which a corner has collapsed. Triangles that have vanished do not
    /// count.
    fn find_ring(&self, v: u32, redirect: impl Fn(u32) -> u32) -> Option<Ring> {
        let star = self.stars.around(v);
        if star.len() < 3 || star.len() > MAX_VALENCE {
            return None;
        }
        let mut sides = [[NONE; 2]; MAX_VALENCE];
        let mut count = 0;
        for &t in star {
            let [a, b, c] = self.mesh.triangles[t as usize];
            let [from, to] = if a == v {
                [b, c]
            } else if b == v {
                [c, a]
            } else {
                [a, b]
            }
            .map(&redirect);
            sides[count] = [from, to];
            count += usize::from(from != to);
        }
        let sides = &sides[..count];
        if count < 3 {
            return None;
        }
        let mut ring = Ring { vertices: [NONE; MAX_VALENCE], len: count };
        let mut at = sides[0][0];
        for place in 0..count {
            // A vertex that comes again closes the ring too early: the vertex has several fans.
            if place > 0 && at == sides[0][0] {
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
        (at == sides[0][0]).then_some(ring)
    }

    /// Compute the error of the collapse of a vertex into each of its neighbours.
    ///
    /// The quadric of the current triangles gives the errors, with the vertex as the origin. Its linear
    /// term and its constant are then zero. Single precision suffices to compare errors.
    fn compute_errors(&self, centre: u32, ring: &Ring) -> [f32; MAX_VALENCE] {
        let own = &self.mesh.points[centre as usize];
        // Coordinates and attributes of the neighbours; the first neighbour comes again after the last one.
        let mut sides = [[0.0f32; MAX_VALENCE + LANES]; D];
        for (i, &to) in ring.vertices().iter().chain(&ring.vertices[..1]).enumerate() {
            let point = &self.mesh.points[to as usize];
            for (j, side) in sides.iter_mut().enumerate() {
                let unit = if j < 3 { 1.0 } else { self.state.weight };
                side[i] = (self.scale * unit * (point[j] - own[j])) as f32;
            }
        }
        let mut shape = [Lanes::<LANES, f32>::all(0.0); 6];
        let mut area = Lanes::all(0.0);
        let mut attributes = [[Lanes::all(0.0); 3]; K];
        for first in (0..ring.len).step_by(LANES) {
            let load = |j: usize, from: usize| Lanes(std::array::from_fn(|lane| sides[j][from + lane]));
            let [u, v] = [first, first + 1].map(|from| [0, 1, 2].map(|j| load(j, from)));
            let normal = lanes::cross(&u, &v);
            // Without an area, the triangle has no error.
            let norm2 = lanes::dot(&normal, &normal).map(|x| if x > 0.0 { x } else { f32::INFINITY });
            let inverse = norm2.map(|x| 1.0 / x);
            let half = Lanes(std::array::from_fn(|lane| match first + lane {
                i if i >= ring.len => 0.0,
                i => 0.5 * self.triangle_importance([centre, ring.vertices[i], ring.vertices[ring.next(i)]]),
            }));
            let own_area = half * norm2.map(|x| if x < f32::INFINITY { x.sqrt() } else { 0.0 });
            area += own_area;
            let mut add = |gradient: &LaneVec3<LANES, f32>| {
                let [x, y, z] = gradient.map(|x| own_area * x);
                let [gx, gy, gz] = *gradient;
                let products = [x * gx, x * gy, x * gz, y * gy, y * gz, z * gz];
                (0..6).for_each(|i| shape[i] += products[i]);
                [x, y, z]
            };
            let unit_factor = inverse.map(f32::sqrt);
            add(&normal.map(|x| x * unit_factor));
            let along_u = lanes::cross(&v, &normal).map(|x| x * inverse);
            let along_v = lanes::cross(&normal, &u).map(|x| x * inverse);
            for (j, sum) in attributes.iter_mut().enumerate() {
                let [du, dv] = [first, first + 1].map(|from| load(3 + j, from));
                let gradient = [0, 1, 2].map(|i| du * along_u[i] + dv * along_v[i]);
                let weighted = add(&gradient);
                (0..3).for_each(|i| sum[i] += weighted[i]);
            }
        }
        let sum = |lanes: Lanes<LANES, f32>| (lanes.0[0] + lanes.0[1]) + (lanes.0[2] + lanes.0[3]);
        let [xx, xy, xz, yy, yz, zz] = shape.map(sum);
        let (area, attributes) = (sum(area), attributes.map(|gradient| gradient.map(sum)));
        let mut errors = [f32::INFINITY; MAX_VALENCE];
        for (i, error) in errors.iter_mut().enumerate().take(ring.len) {
            let [x, y, z] = [0, 1, 2].map(|j| sides[j][i]);
            let mut all = x * (xx * x + 2.0 * (xy * y + xz * z)) + y * (yy * y + 2.0 * yz * z) + z * zz * z;
            for (j, [gx, gy, gz]) in attributes.iter().enumerate() {
                let s = sides[3 + j][i];
                all += s * (s * area - 2.0 * (gx * x + gy * y + gz * z));
            }
            let length2 = x * x + y * y + z * z;
            let with_length = all.max(0.0) + LENGTH_COST_FACTOR * area * length2;
            // The attributes may overflow.
            *error = if all.is_finite() { with_length } else { f32::INFINITY };
        }
        errors
    }

    /// Return the factor on the error of a triangle.
    #[inline]
    fn triangle_importance(&self, corners: [u32; 3]) -> f32 {
        if self.state.importance.is_empty() {
            return 1.0;
        }
        (corners.iter().map(|&v| self.state.importance[v as usize]).sum::<f64>() / 3.0) as f32
    }

    /// Check the link condition for the collapse of `v` into its neighbour `ring[to]`.
    fn preserves_topology(&self, v: u32, ring: &Ring, to: usize, into: &[u32]) -> bool {
        let target = ring.vertices[to];
        let beside = [ring.vertices[ring.previous(to)], ring.vertices[ring.next(to)]];
        for &t in self.stars.around(target) {
            let corners = self.mesh.triangles[t as usize].map(|corner| into[corner as usize]);
            let others = corners.into_iter().filter(|&corner| corner != target);
            if corners.contains(&v) || others.clone().count() < 2 {
                continue;
            }
            let mut on_ring = 0;
            for corner in others {
                if beside.contains(&corner) {
                    on_ring += 1;
                } else if ring.vertices().contains(&corner) {
                    return false;
                }
            }
            // The only triangle that is left exists already.
            if ring.len == 3 && on_ring == 2 {
                return false;
            }
        }
        true
    }

    fn keeps_triangles(&self, v: u32, ring: &Ring, to: usize) -> bool {
        let from = &position_of(&self.mesh.points[v as usize]);
        let position = |i: usize| position_of(&self.mesh.points[ring.vertices[i] as usize]);
        let target = position(to);
        let mean_normal = || {
            (0..ring.len).fold([0.0; 3], |sum, i| {
                let [a, b] = [position(i), position(ring.next(i))];
                add_scaled(&sum, 1.0, &cross(&sub(&a, from), &sub(&b, from)))
            })
        };
        (0..ring.len)
            .filter(|&i| i != to && ring.next(i) != to)
            .all(|i| keeps_triangle([from, &target], [&position(i), &position(ring.next(i))], mean_normal))
    }
}

fn find_smallest(errors: &[f32]) -> usize {
    (1..errors.len()).fold(0, |best, i| if errors[i] < errors[best] { i } else { best })
}

/// Find the vertices that a pass may remove, the cheapest first.
fn find_cheapest(removals: &[Removal], triangles: usize) -> Vec<u32> {
    // The bits of numbers that are not negative have their order.
    let mut queue: Vec<u64> = (0..)
        .zip(removals)
        .filter(|(_, removal)| removal.into != NONE)
        .map(|(v, removal): (u64, _)| u64::from(removal.error.to_bits()) << 32 | v)
        .collect();
    let considered = (CONSIDERED_RATIO * triangles as f64 / 2.0) as usize;
    if considered < queue.len() {
        queue.select_nth_unstable(considered);
        queue.truncate(considered);
    }
    queue.sort_unstable();
    queue.into_iter().map(|key| key as u32).collect()
}

fn log_removals<const D: usize>(mesh: &WholeMesh<D, ()>, chosen: &[Merge], round: usize) -> RegionLog<D> {
    let source = |v: VertexId| VertexId(mesh.vertex_source[v.index()]);
    let of_source = |m: &Merge| Merge { removed: source(m.removed), survivor: source(m.survivor), ..*m };
    RegionLog { round, merges: chosen.iter().map(of_source).collect(), survivor_points: vec![] }
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

fn drop_unused_vertices<const D: usize, const K: usize>(
    mesh: &mut WholeMesh<D, ()>,
    state: &mut QemState<K>,
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
}

fn keep_used<T>(values: &mut Vec<T>, is_used: &[bool]) {
    let mut used = is_used.iter();
    values.retain(|_| used.next() == Some(&true));
    values.shrink_to_fit();
}
