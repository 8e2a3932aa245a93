//! A base mesh once more, with more of the input's vertices where its levels fold.
//!
//! A triangle that is still turned over when its vertices have been tried everywhere is so because the base leaves out what
//! the surface does there. The input is not turned against itself: with enough of its own vertices nothing folds, and a few
//! do. All other collapses are done again as they were, so that the rest of the base stays, and its levels with it.

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

/// A base that gets more vertices where its levels fold.
#[derive(Clone, Debug)]
pub struct Locking {
    /// The collapses that made it, and the vertices of the input it had then.
    collapses: Vec<Collapse>,
    vertices: Vec<u32>,
    /// Vertices of the input that it has to have.
    locked: Vec<bool>,
    /// How often something has folded next to a triangle with this corner.
    times: Vec<u8>,
}

impl Locking {
    /// None is locked yet.
    pub fn new(base: &Base, input: &Input<'_>) -> Self {
        let count = input.points.len();
        Self {
            collapses: base.collapses.clone(),
            vertices: base.vertex_source.clone(),
            locked: vec![false; count],
            times: vec![0; count],
        }
    }

    /// Lock what lies next to the folds over a base: for each of its triangles the vertex of the input nearest to the first of
    /// them, of those that the base has not. Where something folds once more, all corners of the nearest triangle, then those
    /// around them, ring by ring.
    pub fn lock(&mut self, folds: &[Fold], base: &Base, input: &Input<'_>) {
        let mut is_in_base = vec![false; self.locked.len()];
        base.vertex_source.iter().for_each(|&v| is_in_base[v as usize] = true);
        // How many rings around each vertex are locked, itself among them.
        let mut depth = vec![0u8; self.locked.len()];
        let mut times = self.times.clone();
        let mut is_done = vec![false; base.triangles.len()];
        for fold in folds {
            // Another sheet may be nearer.
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

    /// The base that its collapses make where none of them takes a locked vertex. Where it differs from what it was, no
    /// triangle may look away from the surface.
    ///
    /// # Errors
    /// [`KernelError::Interrupted`], or what [`Mesh::new`] returns.
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
        // Vertices that only the order of collapses has left may go, too.
        let locked = (0..).zip(&self.locked).filter(|(_, locked)| **locked).map(|(v, _)| v);
        self.vertices.iter().copied().chain(locked).for_each(|v| mesh.locks[v as usize] = Lock::Locked);
        let mut engine = Engine::new(mesh, measure);
        engine.run(Until::EXHAUSTED, progress)?;
        let (mesh, measure, _, merges, _) = engine.into_parts();
        collapses.extend(merges.iter().map(Collapse::from));
        Ok(described(&mesh, &measure, &input.slots, collapses))
    }
}

/// Make the neighbours of a vertex at least as deep as it is, less one.
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

/// A mesh whose collapses are done again.
struct Again<'a> {
    mesh: Mesh<3>,
    measure: HalfEdge<'a>,
    collapses: Vec<Collapse>,
    /// Vertices whose triangles are others than they were at this time.
    is_other: Vec<bool>,
    /// What has become of each vertex that went before its time.
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

    /// Needles among locked vertices would be needles of the base.
    fn remove_needles(&mut self, locked: &[bool]) {
        for collapse in needles::remove_among(&mut self.mesh, &mut self.measure, locked) {
            let Collapse { removed, survivor } = collapse;
            self.into[removed.index()] = survivor;
            self.collapses.push(collapse);
            self.mark(survivor);
        }
    }

    /// The triangles around a vertex are not what they were.
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

    /// Whether a vertex may go; its star is gathered then.
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
