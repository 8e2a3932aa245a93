//! The mesh triangle that each sample belongs to. Samples are input vertices; triangles have input indices,
//! too.

use super::collapse_history::History;
use super::input_surface::InputSurface;
use super::sample_tracker::SampleLists;
use crate::base::geometry::{position_of, triangle_distance2};

/// Marks the absence of a sample or a triangle.
const ABSENT: u32 = u32::MAX;

/// Linked lists of samples in one array.
pub struct SampleOwners {
    /// First sample, by triangle.
    first: Vec<u32>,
    /// Next sample and owning triangle, by sample.
    next: Vec<u32>,
    owner: Vec<u32>,
}

impl SampleOwners {
    /// Create from the lists of `triangles`.
    pub fn new<const D: usize>(original: &InputSurface<D>, triangles: &[u32], lists: &SampleLists) -> Self {
        let mut watched = Self {
            first: vec![ABSENT; original.triangles.len()],
            next: vec![ABSENT; original.points.len()],
            owner: vec![ABSENT; original.points.len()],
        };
        for (i, &t) in triangles.iter().enumerate() {
            lists.of_triangle(i).iter().for_each(|&v| watched.assign(v, t));
        }
        watched
    }

    /// Iterate over the samples of a triangle.
    pub fn samples_of(&self, triangle: u32) -> impl Iterator<Item = u32> + '_ {
        let some = |v: u32| (v != ABSENT).then_some(v);
        std::iter::successors(some(self.first[triangle as usize]), move |&v| some(self.next[v as usize]))
    }

    /// Return the triangle that a sample belongs to.
    pub fn owner(&self, sample: u32) -> Option<u32> {
        Some(self.owner[sample as usize]).filter(|&t| t != ABSENT)
    }

    /// Reassign the samples of the triangles `before` to the nearest of the triangles `after`.
    pub fn reassign<const D: usize>(
        &mut self,
        original: &InputSurface<D>,
        history: &History<'_, D>,
        before: &[u32],
        after: &[u32],
    ) {
        let samples: Vec<u32> = before.iter().flat_map(|&t| self.samples_of(t)).collect();
        before.iter().for_each(|&t| self.first[t as usize] = ABSENT);
        let placed: Vec<_> = after
            .iter()
            .filter_map(|&t| Some((t, history.corners(t)?.map(|v| position_of(&history.point(v))))))
            .collect();
        for v in samples {
            let p = position_of(&original.points[v as usize]);
            let distances =
                placed.iter().map(|(t, corners)| (triangle_distance2(&p, corners.each_ref()), *t));
            let nearest = distances.min_by(|a, b| a.0.total_cmp(&b.0));
            self.assign(v, nearest.map_or(after[0], |(_, t)| t));
        }
    }

    /// Return the sample lists of `triangles`.
    pub fn to_lists(&self, triangles: &[u32]) -> SampleLists {
        let (mut starts, mut samples) = (Vec::with_capacity(triangles.len() + 1), vec![]);
        starts.push(0);
        for &t in triangles {
            samples.extend(self.samples_of(t));
            starts.push(samples.len() as u32);
        }
        SampleLists { starts, samples }
    }

    fn assign(&mut self, sample: u32, triangle: u32) {
        self.next[sample as usize] = std::mem::replace(&mut self.first[triangle as usize], sample);
        self.owner[sample as usize] = triangle;
    }
}
