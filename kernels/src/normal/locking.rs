//! Rebuild of a base mesh with additional input vertices where its levels fold.
//!
//! If no vertex position removes a fold, the base lacks vertices to represent the surface there. The input
//! has no folds, so a few locked input vertices suffice. All other collapses are replayed unchanged, so the
//! rest of the base and its levels stay as they are.

use super::base_mesh::{Base, Collapse};
use super::coarsening::{DEAR, RULES, Target, described};
use super::fold::Fold;
use super::half_edge::HalfEdge;
use super::input::Input;
use super::needles;
use crate::base::errors::KernelError;
use crate::base::geometry::{around, diagonal, distance2};
use crate::base::ids::{EdgeId, VertexId};
use crate::base::progress::Progress;
use crate::collapse::engine::{Engine, Measure, Until};
use crate::mesh::legality::{Marks, can_collapse};
use crate::mesh::star::Star;
use crate::mesh::triangle_mesh::{Lock, Mesh};

/// Input vertices to keep in a rebuilt base.
#[derive(Clone, Debug)]
pub struct Locking {
    /// Collapses that produced the original base, and its vertices (indices of the input).
    collapses: Vec<Collapse>,
    vertices: Vec<u32>,
    /// True for each input vertex that the base must keep.
    locked: Vec<bool>,
    /// Number of rounds with a fold next to a triangle of each input vertex.
    times: Vec<u8>,
}

impl Locking {
    /// Create the state without locked vertices.
    pub fn new(base: &Base, input: &Input<'_>) -> Self {
        let count = input.points.len();
        Self {
            collapses: base.collapses.clone(),
            vertices: base.vertex_source.clone(),
            locked: vec![false; count],
            times: vec![0; count],
        }
    }

    /// Lock input vertices next to folds. On the first fold of a base triangle, lock the nearest input vertex
    /// that the base lacks. If the same region folds again, lock all corners of the nearest input triangle,
    /// then one more ring per round.
    pub fn lock(&mut self, folds: &[Fold], base: &Base, input: &Input<'_>) {
        let mut is_in_base = vec![false; self.locked.len()];
        base.vertex_source.iter().for_each(|&v| is_in_base[v as usize] = true);
        // Number of rings to lock around each vertex, counting the vertex itself.
        let mut depth = vec![0u8; self.locked.len()];
        let mut times = self.times.clone();
        let mut is_done = vec![false; base.triangles.len()];
        for fold in folds {
            // Search only the associated set, because another sheet may be nearer.
            let set = base.sets.of(fold.triangle).iter().copied();
            let slot = input.surface.nearest_among(&fold.middle, set).slot;
            let corners = input.surface.vertices(slot).map(|v| v as usize);
            let before = corners.iter().fold(0, |most, &v| most.max(self.times[v]));
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
        self.times = times;
        spread(&mut depth, input.triangles);
        self.locked.iter_mut().zip(&depth).for_each(|(locked, depth)| *locked |= *depth > 0);
    }

    /// Build the base by replaying the collapses, except those that remove a locked vertex. In regions that
    /// differ from the original base, flipped triangles are refused.
    ///
    /// # Errors
    /// [`KernelError::Interrupted`], and errors of [`Mesh::new`].
    pub fn base(
        &self,
        input: &Input<'_>,
        target: Target,
        progress: &mut Progress,
    ) -> Result<Base, KernelError> {
        let mesh = Mesh::new(input.points.clone(), input.triangles)?;
        let size = diagonal(&around(mesh.connectivity.vertices().map(|v| *mesh.point(v))));
        let mut measure = HalfEdge::new(&mesh, &input.surface, target.error, RULES[0]);
        (measure.upright, measure.limit) = (true, DEAR * size.powi(4));
        let mut again = Again::new(mesh, measure);
        again.remove_needles(&self.locked);
        for collapse in &self.collapses {
            again.collapse(collapse, &self.locked);
            progress.check_now_and_then()?;
        }
        let Again { mut mesh, measure, mut collapses, .. } = again;
        // Other extra vertices are left only because a replayed collapse was blocked. Collapse them, too.
        let locked = (0..).zip(&self.locked).filter(|(_, locked)| **locked).map(|(v, _)| v);
        self.vertices.iter().copied().chain(locked).for_each(|v| mesh.locks[v as usize] = Lock::Locked);
        let mut engine = Engine::new(mesh, measure);
        engine.run(Until::EXHAUSTED, progress)?;
        let (mesh, measure, _, merges, _) = engine.into_parts();
        collapses.extend(merges.iter().map(Collapse::from));
        Ok(described(&mesh, &measure, &input.slots, collapses))
    }
}

/// Propagate depths: each neighbour of a vertex gets at least its depth minus one.
fn spread(depth: &mut [u8], triangles: &[[u32; 3]]) {
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
struct Again<'a> {
    mesh: Mesh<3>,
    measure: HalfEdge<'a>,
    collapses: Vec<Collapse>,
    /// True for vertices whose triangles differ from the original run at this step.
    is_other: Vec<bool>,
    /// Survivor of each vertex that needle removal collapsed before its recorded turn; otherwise the vertex
    /// itself.
    into: Vec<VertexId>,
    marks: Marks,
    star: Star<3>,
}

impl<'a> Again<'a> {
    fn new(mesh: Mesh<3>, measure: HalfEdge<'a>) -> Self {
        let count = mesh.points.len();
        Self {
            mesh,
            measure,
            collapses: vec![],
            is_other: vec![false; count],
            into: (0..count).map(VertexId::from_index).collect(),
            marks: Marks::new(count),
            star: Star::default(),
        }
    }

    /// Remove needles between locked vertices first, because they would become needles of the base.
    fn remove_needles(&mut self, locked: &[bool]) {
        for collapse in needles::remove_among(&mut self.mesh, &mut self.measure, locked) {
            let Collapse { removed, survivor } = collapse;
            self.into[removed.index()] = survivor;
            self.collapses.push(collapse);
            self.mark(survivor);
        }
    }

    /// Mark a vertex and its neighbours as different from the original run.
    fn mark(&mut self, v: VertexId) {
        self.is_other[v.index()] = true;
        for (_, w) in self.mesh.connectivity.spokes(v) {
            self.is_other[w.index()] = true;
        }
    }

    fn collapse(&mut self, collapse: &Collapse, locked: &[bool]) {
        let removed = collapse.removed;
        if self.into[removed.index()] != removed {
            return;
        }
        let mut survivor = collapse.survivor;
        while self.into[survivor.index()] != survivor {
            survivor = self.into[survivor.index()];
        }
        let edge = self.mesh.connectivity.spokes(removed).find(|(_, w)| *w == survivor).map(|(edge, _)| edge);
        match edge.filter(|&edge| !locked[removed.index()] && self.may_collapse(edge, removed, survivor)) {
            Some(edge) => {
                let point = *self.mesh.point(survivor);
                let done = self.mesh.collapse(edge, survivor, point);
                self.measure.commit(&self.mesh, &self.star, &done, 0.0);
                self.collapses.push(Collapse { removed, survivor });
                self.is_other[survivor.index()] |= self.is_other[removed.index()];
            }
            None => {
                self.mark(removed);
                self.mark(survivor);
            }
        }
    }

    /// Check whether a vertex may be removed, and gather its star for the collapse.
    fn may_collapse(&mut self, edge: EdgeId, removed: VertexId, survivor: VertexId) -> bool {
        if can_collapse(&self.mesh.connectivity, edge, &mut self.marks).is_err() {
            return false;
        }
        self.star.gather(&self.mesh, edge);
        let is_as_it_was = !self.is_other[removed.index()] && !self.is_other[survivor.index()];
        let end = usize::from(self.star.ends[1] == survivor);
        !self.star.end_stays[1 - end] && (is_as_it_was || self.measure.fits(&self.mesh, &self.star, end))
    }
}
