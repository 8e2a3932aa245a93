//! Straightening borders, each once for the patches on both sides, so that they still fit.
//!
//! Between two corners a border is a chain of vertices that lie on the same two patches (or on one, and the boundary
//! of the mesh). Of a chain stay the vertices that keep it near its chords (Douglas and Peucker, "Algorithms for the
//! reduction of the number of points required to represent a digitized line", 1973).

use super::border::{Borders, next_border};
use super::patches::{Options, Patch, Patches, is_border};
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, norm2, position, segment_distance2, sub};
use crate::base::ids::{HalfedgeId, VertexId};
use crate::base::progress::Progress;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::{Lock, Mesh};

/// A longer chain is cut, as the time for a chain can grow with the square of its length.
const LONGEST: usize = 512;

/// How far the border of a patch may leave its chords.
pub fn tolerance(patch: &Patch, options: &Options) -> f64 {
    let shape = (options.max_distance * options.max_distance - patch.thickness().powi(2)).max(0.0);
    let color = (options.max_color - 2.0 * patch.residual).max(0.0);
    // Flat colours change nowhere: 0 / 0 must not be a bound.
    let color = if color >= patch.gradient * shape.sqrt() { f64::INFINITY } else { color / patch.gradient };
    shape.sqrt().min(color)
}

/// Which vertices on borders stay. `known` says it for the borders of patches that are what they were before: a
/// chain between two of these has the same corners at its ends, or none, as other patches were only divided.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn straighten<const D: usize>(
    mesh: &Mesh<D>,
    patches: &Patches,
    borders: &Borders,
    known: Option<(&[bool], &[Option<u32>])>,
    options: &Options,
    progress: &mut Progress,
) -> Result<Vec<bool>, KernelError> {
    let connectivity = &mesh.connectivity;
    let is_corner = |v: VertexId| borders.degree[v.index()] != 2 || mesh.lock(v) != Lock::Free;
    let mut stays: Vec<bool> = (0..mesh.points.len()).map(VertexId::from_index).map(is_corner).collect();
    let mut is_done = vec![false; mesh.points.len()];
    let mut chain = Chain { mesh, vertices: vec![], stack: vec![], is_closed: false };
    let tolerances: Vec<f64> = patches.patches.iter().map(|p| tolerance(p, options)).collect();
    // Chains between corners first; what is left then has none.
    for from_corner in [true, false] {
        for patch in 0..patches.patches.len() {
            progress.check_now_and_then()?;
            for &h in borders.loops(patch).flatten() {
                let (start, second) = (connectivity.origin(h), connectivity.target(h));
                let is_new = if from_corner {
                    is_corner(start) && !is_corner(second) && !is_done[second.index()]
                } else {
                    !is_corner(start) && !is_done[start.index()]
                };
                if !is_new {
                    continue;
                }
                chain.trace(&patches.of, h, is_corner);
                let twin = connectivity.twin(h);
                let beside = if twin.is_some() {
                    patches.of[Connectivity::triangle(twin).index()] as usize
                } else {
                    patch
                };
                chain.vertices.iter().for_each(|v| is_done[v.index()] = true);
                match known {
                    Some((before, was)) if was[patch].is_some() && was[beside].is_some() => {
                        chain.vertices.iter().for_each(|v| stays[v.index()] |= before[v.index()]);
                    }
                    _ => chain.straighten(tolerances[patch].min(tolerances[beside]), &mut stays),
                }
            }
        }
    }
    Ok(stays)
}

struct Chain<'a, const D: usize> {
    mesh: &'a Mesh<D>,
    vertices: Vec<VertexId>,
    stack: Vec<(usize, usize)>,
    /// Whether its ends are the same vertex.
    is_closed: bool,
}

impl<const D: usize> Chain<'_, D> {
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
            h = next_border(connectivity, of, h);
        }
    }

    fn at(&self, i: usize) -> Vec3 {
        position(self.mesh.point(self.vertices[i]))
    }

    fn straighten(&mut self, tolerance: f64, stays: &mut [bool]) {
        let last = self.vertices.len() - 1;
        if !self.is_closed {
            stays[self.vertices[0].index()] = true;
            self.keep_between(0, last, tolerance, stays);
            return;
        }
        if self.vertices.iter().all(|v| !stays[v.index()]) {
            // Without a corner, begin at an end of it.
            let far = self.farthest_from(self.at(0), 0, last);
            self.vertices.pop();
            self.vertices.rotate_left(far);
            self.vertices.push(self.vertices[0]);
        }
        let middle = self.farthest_from(self.at(0), 0, last);
        stays[self.vertices[0].index()] = true;
        stays[self.vertices[middle].index()] = true;
        let kept = self.keep_between(0, middle, tolerance, stays)
            + self.keep_between(middle, last, tolerance, stays);
        if kept == 0 {
            // Two vertices bound nothing.
            let sides = [self.farthest_between(0, middle), self.farthest_between(middle, last)];
            if let Some((i, _)) = sides.into_iter().flatten().max_by(|a, b| a.1.total_cmp(&b.1)) {
                stays[self.vertices[i].index()] = true;
            }
        }
    }

    fn farthest_from(&self, p: Vec3, from: usize, to: usize) -> usize {
        let (mut best, mut most) = (from + 1, -1.0);
        for i in from + 1..to {
            let away = norm2(&sub(&self.at(i), &p));
            if away > most {
                (best, most) = (i, away);
            }
        }
        best
    }

    /// The vertex between two of the chain that is farthest from the chord, and its squared distance.
    fn farthest_between(&self, from: usize, to: usize) -> Option<(usize, f64)> {
        let (a, b) = (self.at(from), self.at(to));
        let mut best: Option<(usize, f64)> = None;
        for i in from + 1..to {
            let away = segment_distance2(&self.at(i), &a, &b);
            if best.is_none_or(|(_, most)| away > most) {
                best = Some((i, away));
            }
        }
        best
    }

    /// Returns how many vertices stay between the two.
    fn keep_between(&mut self, from: usize, to: usize, tolerance: f64, stays: &mut [bool]) -> usize {
        let mut kept = 0;
        let mut begin = from;
        while begin < to {
            let end = if to - begin > LONGEST { begin + LONGEST } else { to };
            if end < to {
                stays[self.vertices[end].index()] = true;
                kept += 1;
            }
            self.stack.push((begin, end));
            while let Some((a, b)) = self.stack.pop() {
                let Some((far, away)) = self.farthest_between(a, b) else { continue };
                if away > tolerance * tolerance {
                    stays[self.vertices[far].index()] = true;
                    kept += 1;
                    self.stack.extend([(a, far), (far, b)]);
                }
            }
            begin = end;
        }
        kept
    }
}
