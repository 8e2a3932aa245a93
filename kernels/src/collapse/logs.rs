//! What happened in the regions of each round, and in what order it can be repeated.

use crate::collapse::engine::Merge;

/// What happened in one region.
#[derive(Clone, Debug, PartialEq)]
pub struct Log<const D: usize> {
    pub round: usize,
    /// In numbers of the vertices at the start.
    pub merges: Vec<Merge>,
    /// Where their survivors went; empty unless asked for.
    pub path: Vec<[f64; D]>,
}

/// List and place of all merges, those of least priority first.
pub fn by_priority<'a>(lists: impl Iterator<Item = &'a [Merge]>) -> impl Iterator<Item = (usize, usize)> {
    let mut order: Vec<(f64, u32, u32)> = vec![];
    for (list, merges) in lists.enumerate() {
        order.extend(merges.iter().enumerate().map(|(i, m)| (m.priority, list as u32, i as u32)));
    }
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    order.into_iter().map(|(_, list, i)| (list as usize, i as usize))
}

/// All collapses one after the other: the log of each, and its place there.
pub fn in_order<const D: usize>(logs: &[Log<D>]) -> impl Iterator<Item = (usize, usize)> {
    let rounds = logs.chunk_by(|a, b| a.round == b.round).scan(0, |first, round| {
        let start = *first;
        *first += round.len();
        Some((start, round))
    });
    rounds.flat_map(|(start, round)| {
        by_priority(round.iter().map(|log| &log.merges[..])).map(move |(log, i)| (start + log, i))
    })
}

/// The collapses one after the other, in numbers of the vertices at the start, and where their survivors went.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Way<const D: usize> {
    pub removed: Vec<u32>,
    pub survivor: Vec<u32>,
    pub path: Vec<[f64; D]>,
}

impl<const D: usize> Way<D> {
    /// All that was recorded: nothing, if that was not asked for.
    pub fn new(logs: &[Log<D>]) -> Self {
        if logs.iter().all(|log| log.path.is_empty()) {
            return Self::default();
        }
        let recorded =
            in_order(logs).filter_map(|(log, i)| Some((&logs[log].merges[i], logs[log].path.get(i)?)));
        recorded.map(|(merge, to)| (merge.removed.0, merge.survivor.0, *to)).collect()
    }
}

impl<const D: usize> FromIterator<(u32, u32, [f64; D])> for Way<D> {
    fn from_iter<I: IntoIterator<Item = (u32, u32, [f64; D])>>(collapses: I) -> Self {
        let mut way = Self { removed: vec![], survivor: vec![], path: vec![] };
        for (removed, survivor, to) in collapses {
            way.removed.push(removed);
            way.survivor.push(survivor);
            way.path.push(to);
        }
        way
    }
}
