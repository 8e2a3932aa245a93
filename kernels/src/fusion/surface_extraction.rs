//! Extraction of the zero surface by marching cubes (Lorensen and Cline 1987), with shared vertices.
//!
//! A voxel owns the three edges that start at it in the positive directions; a block owns the edges and cubes
//! of its voxels. The vertices and triangles of a block depend only on voxels at most one away from its own.
//! A field processed in bricks, each with a rim of one block, therefore gives the same surface to the bit as
//! the whole field.
//!
//! At the border of the field, cubes around an edge may be missing. If the two remaining cubes touch only in
//! this edge, each gets a separate vertex, so that no vertex joins two fans of triangles.

use std::collections::HashMap;

use super::block_order;
use super::cube_table::{CORNER_COUNT, CUBE_TABLE, EDGE_CORNERS};
use super::distance_field::{BLOCK_SIDE, BLOCK_VOXELS, DistanceField, VoxelSample};
use crate::base::errors::KernelError;
use crate::base::parallel;
use crate::base::progress::Progress;

/// Side of the cube of voxel values that a block's edges and cubes depend on: the block, and one voxel on
/// each side.
const PADDED_SIDE: usize = BLOCK_SIDE + 2;
const PADDED_VOXELS: usize = PADDED_SIDE * PADDED_SIDE * PADDED_SIDE;
/// Index difference from a voxel to the next along each axis.
const AXIS_STRIDES: [usize; 3] = [1, PADDED_SIDE, PADDED_SIDE * PADDED_SIDE];
/// Number of edge codes of a block. The second vertices of edges have codes from here on.
const EDGE_CODES: usize = 3 * BLOCK_VOXELS;
/// Minimum distance of a vertex from both ends of its edge, in edge lengths. Coincident vertices at a voxel
/// would give triangles without area.
const MIN_EDGE_FRACTION: f64 = 1e-3;
/// Blocks that a thread processes at a time.
const BLOCKS_PER_CHUNK: usize = 64;
const NONE: u32 = u32::MAX;

/// Key of a vertex: its block, and the edge code voxel × 3 + axis, plus 1536 for the second vertex of an
/// edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct EdgeKey {
    /// Z-order key of the block.
    pub block: u64,
    pub code: u16,
}

/// Box of blocks: `low` inclusive, `high` exclusive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockBox {
    pub low: [i32; 3],
    pub high: [i32; 3],
}

impl BlockBox {
    /// Check whether a block is inside the box.
    pub fn contains(&self, block: [i32; 3]) -> bool {
        (0..3).all(|k| self.low[k] <= block[k] && block[k] < self.high[k])
    }
}

/// Surface mesh of a field, or of one brick of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExtractedSurface {
    /// Positions in voxels.
    pub positions: Vec<[f64; 3]>,
    pub samples: Vec<VoxelSample>,
    /// Vertex indices. Indices ≥ `positions.len()` refer to `foreign`.
    pub triangles: Vec<[u32; 3]>,
    /// Vertices that belong to other bricks.
    pub foreign: Vec<EdgeKey>,
    /// Vertices on the lower faces of the brick, which other bricks may refer to, with their indices.
    pub shared: Vec<(EdgeKey, u32)>,
}

/// Extract the surface through voxels observed by at least `least` frames.
///
/// With `own`, extract only the surface in this box of blocks; the field must also contain the adjacent
/// blocks. Vertices and triangles follow the Z-order of the blocks.
///
/// # Errors
/// [`KernelError::TooManyTriangles`] if the vertices or triangles exceed 2³¹ − 1. As [`Progress::check`].
pub fn extract_surface<F: DistanceField>(
    field: &F,
    least: u32,
    own: Option<BlockBox>,
    threads: usize,
    progress: &Progress<'_>,
) -> Result<ExtractedSurface, KernelError> {
    let blocks = BlockNeighbours::new(field, least, own, threads);
    progress.check()?;
    let is_own = |slot: usize| own.is_none_or(|own| own.contains(field.block_coordinates(slot)));

    let chunks = blocks.order.len().div_ceil(BLOCKS_PER_CHUNK);
    let chunk = |number: usize| {
        &blocks.order[number * BLOCKS_PER_CHUNK..blocks.order.len().min((number + 1) * BLOCKS_PER_CHUNK)]
    };
    let found = parallel::map(chunks, threads, PaddedBlock::default, |around, number| {
        let mut found = VertexChunk::default();
        if progress.check().is_err() {
            return found;
        }
        for &slot in chunk(number) {
            let slot = slot as usize;
            if !blocks.may_contain_surface(slot) {
                continue;
            }
            blocks.copy_padded(field, slot, least, around);
            found.add(&blocks, field, slot, around, is_own(slot));
        }
        found
    });
    progress.check()?;

    let mut cut: Vec<CutEdges> = vec![];
    let mut of_slot = vec![NONE; field.block_count()];
    let (mut positions, mut samples) = (vec![], vec![]);
    for mut vertices in found {
        for mut one in vertices.cut.drain(..) {
            one.first_vertex += positions.len();
            of_slot[one.slot] = cut.len() as u32;
            cut.push(one);
        }
        positions.append(&mut vertices.positions);
        samples.append(&mut vertices.samples);
    }
    check_index_limit(positions.len())?;

    let pieces = parallel::map(chunks, threads, PaddedBlock::default, |around, number| {
        let mut piece = TriangleChunk::default();
        if progress.check().is_err() {
            return piece;
        }
        for &slot in chunk(number) {
            let slot = slot as usize;
            if is_own(slot) && blocks.may_contain_surface(slot) {
                blocks.copy_padded(field, slot, least, around);
                piece.add(&blocks, slot, around, |slot, code, fan| {
                    let of = &cut[of_slot[slot] as usize];
                    if is_own(slot) { Ok(of.vertex_index(code, fan)) } else { Err(of.key(field, code, fan)) }
                });
            }
        }
        piece
    });
    progress.check()?;

    let mut foreign: Vec<EdgeKey> = pieces.iter().flat_map(|piece| piece.foreign.iter().copied()).collect();
    foreign.sort_unstable();
    foreign.dedup();
    let mut triangles = Vec::with_capacity(pieces.iter().map(|piece| piece.triangles.len()).sum());
    check_index_limit(triangles.capacity().max(positions.len() + foreign.len()))?;
    for piece in pieces {
        triangles.extend(piece.triangles.iter().map(|triangle| {
            triangle.map(|corner| match corner {
                TriangleCorner::Own(number) => number,
                TriangleCorner::Foreign(key) => {
                    let place = foreign.partition_point(|k| *k < piece.foreign[key as usize]);
                    (positions.len() + place) as u32
                }
            })
        }));
    }
    let shared = own.map_or(vec![], |own| vertices_on_lower_faces(field, &cut, own));
    Ok(ExtractedSurface { positions, samples, triangles, foreign, shared })
}

fn check_index_limit(count: usize) -> Result<(), KernelError> {
    let limit = i32::MAX as usize;
    if count > limit { Err(KernelError::TooManyTriangles { wanted: count as f64, limit }) } else { Ok(()) }
}

/// List the vertices on the lower faces of a box, sorted by key.
fn vertices_on_lower_faces<F: DistanceField>(
    field: &F,
    cut: &[CutEdges],
    own: BlockBox,
) -> Vec<(EdgeKey, u32)> {
    let mut found = vec![];
    for one in cut {
        let block = field.block_coordinates(one.slot);
        if !own.contains(block) || (0..3).all(|k| block[k] != own.low[k]) {
            continue;
        }
        for code in (0..EDGE_CODES).filter(|&code| one.has_vertex(code)) {
            let voxel = voxel_position(code / 3);
            if (0..3).any(|k| block[k] == own.low[k] && voxel[k] == 0) {
                for fan in 0..=usize::from(one.second_rank(code).is_some()) {
                    found.push((one.key(field, code, fan), one.vertex_index(code, fan)));
                }
            }
        }
    }
    found.sort_unstable();
    found
}

/// Compute the position of a voxel in its block.
fn voxel_position(voxel: usize) -> [usize; 3] {
    [voxel % BLOCK_SIDE, voxel / BLOCK_SIDE % BLOCK_SIDE, voxel / (BLOCK_SIDE * BLOCK_SIDE)]
}

fn voxel_index([x, y, z]: [usize; 3]) -> usize {
    (z * BLOCK_SIDE + y) * BLOCK_SIDE + x
}

/// Blocks of a field and their neighbours.
struct BlockNeighbours {
    /// Slots in Z-order.
    order: Vec<u32>,
    /// Slots of the 27 neighbours of each block, x fastest, the block itself at index 13.
    neighbours: Vec<[u32; 27]>,
    /// Bit 0: some voxels are in front of the surface; bit 1: some are behind it.
    sides: Vec<u8>,
}

impl BlockNeighbours {
    /// Index all blocks of a field, or the blocks of a box and those adjacent to it.
    fn new<F: DistanceField>(field: &F, least: u32, own: Option<BlockBox>, threads: usize) -> Self {
        let count = field.block_count();
        let near = own.map(|own| BlockBox { low: own.low.map(|c| c - 1), high: own.high.map(|c| c + 1) });
        let is_near = |slot: usize| near.is_none_or(|near| near.contains(field.block_coordinates(slot)));
        let mut order: Vec<u32> = (0..count as u32).filter(|&slot| is_near(slot as usize)).collect();
        order.sort_unstable_by_key(|&slot| block_order::block_key(field.block_coordinates(slot as usize)));
        let slots: HashMap<[i32; 3], u32> =
            order.iter().map(|&slot| (field.block_coordinates(slot as usize), slot)).collect();
        let sides = parallel::collect(count, threads, |slot| {
            if !is_near(slot) {
                return 0;
            }
            let mut values = [f32::NAN; BLOCK_VOXELS];
            field.distances(slot, least, &mut values);
            let (before, behind) = values
                .iter()
                .fold((false, false), |(before, behind), &d| (before | (d >= 0.0), behind | (d < 0.0)));
            u8::from(before) | u8::from(behind) << 1
        });
        let beside = parallel::collect(count, threads, |slot| {
            let block = field.block_coordinates(slot);
            let mut found = [NONE; 27];
            // Blocks without known voxels contain no surface.
            if sides[slot] != 0 {
                for (i, found) in found.iter_mut().enumerate() {
                    let other = std::array::from_fn(|k| block[k] + neighbour_offset(i)[k]);
                    *found = slots.get(&other).copied().unwrap_or(NONE);
                }
            }
            found
        });
        Self { order, neighbours: beside, sides }
    }

    /// Check whether the surface may pass through the cubes of a block.
    fn may_contain_surface(&self, slot: usize) -> bool {
        let upper = [13, 14, 16, 17, 22, 23, 25, 26];
        let sides = upper
            .iter()
            .map(|&i| self.neighbours[slot][i])
            .filter(|&slot| slot != NONE)
            .fold(0, |sides, slot| sides | self.sides[slot as usize]);
        sides == 3
    }

    /// Copy the distances of a block and its one-voxel border.
    fn copy_padded<F: DistanceField>(&self, field: &F, slot: usize, least: u32, into: &mut PaddedBlock) {
        let PaddedBlock { values, inside, known } = into;
        field.distances(slot, least, inside);
        for (row, given) in inside.chunks_exact(BLOCK_SIDE).enumerate() {
            let start = ((row / BLOCK_SIDE + 1) * PADDED_SIDE + row % BLOCK_SIDE + 1) * PADDED_SIDE + 1;
            values[start..start + BLOCK_SIDE].copy_from_slice(given);
        }
        // Positions along an axis that a neighbour's values fill, and the first of the neighbour's voxels.
        let span = |offset: i32| match offset {
            -1 => (0..1, BLOCK_SIDE - 1),
            0 => (1..BLOCK_SIDE + 1, 0),
            _ => (BLOCK_SIDE + 1..PADDED_SIDE, 0),
        };
        for (i, &other) in self.neighbours[slot].iter().enumerate().filter(|&(i, _)| i != 13) {
            let [(xs, x0), (ys, y0), (zs, z0)] = neighbour_offset(i).map(span);
            for (dz, z) in zs.enumerate() {
                for (dy, y) in ys.clone().enumerate() {
                    for (dx, x) in xs.clone().enumerate() {
                        values[(z * PADDED_SIDE + y) * PADDED_SIDE + x] = if other == NONE {
                            f32::NAN
                        } else {
                            field.distance(other as usize, voxel_index([x0 + dx, y0 + dy, z0 + dz]), least)
                        };
                    }
                }
            }
        }
        // Cubes whose eight values are known, by their lowest corner.
        for (known, value) in known.iter_mut().zip(values.iter()) {
            *known = !value.is_nan();
        }
        for step in AXIS_STRIDES {
            for i in 0..PADDED_VOXELS - step {
                known[i] &= known[i + step];
            }
        }
    }
}

/// Return the offset of neighbour `i` of 27.
fn neighbour_offset(i: usize) -> [i32; 3] {
    [i % 3, i / 3 % 3, i / 9].map(|c| c as i32 - 1)
}

/// Values that a block's surface depends on.
struct PaddedBlock {
    values: [f32; PADDED_VOXELS],
    inside: [f32; BLOCK_VOXELS],
    known: [bool; PADDED_VOXELS],
}

impl Default for PaddedBlock {
    fn default() -> Self {
        Self {
            values: [f32::NAN; PADDED_VOXELS],
            inside: [f32::NAN; BLOCK_VOXELS],
            known: [false; PADDED_VOXELS],
        }
    }
}

impl PaddedBlock {
    /// Return the complete cubes among the four around an edge, as bits in their order around it.
    fn known_cubes_around_edge(&self, at: usize, axis: usize) -> u8 {
        let (u, v) = (AXIS_STRIDES[(axis + 1) % 3], AXIS_STRIDES[(axis + 2) % 3]);
        let whole = [at, at - u, at - u - v, at - v].map(|cube| u8::from(self.known[cube]));
        whole[0] | whole[1] << 1 | whole[2] << 2 | whole[3] << 3
    }
}

/// Return the position of a cube in the order around one of its edges.
fn cube_rank_around_edge(edge: usize) -> usize {
    let (axis, lower) = EDGE_CORNERS[edge];
    let (u, v) = (lower >> ((axis + 1) % 3) & 1, lower >> ((axis + 2) % 3) & 1);
    [0, 1, 3, 2][u | v << 1]
}

/// Edges of a block that have a vertex.
struct CutEdges {
    slot: usize,
    /// Index of the block's first vertex.
    first_vertex: usize,
    edges: [u64; EDGE_CODES / 64],
    /// Number of set bits before each word of `edges`.
    before: [u16; EDGE_CODES / 64],
    count: usize,
    /// Edges with a second vertex; second vertices follow all first ones.
    second_vertices: Vec<u16>,
}

impl CutEdges {
    fn has_vertex(&self, code: usize) -> bool {
        self.edges[code / 64] >> (code % 64) & 1 == 1
    }

    fn second_rank(&self, code: usize) -> Option<usize> {
        self.second_vertices.binary_search(&(code as u16)).ok()
    }

    /// Return the edge code, and the rank of the second vertex if the cube's fan uses one.
    fn vertex(&self, code: usize, fan: usize) -> (usize, Option<usize>) {
        (code, if fan == 1 { self.second_rank(code) } else { None })
    }

    fn vertex_index(&self, code: usize, fan: usize) -> u32 {
        let local = match self.vertex(code, fan) {
            (_, Some(second)) => self.count + second,
            (code, None) => {
                let below = self.edges[code / 64] & ((1 << (code % 64)) - 1);
                usize::from(self.before[code / 64]) + below.count_ones() as usize
            }
        };
        (self.first_vertex + local) as u32
    }

    fn key<F: DistanceField>(&self, field: &F, code: usize, fan: usize) -> EdgeKey {
        let second = self.vertex(code, fan).1.map_or(0, |_| EDGE_CODES);
        EdgeKey {
            block: block_order::block_key(field.block_coordinates(self.slot)),
            code: (code + second) as u16,
        }
    }
}

/// Vertices of some blocks.
#[derive(Default)]
struct VertexChunk {
    cut: Vec<CutEdges>,
    positions: Vec<[f64; 3]>,
    samples: Vec<VoxelSample>,
}

impl VertexChunk {
    /// Find the edges of a block that have a vertex; also compute the positions if the block is owned.
    fn add<F: DistanceField>(
        &mut self,
        blocks: &BlockNeighbours,
        field: &F,
        slot: usize,
        around: &PaddedBlock,
        is_own: bool,
    ) {
        let mut cut = CutEdges {
            slot,
            first_vertex: self.positions.len(),
            edges: [0; EDGE_CODES / 64],
            before: [0; EDGE_CODES / 64],
            count: 0,
            second_vertices: vec![],
        };
        let origin = field.block_coordinates(slot).map(|c| i64::from(c) * BLOCK_SIDE as i64);
        for v in 0..BLOCK_VOXELS {
            let [x, y, z] = voxel_position(v);
            let at = ((z + 1) * PADDED_SIDE + y + 1) * PADDED_SIDE + x + 1;
            let here = around.values[at];
            for axis in 0..3 {
                let there = around.values[at + AXIS_STRIDES[axis]];
                let is_cut = (here < 0.0 && there >= 0.0) || (here >= 0.0 && there < 0.0);
                if !is_cut {
                    continue;
                }
                let cubes = around.known_cubes_around_edge(at, axis);
                if cubes == 0 {
                    continue;
                }
                let code = 3 * v + axis;
                cut.edges[code / 64] |= 1 << (code % 64);
                if cubes == 0b0101 || cubes == 0b1010 {
                    cut.second_vertices.push(code as u16);
                }
                if is_own {
                    let share = f64::from(here) / (f64::from(here) - f64::from(there));
                    let share = share.clamp(MIN_EDGE_FRACTION, 1.0 - MIN_EDGE_FRACTION);
                    let mut position = [x, y, z].map(|c| c as i64);
                    for k in 0..3 {
                        position[k] += origin[k];
                    }
                    let mut position = position.map(|c| c as f64);
                    position[axis] += share;
                    self.positions.push(position);
                    let next = blocks.next_voxel(slot, [x, y, z], axis);
                    let (a, b) = (field.sample(slot, v), field.sample(next.0, next.1));
                    self.samples.push(VoxelSample::interpolate(a, b, share as f32));
                }
            }
        }
        let mut count = 0;
        for (before, edges) in cut.before.iter_mut().zip(cut.edges) {
            *before = count as u16;
            count += edges.count_ones() as usize;
        }
        if count == 0 {
            return;
        }
        cut.count = count;
        if is_own {
            for &code in &cut.second_vertices {
                let first = cut.vertex_index(usize::from(code), 0) as usize;
                self.positions.push(self.positions[first]);
                self.samples.push(self.samples[first]);
            }
        }
        self.cut.push(cut);
    }
}

impl BlockNeighbours {
    /// Return the block and index of the next voxel along an axis.
    fn next_voxel(&self, slot: usize, mut at: [usize; 3], axis: usize) -> (usize, usize) {
        at[axis] += 1;
        if at[axis] < BLOCK_SIDE {
            return (slot, voxel_index(at));
        }
        at[axis] = 0;
        (self.neighbours[slot][13 + [1, 3, 9][axis]] as usize, voxel_index(at))
    }
}

#[derive(Clone, Copy)]
enum TriangleCorner {
    Own(u32),
    /// Index into the foreign vertices of the chunk.
    Foreign(u32),
}

/// Triangles of some blocks.
#[derive(Default)]
struct TriangleChunk {
    triangles: Vec<[TriangleCorner; 3]>,
    foreign: Vec<EdgeKey>,
}

impl TriangleChunk {
    /// Add the triangles of a block. `vertex` returns the vertex of a block's edge for a fan.
    fn add(
        &mut self,
        blocks: &BlockNeighbours,
        slot: usize,
        around: &PaddedBlock,
        vertex: impl Fn(usize, usize, usize) -> Result<u32, EdgeKey>,
    ) {
        for v in 0..BLOCK_VOXELS {
            let [x, y, z] = voxel_position(v);
            let at = ((z + 1) * PADDED_SIDE + y + 1) * PADDED_SIDE + x + 1;
            if !around.known[at] {
                continue;
            }
            let behind = (0..CORNER_COUNT).fold(0_u8, |behind, c| {
                let corner = at
                    + (c & 1) * AXIS_STRIDES[0]
                    + (c >> 1 & 1) * AXIS_STRIDES[1]
                    + (c >> 2) * AXIS_STRIDES[2];
                behind | u8::from(around.values[corner] < 0.0) << c
            });
            for triangle in CUBE_TABLE.triangles(behind) {
                let corners = triangle.map(|edge| {
                    let (axis, lower) = EDGE_CORNERS[usize::from(edge)];
                    let of = [x + (lower & 1), y + (lower >> 1 & 1), z + (lower >> 2)];
                    let beside = 13 + of[0] / BLOCK_SIDE + of[1] / BLOCK_SIDE * 3 + of[2] / BLOCK_SIDE * 9;
                    let code = 3 * voxel_index(of.map(|c| c % BLOCK_SIDE)) + axis;
                    // If two cubes touch only in this edge, the first in the order uses the first vertex.
                    let fan = cube_rank_around_edge(usize::from(edge)) / 2;
                    match vertex(blocks.neighbours[slot][beside] as usize, code, fan) {
                        Ok(number) => TriangleCorner::Own(number),
                        Err(key) => {
                            self.foreign.push(key);
                            TriangleCorner::Foreign(self.foreign.len() as u32 - 1)
                        }
                    }
                });
                self.triangles.push(corners);
            }
        }
    }
}

#[cfg(test)]
mod tests;
