//! Construction of the connectivity from triangles, by a counting sort of their sides. The numbering does not
//! depend on the thread count.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

use crate::base::errors::KernelError;
use crate::base::ids::{EdgeId, HalfedgeId, VertexId};
use crate::base::parallel;
use crate::mesh::connectivity::{Connectivity, Halfedge};

/// Meshes with fewer triangles are connected on one thread.
const MIN_PARALLEL_TRIANGLES: usize = 1 << 14;

/// Vertices whose fans a thread checks per batch.
const FAN_BATCH: usize = 1 << 14;

/// Sides sampled to split them evenly among threads.
const RANGE_SAMPLES: usize = 1 << 12;

/// Check vertex indices and the number of triangles.
///
/// # Errors
/// [`KernelError::TooManyTriangles`], [`KernelError::IndexOutOfRange`].
pub fn check_indices(vertex_count: usize, triangles: &[[u32; 3]]) -> Result<(), KernelError> {
    let limit = Connectivity::MAX_TRIANGLES;
    if triangles.len() > limit || vertex_count >= (u32::MAX / 2) as usize {
        return Err(KernelError::TooManyTriangles { wanted: triangles.len() as f64, limit });
    }
    // Testing all indices without an early exit is faster, because the loop is vectorised.
    if triangles.as_flattened().iter().fold(true, |known, &v| known & (v < vertex_count as u32)) {
        return Ok(());
    }
    let out_of_range = |corners: &[u32; 3]| corners.iter().copied().find(|&v| v as usize >= vertex_count);
    for (triangle, corners) in triangles.iter().enumerate() {
        if let Some(vertex) = out_of_range(corners) {
            return Err(KernelError::IndexOutOfRange {
                triangle,
                vertex: vertex.into(),
                vertices: vertex_count,
            });
        }
    }
    Ok(())
}

impl Connectivity {
    /// Build the connectivity of a manifold mesh.
    ///
    /// # Errors
    /// An index out of range, an edge with three triangles or with two of opposite orientation, two triangles
    /// with the same vertices, or a vertex that joins several fans. Triangles with repeated vertices must be
    /// removed before.
    pub fn from_triangles(vertex_count: usize, triangles: &[[u32; 3]]) -> Result<Self, KernelError> {
        Self::from_triangles_on(1, vertex_count, triangles)
    }

    /// Build the connectivity on several threads.
    pub fn from_triangles_on(
        threads: usize,
        vertex_count: usize,
        triangles: &[[u32; 3]],
    ) -> Result<Self, KernelError> {
        build_connectivity(threads, vertex_count, triangles, |_| false)
    }

    /// Build the connectivity of a region of a mesh. Rim vertices have more triangles outside the region, so
    /// the check for a single fan skips them.
    pub fn from_region(
        vertex_count: usize,
        triangles: &[[u32; 3]],
        on_rim: impl Fn(VertexId) -> bool + Sync,
    ) -> Result<Self, KernelError> {
        build_connectivity(1, vertex_count, triangles, on_rim)
    }

    /// Build the connectivity from paired halfedges. `origins` is the start vertex of each halfedge; every
    /// fan of triangles must have a separate vertex.
    pub(crate) fn from_twins(vertex_count: usize, origins: &[VertexId], twins: &[HalfedgeId]) -> Self {
        let mut halfedges: Vec<Halfedge> = Vec::with_capacity(origins.len());
        let mut edges = Vec::with_capacity(origins.len() / 2 + 1);
        for (h, (&origin, &twin)) in origins.iter().zip(twins).enumerate() {
            let edge = if twin.index() < h {
                halfedges[twin.index()].edge
            } else {
                edges.push(HalfedgeId::from_index(h));
                EdgeId::from_index(edges.len() - 1)
            };
            halfedges.push(Halfedge { origin, twin, edge });
        }
        let triangle_count = halfedges.len() / 3;
        let mut outgoing = vec![HalfedgeId::NONE; vertex_count];
        for (h, halfedge) in halfedges.iter().enumerate() {
            let slot = &mut outgoing[halfedge.origin.index()];
            if slot.is_none() || halfedge.twin.is_none() {
                *slot = HalfedgeId::from_index(h);
            }
        }
        Self { halfedges, outgoing, edges, triangle_count }
    }
}

fn build_connectivity(
    threads: usize,
    vertex_count: usize,
    triangles: &[[u32; 3]],
    on_rim: impl Fn(VertexId) -> bool + Sync,
) -> Result<Connectivity, KernelError> {
    check_indices(vertex_count, triangles)?;
    let threads = if triangles.len() < MIN_PARALLEL_TRIANGLES { 1 } else { threads };
    let (edges, halfedges) = pair_halfedges(threads, vertex_count, triangles)?;
    let (outgoing, degree) = find_outgoing(threads, vertex_count, &halfedges);
    let connectivity = Connectivity { halfedges, outgoing, edges, triangle_count: triangles.len() };
    connectivity.check_fans(threads, &degree, on_rim)?;
    Ok(connectivity)
}

/// Pair the halfedges. Returns the first halfedge of each edge, and all halfedges. Edges are numbered by
/// lower end, then by higher end.
fn pair_halfedges(
    threads: usize,
    vertex_count: usize,
    triangles: &[[u32; 3]],
) -> Result<(Vec<HalfedgeId>, Vec<Halfedge>), KernelError> {
    let corners = triangles.as_flattened();
    let mut halfedges = parallel::collect(corners.len(), threads, |h| Halfedge {
        origin: VertexId(corners[h]),
        twin: HalfedgeId::NONE,
        edge: EdgeId::NONE,
    });
    let ranges = split_evenly(threads, vertex_count, triangles);
    let told = as_atomics(&mut halfedges);
    let found =
        parallel::map(ranges.len(), threads, || (), |(), i| RangeEdges::new(&ranges[i], triangles, told));
    // Offset of the edges of each range.
    let (mut edges, mut begins) = (vec![], vec![]);
    let (mut crowded, mut inconsistent) = (vec![], vec![]);
    for of_range in found {
        begins.push(edges.len() as u32);
        if edges.is_empty() {
            edges = of_range.first;
        } else {
            edges.extend(of_range.first);
        }
        crowded.extend(of_range.non_manifold);
        inconsistent.extend(of_range.inconsistent);
    }
    if !crowded.is_empty() {
        return Err(KernelError::NonManifoldEdges(crowded));
    }
    if !inconsistent.is_empty() {
        return Err(KernelError::InconsistentEdges(inconsistent));
    }
    let begin = |low: u32| begins[ranges.iter().position(|range| low < range.end).unwrap_or(0)];
    let is_any_doubled = AtomicBool::new(false);
    parallel::update(&mut halfedges, threads, |h, halfedge| {
        halfedge.edge.0 += begin(side_ends(&triangles[h / 3], h % 3)[0]);
        if has_same_vertices(triangles, HalfedgeId::from_index(h), halfedge.twin) {
            is_any_doubled.store(true, Relaxed);
        }
    });
    if is_any_doubled.into_inner() {
        Err(same_vertices_error(triangles, &halfedges))
    } else {
        Ok((edges, halfedges))
    }
}

/// Borrow halfedges as atomics, so that several threads may write them: origin, twin and edge of each.
fn as_atomics(halfedges: &mut [Halfedge]) -> &[[AtomicU32; 3]] {
    // SAFETY: a halfedge is `repr(C)` with three 32-bit integers, and an atomic integer has the layout of a
    // plain one. The mutable borrow excludes other access.
    unsafe { &*(std::ptr::from_mut(halfedges) as *const [[AtomicU32; 3]]) }
}

/// Return the ends of the side that starts at a corner of a triangle, lower end first.
#[inline]
fn side_ends(triangle: &[u32; 3], corner: usize) -> [u32; 2] {
    let (a, b) = (triangle[corner], triangle[(corner + 1) % 3]);
    [a.min(b), a.max(b)]
}

/// Split the vertices into ranges that are the lower ends of about equally many sides.
fn split_evenly(count: usize, vertex_count: usize, triangles: &[[u32; 3]]) -> Vec<Range<u32>> {
    let last = vertex_count as u32;
    if count <= 1 {
        return std::iter::once(0..last).collect();
    }
    let step = (3 * triangles.len()).div_ceil(RANGE_SAMPLES).max(1);
    let mut low: Vec<u32> =
        (0..3 * triangles.len()).step_by(step).map(|h| side_ends(&triangles[h / 3], h % 3)[0]).collect();
    low.sort_unstable();
    let begin = |i: usize| {
        if i == 0 { 0 } else { low.get(i * low.len() / count).copied().unwrap_or(last) }
    };
    (0..count).map(|i| begin(i)..if i + 1 < count { begin(i + 1) } else { last }).collect()
}

/// Edges whose lower ends are in a range.
struct RangeEdges {
    /// First halfedge of each edge.
    first: Vec<HalfedgeId>,
    /// Ends of edges with more than two triangles.
    non_manifold: Vec<[u32; 2]>,
    /// Ends of edges that both triangles traverse in the same direction.
    inconsistent: Vec<[u32; 2]>,
}

impl RangeEdges {
    /// Find the edges, and store the twin and the edge of each halfedge. Edges are counted from the start of
    /// the range.
    fn new(range: &Range<u32>, triangles: &[[u32; 3]], told: &[[AtomicU32; 3]]) -> Self {
        let GroupedSides { sides, starts } = GroupedSides::new(range, triangles);
        let mut found = Self {
            first: Vec::with_capacity(sides.len() / 2 + 1),
            non_manifold: vec![],
            inconsistent: vec![],
        };
        // Sort keys: higher end in the upper half, halfedge in the lower half.
        let mut around: Vec<u64> = vec![];
        for (low, group) in range.clone().zip(starts.windows(2)) {
            let group = &sides[group[0] as usize..group[1] as usize];
            let high = |h: u32| side_ends(&triangles[h as usize / 3], h as usize % 3)[1];
            around.clear();
            around.extend(group.iter().map(|&h| u64::from(high(h)) << 32 | u64::from(h)));
            // A small sort: one entry per neighbour of the vertex.
            around.sort_unstable();
            for same in around.chunk_by(|g, h| g >> 32 == h >> 32) {
                found.record_edge(low, same, triangles, told);
            }
        }
        found
    }

    /// Record an edge, given all its sides in the order of their halfedges.
    #[inline]
    fn record_edge(&mut self, low: u32, same: &[u64], triangles: &[[u32; 3]], told: &[[AtomicU32; 3]]) {
        let high = (same[0] >> 32) as u32;
        let origin = |h: u32| triangles[h as usize / 3][h as usize % 3];
        let edge = self.first.len() as u32;
        let tell = |h: u32, twin: u32| {
            told[h as usize][1].store(twin, Relaxed);
            told[h as usize][2].store(edge, Relaxed);
        };
        let first = same[0] as u32;
        match *same {
            [_] => tell(first, HalfedgeId::NONE.0),
            [_, second] if origin(first) != origin(second as u32) => {
                tell(first, second as u32);
                tell(second as u32, first);
            }
            [_, _] => self.inconsistent.push([low, high]),
            _ => self.non_manifold.push([low, high]),
        }
        self.first.push(HalfedgeId(first));
    }
}

/// Sides of triangles (as halfedges) whose lower ends are in a range, grouped by lower end.
struct GroupedSides {
    sides: Vec<u32>,
    /// Start of each vertex's group, and the end of the last.
    starts: Vec<u32>,
}

impl GroupedSides {
    fn new(range: &Range<u32>, triangles: &[[u32; 3]]) -> Self {
        let width = range.end.saturating_sub(range.start);
        // Counting sort: counts are stored two entries ahead, so that `starts[v + 1]` is the insertion
        // position of group v, and ends as the start of group v + 1.
        let mut starts = vec![0u32; width as usize + 2];
        for triangle in triangles {
            for corner in 0..3 {
                let place = side_ends(triangle, corner)[0].wrapping_sub(range.start);
                if place < width {
                    starts[place as usize + 2] += 1;
                }
            }
        }
        (0..width as usize).for_each(|v| starts[v + 2] += starts[v + 1]);
        let mut sides = vec![0u32; starts[width as usize + 1] as usize];
        for (t, triangle) in triangles.iter().enumerate() {
            for corner in 0..3 {
                let place = side_ends(triangle, corner)[0].wrapping_sub(range.start);
                if place < width {
                    let next = &mut starts[place as usize + 1];
                    sides[*next as usize] = (3 * t + corner) as u32;
                    *next += 1;
                }
            }
        }
        starts.pop();
        Self { sides, starts }
    }
}

/// Check whether two adjacent triangles have the same three vertices; true only for the first of the two
/// halfedges.
fn has_same_vertices(triangles: &[[u32; 3]], h: HalfedgeId, twin: HalfedgeId) -> bool {
    let across = |h: HalfedgeId| triangles.as_flattened()[Connectivity::prev(h).index()];
    twin.is_some() && h < twin && across(h) == across(twin)
}

/// Make the error for triangles with the same vertices.
fn same_vertices_error(triangles: &[[u32; 3]], halfedges: &[Halfedge]) -> KernelError {
    let mut doubled: Vec<[u32; 2]> = vec![];
    for (h, halfedge) in halfedges.iter().enumerate() {
        let (own, twin) = (HalfedgeId::from_index(h), halfedge.twin);
        if has_same_vertices(triangles, own, twin) {
            doubled.push([own, twin].map(|h| Connectivity::triangle(h).0));
        }
    }
    doubled.sort_unstable();
    doubled.dedup();
    KernelError::SameVertices(doubled)
}

/// Find an outgoing halfedge of each vertex (on a boundary the last one without a twin), and the number of
/// outgoing halfedges.
fn find_outgoing(threads: usize, vertex_count: usize, halfedges: &[Halfedge]) -> (Vec<HalfedgeId>, Vec<u32>) {
    let (mut outgoing, mut degree) = (vec![HalfedgeId::NONE; vertex_count], vec![0u32; vertex_count]);
    let part = vertex_count.div_ceil(threads.max(1)).max(1);
    let parts = outgoing.chunks_mut(part).zip(degree.chunks_mut(part)).enumerate().collect();
    parallel::for_each_part(parts, threads, |(number, (outgoing, degree))| {
        let first = (number * part) as u32;
        for (h, halfedge) in halfedges.iter().enumerate() {
            let place = halfedge.origin.0.wrapping_sub(first) as usize;
            if let Some(slot) = outgoing.get_mut(place) {
                if slot.is_none() || halfedge.twin.is_none() {
                    *slot = HalfedgeId::from_index(h);
                }
                degree[place] += 1;
            }
        }
    });
    (outgoing, degree)
}

impl Connectivity {
    /// Check that the fan of each vertex contains all its triangles.
    fn check_fans(
        &self,
        threads: usize,
        degree: &[u32],
        on_rim: impl Fn(VertexId) -> bool + Sync,
    ) -> Result<(), KernelError> {
        let is_pinched = |&v: &u32| {
            degree[v as usize] > 0
                && !on_rim(VertexId(v))
                && self.fan(VertexId(v)).count() != degree[v as usize] as usize
        };
        let pinched = parallel::map(
            degree.len().div_ceil(FAN_BATCH),
            threads,
            || (),
            |(), batch| {
                let vertices = batch * FAN_BATCH..degree.len().min((batch + 1) * FAN_BATCH);
                vertices.map(|v| v as u32).filter(is_pinched).collect::<Vec<u32>>()
            },
        )
        .concat();
        if pinched.is_empty() { Ok(()) } else { Err(KernelError::PinchedVertices(pinched)) }
    }
}
