//! Patch borders: loops of halfedges around each patch, and the number of border edges at each vertex.

use super::patches::{Patches, is_border};
use crate::base::errors::KernelError;
use crate::base::ids::{HalfedgeId, VertexId};
use crate::base::parallel;
use crate::base::progress::Progress;
use crate::mesh::connectivity::Connectivity;

/// Halfedges per parallel batch.
const BATCH_HALFEDGES: u32 = 1 << 16;

/// Patches per parallel batch.
const BATCH_PATCHES: usize = 16;

/// Borders of all patches; each border halfedge has its patch on the left.
#[derive(Clone, Debug)]
pub struct Borders {
    halfedges: Vec<HalfedgeId>,
    /// Start of each loop in `halfedges`, plus the end.
    loops: Vec<u32>,
    /// Start of each patch's loops in `trace_patch_loops`, plus the end.
    patches: Vec<u32>,
    /// Number of border edges at each vertex.
    pub border_degree: Vec<u32>,
    /// Number of interior vertices of each patch.
    pub interior_counts: Vec<u32>,
}

impl Borders {
    /// Return all border halfedges.
    pub fn all_halfedges(&self) -> &[HalfedgeId] {
        &self.halfedges
    }

    /// Return the loops of a patch, each as its halfedges in order.
    pub fn trace_patch_loops(&self, patch: usize) -> impl ExactSizeIterator<Item = &[HalfedgeId]> {
        let range = self.patches[patch] as usize..self.patches[patch + 1] as usize;
        range.map(|i| &self.halfedges[self.loops[i] as usize..self.loops[i + 1] as usize])
    }

    /// Check whether a patch is a disc, possibly with holes, by its Euler characteristic: V − E + F = 2 −
    /// loops.
    pub fn is_disc_with_holes(&self, patch: usize, faces: u32) -> bool {
        let loops = self.trace_patch_loops(patch).len() as i64;
        let border: i64 = self.trace_patch_loops(patch).map(|l| l.len() as i64).sum();
        // A loop has equally many vertices and edges if repeated vertices count twice. E = (3F + border) / 2.
        let twice_euler = 2 * i64::from(self.interior_counts[patch]) + border - i64::from(faces);
        loops > 0 && twice_euler == 2 * (2 - loops)
    }
}

/// Find the border halfedge that follows `h` around the same patch.
pub fn find_next_border(connectivity: &Connectivity, of: &[u32], h: HalfedgeId) -> HalfedgeId {
    let mut next = Connectivity::next(h);
    while !is_border(connectivity, of, next) {
        next = Connectivity::next(connectivity.twin(next));
    }
    next
}

/// Trace the borders of all patches.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn trace_borders(
    connectivity: &Connectivity,
    patches: &Patches,
    threads: usize,
    progress: &Progress,
) -> Result<Borders, KernelError> {
    let of = &patches.patch_of_triangle;
    let count = 3 * connectivity.triangle_slots() as u32;
    let mut borders = Borders {
        halfedges: vec![],
        loops: vec![0],
        patches: Vec::with_capacity(patches.patches.len() + 1),
        border_degree: vec![0; connectivity.vertex_slots()],
        interior_counts: vec![],
    };
    let all = parallel::map(
        count.div_ceil(BATCH_HALFEDGES) as usize,
        threads,
        || (),
        |_, batch| {
            let from = batch as u32 * BATCH_HALFEDGES;
            let halfedges = (from..count.min(from + BATCH_HALFEDGES)).map(HalfedgeId);
            halfedges.filter(|&h| is_border(connectivity, of, h)).collect::<Vec<_>>()
        },
    )
    .concat();
    for &h in &all {
        borders.border_degree[connectivity.origin(h).index()] += 1;
        if connectivity.twin(h).is_none() {
            borders.border_degree[connectivity.target(h).index()] += 1;
        }
    }
    progress.check()?;
    borders.interior_counts = count_interior(connectivity, patches, &borders.border_degree, threads);
    borders.trace_loops(connectivity, of, &group_by_patch(&all, patches), threads, progress)?;
    Ok(borders)
}

/// Count the interior vertices of each patch.
fn count_interior(
    connectivity: &Connectivity,
    patches: &Patches,
    degree: &[u32],
    threads: usize,
) -> Vec<u32> {
    let part = degree.len().div_ceil(threads.max(1)).max(1);
    let parts = degree.len().div_ceil(part);
    let counted = parallel::map(
        parts,
        threads,
        || (),
        |(), number| {
            let mut inside = vec![0u32; patches.patches.len()];
            for v in (number * part..degree.len().min((number + 1) * part)).filter(|&v| degree[v] == 0) {
                if let Some(h) = connectivity.fan(VertexId::from_index(v)).next() {
                    inside[patches.patch_of_triangle[Connectivity::triangle(h).index()] as usize] += 1;
                }
            }
            inside
        },
    );
    parallel::collect(patches.patches.len(), 1, |patch| counted.iter().map(|part| part[patch]).sum())
}

/// Loops of some patches: halfedges, length of each loop, and number of loops per patch.
type Loops = (Vec<HalfedgeId>, Vec<u32>, Vec<u32>);

impl Borders {
    fn trace_loops(
        &mut self,
        connectivity: &Connectivity,
        of: &[u32],
        (all, starts): &(Vec<HalfedgeId>, Vec<u32>),
        threads: usize,
        progress: &Progress,
    ) -> Result<(), KernelError> {
        let count = starts.len() - 1;
        let found: Vec<Result<Loops, KernelError>> = parallel::map(
            count.div_ceil(BATCH_PATCHES),
            threads,
            || (),
            |(), batch| {
                progress.check()?;
                let patches =
                    starts[batch * BATCH_PATCHES..=count.min((batch + 1) * BATCH_PATCHES)].windows(2);
                let borders = patches.map(|range| &all[range[0] as usize..range[1] as usize]);
                Ok(loops(connectivity, of, borders))
            },
        );
        self.halfedges.reserve(all.len());
        self.patches.push(0);
        let (mut end, mut last) = (0, 0);
        for traced in found {
            let (halfedges, lengths, counts) = traced?;
            self.halfedges.extend(halfedges);
            self.loops.extend(lengths.into_iter().map(|length| {
                end += length;
                end
            }));
            self.patches.extend(counts.into_iter().map(|count| {
                last += count;
                last
            }));
        }
        Ok(())
    }
}

/// Trace the loops of patches, each given by its sorted border halfedges.
fn loops<'a>(
    connectivity: &Connectivity,
    of: &[u32],
    borders: impl Iterator<Item = &'a [HalfedgeId]>,
) -> Loops {
    let (mut traced, mut lengths, mut counts) = (vec![], vec![], vec![]);
    let mut is_done = vec![];
    for border in borders {
        is_done.clear();
        is_done.resize(border.len(), false);
        let mut count = 0;
        for (i, &start) in border.iter().enumerate() {
            if is_done[i] {
                continue;
            }
            let first = traced.len();
            let mut h = start;
            loop {
                // Borders are short and sorted, so a binary search is cheap.
                if let Ok(place) = border.binary_search(&h) {
                    is_done[place] = true;
                }
                traced.push(h);
                h = find_next_border(connectivity, of, h);
                if h == start {
                    break;
                }
            }
            lengths.push((traced.len() - first) as u32);
            count += 1;
        }
        counts.push(count);
    }
    (traced, lengths, counts)
}

/// Sort halfedges by patch with a counting sort. Returns them with the start of each patch.
fn group_by_patch(all: &[HalfedgeId], patches: &Patches) -> (Vec<HalfedgeId>, Vec<u32>) {
    let patch = |h: HalfedgeId| patches.patch_of_triangle[Connectivity::triangle(h).index()] as usize;
    let mut starts = vec![0u32; patches.patches.len() + 1];
    all.iter().for_each(|&h| starts[patch(h) + 1] += 1);
    (0..patches.patches.len()).for_each(|p| starts[p + 1] += starts[p]);
    let mut next = starts.clone();
    let mut grouped = vec![HalfedgeId::NONE; all.len()];
    for &h in all {
        let place = &mut next[patch(h)];
        grouped[*place as usize] = h;
        *place += 1;
    }
    (grouped, starts)
}
