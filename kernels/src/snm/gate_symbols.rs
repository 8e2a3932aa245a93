//! Coding of gate symbols as decisions: mesh boundary, tip at the next border vertex, at the previous one,
//! new tip, or another border vertex.

use crate::base::ids::VertexId;

use super::base_vertices::{RATES, TipPrediction};
use super::border::GateSymbol;
use super::coder::{Coder, Exhausted};
use super::decisions::{Decisions, Rates};
use super::frame::{dot, subtract};
use super::integers::{IntegerModels, NumberPrior};
use super::logistic::ln;
use super::region::Region;

const FEATURE_COUNT: usize = 10;
/// Initial weights, from least squares over the base meshes of nine scans.
const CLOSING_WEIGHTS: [[f32; FEATURE_COUNT]; 2] =
    [[-0.5, -1.4, 0.35, 1.0, 0.55, 1.5, 0.5, -0.6, 1.4, 0.0]; 2];

/// Maximum number of border edges for which vertices are sorted by distance for each tip elsewhere on the
/// border.
const MAX_SORTED_BORDER: usize = 1024;

/// Adaptive models of gate symbols.
pub(super) struct GateSymbolModels {
    closes: Decisions<FEATURE_COUNT, 0>,
    boundary: Decisions<1, 0>,
    other: Decisions<1, 0>,
    ranks: IntegerModels<1, 0>,
}

impl GateSymbolModels {
    pub(super) fn new() -> Self {
        // Other vertices need a search. The margin limits the number of searches that a damaged file can
        // cause.
        let rare = Rates { min_probability: 4096, ..RATES };
        Self {
            closes: Decisions::new(RATES, &CLOSING_WEIGHTS, []),
            boundary: Decisions::new(RATES, &[[-3.0]], []),
            other: Decisions::new(rare, &[[-2.6]], []),
            ranks: IntegerModels::new(rare, &[[0.0]], [], 1),
        }
    }

    /// Code the symbol of `gate`. `has_boundary` is true if the mesh has a boundary.
    pub(super) fn code<C: Coder>(
        &mut self,
        coder: &mut C,
        region: &Region,
        is_open: bool,
        gate: u32,
        guess: &TipPrediction,
        given: GateSymbol,
    ) -> Result<GateSymbol, Exhausted> {
        if is_open && self.boundary.code_bit(coder, 0, &[1.0], &[], given == GateSymbol::MeshBoundary)? {
            return Ok(GateSymbol::MeshBoundary);
        }
        let edge = region.border.edge(gate);
        let [_, next, previous] = region.neighbouring_corners(gate);
        if !region.border.edge(edge.next).is_boundary {
            let features = compute_closing_features(region, guess, next, 0.5, guess.ends[1]);
            if self.closes.code_bit(coder, 0, &features, &[], given == GateSymbol::Next)? {
                return Ok(GateSymbol::Next);
            }
        }
        let is_triangle = region.border.edge(edge.next).next == edge.prev;
        if !region.border.edge(edge.prev).is_boundary && !is_triangle {
            let features = compute_closing_features(region, guess, previous, -0.5, guess.ends[0]);
            if self.closes.code_bit(coder, 1, &features, &[], given == GateSymbol::Previous)? {
                return Ok(GateSymbol::Previous);
            }
        }
        if !self.other.code_bit(coder, 0, &[1.0], &[], matches!(given, GateSymbol::OtherVertex(_)))? {
            return Ok(if let GateSymbol::NewVertex(_) = given {
                given
            } else {
                GateSymbol::NewVertex(VertexId::NONE)
            });
        }
        let given = if let GateSymbol::OtherVertex(gap) = given { Some(gap) } else { None };
        self.other(coder, region, gate, guess, given).map(GateSymbol::OtherVertex)
    }

    /// Code the border edge of another tip, as its rank by distance from the predicted tip.
    fn other<C: Coder>(
        &mut self,
        coder: &mut C,
        region: &Region,
        gate: u32,
        guess: &TipPrediction,
        given: Option<u32>,
    ) -> Result<u32, Exhausted> {
        let border = &region.border;
        let is_long = border.present().len() > MAX_SORTED_BORDER;
        let key = |gap: u32| {
            let apart = subtract(region.position(border.edge(gap).origin), guess.point);
            // Positive floats are ordered like their bits.
            (if is_long { 0 } else { dot(apart, apart).to_bits() }, gap)
        };
        // Exclude the neighbours of the gate, which would leave a loop of two edges.
        let beside = [border.edge(gate).prev, border.edge(border.edge(gate).next).next];
        let is_far = |gap: &u32| !beside.contains(gap) && !guess.ends.contains(&border.edge(*gap).origin);
        let mut keys: Vec<(u64, u32)> = border.present().iter().copied().filter(is_far).map(key).collect();
        let rank = given.map_or(0, |gap| {
            let own = key(gap);
            keys.iter().filter(|&&key| key < own).count()
        });
        let expected = if is_long { keys.len() as f32 } else { 1.0 };
        let known = NumberPrior { expected, features: [1.0], contexts: [], sign_logit: 9.0, sign_context: 0 };
        let rank = self.ranks.code(coder, &known, rank as i64)?;
        let rank = usize::try_from(rank).ok().filter(|&rank| rank < keys.len()).ok_or(Exhausted)?;
        Ok(keys.select_nth_unstable(rank).1.1)
    }
}

/// Compute the features for a tip at `tip`, the border vertex next to one end of the gate. That end, vertex
/// `end`, has coordinate `at` (±½) along the gate.
fn compute_closing_features(
    region: &Region,
    guess: &TipPrediction,
    tip: u32,
    at: f64,
    end: u32,
) -> [f32; FEATURE_COUNT] {
    let valence = |v: u32| 0.2 * (f32::from(region.valences[v as usize]) - 5.0).min(5.0);
    let local = guess.frame.to_local(region.position(tip));
    let apart = subtract(local, guess.local);
    let distance = dot(apart, apart).sqrt() as f32;
    let [arm, third] = [at, -at].map(|x| subtract(local, [x, 0.0, 0.0]));
    let [arm_length, third_length] = [arm, third].map(|v| dot(v, v).sqrt().max(1e-3));
    [
        1.0,
        distance.min(4.0),
        1.0 / (1.0 + distance),
        local[1].clamp(-2.0, 2.0) as f32,
        local[2].abs().min(2.0) as f32,
        // Cosine and sine of the interior angle.
        (-2.0 * at * arm[0] / arm_length) as f32,
        (arm[1] / arm_length) as f32,
        ln(third_length as f32).clamp(-2.0, 2.0),
        valence(end),
        valence(tip),
    ]
}
