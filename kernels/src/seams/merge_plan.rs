//! Merge plan of an edge: classes of wedges and candidate positions.

use super::wedges::ABSENT;
use crate::base::geometry::Vec3;
use crate::base::ids::EdgeId;
use crate::quadrics::quadric::Quadric;

/// A candidate position for the vertex that replaces an edge.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub position: Vec3,
    /// The end whose texture coordinates are kept; `None` to compute them from the quadrics.
    pub kept_end: Option<usize>,
    pub cost: f64,
}

/// A seam edge that grows when its neighbour shrinks.
#[derive(Clone, Copy, Debug)]
pub(super) struct GrowingSeam {
    pub next: EdgeId,
    /// Upper bound on the distance of its texture coordinates from the seam in the input.
    pub drift: f64,
}

/// A wedge at an end of the edge, and its class.
#[derive(Clone, Copy, Debug)]
pub(super) struct ClassMember {
    pub wedge: u32,
    pub end: usize,
    pub class: usize,
}

/// Wedges that merge into one.
#[derive(Clone, Copy, Debug)]
pub(super) struct WedgeClass<const K: usize> {
    pub quadric: Quadric<K>,
    /// A wedge of the class at each end, or `NONE`.
    pub at_end: [u32; 2],
    /// By end: the class has several wedges with different texture coordinates there.
    pub has_different_uvs: [bool; 2],
    pub is_merged: bool,
    pub value: [f64; K],
    pub home_triangle: u32,
}

impl<const K: usize> WedgeClass<K> {
    /// Test if the class consists of a single wedge at the kept end.
    pub fn is_only_at(&self, keep: Option<usize>) -> bool {
        !self.is_merged && keep.is_some_and(|end| self.at_end[end] != ABSENT)
    }

    /// Return any wedge of the class.
    pub fn any_wedge(&self) -> u32 {
        if self.at_end[0] != ABSENT { self.at_end[0] } else { self.at_end[1] }
    }

    /// Return the wedge that remains if the end `survivor` does.
    pub fn remaining_wedge(&self, survivor: usize) -> u32 {
        if self.at_end[survivor] != ABSENT { self.at_end[survivor] } else { self.at_end[1 - survivor] }
    }
}

/// Merge plan of one edge.
#[derive(Clone, Debug)]
pub(super) struct MergePlan<const K: usize> {
    pub members: Vec<ClassMember>,
    pub classes: Vec<WedgeClass<K>>,
    pub candidates: Vec<Candidate>,
    /// Wedges on both sides of the edge, at its first and second end; `None` for a missing side.
    pub sides: [Option<[u32; 2]>; 2],
    pub is_plain: bool,
    /// Sum of the shape quadrics of both ends; only set if `has_single_wedges` is false.
    pub shape: Quadric<0>,
    pub runs: [Option<GrowingSeam>; 2],
}

impl<const K: usize> MergePlan<K> {
    /// Find the class of a wedge at an end.
    pub fn class_of(&self, end: usize, wedge: u32) -> Option<&WedgeClass<K>> {
        let member = self.members.iter().find(|m| m.end == end && m.wedge == wedge)?;
        Some(&self.classes[member.class])
    }
}

impl<const K: usize> Default for MergePlan<K> {
    fn default() -> Self {
        Self {
            members: vec![],
            classes: vec![],
            candidates: vec![],
            sides: [None; 2],
            is_plain: true,
            shape: Quadric::default(),
            runs: [None; 2],
        }
    }
}
