//! The edge-collapse engine: queue, legality and bookkeeping. What a collapse costs, where it leads and
//! what it may change is the business of a [`Measure`].
//!
//! ```text
//! queue ← every edge, by measure.priority
//! until the queue is empty, or far enough:
//!     e ← first of the queue
//!     topology legal?             legality::can_collapse
//!     where to?                   measure.propose
//!     no triangle folds?          legality::keeps_triangles
//!     within the bounds?          measure.judge
//!     collapse, measure.commit, and offer the edges around again
//! ```

use crate::base::errors::KernelError;
use crate::base::ids::{EdgeId, VertexId};
use crate::base::progress::Progress;
use crate::collapse::queue::Queue;
use crate::mesh::legality::{Illegal, Marks, can_collapse, keeps_triangles, new_chord};
use crate::mesh::star::Star;
use crate::mesh::triangle_mesh::{Lock, Mesh};

pub use crate::mesh::connectivity::Collapsed;

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

/// Which priorities a collapse changes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Reach {
    /// Those of the edges at the centre of the new star.
    Spokes,
    /// Those of the edges of the new star.
    Star,
    /// Those of all edges that touch the new star. Those at its centre are asked again at once; of the others,
    /// which change little, each is asked again when it comes to the front.
    Ring,
}

/// The part of a simplifier that varies.
///
/// The engine calls `priority` whenever it needs the order, then `propose`, `judge` and `commit` in this order
/// for one edge, stopping at the first refusal.
pub trait Measure<const D: usize> {
    /// A refusal of the measure's own.
    type Bound: Copy + Eq + Send + Sync + std::fmt::Debug;
    /// What one collapse adds to the records.
    type Change;

    /// Which priorities a collapse changes.
    const REACH: Reach = Reach::Star;

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

    /// Whether collapses that would join locked vertices by a new edge are refused: see [`new_chord`].
    fn without_chords(&self) -> bool {
        false
    }

    /// What a proposal turns out to cost, where that takes more than `priority` looks at: an edge that costs more than
    /// the next one waits for its turn.
    fn cost(&self, _: &Proposal<D, Self::Change>) -> f64 {
        f64::NEG_INFINITY
    }

    /// Record a collapse. `mesh` is as it is now; `star` as it was, with the triangles that vanished and those
    /// that moved from the removed end to the survivor.
    fn commit(&mut self, mesh: &Mesh<D>, star: &Star<D>, collapsed: &Collapsed, change: Self::Change);
}

/// Why an edge may not collapse.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Refusal<B> {
    Illegal(Illegal),
    /// Its priority was refused: only a change of the edge itself can help.
    Barred(B),
    /// Its proposal was refused: any change of its star can help.
    Bound(B),
    /// It costs more than the next one, and is in the queue again where it belongs.
    Later,
    /// Its star reaches the rim of the region, where others know more.
    Rim,
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
    /// As far as was asked: few enough triangles, enough collapses, or the priority reached.
    Target,
    /// Next to none did, as was asked for.
    Few,
    /// The caller was content with what there is.
    Enough,
}

/// How far a run goes: whatever comes first.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Until {
    /// At most this many triangles are left.
    pub triangles: usize,
    /// This many collapses have taken place.
    pub collapses: usize,
    /// Every edge has a larger priority.
    pub priority: f64,
}

impl Until {
    /// Until no edge may collapse.
    pub const EXHAUSTED: Self = Self { triangles: 0, collapses: usize::MAX, priority: f64::INFINITY };
}

/// A collapse as the engine remembers it.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Merge {
    pub removed: VertexId,
    pub survivor: VertexId,
    /// The largest priority of any collapse so far: it never falls from one merge to the next.
    pub priority: f64,
    /// How many triangles vanished, 1 or 2.
    pub triangles: u8,
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
    changes: Changes,
    star: Star<D>,
    ring: Vec<VertexId>,
    merges: Vec<Merge>,
    /// Where the survivors of the merges went, if that is recorded.
    path: Option<Vec<[f64; D]>>,
    attempts: u64,
}

/// What the engine knows of the edges of a mesh: why each that may not collapse may not.
pub type Refusals<B> = Vec<Option<Refusal<B>>>;

/// The mesh, the measure, why its edges may not collapse, the merges, and where they went if that was recorded.
pub type Parts<const D: usize, M> =
    (Mesh<D>, M, Refusals<<M as Measure<D>>::Bound>, Vec<Merge>, Option<Vec<[f64; D]>>);

impl<const D: usize, M: Measure<D>> Engine<D, M> {
    pub fn new(mesh: Mesh<D>, measure: M) -> Self {
        let refusals = vec![None; mesh.connectivity.edge_slots()];
        Self::resume(mesh, measure, refusals)
    }

    /// Go on with a mesh whose refused edges are known: they wait until something changes beside them.
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

    /// Record where the survivors go from now on.
    pub fn record_path(&mut self) {
        self.path = Some(vec![]);
    }

    /// Collapse as far as asked.
    ///
    /// # Errors
    /// [`KernelError::Interrupted`] when `progress` says so.
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

    /// Bring the first edge to where it belongs until one is first that is there already.
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
                // What the rim forbids here may be allowed in another region: the edge stays open.
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

    /// Bring the queue up to date around a vertex that has moved.
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
        // Other edges with one end on the ring: what was refused may be legal now that their stars have changed.
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

    /// All collapses, in their order.
    pub fn merges(&self) -> &[Merge] {
        &self.merges
    }

    /// Priorities of the edges still to be tried, in no order.
    pub fn waiting(&self) -> impl Iterator<Item = f64> + '_ {
        self.queue.keys()
    }

    /// Why an edge may not collapse; none while it has yet to be tried.
    pub fn refusal(&self, edge: EdgeId) -> Option<Refusal<M::Bound>> {
        self.refusals[edge.index()]
    }

    /// Edges that reached the front of the queue, some of them more than once.
    pub fn attempts(&self) -> u64 {
        self.attempts
    }

    /// All that the engine leaves.
    pub fn into_parts(self) -> Parts<D, M> {
        (self.mesh, self.measure, self.refusals, self.merges, self.path)
    }
}

/// Which edges in the queue may have another priority than when they were put there. To note it at vertices saves
/// walking around each of them after every collapse.
struct Changes {
    /// How many there were.
    count: u32,
    /// The last one beside each vertex.
    beside: Vec<u32>,
    /// The last one each edge's priority knows of.
    known: Vec<u32>,
}

impl Changes {
    fn new(vertices: usize, edges: usize) -> Self {
        Self { count: 0, beside: vec![0; vertices], known: vec![0; edges] }
    }

    /// The next change begins.
    fn next(&mut self) {
        self.count += 1;
    }

    /// It changes what the edges of a vertex cost.
    fn around(&mut self, v: VertexId) {
        self.beside[v.index()] = self.count;
    }

    /// The priority of an edge is brought up to date.
    fn freshen(&mut self, edge: EdgeId) {
        self.known[edge.index()] = self.count;
    }

    fn is_stale(&self, edge: EdgeId, ends: [VertexId; 2]) -> bool {
        ends.iter().any(|v| self.beside[v.index()] > self.known[edge.index()])
    }
}

/// Whether an edge has an end on the rim of a region.
#[inline]
fn on_rim<const D: usize>(mesh: &Mesh<D>, edge: EdgeId) -> bool {
    mesh.connectivity.ends(edge).iter().any(|&v| mesh.lock(v) == Lock::Rim)
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
