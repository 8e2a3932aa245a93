//! How many edges wait, by their priorities.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// Sixteen classes for every doubling of a priority.
pub struct Histogram {
    counts: Vec<AtomicU32>,
    /// Edges that each one counted stands for.
    scale: f64,
}

const CLASS_BITS: u32 = 48;

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: (0..1 << (63 - CLASS_BITS)).map(|_| AtomicU32::new(0)).collect(), scale: 1.0 }
    }
}

impl Histogram {
    pub fn add(&self, priorities: impl Iterator<Item = f64>) {
        for priority in priorities {
            let class = (priority.max(0.0).to_bits() >> CLASS_BITS) as usize;
            self.counts[class].fetch_add(1, Relaxed);
        }
    }

    /// The same, where each edge that was counted stands for several.
    pub fn scaled(self, scale: f64) -> Self {
        Self { scale, ..self }
    }

    /// The priority up to which about `collapses` take place on a mesh where `most` can.
    pub fn priority_for(&self, collapses: usize, most: usize) -> f64 {
        // Of three edges one collapses and two merge with others when all go, while the first few are all
        // collapses.
        let share = collapses as f64 / most.max(1) as f64;
        let wanted = collapses as f64 * (1.0 + 2.0 * share);
        let mut below = 0.0;
        for (class, count) in self.counts.iter().enumerate() {
            below += self.scale * f64::from(count.load(Relaxed));
            if below >= wanted {
                return f64::from_bits((class as u64 + 1) << CLASS_BITS);
            }
        }
        f64::INFINITY
    }
}
