//! Priority queue of edges with changeable keys: a 4-ary heap that stores the position of each edge.
//!
//! Four children share a cache line, and the tree is half as deep as a binary heap. Equal keys are ordered by
//! edge index, so the result never depends on the history of the heap.

use crate::base::ids::EdgeId;

const ARITY: usize = 4;
const ABSENT: u32 = u32::MAX;

/// Key and edge in one integer that compares without a branch.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
struct Entry(u128);

impl Entry {
    #[inline]
    fn new(key: f64, edge: EdgeId) -> Self {
        debug_assert!(!key.is_nan());
        // +0 and −0 are the same key.
        let bits = (key + 0.0).to_bits();
        let rank = if bits >> 63 == 0 { bits | 1 << 63 } else { !bits };
        Self(u128::from(rank) << 64 | u128::from(edge.0))
    }

    #[inline]
    fn key(self) -> f64 {
        let rank = (self.0 >> 64) as u64;
        f64::from_bits(if rank >> 63 == 1 { rank & !(1 << 63) } else { !rank })
    }

    #[inline]
    fn edge(self) -> EdgeId {
        EdgeId(self.0 as u32)
    }
}

/// Priority queue of edges.
#[derive(Clone, Debug)]
pub struct EdgeQueue {
    heap: Vec<Entry>,
    heap_positions: Vec<u32>,
}

impl EdgeQueue {
    /// Build a queue in linear time; all edge indices are below `slots`.
    pub fn new(slots: usize, entries: impl Iterator<Item = (EdgeId, f64)>) -> Self {
        let mut queue = Self { heap: Vec::with_capacity(slots), heap_positions: vec![ABSENT; slots] };
        for (edge, key) in entries {
            queue.heap_positions[edge.index()] = queue.heap.len() as u32;
            queue.heap.push(Entry::new(key, edge));
        }
        for at in (0..queue.heap.len().div_ceil(ARITY)).rev() {
            queue.sift_down(at);
        }
        queue
    }

    pub fn len(&self) -> usize {
        self.heap.len()
    }

    pub fn is_empty(&self) -> bool {
        self.heap.is_empty()
    }

    /// Return the edge with the smallest key, and the key.
    #[inline]
    pub fn first(&self) -> Option<(EdgeId, f64)> {
        self.heap.first().map(|entry| (entry.edge(), entry.key()))
    }

    /// Test if an edge is queued.
    #[inline]
    pub fn contains(&self, edge: EdgeId) -> bool {
        self.heap_positions.get(edge.index()).is_some_and(|&place| place != ABSENT)
    }

    /// Iterate over all keys, unordered.
    pub fn keys(&self) -> impl Iterator<Item = f64> + '_ {
        self.heap.iter().map(|entry| entry.key())
    }

    /// Remove and return the edge with the smallest key.
    pub fn pop(&mut self) -> Option<EdgeId> {
        let edge = self.heap.first()?.edge();
        self.remove(edge);
        Some(edge)
    }

    /// Insert an edge, or change its key.
    pub fn set(&mut self, edge: EdgeId, key: f64) {
        if edge.index() >= self.heap_positions.len() {
            self.heap_positions.resize(edge.index() + 1, ABSENT);
        }
        let entry = Entry::new(key, edge);
        let place = self.heap_positions[edge.index()];
        if place == ABSENT {
            self.heap.push(entry);
            self.sift_up(self.heap.len() - 1);
            return;
        }
        let at = place as usize;
        let sooner = entry < self.heap[at];
        self.heap[at] = entry;
        if sooner { self.sift_up(at) } else { self.sift_down(at) }
    }

    /// Remove an edge if it is queued.
    pub fn remove(&mut self, edge: EdgeId) {
        let place = std::mem::replace(&mut self.heap_positions[edge.index()], ABSENT);
        if place == ABSENT {
            return;
        }
        let at = place as usize;
        let last = self.heap.pop().expect("a queued edge is in the heap");
        if at == self.heap.len() {
            return;
        }
        let sooner = last < self.heap[at];
        self.heap[at] = last;
        if sooner { self.sift_up(at) } else { self.sift_down(at) }
    }

    fn sift_up(&mut self, mut at: usize) {
        let entry = self.heap[at];
        while at > 0 {
            let parent = (at - 1) / ARITY;
            if entry >= self.heap[parent] {
                break;
            }
            self.put(at, self.heap[parent]);
            at = parent;
        }
        self.put(at, entry);
    }

    fn sift_down(&mut self, mut at: usize) {
        let entry = self.heap[at];
        loop {
            let begin = ARITY * at + 1;
            let end = (begin + ARITY).min(self.heap.len());
            let children = self.heap[begin.min(end)..end].iter().copied().zip(begin..);
            let Some((least, child)) = children.reduce(|a, b| if b.0 < a.0 { b } else { a }) else { break };
            if least >= entry {
                break;
            }
            self.put(at, least);
            at = child;
        }
        self.put(at, entry);
    }

    #[inline]
    fn put(&mut self, at: usize, entry: Entry) {
        self.heap[at] = entry;
        self.heap_positions[entry.edge().index()] = at as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drain(queue: &mut EdgeQueue) -> Vec<u32> {
        let mut order = vec![];
        while let Some(edge) = queue.pop() {
            order.push(edge.0);
        }
        order
    }

    #[test]
    fn equal_keys_come_in_the_order_of_their_edges() {
        let mut queue = EdgeQueue::new(9, (0..9).rev().map(|e| (EdgeId(e), f64::from(e / 3))));
        assert_eq!(drain(&mut queue), (0..9).collect::<Vec<_>>());
    }

    #[test]
    fn keys_change_both_ways() {
        let mut queue = EdgeQueue::new(6, (0..6).map(|e| (EdgeId(e), f64::from(e))));
        queue.set(EdgeId(5), -1.0);
        queue.set(EdgeId(0), 2.5);
        queue.set(EdgeId(3), 0.5);
        queue.remove(EdgeId(1));
        queue.remove(EdgeId(1));
        assert_eq!(queue.len(), 5);
        assert_eq!(drain(&mut queue), [5, 3, 2, 0, 4]);
    }

    #[test]
    fn signed_keys_are_ordered_and_zeros_are_equal() {
        let keys = [0.0, 1e-300, -0.0, -2.5, f64::INFINITY, -1e-300, 7.0];
        let mut queue = EdgeQueue::new(7, (0..).map(EdgeId).zip(keys));
        let mut order = vec![];
        while let Some((edge, key)) = queue.first() {
            assert_eq!(key, keys[edge.index()]);
            order.push(edge.0);
            queue.pop();
        }
        assert_eq!(order, [3, 5, 0, 2, 1, 6, 4]);
    }

    #[test]
    fn agrees_with_sorting_after_many_changes() {
        let key = |e: u32, round: u32| f64::from((e * 7919 + round * 104_729) % 1009);
        let mut queue = EdgeQueue::new(500, (0..500).map(|e| (EdgeId(e), key(e, 0))));
        let mut expected: Vec<(u32, f64)> = (0..500).map(|e| (e, key(e, 0))).collect();
        for e in (0..500).step_by(3) {
            queue.set(EdgeId(e), key(e, 1));
            expected[e as usize].1 = key(e, 1);
        }
        expected.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        assert_eq!(drain(&mut queue), expected.iter().map(|e| e.0).collect::<Vec<_>>());
    }
}
