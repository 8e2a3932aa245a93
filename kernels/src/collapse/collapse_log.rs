//! Logs of the collapses, and the order in which they can be replayed.

use crate::collapse::engine::Merge;

/// Collapses of one region in one round.
#[derive(Clone, Debug, PartialEq)]
pub struct RegionLog<const D: usize> {
    pub round: usize,
    /// Vertex indices refer to the initial mesh.
    pub merges: Vec<Merge>,
    /// Positions of the survivors; empty unless requested.
    pub survivor_points: Vec<[f64; D]>,
}

/// Order all merges by priority; yields list index and index in the list.
pub fn order_by_priority<'a>(
    lists: impl Iterator<Item = &'a [Merge]>,
) -> impl Iterator<Item = (usize, usize)> {
    let mut order: Vec<(f64, u32, u32)> = vec![];
    for (list, merges) in lists.enumerate() {
        order.extend(merges.iter().enumerate().map(|(i, m)| (m.priority, list as u32, i as u32)));
    }
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    order.into_iter().map(|(_, list, i)| (list as usize, i as usize))
}

/// Order all collapses for replay; yields log index and index in the log.
pub fn order_for_replay<const D: usize>(logs: &[RegionLog<D>]) -> impl Iterator<Item = (usize, usize)> {
    let rounds = logs.chunk_by(|a, b| a.round == b.round).scan(0, |first, round| {
        let start = *first;
        *first += round.len();
        Some((start, round))
    });
    rounds.flat_map(|(start, round)| {
        order_by_priority(round.iter().map(|log| &log.merges[..])).map(move |(log, i)| (start + log, i))
    })
}

/// Replayable sequence of collapses, in vertex indices of the initial mesh, with the positions of the
/// survivors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CollapseSequence<const D: usize> {
    pub removed: Vec<u32>,
    pub survivor: Vec<u32>,
    pub survivor_points: Vec<[f64; D]>,
}

impl<const D: usize> CollapseSequence<D> {
    /// Create from logs; empty if no positions were recorded.
    pub fn new(logs: &[RegionLog<D>]) -> Self {
        if logs.iter().all(|log| log.survivor_points.is_empty()) {
            return Self::default();
        }
        let recorded = order_for_replay(logs)
            .filter_map(|(log, i)| Some((&logs[log].merges[i], logs[log].survivor_points.get(i)?)));
        recorded.map(|(merge, to)| (merge.removed.0, merge.survivor.0, *to)).collect()
    }
}

impl<const D: usize> FromIterator<(u32, u32, [f64; D])> for CollapseSequence<D> {
    fn from_iter<I: IntoIterator<Item = (u32, u32, [f64; D])>>(collapses: I) -> Self {
        let mut way = Self { removed: vec![], survivor: vec![], survivor_points: vec![] };
        for (removed, survivor, to) in collapses {
            way.removed.push(removed);
            way.survivor.push(survivor);
            way.survivor_points.push(to);
        }
        way
    }
}
