//! The part of a base mesh that is coded.

use super::border::Border;
use super::frame::{Frame, dot, minus};
use crate::subdivision::contents::Base;

#[derive(Default)]
pub(super) struct Region {
    pub border: Border,
    pub base: Base,
    /// Triangles at each vertex so far, 255 at most.
    pub valences: Vec<u8>,
}

impl Region {
    pub(super) fn position(&self, v: u32) -> [f64; 3] {
        self.base.positions[v as usize].map(f64::from)
    }

    /// The frame of an edge of the border.
    pub(super) fn frame(&self, gate: u32) -> Frame {
        let edge = self.border.edge(gate);
        let corners = [edge.origin, self.border.target(gate), edge.across];
        Frame::new(corners.map(|v| self.base.positions[v as usize]))
    }

    /// The corners across the triangle of a gate, at the end of the next edge and at the beginning of the
    /// previous.
    pub(super) fn around(&self, gate: u32) -> [u32; 3] {
        let edge = self.border.edge(gate);
        [edge.across, self.border.target(edge.next), self.border.edge(edge.prev).origin]
    }

    pub(super) fn add_triangle(&mut self, corners: [u32; 3]) {
        for v in corners {
            let valence = &mut self.valences[v as usize];
            *valence = valence.saturating_add(1);
        }
        self.base.triangles.push(corners);
    }

    pub(super) fn add_vertex(&mut self, position: [i32; 3], channels: Option<[i32; 4]>) -> u32 {
        self.base.positions.push(position);
        self.base.channels.extend(channels);
        self.valences.push(0);
        self.valences.len() as u32 - 1
    }

    /// The smaller, the sooner an edge of the border is grown at: where the border turns sharply at its end,
    /// the next vertex is likely to be the tip, and a new vertex at a long edge is better known.
    pub(super) fn urgency(&self, gate: u32) -> u64 {
        let edge = self.border.edge(gate);
        let frame = self.frame(gate);
        let mut angle = 4.0;
        if !self.border.edge(edge.next).closed {
            let next = frame.local(self.position(self.border.target(edge.next)));
            let arm = minus(next, [0.5, 0.0, 0.0]);
            let cosine = -arm[0] / dot(arm, arm).sqrt().max(1e-9);
            // From 0 to 4 as the angle goes from 0 to 360°.
            angle = if arm[1] >= 0.0 { 1.0 - cosine } else { 3.0 + cosine };
        }
        let root = frame.length.sqrt();
        // Positive numbers are ordered as their bits are.
        (angle.max(0.3) / (root * root.sqrt())).to_bits()
    }
}
