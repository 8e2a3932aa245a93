//! What the wedges around an edge become when it collapses, and where its vertex may go.

use super::wedges::NONE;
use crate::base::geometry::Vec3;
use crate::base::ids::EdgeId;
use crate::quadrics::quadric::Quadric;

/// Where the star of an edge may go.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub place: Vec3,
    /// The end whose texture coordinates are kept; none if the quadrics tell them.
    pub keep: Option<usize>,
    pub cost: f64,
}

/// A seam edge that takes in the place of one that shrinks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    pub next: EdgeId,
    /// How far its image is then from what it was in the input, at the most.
    pub drift: f64,
}

/// A wedge at an end of the edge, and what it becomes part of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Member {
    pub wedge: u32,
    pub end: usize,
    pub class: usize,
}

/// What several wedges become.
#[derive(Clone, Copy, Debug)]
pub(super) struct Class<const K: usize> {
    pub quadric: Quadric<K>,
    /// A wedge of it at each end, if there is one.
    pub at_end: [u32; 2],
    /// Whether it has several wedges at an end that differ in their place in the image.
    pub is_torn: [bool; 2],
    pub is_merged: bool,
    pub value: [f64; K],
    pub home: u32,
}

impl<const K: usize> Class<K> {
    /// Whether nothing but one wedge, of the end that is kept, is in it.
    pub fn is_only_at(&self, keep: Option<usize>) -> bool {
        !self.is_merged && keep.is_some_and(|end| self.at_end[end] != NONE)
    }

    /// One of its wedges.
    pub fn some(&self) -> u32 {
        if self.at_end[0] != NONE { self.at_end[0] } else { self.at_end[1] }
    }

    /// The wedge that goes on when the end `survivor` does.
    pub fn kept(&self, survivor: usize) -> u32 {
        if self.at_end[survivor] != NONE { self.at_end[survivor] } else { self.at_end[1 - survivor] }
    }
}

/// What is worked out about one edge.
#[derive(Clone, Debug)]
pub(super) struct Plan<const K: usize> {
    pub members: Vec<Member>,
    pub classes: Vec<Class<K>>,
    pub candidates: Vec<Candidate>,
    /// Wedges of the two sides of the edge, at its first and second end; none on a boundary.
    pub sides: [Option<[u32; 2]>; 2],
    pub is_plain: bool,
    /// The shape quadrics of both ends together; only set where `is_plain` is not.
    pub shape: Quadric<0>,
    pub runs: [Option<Run>; 2],
}

impl<const K: usize> Plan<K> {
    /// What a wedge at an end becomes part of.
    pub fn class_of(&self, end: usize, wedge: u32) -> Option<&Class<K>> {
        let member = self.members.iter().find(|m| m.end == end && m.wedge == wedge)?;
        Some(&self.classes[member.class])
    }
}

impl<const K: usize> Default for Plan<K> {
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
