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

use super::cubes::{CORNERS, CUBES, EDGE};
use super::field::{Field, SIDE, Sample, VOXELS};
use super::order;
use crate::base::errors::KernelError;
use crate::base::parallel;
use crate::base::progress::Progress;

/// Side of the cube of voxel values that a block's edges and cubes depend on: the block, and one voxel on
/// each side.
const WIDE: usize = SIDE + 2;
const AROUND: usize = WIDE * WIDE * WIDE;
/// Index difference from a voxel to the next along each axis.
const STEP: [usize; 3] = [1, WIDE, WIDE * WIDE];
/// Number of edge codes of a block. The second vertices of edges have codes from here on.
const CODES: usize = 3 * VOXELS;
/// Minimum distance of a vertex from both ends of its edge, in edge lengths. Coincident vertices at a voxel
/// would give triangles without area.
const LEAST_SHARE: f64 = 1e-3;
/// Blocks that a thread processes at a time.
const CHUNK: usize = 64;
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
pub struct Surface {
    /// Positions in voxels.
    pub positions: Vec<[f64; 3]>,
    pub samples: Vec<Sample>,
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
pub fn surface<F: Field>(
    field: &F,
    least: u32,
    own: Option<BlockBox>,
    threads: usize,
    progress: &Progress<'_>,
) -> Result<Surface, KernelError> {
    let blocks = Blocks::new(field, least, own, threads);
    progress.check()?;
    let is_own = |slot: usize| own.is_none_or(|own| own.contains(field.block(slot)));

    let chunks = blocks.order.len().div_ceil(CHUNK);
    let chunk = |number: usize| &blocks.order[number * CHUNK..blocks.order.len().min((number + 1) * CHUNK)];
    let found = parallel::map(chunks, threads, Around::default, |around, number| {
        let mut found = Vertices::default();
        if progress.check().is_err() {
            return found;
        }
        for &slot in chunk(number) {
            let slot = slot as usize;
            if !blocks.may_cross(slot) {
                continue;
            }
            blocks.around(field, slot, least, around);
            found.add(&blocks, field, slot, around, is_own(slot));
        }
        found
    });
    progress.check()?;

    let mut cut: Vec<Cut> = vec![];
    let mut of_slot = vec![NONE; field.count()];
    let (mut positions, mut samples) = (vec![], vec![]);
    for mut vertices in found {
        for mut one in vertices.cut.drain(..) {
            one.first += positions.len();
            of_slot[one.slot] = cut.len() as u32;
            cut.push(one);
        }
        positions.append(&mut vertices.positions);
        samples.append(&mut vertices.samples);
    }
    few_enough(positions.len())?;

    let pieces = parallel::map(chunks, threads, Around::default, |around, number| {
        let mut piece = Triangles::default();
        if progress.check().is_err() {
            return piece;
        }
        for &slot in chunk(number) {
            let slot = slot as usize;
            if is_own(slot) && blocks.may_cross(slot) {
                blocks.around(field, slot, least, around);
                piece.add(&blocks, slot, around, |slot, code, fan| {
                    let of = &cut[of_slot[slot] as usize];
                    if is_own(slot) { Ok(of.number(code, fan)) } else { Err(of.key(field, code, fan)) }
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
    few_enough(triangles.capacity().max(positions.len() + foreign.len()))?;
    for piece in pieces {
        triangles.extend(piece.triangles.iter().map(|triangle| {
            triangle.map(|corner| match corner {
                Corner::Own(number) => number,
                Corner::Foreign(key) => {
                    let place = foreign.partition_point(|k| *k < piece.foreign[key as usize]);
                    (positions.len() + place) as u32
                }
            })
        }));
    }
    let shared = own.map_or(vec![], |own| shared(field, &cut, own));
    Ok(Surface { positions, samples, triangles, foreign, shared })
}

fn few_enough(count: usize) -> Result<(), KernelError> {
    let limit = i32::MAX as usize;
    if count > limit { Err(KernelError::TooManyTriangles { wanted: count as f64, limit }) } else { Ok(()) }
}

/// List the vertices on the lower faces of a box, sorted by key.
fn shared<F: Field>(field: &F, cut: &[Cut], own: BlockBox) -> Vec<(EdgeKey, u32)> {
    let mut found = vec![];
    for one in cut {
        let block = field.block(one.slot);
        if !own.contains(block) || (0..3).all(|k| block[k] != own.low[k]) {
            continue;
        }
        for code in (0..CODES).filter(|&code| one.has(code)) {
            let voxel = place(code / 3);
            if (0..3).any(|k| block[k] == own.low[k] && voxel[k] == 0) {
                for fan in 0..=usize::from(one.second(code).is_some()) {
                    found.push((one.key(field, code, fan), one.number(code, fan)));
                }
            }
        }
    }
    found.sort_unstable();
    found
}

/// Compute the position of a voxel in its block.
fn place(voxel: usize) -> [usize; 3] {
    [voxel % SIDE, voxel / SIDE % SIDE, voxel / (SIDE * SIDE)]
}

fn voxel([x, y, z]: [usize; 3]) -> usize {
    (z * SIDE + y) * SIDE + x
}

/// Blocks of a field and their neighbours.
struct Blocks {
    /// Slots in Z-order.
    order: Vec<u32>,
    /// Slots of the 27 neighbours of each block, x fastest, the block itself at index 13.
    beside: Vec<[u32; 27]>,
    /// Bit 0: some voxels are in front of the surface; bit 1: some are behind it.
    sides: Vec<u8>,
}

impl Blocks {
    /// Index all blocks of a field, or the blocks of a box and those adjacent to it.
    fn new<F: Field>(field: &F, least: u32, own: Option<BlockBox>, threads: usize) -> Self {
        let count = field.count();
        let near = own.map(|own| BlockBox { low: own.low.map(|c| c - 1), high: own.high.map(|c| c + 1) });
        let is_near = |slot: usize| near.is_none_or(|near| near.contains(field.block(slot)));
        let mut order: Vec<u32> = (0..count as u32).filter(|&slot| is_near(slot as usize)).collect();
        order.sort_unstable_by_key(|&slot| order::key(field.block(slot as usize)));
        let slots: HashMap<[i32; 3], u32> =
            order.iter().map(|&slot| (field.block(slot as usize), slot)).collect();
        let sides = parallel::collect(count, threads, |slot| {
            if !is_near(slot) {
                return 0;
            }
            let mut values = [f32::NAN; VOXELS];
            field.distances(slot, least, &mut values);
            let (before, behind) = values
                .iter()
                .fold((false, false), |(before, behind), &d| (before | (d >= 0.0), behind | (d < 0.0)));
            u8::from(before) | u8::from(behind) << 1
        });
        let beside = parallel::collect(count, threads, |slot| {
            let block = field.block(slot);
            let mut found = [NONE; 27];
            // Blocks without known voxels contain no surface.
            if sides[slot] != 0 {
                for (i, found) in found.iter_mut().enumerate() {
                    let other = std::array::from_fn(|k| block[k] + offset(i)[k]);
                    *found = slots.get(&other).copied().unwrap_or(NONE);
                }
            }
            found
        });
        Self { order, beside, sides }
    }

    /// Check whether the surface may pass through the cubes of a block.
    fn may_cross(&self, slot: usize) -> bool {
        let upper = [13, 14, 16, 17, 22, 23, 25, 26];
        let sides = upper
            .iter()
            .map(|&i| self.beside[slot][i])
            .filter(|&slot| slot != NONE)
            .fold(0, |sides, slot| sides | self.sides[slot as usize]);
        sides == 3
    }

    /// Copy the distances of a block and its one-voxel border.
    fn around<F: Field>(&self, field: &F, slot: usize, least: u32, into: &mut Around) {
        let Around { values, inside, known } = into;
        field.distances(slot, least, inside);
        for (row, given) in inside.chunks_exact(SIDE).enumerate() {
            let start = ((row / SIDE + 1) * WIDE + row % SIDE + 1) * WIDE + 1;
            values[start..start + SIDE].copy_from_slice(given);
        }
        // Positions along an axis that a neighbour's values fill, and the first of the neighbour's voxels.
        let span = |offset: i32| match offset {
            -1 => (0..1, SIDE - 1),
            0 => (1..SIDE + 1, 0),
            _ => (SIDE + 1..WIDE, 0),
        };
        for (i, &other) in self.beside[slot].iter().enumerate().filter(|&(i, _)| i != 13) {
            let [(xs, x0), (ys, y0), (zs, z0)] = offset(i).map(span);
            for (dz, z) in zs.enumerate() {
                for (dy, y) in ys.clone().enumerate() {
                    for (dx, x) in xs.clone().enumerate() {
                        values[(z * WIDE + y) * WIDE + x] = if other == NONE {
                            f32::NAN
                        } else {
                            field.distance(other as usize, voxel([x0 + dx, y0 + dy, z0 + dz]), least)
                        };
                    }
                }
            }
        }
        // Cubes whose eight values are known, by their lowest corner.
        for (known, value) in known.iter_mut().zip(values.iter()) {
            *known = !value.is_nan();
        }
        for step in STEP {
            for i in 0..AROUND - step {
                known[i] &= known[i + step];
            }
        }
    }
}

/// Return the offset of neighbour `i` of 27.
fn offset(i: usize) -> [i32; 3] {
    [i % 3, i / 3 % 3, i / 9].map(|c| c as i32 - 1)
}

/// Values that a block's surface depends on.
struct Around {
    values: [f32; AROUND],
    inside: [f32; VOXELS],
    known: [bool; AROUND],
}

impl Default for Around {
    fn default() -> Self {
        Self { values: [f32::NAN; AROUND], inside: [f32::NAN; VOXELS], known: [false; AROUND] }
    }
}

impl Around {
    /// Return the complete cubes among the four around an edge, as bits in their order around it.
    fn cubes(&self, at: usize, axis: usize) -> u8 {
        let (u, v) = (STEP[(axis + 1) % 3], STEP[(axis + 2) % 3]);
        let whole = [at, at - u, at - u - v, at - v].map(|cube| u8::from(self.known[cube]));
        whole[0] | whole[1] << 1 | whole[2] << 2 | whole[3] << 3
    }
}

/// Return the position of a cube in the order around one of its edges.
fn turn(edge: usize) -> usize {
    let (axis, lower) = EDGE[edge];
    let (u, v) = (lower >> ((axis + 1) % 3) & 1, lower >> ((axis + 2) % 3) & 1);
    [0, 1, 3, 2][u | v << 1]
}

/// Edges of a block that have a vertex.
struct Cut {
    slot: usize,
    /// Index of the block's first vertex.
    first: usize,
    edges: [u64; CODES / 64],
    /// Number of set bits before each word of `edges`.
    before: [u16; CODES / 64],
    count: usize,
    /// Edges with a second vertex; second vertices follow all first ones.
    doubled: Vec<u16>,
}

impl Cut {
    fn has(&self, code: usize) -> bool {
        self.edges[code / 64] >> (code % 64) & 1 == 1
    }

    fn second(&self, code: usize) -> Option<usize> {
        self.doubled.binary_search(&(code as u16)).ok()
    }

    /// Return the edge code, and the rank of the second vertex if the cube's fan uses one.
    fn vertex(&self, code: usize, fan: usize) -> (usize, Option<usize>) {
        (code, if fan == 1 { self.second(code) } else { None })
    }

    fn number(&self, code: usize, fan: usize) -> u32 {
        let local = match self.vertex(code, fan) {
            (_, Some(second)) => self.count + second,
            (code, None) => {
                let below = self.edges[code / 64] & ((1 << (code % 64)) - 1);
                usize::from(self.before[code / 64]) + below.count_ones() as usize
            }
        };
        (self.first + local) as u32
    }

    fn key<F: Field>(&self, field: &F, code: usize, fan: usize) -> EdgeKey {
        let second = self.vertex(code, fan).1.map_or(0, |_| CODES);
        EdgeKey { block: order::key(field.block(self.slot)), code: (code + second) as u16 }
    }
}

/// Vertices of some blocks.
#[derive(Default)]
struct Vertices {
    cut: Vec<Cut>,
    positions: Vec<[f64; 3]>,
    samples: Vec<Sample>,
}

impl Vertices {
    /// Find the edges of a block that have a vertex; also compute the positions if the block is owned.
    fn add<F: Field>(&mut self, blocks: &Blocks, field: &F, slot: usize, around: &Around, is_own: bool) {
        let mut cut = Cut {
            slot,
            first: self.positions.len(),
            edges: [0; CODES / 64],
            before: [0; CODES / 64],
            count: 0,
            doubled: vec![],
        };
        let origin = field.block(slot).map(|c| i64::from(c) * SIDE as i64);
        for v in 0..VOXELS {
            let [x, y, z] = place(v);
            let at = ((z + 1) * WIDE + y + 1) * WIDE + x + 1;
            let here = around.values[at];
            for axis in 0..3 {
                let there = around.values[at + STEP[axis]];
                let is_cut = (here < 0.0 && there >= 0.0) || (here >= 0.0 && there < 0.0);
                if !is_cut {
                    continue;
                }
                let cubes = around.cubes(at, axis);
                if cubes == 0 {
                    continue;
                }
                let code = 3 * v + axis;
                cut.edges[code / 64] |= 1 << (code % 64);
                if cubes == 0b0101 || cubes == 0b1010 {
                    cut.doubled.push(code as u16);
                }
                if is_own {
                    let share = f64::from(here) / (f64::from(here) - f64::from(there));
                    let share = share.clamp(LEAST_SHARE, 1.0 - LEAST_SHARE);
                    let mut position = [x, y, z].map(|c| c as i64);
                    for k in 0..3 {
                        position[k] += origin[k];
                    }
                    let mut position = position.map(|c| c as f64);
                    position[axis] += share;
                    self.positions.push(position);
                    let next = blocks.next(slot, [x, y, z], axis);
                    let (a, b) = (field.sample(slot, v), field.sample(next.0, next.1));
                    self.samples.push(Sample::between(a, b, share as f32));
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
            for &code in &cut.doubled {
                let first = cut.number(usize::from(code), 0) as usize;
                self.positions.push(self.positions[first]);
                self.samples.push(self.samples[first]);
            }
        }
        self.cut.push(cut);
    }
}

impl Blocks {
    /// Return the block and index of the next voxel along an axis.
    fn next(&self, slot: usize, mut at: [usize; 3], axis: usize) -> (usize, usize) {
        at[axis] += 1;
        if at[axis] < SIDE {
            return (slot, voxel(at));
        }
        at[axis] = 0;
        (self.beside[slot][13 + [1, 3, 9][axis]] as usize, voxel(at))
    }
}

#[derive(Clone, Copy)]
enum Corner {
    Own(u32),
    /// Index into the foreign vertices of the chunk.
    Foreign(u32),
}

/// Triangles of some blocks.
#[derive(Default)]
struct Triangles {
    triangles: Vec<[Corner; 3]>,
    foreign: Vec<EdgeKey>,
}

impl Triangles {
    /// Add the triangles of a block. `vertex` returns the vertex of a block's edge for a fan.
    fn add(
        &mut self,
        blocks: &Blocks,
        slot: usize,
        around: &Around,
        vertex: impl Fn(usize, usize, usize) -> Result<u32, EdgeKey>,
    ) {
        for v in 0..VOXELS {
            let [x, y, z] = place(v);
            let at = ((z + 1) * WIDE + y + 1) * WIDE + x + 1;
            if !around.known[at] {
                continue;
            }
            let behind = (0..CORNERS).fold(0_u8, |behind, c| {
                let corner = at + (c & 1) * STEP[0] + (c >> 1 & 1) * STEP[1] + (c >> 2) * STEP[2];
                behind | u8::from(around.values[corner] < 0.0) << c
            });
            for triangle in CUBES.triangles(behind) {
                let corners = triangle.map(|edge| {
                    let (axis, lower) = EDGE[usize::from(edge)];
                    let of = [x + (lower & 1), y + (lower >> 1 & 1), z + (lower >> 2)];
                    let beside = 13 + of[0] / SIDE + of[1] / SIDE * 3 + of[2] / SIDE * 9;
                    let code = 3 * voxel(of.map(|c| c % SIDE)) + axis;
                    // If two cubes touch only in this edge, the first in the order uses the first vertex.
                    let fan = turn(usize::from(edge)) / 2;
                    match vertex(blocks.beside[slot][beside] as usize, code, fan) {
                        Ok(number) => Corner::Own(number),
                        Err(key) => {
                            self.foreign.push(key);
                            Corner::Foreign(self.foreign.len() as u32 - 1)
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
