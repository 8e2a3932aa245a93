//! State of an assembly: kept border vertices and the triangles of each patch.

use std::sync::OnceLock;

use super::border::Borders;
use super::patches::{Options, Patch, Patches};
use super::polygon::Polygon;
use crate::base::ids::{TriangleId, VertexId};
use crate::base::parallel;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::Mesh;

/// Patches per parallel batch.
pub(super) const BATCH: usize = 64;

/// Sort the input triangles by patch. Returns them with the start of each patch.
fn sort_by_patch(patches: &Patches) -> (Vec<u32>, Vec<u32>) {
    let mut starts = vec![0u32; patches.patches.len() + 1];
    patches.patch_of_triangle.iter().for_each(|&p| starts[p as usize + 1] += 1);
    (0..patches.patches.len()).for_each(|p| starts[p + 1] += starts[p]);
    let mut next = starts.clone();
    let mut members = vec![0; patches.patch_of_triangle.len()];
    for (t, &p) in patches.patch_of_triangle.iter().enumerate() {
        members[next[p as usize] as usize] = t as u32;
        next[p as usize] += 1;
    }
    (members, starts)
}

/// State of the assembly of all patches.
pub(super) struct Assembly<'a, const D: usize> {
    pub(super) mesh: &'a Mesh<D>,
    pub(super) options: &'a Options,
    pub(super) patches: &'a Patches,
    pub(super) borders: &'a Borders,
    /// Input triangles sorted by patch; built on demand because few results need them.
    pub(super) members: OnceLock<(Vec<u32>, Vec<u32>)>,
    /// True for border vertices of the result.
    pub(super) stays: Vec<bool>,
    /// True for patches that keep their triangles, including interior vertices.
    pub(super) keeps_triangles: Vec<bool>,
    /// True for kept patches that have no triangulation even with all border vertices.
    pub(super) is_folded: Vec<bool>,
    pub(super) attempt_counts: Vec<u8>,
    /// Interior edges forbidden per patch, because the same edge exists elsewhere; sorted.
    pub(super) forbidden: Vec<(u32, [VertexId; 2])>,
    /// New triangles of each patch that does not keep its own, with their source triangles.
    pub(super) triangles: Vec<Vec<([u32; 3], u32)>>,
    /// Sorted edges of the result, outdated for changed patches.
    pub(super) edges: Vec<ResultEdge>,
    /// True for patches whose edges may have changed since `edges` was gathered.
    pub(super) has_changed: Vec<bool>,
    pub(super) rounds: usize,
}

impl<const D: usize> Assembly<'_, D> {
    /// Build the polygon of a patch from its kept border vertices.
    pub(super) fn polygon(&self, patch: u32) -> Polygon<'_> {
        let number = patch as usize;
        Polygon::new(self.mesh, self.borders, number, &self.patches.patches[number], &self.stays)
    }

    /// Sort and deduplicate patches, dropping those that keep their triangles.
    pub(super) fn sort_unique(&self, mut again: Vec<u32>) -> Vec<u32> {
        again.sort_unstable();
        again.dedup();
        again.retain(|&p| !self.keeps_triangles[p as usize]);
        again
    }

    /// Restore a border vertex, and queue all patches around it.
    pub(super) fn restore_vertex(&mut self, v: VertexId, again: &mut Vec<u32>) {
        if !std::mem::replace(&mut self.stays[v.index()], true) {
            let triangles = self.mesh.connectivity.fan(v).map(|h| Connectivity::triangle(h).index());
            again.extend(triangles.map(|t| self.patches.patch_of_triangle[t]));
        }
    }

    /// Let a patch keep its triangles, and restore all its border vertices.
    pub(super) fn keep_patch(&mut self, patch: u32, again: &mut Vec<u32>) {
        self.keeps_triangles[patch as usize] = true;
        self.has_changed[patch as usize] = true;
        self.triangles[patch as usize] = vec![];
        let borders = self.borders;
        for &h in borders.trace_patch_loops(patch as usize).flatten() {
            self.restore_vertex(self.mesh.connectivity.origin(h), again);
        }
    }

    /// Return the input triangles of a patch.
    pub(super) fn members(&self, patch: u32) -> &[u32] {
        let (members, starts) = self.members.get_or_init(|| sort_by_patch(self.patches));
        &members[starts[patch as usize] as usize..starts[patch as usize + 1] as usize]
    }

    /// Compute upper bounds of the deviation in each patch: distance and colour difference.
    pub(super) fn compute_bounds(&self) -> Vec<[f64; 2]> {
        let mut bounds = vec![[0.0; 2]; self.patches.patches.len()];
        parallel::fill(&mut bounds, self.options.threads, |p| {
            let patch: &Patch = &self.patches.patches[p];
            if self.keeps_triangles[p] {
                return [0.0; 2];
            }
            let polygon = self.polygon(p as u32);
            let away = (0..polygon.corners.len()).filter_map(|c| polygon.find_farthest(self.mesh, c));
            let aside = away.map(|(_, away)| away).fold(0.0, f64::max);
            [patch.thickness().hypot(aside), 2.0 * patch.residual + patch.gradient * aside]
        });
        bounds
    }

    /// Build the result: source vertices, triangles, and the source triangle and patch of each triangle.
    #[allow(clippy::type_complexity)]
    pub(super) fn build_output(&self) -> (Vec<u32>, Vec<[u32; 3]>, Vec<u32>, Vec<u32>) {
        let connectivity = &self.mesh.connectivity;
        let (mut triangles, mut sources, mut patch) = (vec![], vec![], vec![]);
        for p in 0..self.patches.patches.len() as u32 {
            if self.keeps_triangles[p as usize] {
                for &t in self.members(p) {
                    triangles.push(connectivity.corners(TriangleId(t)).map(|v| v.0));
                    sources.push(t);
                }
            } else {
                for &(triangle, source) in &self.triangles[p as usize] {
                    triangles.push(triangle);
                    sources.push(source);
                }
            }
            patch.resize(triangles.len(), p);
        }
        let mut number = vec![u32::MAX; self.mesh.points.len()];
        triangles.iter().flatten().for_each(|&v| number[v as usize] = 0);
        let mut vertices = vec![];
        for (v, number) in number.iter_mut().enumerate().filter(|(_, n)| **n == 0) {
            *number = vertices.len() as u32;
            vertices.push(v as u32);
        }
        triangles.iter_mut().flatten().for_each(|v| *v = number[*v as usize]);
        sources.iter_mut().for_each(|t| *t = self.mesh.triangle_source[*t as usize]);
        (vertices, triangles, sources, patch)
    }
}

pub(super) fn sort_pair(a: VertexId, b: VertexId) -> [VertexId; 2] {
    [a.min(b), a.max(b)]
}

/// Kind of an edge of the result. Among equal edges, the first in this order may stay.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(super) enum EdgeKind {
    /// Edge of the input.
    Input,
    /// Chord that replaces several border edges.
    Chord,
    /// Edge inside a patch.
    Inner,
}

/// Edge of the result: its ends, kind, identifier within its kind, and patch.
pub(super) type ResultEdge = ([VertexId; 2], EdgeKind, u32, u32);
