//! Edge-collapse engine: queue, legality and bookkeeping.
//!
//! The cost of a collapse, the new position and further constraints come from a [`Measure`].
//!
//! ```text
//! queue ← every edge, by measure.priority
//! until the queue is empty, or the target is reached:
//!     e ← first edge of the queue
//!     topology preserved?         legality::can_collapse
//!     new position                measure.propose
//!     no triangle folds?          legality::keeps_triangles
//!     within the bounds?          measure.judge
//!     collapse, measure.commit, and requeue the edges around
//! ```

use crate::base::errors::KernelError;
use crate::base::ids::{EdgeId, VertexId};
use crate::base::progress::Progress;
use crate::collapse::queue::Queue;
use crate::mesh::legality::{Illegal, Marks, can_collapse, keeps_triangles, new_chord};
use crate::mesh::star::Star;
use crate::mesh::triangle_mesh::{Lock, Mesh};

pub use crate::mesh::connectivity::Collapsed;

/// A proposed collapse of an edge.
#[derive(Clone, Copy, Debug)]
pub struct Proposal<const D: usize, C> {
    /// The end that keeps its index, 0 or 1.
    pub survivor: usize,
    /// New position of the survivor; unchanged for a half-edge collapse.
    pub point: [f64; D],
    /// Intermediate result of the measure that `commit` needs.
    pub change: C,
}

/// The edges whose priorities a collapse changes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Reach {
    /// Edges from the survivor.
    Spokes,
    /// Edges of the new star.
    Star,
    /// All edges that touch the new star. Edges from the survivor are updated at once. The others change
    /// little and are updated when they reach the front of the queue.
    Ring,
}

/// Cost function and constraints of a simplification method.
///
/// The engine calls `priority` whenever it needs the order of an edge. To collapse an edge it calls
/// `propose`, `judge` and `commit` in this order, and stops at the first refusal.
pub trait Measure<const D: usize> {
    /// Reason for a refusal by the measure.
    type Bound: Copy + Eq + Send + Sync + std::fmt::Debug;
    /// Data passed from `propose` to `commit`.
    type Change;

    /// The edges whose priorities a collapse changes.
    const REACH: Reach = Reach::Star;

    /// Compute the priority of an edge; the smallest is tried first.
    ///
    /// May depend only on the edge, its ends and the state stored for them: only edges of the new star are
    /// updated after a collapse.
    fn priority(&self, mesh: &Mesh<D>, edge: EdgeId) -> Result<f64, Self::Bound>;

    /// Propose a survivor and its new position. Refusals that are cheap to find belong here.
    fn propose(&mut self, mesh: &Mesh<D>, star: &Star<D>) -> Result<Proposal<D, Self::Change>, Self::Bound>;

    /// Check the bounds of a proposal that folds no triangle; may complete its `change`.
    fn judge(
        &mut self,
        mesh: &Mesh<D>,
        star: &Star<D>,
        proposal: &mut Proposal<D, Self::Change>,
    ) -> Result<(), Self::Bound>;

    /// Refuse collapses that would create an edge between locked vertices: see [`new_chord`].
    fn without_chords(&self) -> bool {
        false
    }

    /// Return the actual cost of a proposal, if `priority` is only an estimate.
    ///
    /// An edge that costs more than the next one is put back into the queue.
    fn cost(&self, _: &Proposal<D, Self::Change>) -> f64 {
        f64::NEG_INFINITY
    }

    /// Update the state after a collapse.
    ///
    /// `mesh` is the mesh after the collapse. `star` is the star before it, with the triangles that vanished
    /// and those that moved to the survivor.
    fn commit(&mut self, mesh: &Mesh<D>, star: &Star<D>, collapsed: &Collapsed, change: Self::Change);
}

/// Reason why an edge cannot collapse.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Refusal<B> {
    Illegal(Illegal),
    /// The priority was refused: only a change of the edge itself can help.
    Barred(B),
    /// The proposal was refused: any change of the star can help.
    Bound(B),
    /// The edge costs more than the next one and is in the queue again.
    Later,
    /// The star reaches the rim of the region, so another region must decide.
    Rim,
}

/// Result of one step of the engine.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Step<B> {
    Collapsed(Collapsed),
    Refused(EdgeId, Refusal<B>),
    /// The queue is empty.
    Finished,
}

/// Reason why a run ended.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Stop {
    /// No edge is left that can collapse.
    Exhausted,
    /// The requested number of triangles or collapses, or the priority limit, is reached.
    Target,
    /// A round collapsed fewer edges than the minimum of the goal.
    Few,
    /// The caller asked to keep the mesh simplified so far.
    Enough,
}

/// Stop criteria of a run; the first one that is met applies.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Until {
    /// At most this many triangles are left.
    pub triangles: usize,
    /// This many collapses have taken place.
    pub collapses: usize,
    /// All remaining edges have a larger priority.
    pub priority: f64,
}

impl Until {
    /// Run until no edge can collapse.
    pub const EXHAUSTED: Self = Self { triangles: 0, collapses: usize::MAX, priority: f64::INFINITY };
}

/// Record of a collapse.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Merge {
    pub removed: VertexId,
    pub survivor: VertexId,
    /// Maximum priority of all collapses so far, so it never decreases from merge to merge.
    pub priority: f64,
    /// Number of triangles that vanished, 1 or 2.
    pub triangles: u8,
}

/// Edge-collapse loop over one mesh with one queue.
pub struct Engine<const D: usize, M: Measure<D>> {
    mesh: Mesh<D>,
    measure: M,
    queue: Queue,
    refusals: Vec<Option<Refusal<M::Bound>>>,
    /// Vertices with an edge that was refused since they were last updated. Most vertices have none, and
    /// their edges need not be fetched from memory.
    stuck: Vec<bool>,
    marks: Marks,
    changes: Changes,
    star: Star<D>,
    ring: Vec<VertexId>,
    merges: Vec<Merge>,
    /// Positions of the survivors, if they are recorded.
    path: Option<Vec<[f64; D]>>,
    attempts: u64,
}

/// By edge: the reason why it cannot collapse.
pub type Refusals<B> = Vec<Option<Refusal<B>>>;

/// Mesh, measure, refusals, merges, and survivor positions if they were recorded.
pub type Parts<const D: usize, M> =
    (Mesh<D>, M, Refusals<<M as Measure<D>>::Bound>, Vec<Merge>, Option<Vec<[f64; D]>>);

impl<const D: usize, M: Measure<D>> Engine<D, M> {
    pub fn new(mesh: Mesh<D>, measure: M) -> Self {
        let refusals = vec![None; mesh.connectivity.edge_slots()];
        Self::resume(mesh, measure, refusals)
    }

    /// Continue with known refusals: refused edges wait until their surroundings change.
    pub fn resume(mesh: Mesh<D>, measure: M, mut refusals: Refusals<M::Bound>) -> Self {
        let slots = mesh.connectivity.edge_slots();
        let vertices = mesh.connectivity.vertex_slots();
        let mut stuck = vec![false; vertices];
        for edge in mesh.connectivity.edges().filter(|e| refusals[e.index()].is_some()) {
            mesh.connectivity.ends(edge).iter().for_each(|v| stuck[v.index()] = true);
        }
        let open: Vec<EdgeId> = mesh
            .connectivity
            .edges()
            .filter(|&edge| refusals[edge.index()].is_none() && !on_rim(&mesh, edge))
            .collect();
        let entries = open.into_iter().filter_map(|edge| match measure.priority(&mesh, edge) {
            Ok(priority) => Some((edge, priority)),
            Err(bound) => {
                refusals[edge.index()] = Some(Refusal::Barred(bound));
                None
            }
        });
        let queue = Queue::new(slots, entries);
        Self {
            mesh,
            measure,
            queue,
            refusals,
            stuck,
            marks: Marks::new(vertices),
            changes: if M::REACH == Reach::Ring { Changes::new(vertices, slots) } else { Changes::new(0, 0) },
            star: Star::default(),
            ring: vec![],
            merges: vec![],
            path: None,
            attempts: 0,
        }
    }

    /// Record the positions of survivors from now on.
    pub fn record_path(&mut self) {
        self.path = Some(vec![]);
    }

    /// Collapse edges until a stop criterion is met.
    ///
    /// # Errors
    /// [`KernelError::Interrupted`] when `progress` requests it.
    pub fn run(&mut self, until: Until, progress: &mut Progress) -> Result<Stop, KernelError> {
        loop {
            let few = self.mesh.connectivity.triangle_count() <= until.triangles;
            if few || self.merges.len() >= until.collapses {
                return Ok(Stop::Target);
            }
            self.refresh_first();
            match self.queue.first() {
                None => return Ok(Stop::Exhausted),
                Some((_, priority)) if priority > until.priority => return Ok(Stop::Target),
                Some(_) => self.step(),
            };
            progress.check_now_and_then()?;
            if progress.is_enough() {
                return Ok(Stop::Enough);
            }
        }
    }

    /// Update the first edge of the queue until its priority is current.
    fn refresh_first(&mut self) {
        if M::REACH != Reach::Ring {
            return;
        }
        while let Some((edge, _)) = self.queue.first() {
            if !self.changes.is_stale(edge, self.mesh.connectivity.ends(edge)) {
                break;
            }
            self.changes.freshen(edge);
            offer(edge, &self.mesh, &self.measure, &mut self.queue, &mut self.refusals);
        }
    }

    /// Try the first edge of the queue.
    pub fn step(&mut self) -> Step<M::Bound> {
        self.refresh_first();
        let Some((edge, priority)) = self.queue.first() else {
            return Step::Finished;
        };
        self.queue.discard(edge);
        self.attempts += 1;
        match self.attempt(edge, priority) {
            Ok(collapsed) => Step::Collapsed(collapsed),
            Err(refusal) => {
                // Another region may allow an edge at the rim, so it stays open.
                if !matches!(refusal, Refusal::Rim | Refusal::Later) {
                    self.refusals[edge.index()] = Some(refusal);
                    for v in self.mesh.connectivity.ends(edge) {
                        self.stuck[v.index()] = true;
                    }
                }
                Step::Refused(edge, refusal)
            }
        }
    }

    fn attempt(&mut self, edge: EdgeId, priority: f64) -> Result<Collapsed, Refusal<M::Bound>> {
        can_collapse(&self.mesh.connectivity, edge, &mut self.marks).map_err(Refusal::Illegal)?;
        self.star.gather(&self.mesh, edge);
        if self.star.end_stays == [true, true] {
            return Err(Refusal::Illegal(Illegal::Locked));
        }
        let on_rim = |v: VertexId| self.mesh.lock(v) == Lock::Rim;
        if self.star.wings.iter().any(|w| on_rim(w.from) && on_rim(w.to)) {
            return Err(Refusal::Rim);
        }
        if self.measure.without_chords() {
            match new_chord(&self.mesh, &self.star) {
                Some(Lock::Rim) => return Err(Refusal::Rim),
                Some(_) => return Err(Refusal::Illegal(Illegal::Locked)),
                None => {}
            }
        }
        let mut proposal = self.measure.propose(&self.mesh, &self.star).map_err(Refusal::Bound)?;
        keeps_triangles(&self.star, &proposal.point).map_err(Refusal::Illegal)?;
        self.measure.judge(&self.mesh, &self.star, &mut proposal).map_err(Refusal::Bound)?;
        let cost = self.measure.cost(&proposal);
        if cost > priority && self.queue.first().is_some_and(|(_, next)| next < cost) {
            self.queue.set(edge, cost);
            return Err(Refusal::Later);
        }
        let priority = priority.max(cost);

        let survivor = self.star.ends[proposal.survivor];
        let collapsed = self.mesh.collapse(edge, survivor, proposal.point);
        let highest = self.merges.last().map_or(priority, |last| last.priority.max(priority));
        self.merges.push(Merge {
            removed: collapsed.removed,
            survivor,
            priority: highest,
            triangles: collapsed.merged.iter().flatten().count() as u8,
        });
        if let Some(path) = &mut self.path {
            path.push(proposal.point);
        }
        self.measure.commit(&self.mesh, &self.star, &collapsed, proposal.change);
        for (_, gone) in collapsed.merged.into_iter().flatten() {
            self.queue.discard(gone);
        }
        self.offer_around(survivor);
        Ok(collapsed)
    }

    /// Update the queue around a vertex that has moved.
    fn offer_around(&mut self, centre: VertexId) {
        let connectivity = &self.mesh.connectivity;
        self.ring.clear();
        self.ring.extend(connectivity.spokes(centre).map(|(_, v)| v));
        match M::REACH {
            Reach::Spokes => {
                for (edge, _) in connectivity.spokes(centre).filter(|(edge, _)| !on_rim(&self.mesh, *edge)) {
                    offer(edge, &self.mesh, &self.measure, &mut self.queue, &mut self.refusals);
                }
            }
            Reach::Star => {
                let live = |edge: &&EdgeId| connectivity.is_edge(**edge) && !on_rim(&self.mesh, **edge);
                for &edge in self.star.others.iter().filter(live) {
                    offer(edge, &self.mesh, &self.measure, &mut self.queue, &mut self.refusals);
                }
            }
            Reach::Ring => {
                self.changes.next();
                for (edge, v) in connectivity.spokes(centre) {
                    self.changes.around(v);
                    self.changes.freshen(edge);
                    if !on_rim(&self.mesh, edge) {
                        offer(edge, &self.mesh, &self.measure, &mut self.queue, &mut self.refusals);
                    }
                }
            }
        }
        // Other edges from the ring: refused ones may be legal now, because their stars have changed.
        for &v in &self.ring {
            if std::mem::replace(&mut self.stuck[v.index()], false) {
                for (edge, _) in connectivity.spokes(v) {
                    let refused =
                        matches!(self.refusals[edge.index()], Some(Refusal::Illegal(_) | Refusal::Bound(_)));
                    if refused && !on_rim(&self.mesh, edge) {
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

    /// Return all collapses in chronological order.
    pub fn merges(&self) -> &[Merge] {
        &self.merges
    }

    /// Iterate over the priorities of the queued edges, unordered.
    pub fn waiting(&self) -> impl Iterator<Item = f64> + '_ {
        self.queue.keys()
    }

    /// Return the reason why an edge cannot collapse; `None` while it is untried.
    pub fn refusal(&self, edge: EdgeId) -> Option<Refusal<M::Bound>> {
        self.refusals[edge.index()]
    }

    /// Number of edges tried; an edge may count several times.
    pub fn attempts(&self) -> u64 {
        self.attempts
    }

    /// Return the mesh and all state.
    pub fn into_parts(self) -> Parts<D, M> {
        (self.mesh, self.measure, self.refusals, self.merges, self.path)
    }
}

/// Tracks which queued priorities are out of date. Marking vertices is cheaper than visiting all edges around
/// each of them after every collapse.
struct Changes {
    /// Number of changes so far.
    count: u32,
    /// By vertex: the last change next to it.
    beside: Vec<u32>,
    /// By edge: the last change that its priority includes.
    known: Vec<u32>,
}

impl Changes {
    fn new(vertices: usize, edges: usize) -> Self {
        Self { count: 0, beside: vec![0; vertices], known: vec![0; edges] }
    }

    /// Start the next change.
    fn next(&mut self) {
        self.count += 1;
    }

    /// Mark that the current change affects the edges of a vertex.
    fn around(&mut self, v: VertexId) {
        self.beside[v.index()] = self.count;
    }

    /// Mark the priority of an edge as current.
    fn freshen(&mut self, edge: EdgeId) {
        self.known[edge.index()] = self.count;
    }

    fn is_stale(&self, edge: EdgeId, ends: [VertexId; 2]) -> bool {
        ends.iter().any(|v| self.beside[v.index()] > self.known[edge.index()])
    }
}

/// Test if an edge has an end on the rim of the region.
#[inline]
fn on_rim<const D: usize>(mesh: &Mesh<D>, edge: EdgeId) -> bool {
    mesh.connectivity.ends(edge).iter().any(|&v| mesh.lock(v) == Lock::Rim)
}

/// Requeue an edge with its current priority, or record its refusal.
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
