//! Edge-collapse engine: queue, legality and bookkeeping.
//!
//! The cost of a collapse, the new position and further constraints come from a [`PixelMeasure`].
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
use crate::collapse::edge_queue::EdgeQueue;
use crate::mesh::collapse_legality::{
    IllegalCollapse, VertexMarks, can_collapse, check_triangles, find_new_chord,
};
use crate::mesh::edge_star::EdgeStar;
use crate::mesh::triangle_mesh::{Mesh, VertexLock};

pub use crate::mesh::connectivity::CollapseChange;

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
pub enum PriorityScope {
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
    type Reason: Copy + Eq + Send + Sync + std::fmt::Debug;
    /// Data passed from `propose` to `commit`.
    type Change;

    /// The edges whose priorities a collapse changes.
    const PRIORITY_SCOPE: PriorityScope = PriorityScope::Star;

    /// Compute the priority of an edge; the smallest is tried first.
    ///
    /// May depend only on the edge, its ends and the state stored for them: only edges of the new star are
    /// updated after a collapse.
    fn priority(&self, mesh: &Mesh<D>, edge: EdgeId) -> Result<f64, Self::Reason>;

    /// Propose a survivor and its new position. Refusals that are cheap to find belong here.
    fn propose(
        &mut self,
        mesh: &Mesh<D>,
        star: &EdgeStar<D>,
    ) -> Result<Proposal<D, Self::Change>, Self::Reason>;

    /// Check the bounds of a proposal that folds no triangle; may complete its `change`.
    fn judge(
        &mut self,
        mesh: &Mesh<D>,
        star: &EdgeStar<D>,
        proposal: &mut Proposal<D, Self::Change>,
    ) -> Result<(), Self::Reason>;

    /// Refuse collapses that would create an edge between locked vertices: see [`find_new_chord`].
    fn forbids_chords(&self) -> bool {
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
    fn commit(
        &mut self,
        mesh: &Mesh<D>,
        star: &EdgeStar<D>,
        collapsed: &CollapseChange,
        change: Self::Change,
    );
}

/// Reason why an edge cannot collapse.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Refusal<B> {
    Illegal(IllegalCollapse),
    /// The priority was refused: only a change of the edge itself can help.
    PriorityRefused(B),
    /// The proposal was refused: any change of the star can help.
    ProposalRefused(B),
    /// The edge costs more than the next one and is in the queue again.
    Postponed,
    /// The star reaches the rim of the region, so another region must decide.
    Rim,
}

/// Result of one step of the engine.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Step<B> {
    Collapsed(CollapseChange),
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
    Stalled,
    /// The caller asked to keep the mesh simplified so far.
    StoppedByCaller,
}

/// Stop criteria of a run; the first one that is met applies.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct StopCriteria {
    /// At most this many triangles are left.
    pub triangles: usize,
    /// This many collapses have taken place.
    pub collapses: usize,
    /// All remaining edges have a larger priority.
    pub priority: f64,
}

impl StopCriteria {
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
    queue: EdgeQueue,
    refusals: Vec<Option<Refusal<M::Reason>>>,
    /// Vertices with an edge that was refused since they were last updated. Most vertices have none, and
    /// their edges need not be fetched from memory.
    has_refused_edge: Vec<bool>,
    marks: VertexMarks,
    changes: StalePriorities,
    star: EdgeStar<D>,
    ring: Vec<VertexId>,
    merges: Vec<Merge>,
    /// Positions of the survivors, if they are recorded.
    survivor_points: Option<Vec<[f64; D]>>,
    attempts: u64,
}

/// By edge: the reason why it cannot collapse.
pub type Refusals<B> = Vec<Option<Refusal<B>>>;

/// Mesh, measure, refusals, merges, and survivor positions if they were recorded.
pub type EngineParts<const D: usize, M> =
    (Mesh<D>, M, Refusals<<M as Measure<D>>::Reason>, Vec<Merge>, Option<Vec<[f64; D]>>);

impl<const D: usize, M: Measure<D>> Engine<D, M> {
    pub fn new(mesh: Mesh<D>, measure: M) -> Self {
        let refusals = vec![None; mesh.connectivity.edge_slots()];
        Self::resume(mesh, measure, refusals)
    }

    /// Continue with known refusals: refused edges wait until their surroundings change.
    pub fn resume(mesh: Mesh<D>, measure: M, mut refusals: Refusals<M::Reason>) -> Self {
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
                refusals[edge.index()] = Some(Refusal::PriorityRefused(bound));
                None
            }
        });
        let queue = EdgeQueue::new(slots, entries);
        Self {
            mesh,
            measure,
            queue,
            refusals,
            has_refused_edge: stuck,
            marks: VertexMarks::new(vertices),
            changes: if M::PRIORITY_SCOPE == PriorityScope::Ring {
                StalePriorities::new(vertices, slots)
            } else {
                StalePriorities::new(0, 0)
            },
            star: EdgeStar::default(),
            ring: vec![],
            merges: vec![],
            survivor_points: None,
            attempts: 0,
        }
    }

    /// Record the positions of survivors from now on.
    pub fn record_survivor_points(&mut self) {
        self.survivor_points = Some(vec![]);
    }

    /// Collapse edges until a stop criterion is met.
    ///
    /// # Errors
    /// [`KernelError::Interrupted`] when `progress` requests it.
    pub fn run(&mut self, until: StopCriteria, progress: &mut Progress) -> Result<Stop, KernelError> {
        loop {
            let few = self.mesh.connectivity.triangle_count() <= until.triangles;
            if few || self.merges.len() >= until.collapses {
                return Ok(Stop::Target);
            }
            self.update_first();
            match self.queue.first() {
                None => return Ok(Stop::Exhausted),
                Some((_, priority)) if priority > until.priority => return Ok(Stop::Target),
                Some(_) => self.step(),
            };
            progress.check_periodically()?;
            if progress.is_stopping_early() {
                return Ok(Stop::StoppedByCaller);
            }
        }
    }

    /// Update the first edge of the queue until its priority is current.
    fn update_first(&mut self) {
        if M::PRIORITY_SCOPE != PriorityScope::Ring {
            return;
        }
        while let Some((edge, _)) = self.queue.first() {
            if !self.changes.is_stale(edge, self.mesh.connectivity.ends(edge)) {
                break;
            }
            self.changes.mark_current(edge);
            requeue_edge(edge, &self.mesh, &self.measure, &mut self.queue, &mut self.refusals);
        }
    }

    /// Try the first edge of the queue.
    pub fn step(&mut self) -> Step<M::Reason> {
        self.update_first();
        let Some((edge, priority)) = self.queue.first() else {
            return Step::Finished;
        };
        self.queue.remove(edge);
        self.attempts += 1;
        match self.attempt(edge, priority) {
            Ok(collapsed) => Step::Collapsed(collapsed),
            Err(refusal) => {
                // Another region may allow an edge at the rim, so it stays open.
                if !matches!(refusal, Refusal::Rim | Refusal::Postponed) {
                    self.refusals[edge.index()] = Some(refusal);
                    for v in self.mesh.connectivity.ends(edge) {
                        self.has_refused_edge[v.index()] = true;
                    }
                }
                Step::Refused(edge, refusal)
            }
        }
    }

    fn attempt(&mut self, edge: EdgeId, priority: f64) -> Result<CollapseChange, Refusal<M::Reason>> {
        can_collapse(&self.mesh.connectivity, edge, &mut self.marks).map_err(Refusal::Illegal)?;
        self.star.gather(&self.mesh, edge);
        if self.star.end_is_fixed == [true, true] {
            return Err(Refusal::Illegal(IllegalCollapse::Locked));
        }
        let on_rim = |v: VertexId| self.mesh.lock(v) == VertexLock::Rim;
        if self.star.remaining.iter().any(|w| on_rim(w.side_start) && on_rim(w.side_end)) {
            return Err(Refusal::Rim);
        }
        if self.measure.forbids_chords() {
            match find_new_chord(&self.mesh, &self.star) {
                Some(VertexLock::Rim) => return Err(Refusal::Rim),
                Some(_) => return Err(Refusal::Illegal(IllegalCollapse::Locked)),
                None => {}
            }
        }
        let mut proposal = self.measure.propose(&self.mesh, &self.star).map_err(Refusal::ProposalRefused)?;
        check_triangles(&self.star, &proposal.point).map_err(Refusal::Illegal)?;
        self.measure.judge(&self.mesh, &self.star, &mut proposal).map_err(Refusal::ProposalRefused)?;
        let cost = self.measure.cost(&proposal);
        if cost > priority && self.queue.first().is_some_and(|(_, next)| next < cost) {
            self.queue.set(edge, cost);
            return Err(Refusal::Postponed);
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
        if let Some(path) = &mut self.survivor_points {
            path.push(proposal.point);
        }
        self.measure.commit(&self.mesh, &self.star, &collapsed, proposal.change);
        for (_, gone) in collapsed.merged.into_iter().flatten() {
            self.queue.remove(gone);
        }
        self.requeue_around(survivor);
        Ok(collapsed)
    }

    /// Update the queue around a vertex that has moved.
    fn requeue_around(&mut self, centre: VertexId) {
        let connectivity = &self.mesh.connectivity;
        self.ring.clear();
        self.ring.extend(connectivity.vertex_edges(centre).map(|(_, v)| v));
        match M::PRIORITY_SCOPE {
            PriorityScope::Spokes => {
                for (edge, _) in
                    connectivity.vertex_edges(centre).filter(|(edge, _)| !on_rim(&self.mesh, *edge))
                {
                    requeue_edge(edge, &self.mesh, &self.measure, &mut self.queue, &mut self.refusals);
                }
            }
            PriorityScope::Star => {
                let live = |edge: &&EdgeId| connectivity.is_edge(**edge) && !on_rim(&self.mesh, **edge);
                for &edge in self.star.other_edges.iter().filter(live) {
                    requeue_edge(edge, &self.mesh, &self.measure, &mut self.queue, &mut self.refusals);
                }
            }
            PriorityScope::Ring => {
                self.changes.start_change();
                for (edge, v) in connectivity.vertex_edges(centre) {
                    self.changes.mark_vertex(v);
                    self.changes.mark_current(edge);
                    if !on_rim(&self.mesh, edge) {
                        requeue_edge(edge, &self.mesh, &self.measure, &mut self.queue, &mut self.refusals);
                    }
                }
            }
        }
        // Other edges from the ring: refused ones may be legal now, because their stars have changed.
        for &v in &self.ring {
            if std::mem::replace(&mut self.has_refused_edge[v.index()], false) {
                for (edge, _) in connectivity.vertex_edges(v) {
                    let refused = matches!(
                        self.refusals[edge.index()],
                        Some(Refusal::Illegal(_) | Refusal::ProposalRefused(_))
                    );
                    if refused && !on_rim(&self.mesh, edge) {
                        requeue_edge(edge, &self.mesh, &self.measure, &mut self.queue, &mut self.refusals);
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
    pub fn queued_priorities(&self) -> impl Iterator<Item = f64> + '_ {
        self.queue.keys()
    }

    /// Return the reason why an edge cannot collapse; `None` while it is untried.
    pub fn refusal(&self, edge: EdgeId) -> Option<Refusal<M::Reason>> {
        self.refusals[edge.index()]
    }

    /// Number of edges tried; an edge may count several times.
    pub fn attempts(&self) -> u64 {
        self.attempts
    }

    /// Return the mesh and all state.
    pub fn into_parts(self) -> EngineParts<D, M> {
        (self.mesh, self.measure, self.refusals, self.merges, self.survivor_points)
    }
}

/// Tracks which queued priorities are out of date. Marking vertices is cheaper than visiting all edges around
/// each of them after every collapse.
struct StalePriorities {
    /// Number of changes so far.
    count: u32,
    /// By vertex: the last change next to it.
    last_change_at_vertex: Vec<u32>,
    /// By edge: the last change that its priority includes.
    last_change_of_edge: Vec<u32>,
}

impl StalePriorities {
    fn new(vertices: usize, edges: usize) -> Self {
        Self { count: 0, last_change_at_vertex: vec![0; vertices], last_change_of_edge: vec![0; edges] }
    }

    /// Start the next change.
    fn start_change(&mut self) {
        self.count += 1;
    }

    /// Mark that the current change affects the edges of a vertex.
    fn mark_vertex(&mut self, v: VertexId) {
        self.last_change_at_vertex[v.index()] = self.count;
    }

    /// Mark the priority of an edge as current.
    fn mark_current(&mut self, edge: EdgeId) {
        self.last_change_of_edge[edge.index()] = self.count;
    }

    fn is_stale(&self, edge: EdgeId, ends: [VertexId; 2]) -> bool {
        ends.iter().any(|v| self.last_change_at_vertex[v.index()] > self.last_change_of_edge[edge.index()])
    }
}

/// Test if an edge has an end on the rim of the region.
#[inline]
fn on_rim<const D: usize>(mesh: &Mesh<D>, edge: EdgeId) -> bool {
    mesh.connectivity.ends(edge).iter().any(|&v| mesh.lock(v) == VertexLock::Rim)
}

/// Requeue an edge with its current priority, or record its refusal.
fn requeue_edge<const D: usize, M: Measure<D>>(
    edge: EdgeId,
    mesh: &Mesh<D>,
    measure: &M,
    queue: &mut EdgeQueue,
    refusals: &mut [Option<Refusal<M::Reason>>],
) {
    match measure.priority(mesh, edge) {
        Ok(priority) => {
            refusals[edge.index()] = None;
            queue.set(edge, priority);
        }
        Err(bound) => {
            refusals[edge.index()] = Some(Refusal::PriorityRefused(bound));
            queue.remove(edge);
        }
    }
}
