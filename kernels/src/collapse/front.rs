//! The edges that wait for their turn: all in one queue, or only those of a window and up to a ceiling, while the
//! priorities of the others are remembered.
//!
//! One queue goes everywhere on the mesh from one collapse to the next, and on a large mesh every step waits for
//! memory. Window after window, each up to the same priority, a small part of it is worked on at a time.

use std::ops::Range;

use crate::base::ids::EdgeId;
use crate::collapse::queue::Queue;

pub struct Front {
    queue: Queue,
    /// Priorities of all edges, infinite for those that do not wait; empty while all are in the queue.
    keys: Vec<f64>,
    window: Range<usize>,
    ceiling: f64,
}

impl Front {
    /// All edges given wait in one queue; `slots` bounds their numbers.
    pub fn new(slots: usize, entries: impl Iterator<Item = (EdgeId, f64)>) -> Self {
        Self { queue: Queue::new(slots, entries), keys: vec![], window: 0..slots, ceiling: f64::INFINITY }
    }

    /// Remember the priorities, and let no edge be first until [`Front::open`].
    pub fn close(&mut self) {
        if self.keys.is_empty() {
            self.keys = vec![f64::INFINITY; self.window.end];
        }
        for (edge, key) in self.queue.drain() {
            self.keys[edge.index()] = key;
        }
        self.window = 0..0;
    }

    /// Let the edges of a window take their turns, up to a priority.
    pub fn open(&mut self, window: Range<usize>, ceiling: f64) {
        self.close();
        for (offset, &key) in self.keys[window.clone()].iter().enumerate() {
            if key <= ceiling && key < f64::INFINITY {
                self.queue.set(EdgeId::from_index(window.start + offset), key);
            }
        }
        (self.window, self.ceiling) = (window, ceiling);
    }

    /// The priorities that are remembered; infinite ones are of edges that do not wait.
    pub fn remembered(&self) -> &[f64] {
        &self.keys
    }

    #[inline]
    pub fn first(&self) -> Option<(EdgeId, f64)> {
        self.queue.first()
    }

    /// All priorities in the queue, in no order.
    pub fn keys(&self) -> impl Iterator<Item = f64> + '_ {
        self.queue.keys()
    }

    #[inline]
    pub fn set(&mut self, edge: EdgeId, key: f64) {
        if let Some(remembered) = self.keys.get_mut(edge.index()) {
            *remembered = key;
            if key > self.ceiling || !self.window.contains(&edge.index()) {
                self.queue.discard(edge);
                return;
            }
        }
        self.queue.set(edge, key);
    }

    #[inline]
    pub fn discard(&mut self, edge: EdgeId) {
        if let Some(remembered) = self.keys.get_mut(edge.index()) {
            *remembered = f64::INFINITY;
        }
        self.queue.discard(edge);
    }
}
