//! Regions of a mesh: cutting them out of the whole, and joining them again.
//!
//! A region fits into the cache and is processed by one thread. Vertices shared with other regions form its
//! rim and do not move. The next partition has its rims elsewhere.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use crate::base::errors::KernelError;
use crate::base::ids::{EdgeId, HalfedgeId, VertexId};
use crate::base::parallel::{for_each_part, map};
use crate::collapse::engine::{Merge, Refusal, Refusals};
use crate::collapse::method_state::MethodState;
use crate::collapse::partition::Partition;
use crate::collapse::whole_mesh::{CornerRefusals, WholeMesh};
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::{Mesh, VertexLock};

const NO_REGION: u32 = u32::MAX;
/// Owner of a vertex that belongs to several regions.
pub const SHARED: u32 = u32::MAX - 1;

/// Find the region of each vertex, or [`SHARED`].
pub fn find_owners(
    vertices: usize,
    triangles: &[[u32; 3]],
    partition: &Partition,
    threads: usize,
) -> Vec<u32> {
    if partition.len() == 1 {
        return vec![0; vertices];
    }
    // In any thread order, a vertex of two regions ends up shared.
    let owner: Vec<AtomicU32> = (0..vertices).map(|_| AtomicU32::new(NO_REGION)).collect();
    let claim = |(): &mut (), p: usize| {
        for &v in partition.region(p).iter().flat_map(|&t| &triangles[t as usize]) {
            let slot = &owner[v as usize];
            let seen = slot.load(Relaxed);
            if seen == p as u32 || seen == SHARED {
                continue;
            }
            if seen != NO_REGION || slot.compare_exchange(NO_REGION, p as u32, Relaxed, Relaxed).is_err() {
                slot.store(SHARED, Relaxed);
            }
        }
    };
    map(partition.len(), threads, || (), claim);
    owner.into_iter().map(AtomicU32::into_inner).collect()
}

/// Local index of each vertex of the whole mesh, reused from region to region.
pub struct Scratch {
    local: Vec<u32>,
}

impl Scratch {
    pub fn new(vertices: usize) -> Self {
        Self { local: vec![NO_REGION; vertices] }
    }
}

impl<const D: usize, B: Copy> WholeMesh<D, B> {
    /// Cut out the mesh of a region, with the refusals of its edges.
    ///
    /// # Errors
    /// As [`Connectivity::from_region`], with vertex indices of the region.
    pub fn cut_region(
        &self,
        region: &[u32],
        rim: &[bool],
        scratch: &mut Scratch,
    ) -> Result<(Mesh<D>, Refusals<B>), KernelError> {
        // Triangles that are close in the input are usually close in memory.
        let mut triangle_source = region.to_vec();
        triangle_source.sort_unstable();
        let mut vertex_source: Vec<u32> = Vec::with_capacity(region.len() / 2 + 64);
        let mut triangles: Vec<[u32; 3]> = Vec::with_capacity(region.len());
        for &t in &triangle_source {
            triangles.push(self.triangles[t as usize].map(|v| {
                let local = &mut scratch.local[v as usize];
                if *local == NO_REGION {
                    *local = vertex_source.len() as u32;
                    vertex_source.push(v);
                }
                *local
            }));
        }
        for &v in &vertex_source {
            scratch.local[v as usize] = NO_REGION;
        }
        let is_rim = |v: VertexId| rim[vertex_source[v.index()] as usize];
        let connectivity = Connectivity::from_region(vertex_source.len(), &triangles, is_rim)?;
        let lock = |&v: &u32| match (rim[v as usize], self.locked.get(v as usize)) {
            (true, _) => VertexLock::Rim,
            (false, Some(true)) => VertexLock::Locked,
            _ => VertexLock::Free,
        };
        let mut refusals = vec![None; connectivity.edge_slots()];
        if !self.refused.is_empty() {
            for (local, &t) in triangle_source.iter().enumerate() {
                for corner in 0..3 {
                    let edge = connectivity.edge(HalfedgeId((3 * local + corner) as u32));
                    refusals[edge.index()] = self.refused[t as usize][corner];
                }
            }
        }
        let mesh = Mesh {
            points: vertex_source.iter().map(|&v| self.points[v as usize]).collect(),
            locks: vertex_source.iter().map(lock).collect(),
            triangle_source,
            vertex_source,
            connectivity,
        };
        Ok((mesh, refusals))
    }
}

/// A simplified region, ready to be joined.
pub struct SimplifiedRegion<const D: usize, B, R> {
    /// Vertices that are not on the rim.
    points: Vec<[f64; D]>,
    vertex_source: Vec<u32>,
    /// Empty if the whole mesh has no locked vertices.
    locked: Vec<bool>,
    /// Corners: a vertex on the rim as its index in the whole mesh plus `RIM_FLAG`, others as index in
    /// `points`.
    triangles: Vec<[u32; 3]>,
    triangle_source: Vec<u32>,
    refused: Vec<CornerRefusals<B>>,
    /// `None` once they are joined.
    records: Option<R>,
    /// In vertex indices of the whole mesh.
    pub merges: Vec<Merge>,
    survivor_points: Option<Vec<[f64; D]>>,
}

const RIM_FLAG: u32 = 1 << 31;

impl<const D: usize, B: Copy, R> SimplifiedRegion<D, B, R> {
    /// Take out the merges and the recorded positions of the survivors.
    ///
    /// `source` renumbers the vertices of the merges.
    pub fn take_merges(&mut self, source: &[u32]) -> (Vec<Merge>, Vec<[f64; D]>) {
        let mut merges = std::mem::take(&mut self.merges);
        for vertex in merges.iter_mut().flat_map(|m| [&mut m.removed, &mut m.survivor]) {
            *vertex = VertexId(source[vertex.index()]);
        }
        let mut path = self.survivor_points.take().unwrap_or_default();
        path.shrink_to_fit();
        (merges, path)
    }

    /// Number of remaining triangles.
    pub fn triangles(&self) -> usize {
        self.triangles.len()
    }

    /// Extract the result of a simplified region of `whole_mesh`.
    pub fn new(
        mesh: &Mesh<D>,
        whole: &WholeMesh<D, B>,
        refusal: impl Fn(EdgeId) -> Option<Refusal<B>>,
        merges: &[Merge],
        path: Option<Vec<[f64; D]>>,
        records: R,
    ) -> Self {
        let connectivity = &mesh.connectivity;
        let inside = connectivity.vertices().filter(|&v| mesh.lock(v) != VertexLock::Rim).count();
        let mut number = vec![0; connectivity.vertex_slots()];
        let mut points = Vec::with_capacity(inside);
        let mut vertex_source = Vec::with_capacity(inside);
        let mut locked = Vec::with_capacity(if whole.locked.is_empty() { 0 } else { inside });
        for v in connectivity.vertices() {
            let here = mesh.vertex_source[v.index()];
            if mesh.lock(v) == VertexLock::Rim {
                number[v.index()] = here | RIM_FLAG;
            } else {
                number[v.index()] = points.len() as u32;
                points.push(*mesh.point(v));
                vertex_source.push(whole.vertex_source[here as usize]);
                locked.extend(whole.locked.get(here as usize));
            }
        }
        let left = connectivity.triangle_count();
        let mut triangles = Vec::with_capacity(left);
        let mut triangle_source = Vec::with_capacity(left);
        let mut refused = Vec::with_capacity(left);
        for t in connectivity.triangles() {
            triangles.push(connectivity.corners(t).map(|v| number[v.index()]));
            triangle_source.push(whole.triangle_source[mesh.triangle_source[t.index()] as usize]);
            refused.push(std::array::from_fn(|corner| {
                refusal(connectivity.edge(HalfedgeId(3 * t.0 + corner as u32)))
            }));
        }
        let here = |v: VertexId| VertexId(mesh.vertex_source[v.index()]);
        let merges = merges
            .iter()
            .map(|m| Merge { removed: here(m.removed), survivor: here(m.survivor), ..*m })
            .collect();
        let records = Some(records);
        Self {
            points,
            vertex_source,
            locked,
            triangles,
            triangle_source,
            refused,
            records,
            merges,
            survivor_points: path,
        }
    }
}

impl<const D: usize, B: Copy> WholeMesh<D, B> {
    /// Test if no edge of a region can collapse: each is refused or has an end on the rim.
    pub fn is_idle(&self, region: &[u32], rim: &[bool]) -> bool {
        let is_open = |t: usize, side: usize| {
            let ends = [side, (side + 1) % 3].map(|corner| self.triangles[t][corner] as usize);
            self.refused[t][side].is_none() && !rim[ends[0]] && !rim[ends[1]]
        };
        !self.refused.is_empty() && !region.iter().any(|&t| (0..3).any(|side| is_open(t as usize, side)))
    }

    /// Compute the result of a region without collapses.
    ///
    /// It has the same order as if the region had been cut out. `None` if its records have to be loaded.
    pub fn unchanged_region<R: MethodState<D>>(
        &self,
        region: &[u32],
        rim: &[bool],
        records: &R,
        scratch: &mut Scratch,
    ) -> Option<SimplifiedRegion<D, B, R::RegionState>> {
        let mut of = region.to_vec();
        of.sort_unstable();
        let mut inside: Vec<u32> = vec![];
        let mut number = |v: u32| {
            let local = &mut scratch.local[v as usize];
            if rim[v as usize] {
                return v | RIM_FLAG;
            }
            if *local == NO_REGION {
                *local = inside.len() as u32;
                inside.push(v);
            }
            *local
        };
        let triangles = of.iter().map(|&t| self.triangles[t as usize].map(&mut number)).collect();
        inside.iter().for_each(|&v| scratch.local[v as usize] = NO_REGION);
        let locked = if self.locked.is_empty() { &[][..] } else { &inside };
        Some(SimplifiedRegion {
            points: inside.iter().map(|&v| self.points[v as usize]).collect(),
            vertex_source: inside.iter().map(|&v| self.vertex_source[v as usize]).collect(),
            locked: locked.iter().map(|&v| self.locked[v as usize]).collect(),
            triangles,
            triangle_source: of.iter().map(|&t| self.triangle_source[t as usize]).collect(),
            refused: of.iter().map(|&t| self.refused[t as usize]).collect(),
            records: Some(records.unchanged_region(&of, &inside)?),
            merges: vec![],
            survivor_points: None,
        })
    }
}

/// Slices of the next whole mesh for one region.
struct RegionSlices<'a, const D: usize, B> {
    /// Index of its first vertex.
    first: u32,
    points: &'a mut [[f64; D]],
    vertex_source: &'a mut [u32],
    locked: &'a mut [bool],
    triangles: &'a mut [[u32; 3]],
    triangle_source: &'a mut [u32],
    refused: &'a mut [CornerRefusals<B>],
}

impl<const D: usize, B: Copy> RegionSlices<'_, D, B> {
    fn copy_from<R>(self, left: SimplifiedRegion<D, B, R>, rim_number: &[u32]) {
        self.points.copy_from_slice(&left.points);
        self.vertex_source.copy_from_slice(&left.vertex_source);
        self.locked.copy_from_slice(&left.locked);
        self.triangle_source.copy_from_slice(&left.triangle_source);
        self.refused.copy_from_slice(&left.refused);
        let number = |v: u32| {
            if v & RIM_FLAG != 0 { rim_number[(v & !RIM_FLAG) as usize] } else { self.first + v }
        };
        for (corners, own) in self.triangles.iter_mut().zip(&left.triangles) {
            *corners = own.map(number);
        }
    }
}

impl<const D: usize, B: Copy + Send> WholeMesh<D, B> {
    /// Join all regions in the memory of this mesh, which is never smaller. Vertices of the rim come first.
    pub fn join_regions<R: MethodState<D>>(
        mut self,
        rim: &[bool],
        records: R,
        mut remains: Vec<SimplifiedRegion<D, B, R::RegionState>>,
        threads: usize,
    ) -> (Self, R) {
        let rim_vertices: Vec<u32> = (0..rim.len() as u32).filter(|&v| rim[v as usize]).collect();
        let mut rim_number = vec![NO_REGION; rim.len()];
        for (number, &v) in (0..).zip(&rim_vertices) {
            rim_number[v as usize] = number;
            // An index is never larger than the one it replaces, so moving in place is safe.
            let (number, v) = (number as usize, v as usize);
            self.points[number] = self.points[v];
            self.vertex_source[number] = self.vertex_source[v];
            if !self.locked.is_empty() {
                self.locked[number] = self.locked[v];
            }
        }
        let vertices = rim_vertices.len() + remains.iter().map(|p| p.points.len()).sum::<usize>();
        let triangles = remains.iter().map(|p| p.triangles.len()).sum();
        truncate_and_release(&mut self.points, vertices);
        truncate_and_release(&mut self.vertex_source, vertices);
        truncate_and_release(&mut self.locked, vertices);
        truncate_and_release(&mut self.triangles, triangles);
        truncate_and_release(&mut self.triangle_source, triangles);
        self.refused.resize(triangles, [None; 3]);
        let kept = remains.iter_mut().filter_map(|left| left.records.take()).collect();
        let places = self.split_into_slices(rim_vertices.len(), &remains);
        let parts: Vec<_> = places.into_iter().zip(remains).collect();
        for_each_part(parts, threads, |(place, left)| place.copy_from(left, &rim_number));
        let records = records.join_regions(&rim_vertices, kept);
        (self, records)
    }

    /// Divide the arrays into consecutive slices, after the vertices of the rim.
    fn split_into_slices<R>(
        &mut self,
        rim: usize,
        remains: &[SimplifiedRegion<D, B, R>],
    ) -> Vec<RegionSlices<'_, D, B>> {
        let mut points = &mut self.points[rim..];
        let mut vertex_source = &mut self.vertex_source[rim..];
        let mut locked = if self.locked.is_empty() { &mut [][..] } else { &mut self.locked[rim..] };
        let mut triangles = &mut self.triangles[..];
        let mut triangle_source = &mut self.triangle_source[..];
        let mut refused = &mut self.refused[..];
        let mut first = rim as u32;
        let mut places = Vec::with_capacity(remains.len());
        for left in remains {
            let (vertices, count) = (left.points.len(), left.triangles.len());
            places.push(RegionSlices {
                first,
                points: split_off(&mut points, vertices),
                vertex_source: split_off(&mut vertex_source, vertices),
                locked: split_off(&mut locked, left.locked.len()),
                triangles: split_off(&mut triangles, count),
                triangle_source: split_off(&mut triangle_source, count),
                refused: split_off(&mut refused, count),
            });
            first += vertices as u32;
        }
        places
    }
}

/// Truncate, and release the memory of the rest.
fn truncate_and_release<T>(values: &mut Vec<T>, length: usize) {
    values.truncate(length);
    values.shrink_to_fit();
}

/// Split off the first `count` elements of `rest`.
fn split_off<'a, T>(rest: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let (first, others) = std::mem::take(rest).split_at_mut(count);
    *rest = others;
    first
}
