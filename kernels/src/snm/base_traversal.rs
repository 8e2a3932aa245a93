//! Coding of the base mesh by region growing, one triangle at a time from a seed triangle per component.
//!
//! Each step processes one edge of the [`Border`], the gate. Its symbol is either a mesh boundary or a
//! triangle. The tip of the triangle is the next border vertex, the previous one, a new vertex, or another
//! border vertex. Known positions predict the symbol: an interior angle of 30° closes more often than 200°.
//! They also predict the position of a new vertex.
//!
//! The method is the cut-border machine of Gumhold and Straßer (Real time compression of triangle mesh
//! connectivity, 1998). Splits and unions are coded as the rank of the tip by distance from its predicted
//! position.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::base::ids::{HalfedgeId, VertexId};
use crate::base::memory_reserve::Reserve;
use crate::mesh::connectivity::Connectivity;

use super::base_vertices::{TipPrediction, VertexModels};
use super::border::GateSymbol;
use super::coder::{Coder, DryRunCoder, Exhausted};
use super::encoder_input::EncoderInput;
use super::error::SnmError;
use super::gate_symbols::GateSymbolModels;
use super::region::Region;
use crate::subdivision::snm_contents::BaseContents;

/// Base mesh in coder order.
#[derive(Clone, Debug, Default)]
pub struct CanonicalBase {
    pub base: BaseContents,
    /// Index in the given mesh of each vertex and each triangle.
    pub vertex_source: Vec<u32>,
    pub triangle_source: Vec<u32>,
}

/// Callback that chooses the position of a vertex, given its index and an estimate of the extra bits per
/// position.
pub type RoundPosition<'a> = &'a mut dyn FnMut(u32, &dyn Fn(&[i32; 3]) -> f64) -> [i32; 3];

/// Renumber vertices and triangles in coder order, and rotate each triangle so that it starts at its gate.
/// Vertices without triangles are dropped. The operation is idempotent.
///
/// # Errors
/// [`SnmError::Mesh`], as for [`Connectivity::from_triangles`].
pub fn to_canonical(base: &BaseContents) -> Result<CanonicalBase, SnmError> {
    order_base(base, None)
}

/// Renumber as [`to_canonical`] does, with positions that `round` chooses as vertices are reached.
///
/// # Errors
/// As [`to_canonical`].
pub fn to_canonical_rounded<'a>(
    base: &'a BaseContents,
    round: RoundPosition<'a>,
) -> Result<CanonicalBase, SnmError> {
    order_base(base, Some(round))
}

fn order_base<'a>(
    base: &'a BaseContents,
    round: Option<RoundPosition<'a>>,
) -> Result<CanonicalBase, SnmError> {
    let channels = if base.channels.is_empty() { 0 } else { 4 };
    let mut rehearsal = DryRunCoder;
    let mut walk = BaseTraversal::new(&mut rehearsal, Some(EncoderInput::new(base)?), channels);
    walk.round = round;
    walk.run().map_err(|Exhausted| SnmError::InvalidInput("the base mesh is too large"))?;
    let sources = walk.given.map(|given| (given.vertex_source, given.triangle_source));
    let (vertex_source, triangle_source) = sources.unwrap_or_default();
    Ok(CanonicalBase { base: walk.region.base, vertex_source, triangle_source })
}

/// Traversal of a base mesh: of the given mesh in encoding, of the reconstructed one in decoding.
pub(super) struct BaseTraversal<'a, 'b, C> {
    coder: &'a mut C,
    given: Option<EncoderInput<'b>>,
    channels: usize,
    /// True if the mesh has a boundary.
    has_boundary: bool,
    pub region: Region,
    /// Gates to process, the most urgent first.
    gates: BinaryHeap<(Reverse<u64>, u32)>,
    /// Border edges whose neighbours changed.
    changed: Vec<u32>,
    gate_symbols: GateSymbolModels,
    vertex_models: VertexModels,
    /// Callback for the positions of the given mesh; None keeps them.
    round: Option<RoundPosition<'b>>,
}

impl<'a, 'b, C: Coder> BaseTraversal<'a, 'b, C> {
    pub(super) fn new(coder: &'a mut C, given: Option<EncoderInput<'b>>, channels: usize) -> Self {
        Self {
            coder,
            given,
            channels,
            has_boundary: false,
            region: Region::default(),
            gates: BinaryHeap::new(),
            changed: vec![],
            gate_symbols: GateSymbolModels::new(),
            vertex_models: VertexModels::new(),
            round: None,
        }
    }

    /// Traverse all components. Returns [`Exhausted`] also if memory runs out.
    pub(super) fn run(&mut self) -> Result<(), Exhausted> {
        let mut reserve = Reserve::for_rows(0).map_err(|_| Exhausted)?;
        self.has_boundary =
            self.coder.code_even(self.given.as_ref().is_some_and(EncoderInput::has_boundary))?;
        loop {
            let seed = self.given.as_mut().and_then(EncoderInput::next_seed);
            if !self.vertex_models.more(self.coder, seed.is_some())? {
                return Ok(());
            }
            self.code_first_triangle(seed.unwrap_or(HalfedgeId::NONE))?;
            while let Some((_, gate)) = self.gates.pop() {
                if self.region.border.is_open(gate) {
                    reserve.ensure_rows(2 * self.region.base.triangles.len()).map_err(|_| Exhausted)?;
                    self.process_gate(gate)?;
                }
            }
        }
    }

    fn code_first_triangle(&mut self, seed: HalfedgeId) -> Result<(), Exhausted> {
        let halfedges = if seed.is_none() {
            [HalfedgeId::NONE; 3]
        } else {
            [seed, Connectivity::next(seed), Connectivity::prev(seed)]
        };
        let mut corners = [0; 3];
        for (corner, h) in corners.iter_mut().zip(halfedges) {
            let source = self.given.as_ref().map_or(VertexId::NONE, |given| given.connectivity.origin(h));
            let near = self.region.base.positions.last().copied().unwrap_or_default();
            let given = self.input_position(source, |_, _| 0.0);
            let position = self.vertex_models.first(self.coder, near, given)?;
            let near = self.region.base.channels.last().copied().unwrap_or_default();
            *corner = self.add_vertex(position, near, source)?;
        }
        self.add_triangle(corners, seed);
        let [a, b, c] = corners;
        let [ab, bc, ca] = halfedges.map(|h| self.twin(h));
        let edges = [(b, c, ab), (a, b, ca), (c, a, bc)];
        let edges = edges.map(|(origin, across, h)| self.add_edge(origin, across, h));
        for i in 0..3 {
            self.region.border.link(edges[i], edges[(i + 1) % 3]);
        }
        self.queue_changed();
        Ok(())
    }

    /// Attach a triangle to a gate, or mark the gate as mesh boundary.
    fn process_gate(&mut self, gate: u32) -> Result<(), Exhausted> {
        let edge = *self.region.border.edge(gate);
        let (u, v) = (edge.origin, self.region.border.target(gate));
        let guess = self.vertex_models.predict_tip(&self.region, gate);
        let left = match &self.given {
            Some(given) => given.find_symbol(&self.region.border, gate),
            None => GateSymbol::MeshBoundary,
        };
        let left = self.gate_symbols.code(self.coder, &self.region, self.has_boundary, gate, &guess, left)?;
        let (prev, next) = (edge.prev, edge.next);
        let (to_tip, from_tip) = if edge.halfedge.is_some() {
            (Connectivity::next(edge.halfedge), Connectivity::prev(edge.halfedge))
        } else {
            (HalfedgeId::NONE, HalfedgeId::NONE)
        };
        let (outer_right, outer_left) = (self.twin(to_tip), self.twin(from_tip));
        let tip = match left {
            GateSymbol::MeshBoundary => {
                self.region.border.mark_boundary(gate);
                self.changed.push(gate);
                self.queue_changed();
                return Ok(());
            }
            GateSymbol::Next => self.region.border.target(next),
            GateSymbol::Previous => self.region.border.edge(prev).origin,
            GateSymbol::OtherVertex(gap) => self.region.border.edge(gap).origin,
            GateSymbol::NewVertex(source) => self.code_tip(&guess, source)?,
        };
        self.add_triangle([u, v, tip], edge.halfedge);
        self.region.border.remove(gate);
        match left {
            GateSymbol::Next if self.region.border.edge(next).next == prev => {
                self.region.border.remove(next);
                self.region.border.remove(prev);
            }
            GateSymbol::Next => {
                let after = self.region.border.edge(next).next;
                self.region.border.remove(next);
                let new = self.add_edge(u, v, outer_left);
                self.region.border.link(prev, new);
                self.region.border.link(new, after);
            }
            GateSymbol::Previous => {
                let before = self.region.border.edge(prev).prev;
                self.region.border.remove(prev);
                let new = self.add_edge(tip, u, outer_right);
                self.region.border.link(before, new);
                self.region.border.link(new, next);
            }
            GateSymbol::NewVertex(_) | GateSymbol::OtherVertex(_) => {
                let (first, second) = (self.add_edge(u, v, outer_left), self.add_edge(tip, u, outer_right));
                let (before, after) = match left {
                    GateSymbol::OtherVertex(gap) => (self.region.border.edge(gap).prev, gap),
                    _ => (first, second),
                };
                self.region.border.link(prev, first);
                self.region.border.link(before, second);
                self.region.border.link(first, after);
                self.region.border.link(second, next);
            }
            GateSymbol::MeshBoundary => {}
        }
        self.queue_changed();
        Ok(())
    }

    /// Queue all changed edges and their neighbours with updated urgencies.
    fn queue_changed(&mut self) {
        for i in 0..self.changed.len() {
            let edge = self.region.border.edge(self.changed[i]);
            self.changed.extend([edge.prev, edge.next]);
        }
        self.changed.sort_unstable();
        self.changed.dedup();
        for i in 0..self.changed.len() {
            if self.region.border.is_open(self.changed[i]) {
                let urgency = self.region.compute_priority(self.changed[i]);
                self.gates.push((Reverse(urgency), self.changed[i]));
            }
        }
        self.changed.clear();
    }

    /// Opposite halfedge in the given mesh.
    fn twin(&self, h: HalfedgeId) -> HalfedgeId {
        match &self.given {
            Some(given) if h.is_some() => given.connectivity.twin(h),
            _ => HalfedgeId::NONE,
        }
    }

    fn add_edge(&mut self, origin: u32, across: u32, h: HalfedgeId) -> u32 {
        let edge = self.region.border.add(origin, across, h);
        if let Some(given) = self.given.as_mut().filter(|_| h.is_some()) {
            given.record_edge(h, edge);
        }
        self.changed.push(edge);
        edge
    }

    fn add_triangle(&mut self, corners: [u32; 3], h: HalfedgeId) {
        self.region.add_triangle(corners);
        if let Some(given) = &mut self.given {
            given.record_triangle(h);
        }
    }

    /// Return the position of a vertex of the given mesh; None in decoding. `bits` estimates the bits of a
    /// position.
    fn input_position(
        &mut self,
        source: VertexId,
        bits: impl Fn(&VertexModels, &[i32; 3]) -> f64,
    ) -> Option<[i32; 3]> {
        let given = self.given.as_ref()?;
        let corners = &self.vertex_models;
        Some(match &mut self.round {
            Some(round) => round(source.0, &|p| bits(corners, p)),
            None => given.base.positions[source.index()],
        })
    }

    /// Code the new vertex at the tip of a triangle. `source` is its index in the given mesh.
    fn code_tip(&mut self, guess: &TipPrediction, source: VertexId) -> Result<u32, Exhausted> {
        let given = self.input_position(source, |corners, p| corners.estimate_bits(guess, p));
        let position = self.vertex_models.code_tip(self.coder, guess, given)?;
        let mut near = [0; 4];
        if self.channels > 0 {
            let [a, b] = guess.ends.map(|v| self.region.base.channels[v as usize]);
            // Mean of both ends, rounded down.
            near = std::array::from_fn(|i| (i64::from(a[i]) + i64::from(b[i])).div_euclid(2) as i32);
        }
        self.add_vertex(position, near, source)
    }

    fn add_vertex(&mut self, position: [i32; 3], near: [i32; 4], source: VertexId) -> Result<u32, Exhausted> {
        let mut channels = None;
        if self.channels > 0 {
            let given = self.given.as_ref().map(|given| given.base.channels[source.index()]);
            channels = Some(self.vertex_models.channels(self.coder, near, self.channels, given)?);
        }
        if let Some(given) = &mut self.given {
            given.record_vertex(source);
        }
        Ok(self.region.add_vertex(position, channels))
    }
}
