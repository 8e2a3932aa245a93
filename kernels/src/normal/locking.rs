//! Rebuild of a base mesh with additional input vertices where its levels fold.
//!
//! If no vertex position removes a fold, the base lacks vertices to represent the surface there. The input
//! has no folds, so a few locked input vertices suffice. All other collapses are replayed unchanged, so the
//! rest of the base and its levels stay as they are.

use super::base_mesh::{Base, Collapse};
use super::coarsening::{MAX_COLLAPSE_COST, RULES, Target, extract_base};
use super::fold::Fold;
use super::half_edge_measure::HalfEdgeMeasure;
use super::input::Input;
use super::needle_removal;
use crate::base::errors::KernelError;
use crate::base::geometry::{bounding_box, diagonal, distance2};
use crate::base::ids::{EdgeId, VertexId};
use crate::base::progress::Progress;
use crate::collapse::engine::{Engine, Measure, StopCriteria};
use crate::mesh::collapse_legality::{VertexMarks, can_collapse};
use crate::mesh::edge_star::EdgeStar;
use crate::mesh::triangle_mesh::{Mesh, VertexLock};

/// Input vertices to keep in a rebuilt base.
#[derive(Clone, Debug)]
pub struct Locking {
    /// Collapses that produced the original base, and its vertices (indices of the input).
    collapses: Vec<Collapse>,
    vertices: Vec<u32>,
    /// True for each input vertex that the base must keep.
    locked: Vec<bool>,
    /// Number of rounds with a fold next to a triangle of each input vertex.
    fold_counts: Vec<u8>,
}

impl Locking {
    /// Create the state without locked vertices.
    pub fn new(base: &Base, input: &Input<'_>) -> Self {
        let count = input.points.len();
        Self {
            collapses: base.collapses.clone(),
            vertices: base.vertex_source.clone(),
            locked: vec![false; count],
            fold_counts: vec![0; count],
        }
    }

    /// Lock input vertices next to folds. On the first fold of a base triangle, lock the nearest input vertex
    /// that the base lacks. If the same region folds again, lock all corners of the nearest input triangle,
    /// then one more ring per round.
    pub fn lock_around_folds(&mut self, folds: &[Fold], base: &Base, input: &Input<'_>) {
        let mut is_in_base = vec![false; self.locked.len()];
        base.vertex_source.iter().for_each(|&v| is_in_base[v as usize] = true);
        // Number of rings to lock around each vertex, counting the vertex itself.
        let mut depth = vec![0u8; self.locked.len()];
        let mut times = self.fold_counts.clone();
        let mut is_done = vec![false; base.triangles.len()];
        for fold in folds {
            // Search only the associated set, because another sheet may be nearer.
            let set = base.sets.members_of(fold.triangle).iter().copied();
            let slot = input.surface.find_nearest_among(&fold.middle, set).slot;
            let corners = input.surface.vertices(slot).map(|v| v as usize);
            let before = corners.iter().fold(0, |most, &v| most.max(self.fold_counts[v]));
            let is_another = std::mem::replace(&mut is_done[fold.triangle], true);
            if is_another && before == 0 {
                continue;
            }
            let away = |&v: &usize| distance2(&fold.middle, &input.points[v]);
            let missing = corners.into_iter().filter(|&v| !is_in_base[v]);
            let nearest = missing.min_by(|a, b| away(a).total_cmp(&away(b)).then(a.cmp(b)));
            let now = match nearest {
                Some(v) if before == 0 => {
                    depth[v] = depth[v].max(1);
                    1
                }
                Some(_) if before == 1 => 2,
                _ => before.saturating_add(1).max(3),
            };
            for v in corners {
                times[v] = times[v].max(now);
                depth[v] = depth[v].max(now - 1);
            }
        }
        self.fold_counts = times;
        propagate_depth(&mut depth, input.triangles);
        self.locked.iter_mut().zip(&depth).for_each(|(locked, depth)| *locked |= *depth > 0);
    }

    /// Build the base by replaying the collapses, except those that remove a locked vertex. In regions that
    /// differ from the original base, flipped triangles are refused.
    ///
    /// # Errors
    /// [`KernelError::Interrupted`], and errors of [`Mesh::new`].
    pub fn rebuild_base(
        &self,
        input: &Input<'_>,
        target: Target,
        progress: &mut Progress,
    ) -> Result<Base, KernelError> {
        let mesh = Mesh::new(input.points.clone(), input.triangles)?;
        let size = diagonal(&bounding_box(mesh.connectivity.vertices().map(|v| *mesh.point(v))));
        let mut measure = HalfEdgeMeasure::new(&mesh, &input.surface, target.error, RULES[0]);
        (measure.refuse_flipped, measure.limit) = (true, MAX_COLLAPSE_COST * size.powi(4));
        let mut again = CollapseReplay::new(mesh, measure);
        again.remove_needles(&self.locked);
        for collapse in &self.collapses {
            again.replay_collapse(collapse, &self.locked);
            progress.check_periodically()?;
        }
        let CollapseReplay { mut mesh, measure, mut collapses, .. } = again;
        // Other extra vertices are left only because a replayed collapse was blocked. Collapse them, too.
        let locked = (0..).zip(&self.locked).filter(|(_, locked)| **locked).map(|(v, _)| v);
        self.vertices.iter().copied().chain(locked).for_each(|v| mesh.locks[v as usize] = VertexLock::Locked);
        let mut engine = Engine::new(mesh, measure);
        engine.run(StopCriteria::EXHAUSTED, progress)?;
        let (mesh, measure, _, merges, _) = engine.into_parts();
        collapses.extend(merges.iter().map(Collapse::from));
        Ok(extract_base(&mesh, &measure, &input.slots, collapses))
    }
}

/// Propagate depths: each neighbour of a vertex gets at least its depth minus one.
fn propagate_depth(depth: &mut [u8], triangles: &[[u32; 3]]) {
    let mut grown = true;
    while std::mem::take(&mut grown) {
        for corners in triangles {
            let least = corners.iter().fold(1, |most, &v| most.max(depth[v as usize])) - 1;
            for &v in corners {
                grown |= depth[v as usize] < least;
                depth[v as usize] = depth[v as usize].max(least);
            }
        }
    }
}

/// Replay of recorded collapses on the input mesh.
struct CollapseReplay<'a> {
    mesh: Mesh<3>,
    measure: HalfEdgeMeasure<'a>,
    collapses: Vec<Collapse>,
    /// True for vertices whose triangles differ from the original run at this step.
    is_changed: Vec<bool>,
    /// Survivor of each vertex that needle removal collapsed before its recorded turn; otherwise the vertex
    /// itself.
    merged_into: Vec<VertexId>,
    marks: VertexMarks,
    star: EdgeStar<3>,
}

impl<'a> CollapseReplay<'a> {
    fn new(mesh: Mesh<3>, measure: HalfEdgeMeasure<'a>) -> Self {
        let count = mesh.points.len();
        Self {
            mesh,
            measure,
            collapses: vec![],
            is_changed: vec![false; count],
            merged_into: (0..count).map(VertexId::from_index).collect(),
            marks: VertexMarks::new(count),
            star: EdgeStar::default(),
        }
    }

    /// Remove needles between locked vertices first, because they would become needles of the base.
    fn remove_needles(&mut self, locked: &[bool]) {
        for collapse in needle_removal::remove_needles_among(&mut self.mesh, &mut self.measure, locked) {
            let Collapse { removed, survivor } = collapse;
            self.merged_into[removed.index()] = survivor;
            self.collapses.push(collapse);
            self.mark_changed(survivor);
        }
    }

    /// Mark a vertex and its neighbours as different from the original run.
    fn mark_changed(&mut self, v: VertexId) {
        self.is_changed[v.index()] = true;
        for (_, w) in self.mesh.connectivity.vertex_edges(v) {
            self.is_changed[w.index()] = true;
        }
    }

    fn replay_collapse(&mut self, collapse: &Collapse, locked: &[bool]) {
        let removed = collapse.removed;
        if self.merged_into[removed.index()] != removed {
            return;
        }
        let mut survivor = collapse.survivor;
        while self.merged_into[survivor.index()] != survivor {
            survivor = self.merged_into[survivor.index()];
        }
        let edge =
            self.mesh.connectivity.vertex_edges(removed).find(|(_, w)| *w == survivor).map(|(edge, _)| edge);
        match edge.filter(|&edge| !locked[removed.index()] && self.can_replay(edge, removed, survivor)) {
            Some(edge) => {
                let point = *self.mesh.point(survivor);
                let done = self.mesh.collapse(edge, survivor, point);
                self.measure.commit(&self.mesh, &self.star, &done, 0.0);
                self.collapses.push(Collapse { removed, survivor });
                self.is_changed[survivor.index()] |= self.is_changed[removed.index()];
            }
            None => {
                self.mark_changed(removed);
                self.mark_changed(survivor);
            }
        }
    }

    /// Check whether a vertex may be removed, and gather its star for the collapse.
    fn can_replay(&mut self, edge: EdgeId, removed: VertexId, survivor: VertexId) -> bool {
        if can_collapse(&self.mesh.connectivity, edge, &mut self.marks).is_err() {
            return false;
        }
        self.star.gather(&self.mesh, edge);
        let is_as_it_was = !self.is_changed[removed.index()] && !self.is_changed[survivor.index()];
        let end = usize::from(self.star.ends[1] == survivor);
        !self.star.end_is_fixed[1 - end]
            && (is_as_it_was || self.measure.is_feasible(&self.mesh, &self.star, end))
    }
}
