//! Adjacent planar patches that are one plane within the standard deviation of their vertices.
//!
//! Small errors of poses and of the sensor that are common to many frames split a wall into several patches,
//! which grow at slightly different angles. Two patches merge if their common plane meets the conditions of
//! a patch; the pair that fits best comes first.

use super::plane_growth::{FilteredSurface, NO_PLANE, PatchMoments, Plane};
use crate::base::geometry::dot;
use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};

/// Limits of merged patches.
#[derive(Clone, Copy, Debug)]
pub struct MergeLimits {
    /// Minimum cosine between the mean normal of a patch and the common plane.
    pub min_cosine: f64,
    /// Maximum RMS height of a patch over the common plane, in standard deviations of its vertices.
    pub max_rms_deviations: f64,
    /// Maximum RMS angle, in radians, by which normals change steadily across both patches.
    pub max_bend: f64,
}

/// Merge adjacent patches.
///
/// `triangle_labels` are the triangles that the planes are fitted to. `labels` of vertices decide which patches
/// are adjacent; they are changed to the merged planes, which are numbered without gaps.
pub fn merge_planes(
    surface: &FilteredSurface<'_>,
    limits: &MergeLimits,
    triangle_labels: &[u32],
    planes: &mut Vec<Plane>,
    labels: &mut [u32],
) {
    let Some(origin) = surface.points.first() else { return };
    let mut patches = Patches::gather(surface, *origin, triangle_labels, planes, labels);
    // Smallest height first; heights are not negative, so that their bits have the same order.
    let mut queue = BinaryHeap::new();
    let propose = |patches: &Patches, queue: &mut BinaryHeap<_>, a: u32, b: u32| {
        if let Some(height) = patches.measure_common_plane(limits, a, b) {
            queue.push(Reverse((height.to_bits(), a, b, patches.version(a), patches.version(b))));
        }
    };
    for a in 0..planes.len() as u32 {
        for &b in patches.adjacent[a as usize].range(a + 1..) {
            propose(&patches, &mut queue, a, b);
        }
    }
    while let Some(Reverse((_, a, b, version_a, version_b))) = queue.pop() {
        if (version_a, version_b) != (patches.version(a), patches.version(b)) {
            continue;
        }
        patches.merge(a, b);
        for &other in &patches.adjacent[a as usize] {
            propose(&patches, &mut queue, a.min(other), a.max(other));
        }
    }
    patches.finish(planes, labels);
}

/// Patches with their neighbours.
struct Patches {
    moments: Vec<PatchMoments>,
    adjacent: Vec<BTreeSet<u32>>,
    /// Patch that each patch was merged into; itself if none.
    target: Vec<u32>,
    is_merged: Vec<bool>,
}

impl Patches {
    fn gather(
        surface: &FilteredSurface<'_>,
        origin: [f64; 3],
        triangle_labels: &[u32],
        planes: &[Plane],
        labels: &[u32],
    ) -> Self {
        let mut moments = vec![PatchMoments::new(origin); planes.len()];
        for (t, &label) in triangle_labels.iter().enumerate().filter(|(_, label)| **label != NO_PLANE) {
            moments[label as usize].add_triangle(surface, t);
        }
        let mut adjacent = vec![BTreeSet::new(); planes.len()];
        for edge in surface.connectivity.edges() {
            let [a, b] = surface.connectivity.ends(edge).map(|v| labels[v.index()]);
            if a != b && a != NO_PLANE && b != NO_PLANE {
                adjacent[a as usize].insert(b);
                adjacent[b as usize].insert(a);
            }
        }
        let count = planes.len() as u32;
        Self { moments, adjacent, target: (0..count).collect(), is_merged: vec![false; planes.len()] }
    }

    /// Number of triangles, which grows with every merge; 0 for a patch that was merged into another one.
    fn version(&self, patch: u32) -> usize {
        if self.target[patch as usize] == patch { self.moments[patch as usize].triangle_count() } else { 0 }
    }

    /// Measure the larger RMS height of two patches over their common plane. None if a limit is exceeded.
    fn measure_common_plane(&self, limits: &MergeLimits, a: u32, b: u32) -> Option<f64> {
        let parts = [a, b].map(|patch| &self.moments[patch as usize]);
        let mut common = *parts[0];
        common.add(parts[1]);
        let plane = common.fit();
        let height = parts.iter().map(|part| part.rms_deviations(&plane)).fold(0.0, f64::max);
        let is_one_plane = height <= limits.max_rms_deviations
            && parts.iter().all(|part| dot(&part.mean_normal(), &plane.normal) >= limits.min_cosine)
            && common.bend(&plane) <= limits.max_bend;
        is_one_plane.then_some(height)
    }

    fn merge(&mut self, into: u32, from: u32) {
        let [i, f] = [into, from].map(|patch| patch as usize);
        let added = self.moments[f];
        self.moments[i].add(&added);
        self.target[f] = into;
        self.is_merged[i] = true;
        for other in std::mem::take(&mut self.adjacent[f]) {
            self.adjacent[other as usize].remove(&from);
            if other != into {
                self.adjacent[other as usize].insert(into);
                self.adjacent[i].insert(other);
            }
        }
    }

    /// Number the remaining patches without gaps; only merged ones get a new plane.
    fn finish(mut self, planes: &mut Vec<Plane>, labels: &mut [u32]) {
        let (mut kept, mut numbers) = (vec![], vec![NO_PLANE; planes.len()]);
        for patch in 0..planes.len() {
            // Patches merge into smaller numbers, whose own target is final.
            let target = self.target[self.target[patch] as usize];
            self.target[patch] = target;
            if target as usize == patch {
                numbers[patch] = kept.len() as u32;
                kept.push(if self.is_merged[patch] { self.moments[patch].fit() } else { planes[patch] });
            } else {
                numbers[patch] = numbers[target as usize];
            }
        }
        *planes = kept;
        labels
            .iter_mut()
            .filter(|label| **label != NO_PLANE)
            .for_each(|label| *label = numbers[*label as usize]);
    }
}
