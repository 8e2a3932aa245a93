//! Where patches end: loops of halfedges around each, and the vertices where more than two of them meet.

use super::patches::{Patches, is_border};
use crate::base::errors::KernelError;
use crate::base::ids::{HalfedgeId, VertexId};
use crate::base::parallel;
use crate::base::progress::Progress;
use crate::mesh::connectivity::Connectivity;

/// Halfedges that one thread looks at in one go.
const BATCH: u32 = 1 << 16;

/// The borders of all patches; each border halfedge has its patch on the left.
#[derive(Clone, Debug)]
pub struct Borders {
    halfedges: Vec<HalfedgeId>,
    /// Where each loop begins in `halfedges`, and the end.
    loops: Vec<u32>,
    /// Where the loops of each patch begin in `loops`, and the end.
    patches: Vec<u32>,
    /// Border edges at each vertex.
    pub degree: Vec<u32>,
    /// Vertices inside each patch.
    pub inside: Vec<u32>,
}

impl Borders {
    /// All border halfedges.
    pub fn all(&self) -> &[HalfedgeId] {
        &self.halfedges
    }

    /// The loops of a patch, each as the halfedges along it.
    pub fn loops(&self, patch: usize) -> impl ExactSizeIterator<Item = &[HalfedgeId]> {
        let range = self.patches[patch] as usize..self.patches[patch + 1] as usize;
        range.map(|i| &self.halfedges[self.loops[i] as usize..self.loops[i + 1] as usize])
    }

    /// Whether a patch has a border, and is a disc with holes and without handles: V − E + F = 2 − loops.
    pub fn is_planar(&self, patch: usize, faces: u32) -> bool {
        let loops = self.loops(patch).len() as i64;
        let border: i64 = self.loops(patch).map(|l| l.len() as i64).sum();
        // Each loop has as many vertices as edges, where it touches itself counted twice; E = (3F + border) / 2.
        let twice_euler = 2 * i64::from(self.inside[patch]) + border - i64::from(faces);
        loops > 0 && twice_euler == 2 * (2 - loops)
    }
}

/// The border halfedge after `h` around the same patch.
pub fn next_border(connectivity: &Connectivity, of: &[u32], h: HalfedgeId) -> HalfedgeId {
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
pub fn trace(
    connectivity: &Connectivity,
    patches: &Patches,
    threads: usize,
    progress: &mut Progress,
) -> Result<Borders, KernelError> {
    let of = &patches.of;
    let count = 3 * connectivity.triangle_slots() as u32;
    let mut borders = Borders {
        halfedges: vec![],
        loops: vec![0],
        patches: Vec::with_capacity(patches.patches.len() + 1),
        degree: vec![0; connectivity.vertex_slots()],
        inside: vec![0; patches.patches.len()],
    };
    let all = parallel::map(
        count.div_ceil(BATCH) as usize,
        threads,
        || (),
        |_, batch| {
            let from = batch as u32 * BATCH;
            let halfedges = (from..count.min(from + BATCH)).map(HalfedgeId);
            halfedges.filter(|&h| is_border(connectivity, of, h)).collect::<Vec<_>>()
        },
    )
    .concat();
    for &h in &all {
        borders.degree[connectivity.origin(h).index()] += 1;
        if connectivity.twin(h).is_none() {
            borders.degree[connectivity.target(h).index()] += 1;
        }
    }
    progress.check()?;
    for v in (0..borders.degree.len()).filter(|&v| borders.degree[v] == 0) {
        if let Some(h) = connectivity.fan(VertexId::from_index(v)).next() {
            borders.inside[of[Connectivity::triangle(h).index()] as usize] += 1;
        }
    }
    borders.trace_loops(connectivity, of, &by_patch(&all, patches), progress)?;
    Ok(borders)
}

impl Borders {
    fn trace_loops(
        &mut self,
        connectivity: &Connectivity,
        of: &[u32],
        grouped: &(Vec<HalfedgeId>, Vec<u32>),
        progress: &mut Progress,
    ) -> Result<(), KernelError> {
        let mut is_done = vec![false; 3 * connectivity.triangle_slots()];
        self.halfedges.reserve(grouped.0.len());
        for range in grouped.1.windows(2) {
            progress.check_now_and_then()?;
            self.patches.push(self.loops.len() as u32 - 1);
            for &start in &grouped.0[range[0] as usize..range[1] as usize] {
                let mut h = start;
                while !std::mem::replace(&mut is_done[h.index()], true) {
                    self.halfedges.push(h);
                    h = next_border(connectivity, of, h);
                }
                if *self.loops.last().unwrap_or(&0) < self.halfedges.len() as u32 {
                    self.loops.push(self.halfedges.len() as u32);
                }
            }
        }
        self.patches.push(self.loops.len() as u32 - 1);
        Ok(())
    }
}

/// Halfedges sorted by patch, and where each patch begins: a counting sort.
fn by_patch(all: &[HalfedgeId], patches: &Patches) -> (Vec<HalfedgeId>, Vec<u32>) {
    let patch = |h: HalfedgeId| patches.of[Connectivity::triangle(h).index()] as usize;
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
