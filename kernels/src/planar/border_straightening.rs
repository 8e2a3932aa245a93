//! Straightening of patch borders, once for the patches on both sides so that they still fit.
//!
//! Between two corners, a border is a chain of vertices between the same two patches, or between a patch and
//! the mesh boundary. The Douglas–Peucker algorithm selects the kept vertices of a chain (Douglas and
//! Peucker, "Algorithms for the reduction of the number of points required to represent a digitized line",
//! 1973).

use super::border::{Borders, find_next_border};
use super::patches::{Options, Patch, Patches, is_border};
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, norm2, position_of, segment_distance2, sub};
use crate::base::ids::{HalfedgeId, VertexId};
use crate::base::parallel;
use crate::base::progress::Progress;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::{Mesh, VertexLock};

/// Maximum chain length in vertices. Longer chains are cut, because the time can be quadratic.
const MAX_CHAIN_VERTICES: usize = 512;

/// Patches per parallel batch.
const BATCH: usize = 16;

/// Compute the maximum distance of a patch border from its chords, in mesh units.
pub fn compute_tolerance(patch: &Patch, options: &Options) -> f64 {
    let shape = (options.max_distance * options.max_distance - patch.thickness().powi(2)).max(0.0);
    let color = (options.max_color - 2.0 * patch.residual).max(0.0);
    // Constant colours do not limit the distance; this also avoids 0 / 0.
    let color = if color >= patch.gradient * shape.sqrt() { f64::INFINITY } else { color / patch.gradient };
    shape.sqrt().min(color)
}

/// Select the border vertices to keep. `known` holds the selection and patch indices of an earlier run.
/// Chains between two unchanged patches reuse it: other patches were only split, so the corners of such
/// chains are unchanged.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn straighten_borders<const D: usize>(
    mesh: &Mesh<D>,
    patches: &Patches,
    borders: &Borders,
    known: Option<(&[bool], &[Option<u32>])>,
    options: &Options,
    progress: &Progress,
) -> Result<Vec<bool>, KernelError> {
    let is_corner = |v: VertexId| borders.border_degree[v.index()] != 2 || mesh.lock(v) != VertexLock::Free;
    let mut stays: Vec<bool> =
        parallel::collect(mesh.points.len(), options.threads, |v| is_corner(VertexId::from_index(v)));
    let tolerances: Vec<f64> = patches.patches.iter().map(|p| compute_tolerance(p, options)).collect();
    let count = patches.patches.len();
    let kept: Vec<Result<Vec<VertexId>, KernelError>> = parallel::map(
        count.div_ceil(BATCH),
        options.threads,
        || BorderChain { mesh, vertices: vec![], stack: vec![], is_closed: false, kept: vec![] },
        |chain, batch| {
            progress.check()?;
            for patch in batch * BATCH..count.min((batch + 1) * BATCH) {
                for (start, beside) in find_chains(mesh, patches, borders, patch, is_corner) {
                    chain.trace(&patches.patch_of_triangle, start, is_corner);
                    match known {
                        Some((before, was)) if was[patch].is_some() && was[beside].is_some() => {
                            chain.kept.extend(chain.vertices.iter().filter(|v| before[v.index()]));
                        }
                        _ => chain.straighten(tolerances[patch].min(tolerances[beside]), is_corner),
                    }
                }
            }
            Ok(std::mem::take(&mut chain.kept))
        },
    );
    for vertices in kept {
        vertices?.into_iter().for_each(|v| stays[v.index()] = true);
    }
    Ok(stays)
}

/// List the first halfedge of each chain that a patch handles, and the patch on the other side. The patch of
/// lower index handles a chain.
fn find_chains<const D: usize>(
    mesh: &Mesh<D>,
    patches: &Patches,
    borders: &Borders,
    patch: usize,
    is_corner: impl Fn(VertexId) -> bool + Copy,
) -> impl Iterator<Item = (HalfedgeId, usize)> {
    let connectivity = &mesh.connectivity;
    let begins =
        move |&h: &HalfedgeId| is_corner(connectivity.origin(h)) && !is_corner(connectivity.target(h));
    let own = move |h: HalfedgeId| {
        let twin = connectivity.twin(h);
        let beside = if twin.is_some() {
            patches.patch_of_triangle[Connectivity::triangle(twin).index()] as usize
        } else {
            patch
        };
        (beside >= patch).then_some((h, beside))
    };
    // A loop without corners is a chain that starts anywhere.
    let starts = move |halfedges: &'_ [HalfedgeId]| {
        let is_bare = !halfedges.iter().any(|&h| is_corner(connectivity.origin(h)));
        let bare = is_bare.then(|| halfedges[0]);
        let from_corners: Vec<HalfedgeId> = halfedges.iter().copied().filter(begins).collect();
        bare.into_iter().chain(from_corners)
    };
    borders.trace_patch_loops(patch).flat_map(starts).filter_map(own)
}

struct BorderChain<'a, const D: usize> {
    mesh: &'a Mesh<D>,
    vertices: Vec<VertexId>,
    stack: Vec<(usize, usize)>,
    /// True if both ends are the same vertex.
    is_closed: bool,
    /// Kept vertices of all chains so far.
    kept: Vec<VertexId>,
}

impl<const D: usize> BorderChain<'_, D> {
    fn trace(&mut self, of: &[u32], start: HalfedgeId, is_corner: impl Fn(VertexId) -> bool) {
        let connectivity = &self.mesh.connectivity;
        debug_assert!(is_border(connectivity, of, start));
        let first = connectivity.origin(start);
        self.vertices.clear();
        self.vertices.push(first);
        let mut h = start;
        loop {
            let v = connectivity.target(h);
            self.vertices.push(v);
            if v == first || is_corner(v) {
                self.is_closed = v == first;
                return;
            }
            h = find_next_border(connectivity, of, h);
        }
    }

    fn position_at(&self, i: usize) -> Vec3 {
        position_of(self.mesh.point(self.vertices[i]))
    }

    fn straighten(&mut self, tolerance: f64, is_corner: impl Fn(VertexId) -> bool) {
        let last = self.vertices.len() - 1;
        if !self.is_closed {
            self.kept.push(self.vertices[0]);
            self.keep_between(0, last, tolerance);
            return;
        }
        if !is_corner(self.vertices[0]) {
            // A loop without corners starts at its vertex farthest from the first one.
            let far = self.find_farthest_from(self.position_at(0), 0, last);
            self.vertices.pop();
            self.vertices.rotate_left(far);
            self.vertices.push(self.vertices[0]);
        }
        let middle = self.find_farthest_from(self.position_at(0), 0, last);
        self.kept.push(self.vertices[0]);
        self.kept.push(self.vertices[middle]);
        let kept = self.keep_between(0, middle, tolerance) + self.keep_between(middle, last, tolerance);
        if kept == 0 {
            // Two vertices enclose no area, so keep a third one.
            let sides = [self.find_farthest_between(0, middle), self.find_farthest_between(middle, last)];
            if let Some((i, _)) = sides.into_iter().flatten().max_by(|a, b| a.1.total_cmp(&b.1)) {
                self.kept.push(self.vertices[i]);
            }
        }
    }

    fn find_farthest_from(&self, p: Vec3, from: usize, to: usize) -> usize {
        let (mut best, mut most) = (from + 1, -1.0);
        for i in from + 1..to {
            let away = norm2(&sub(&self.position_at(i), &p));
            if away > most {
                (best, most) = (i, away);
            }
        }
        best
    }

    /// Find the vertex farthest from the chord between two vertices of the chain, and its squared distance.
    fn find_farthest_between(&self, from: usize, to: usize) -> Option<(usize, f64)> {
        let (a, b) = (self.position_at(from), self.position_at(to));
        let mut best: Option<(usize, f64)> = None;
        for i in from + 1..to {
            let away = segment_distance2(&self.position_at(i), &a, &b);
            if best.is_none_or(|(_, most)| away > most) {
                best = Some((i, away));
            }
        }
        best
    }

    /// Keep vertices between two vertices of the chain, and return their number.
    fn keep_between(&mut self, from: usize, to: usize, tolerance: f64) -> usize {
        let mut kept = 0;
        let mut begin = from;
        while begin < to {
            let end = if to - begin > MAX_CHAIN_VERTICES { begin + MAX_CHAIN_VERTICES } else { to };
            if end < to {
                self.kept.push(self.vertices[end]);
                kept += 1;
            }
            self.stack.push((begin, end));
            while let Some((a, b)) = self.stack.pop() {
                let Some((far, away)) = self.find_farthest_between(a, b) else { continue };
                if away > tolerance * tolerance {
                    self.kept.push(self.vertices[far]);
                    kept += 1;
                    self.stack.extend([(a, far), (far, b)]);
                }
            }
            begin = end;
        }
        kept
    }
}
