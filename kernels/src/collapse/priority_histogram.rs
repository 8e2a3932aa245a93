//! Histogram of the priorities of waiting edges.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// Sixteen logarithmic classes per factor of two.
pub struct PriorityHistogram {
    counts: Vec<AtomicU32>,
}

const CLASS_BITS: u32 = 48;

impl Default for PriorityHistogram {
    fn default() -> Self {
        Self { counts: (0..1 << (63 - CLASS_BITS)).map(|_| AtomicU32::new(0)).collect() }
    }
}

impl PriorityHistogram {
    pub fn add(&self, priorities: impl Iterator<Item = f64>) {
        for priority in priorities {
            let class = (priority.max(0.0).to_bits() >> CLASS_BITS) as usize;
            self.counts[class].fetch_add(1, Relaxed);
        }
    }

    /// Estimate the priority limit for a number of `collapses`; `most` is the maximum possible on the mesh.
    ///
    /// The counted edges are a sample of the `open` edges, because edges on the rims of regions have no known
    /// priority. Counts are therefore scaled to `open`. Otherwise the sample seems to run out of edges
    /// although the mesh does not, and the limit becomes infinite. A region would then collapse completely
    /// while its neighbours wait. Infinite only if no edge was counted.
    pub fn estimate_priority_limit(&self, collapses: usize, most: usize, open: usize) -> f64 {
        let counts = || self.counts.iter().map(|count| f64::from(count.load(Relaxed)));
        let counted: f64 = counts().sum();
        let scale = (open as f64 / counted.max(1.0)).max(1.0);
        // If all edges go, one of three collapses and two merge with others; the first ones are all
        // collapses.
        let share = collapses as f64 / most.max(1) as f64;
        let wanted = collapses as f64 * (1.0 + 2.0 * share);
        let mut below = 0.0;
        let mut priority = f64::INFINITY;
        for (class, count) in counts().enumerate().filter(|(_, count)| *count > 0.0) {
            below += scale * count;
            priority = f64::from_bits((class as u64 + 1) << CLASS_BITS);
            if below >= wanted {
                break;
            }
        }
        priority
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(priorities: impl Iterator<Item = u32>) -> PriorityHistogram {
        let histogram = PriorityHistogram::default();
        histogram.add(priorities.map(f64::from));
        histogram
    }

    #[test]
    fn sample_is_scaled_to_all_open_edges() {
        let all = counted((1..=1000).flat_map(|priority| [priority; 4]));
        let sample = counted(1..=1000);
        assert_eq!(
            all.estimate_priority_limit(500, 10_000, 4000),
            sample.estimate_priority_limit(500, 10_000, 4000)
        );
        assert!(
            sample.estimate_priority_limit(500, 10_000, 4000)
                < sample.estimate_priority_limit(500, 10_000, 1000)
        );
    }

    /// Without a limit, a region would collapse completely while others wait.
    #[test]
    fn limit_is_infinite_only_without_edges() {
        let few = counted(1..=10);
        let priority = few.estimate_priority_limit(5000, 6000, 12_000);
        assert!((10.0..12.0).contains(&priority), "{priority}");
        assert_eq!(counted(0..0).estimate_priority_limit(1, 10, 10), f64::INFINITY);
    }
}
