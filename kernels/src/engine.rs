//! The edge-collapse engine: queue, legality and bookkeeping. What a collapse costs, where it leads and
//! what it may change is the business of a [`Measure`].
//!
//! ```text
//! queue ← every edge, by measure.priority
//! until the queue is empty or the mesh has few enough triangles:
//!     e ← first of the queue
//!     topology legal?             legality::can_collapse
//!     where to?                   measure.propose
//!     no triangle folds?          legality::keeps_triangles
//!     within the bounds?          measure.judge
//!     collapse, measure.commit, and offer the edges around again
//! ```

use crate::error::KernelError;
use crate::ids::{EdgeId, VertexId};
use crate::legality::{Illegal, Marks, can_collapse, keeps_triangles};
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::queue::Queue;
use crate::star::Star;

pub use crate::connectivity::Collapsed;

/// Where a measure wants to take the star of an edge.
#[derive(Clone, Copy, Debug)]
pub struct Proposal<const D: usize, C> {
    /// The end that keeps its number, 0 or 1.
    pub survivor: usize,
    /// Where it goes; a half-edge collapse leaves it where it is.
    pub point: [f64; D],
    /// What the measure works out on the way and records if the collapse takes place.
    pub change: C,
}

/// The part of a simplifier that varies.
///
/// The engine calls `priority` whenever it needs the order, then `propose`, `judge` and `commit` in this order
/// for one edge, stopping at the first refusal.
pub trait Measure<const D: usize> {
    /// A refusal of the measure's own.
    type Bound: Copy + Eq + std::fmt::Debug;
    /// What one collapse adds to the records.
    type Change;

    /// Edges are tried from the smallest value up. May depend on the edge, its ends and what is recorded of
    /// them, and nothing else: only edges of the new star are asked again after a collapse.
    fn priority(&self, mesh: &Mesh<D>, edge: EdgeId) -> Result<f64, Self::Bound>;

    /// Where the star of an edge should go. Refusals that are cheap to find belong here.
    fn propose(&mut self, mesh: &Mesh<D>, star: &Star<D>) -> Result<Proposal<D, Self::Change>, Self::Bound>;

    /// Whether a proposal that folds no triangle keeps the bounds; may complete its `change`.
    fn judge(
        &mut self,
        mesh: &Mesh<D>,
        star: &Star<D>,
        proposal: &mut Proposal<D, Self::Change>,
    ) -> Result<(), Self::Bound>;

    /// Record a collapse. `mesh` is as it is now; `star` as it was, with the triangles that vanished and those
    /// that moved from the removed end to the survivor.
    fn commit(&mut self, mesh: &Mesh<D>, star: &Star<D>, collapsed: &Collapsed, change: Self::Change);
}

/// Why an edge stands.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Refusal<B> {
    Illegal(Illegal),
    /// Its priority was refused: only a change of the edge itself can help.
    Barred(B),
    /// Its proposal was refused: any change of its star can help.
    Bound(B),
}

/// What one turn of the engine did.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Step<B> {
    Collapsed(Collapsed),
    Refused(EdgeId, Refusal<B>),
    /// The queue is empty.
    Finished,
}

/// Why a run ended.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Stop {
    /// No edge is left that may collapse.
    Exhausted,
    /// The wanted number of triangles is reached.
    Target,
}

pub struct Engine<const D: usize, M: Measure<D>> {
    mesh: Mesh<D>,
    measure: M,
    queue: Queue,
    refusals: Vec<Option<Refusal<M::Bound>>>,
    /// Vertices with an edge whose attempt was refused since they were last looked at. Most have none, and
    /// their edges then need not be fetched from memory.
    stuck: Vec<bool>,
    marks: Marks,
    star: Star<D>,
    ring: Vec<VertexId>,
    collapses: u64,
    attempts: u64,
}

impl<const D: usize, M: Measure<D>> Engine<D, M> {
    pub fn new(mesh: Mesh<D>, measure: M) -> Self {
        let slots = mesh.connectivity.edge_slots();
        let mut refusals = vec![None; slots];
        let entries = mesh.connectivity.edges().filter_map(|edge| match measure.priority(&mesh, edge) {
            Ok(priority) => Some((edge, priority)),
            Err(bound) => {
                refusals[edge.index()] = Some(Refusal::Barred(bound));
                None
            }
        });
        let queue = Queue::new(slots, entries);
        let vertices = mesh.connectivity.vertex_slots();
        Self {
            mesh,
            measure,
            queue,
            refusals,
            stuck: vec![false; vertices],
            marks: Marks::new(vertices),
            star: Star::default(),
            ring: vec![],
            collapses: 0,
            attempts: 0,
        }
    }

    /// Collapse until no edge may or at most `target_triangles` are left.
    ///
    /// # Errors
    /// [`KernelError::Interrupted`] when `progress` says so.
    pub fn run(&mut self, target_triangles: usize, progress: &mut Progress) -> Result<Stop, KernelError> {
        let (edges, triangles) = (self.queue.len(), self.mesh.connectivity.triangle_count());
        let to_remove = triangles.saturating_sub(target_triangles).max(1);
        loop {
            let left = self.mesh.connectivity.triangle_count();
            if left <= target_triangles {
                return Ok(Stop::Target);
            }
            if self.step() == Step::Finished {
                return Ok(Stop::Exhausted);
            }
            progress.tick(|| {
                // Whichever end is nearer: an empty queue or the target.
                let settled = edges.saturating_sub(self.queue.len());
                let removed = (triangles - left) as u128 * edges as u128 / to_remove as u128;
                (settled.max(removed as usize) as u64, edges as u64)
            })?;
        }
    }

    /// Try the first edge of the queue.
    pub fn step(&mut self) -> Step<M::Bound> {
        let Some(edge) = self.queue.pop() else {
            return Step::Finished;
        };
        self.attempts += 1;
        match self.attempt(edge) {
            Ok(collapsed) => Step::Collapsed(collapsed),
            Err(refusal) => {
                self.refusals[edge.index()] = Some(refusal);
                for v in self.mesh.connectivity.ends(edge) {
                    self.stuck[v.index()] = true;
                }
                Step::Refused(edge, refusal)
            }
        }
    }

    fn attempt(&mut self, edge: EdgeId) -> Result<Collapsed, Refusal<M::Bound>> {
        can_collapse(&self.mesh.connectivity, edge, &mut self.marks).map_err(Refusal::Illegal)?;
        self.star.gather(&self.mesh, edge);
        let mut proposal = self.measure.propose(&self.mesh, &self.star).map_err(Refusal::Bound)?;
        keeps_triangles(&self.star, &proposal.point).map_err(Refusal::Illegal)?;
        self.measure.judge(&self.mesh, &self.star, &mut proposal).map_err(Refusal::Bound)?;

        let survivor = self.star.ends[proposal.survivor];
        let collapsed = self.mesh.collapse(edge, survivor, proposal.point);
        self.collapses += 1;
        self.measure.commit(&self.mesh, &self.star, &collapsed, proposal.change);
        for (_, gone) in collapsed.merged.into_iter().flatten() {
            self.queue.discard(gone);
        }
        self.offer_around(survivor);
        Ok(collapsed)
    }

    /// Bring the queue up to date around a vertex that has moved.
    fn offer_around(&mut self, centre: VertexId) {
        let connectivity = &self.mesh.connectivity;
        self.ring.clear();
        self.ring.extend(connectivity.spokes(centre).map(|(_, v)| v));
        for &edge in self.star.others.iter().filter(|&&edge| connectivity.is_edge(edge)) {
            offer(edge, &self.mesh, &self.measure, &mut self.queue, &mut self.refusals);
        }
        // Other edges with one end on the ring: what was refused may be legal now that their stars have changed.
        for &v in &self.ring {
            if std::mem::replace(&mut self.stuck[v.index()], false) {
                for (edge, _) in connectivity.spokes(v) {
                    if matches!(self.refusals[edge.index()], Some(Refusal::Illegal(_) | Refusal::Bound(_))) {
                        offer(edge, &self.mesh, &self.measure, &mut self.queue, &mut self.refusals);
                    }
                }
            }
        }
    }

    pub fn mesh(&self) -> &Mesh<D> {
        &self.mesh
    }

    pub fn measure(&self) -> &M {
        &self.measure
    }

    pub fn collapses(&self) -> u64 {
        self.collapses
    }

    /// Edges that reached the front of the queue, some of them more than once.
    pub fn attempts(&self) -> u64 {
        self.attempts
    }

    /// Edges of the mesh as it is now that stand because of a refusal `is` accepts: each counts once, under
    /// the rule that refused it last.
    pub fn standing(&self, is: impl Fn(Refusal<M::Bound>) -> bool) -> usize {
        self.mesh.connectivity.edges().filter(|e| self.refusals[e.index()].is_some_and(&is)).count()
    }

    pub fn into_mesh(self) -> Mesh<D> {
        self.mesh
    }
}

/// Put an edge where its priority belongs now: into the queue, or among the refused.
fn offer<const D: usize, M: Measure<D>>(
    edge: EdgeId,
    mesh: &Mesh<D>,
    measure: &M,
    queue: &mut Queue,
    refusals: &mut [Option<Refusal<M::Bound>>],
) {
    match measure.priority(mesh, edge) {
        Ok(priority) => {
            refusals[edge.index()] = None;
            queue.set(edge, priority);
        }
        Err(bound) => {
            refusals[edge.index()] = Some(Refusal::Barred(bound));
            queue.discard(edge);
        }
    }
}
