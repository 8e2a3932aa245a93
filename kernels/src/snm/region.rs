//! Coded part of a base mesh.

use super::border::Border;
use super::frame::{GateFrame, dot, subtract};
use crate::subdivision::snm_contents::BaseContents;

/// Coded vertices and triangles, with the border around them.
#[derive(Default)]
pub(super) struct Region {
    pub border: Border,
    pub base: BaseContents,
    /// Number of coded triangles at each vertex, at most 255.
    pub valences: Vec<u8>,
}

impl Region {
    /// Return the position of a vertex in grid coordinates.
    pub(super) fn position(&self, v: u32) -> [f64; 3] {
        self.base.positions[v as usize].map(f64::from)
    }

    /// Build the frame of a border edge.
    pub(super) fn frame(&self, gate: u32) -> GateFrame {
        let edge = self.border.edge(gate);
        let corners = [edge.origin, self.border.target(gate), edge.opposite];
        GateFrame::new(corners.map(|v| self.base.positions[v as usize]))
    }

    /// Return the opposite corner of the gate's triangle, the end of the next edge and the start of the
    /// previous edge.
    pub(super) fn neighbouring_corners(&self, gate: u32) -> [u32; 3] {
        let edge = self.border.edge(gate);
        [edge.opposite, self.border.target(edge.next), self.border.edge(edge.prev).origin]
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

    /// Compute the priority of a gate; smaller values are processed first. A sharp turn of the border makes
    /// the next vertex a likely tip. At long edges, a new vertex is predicted better.
    pub(super) fn compute_priority(&self, gate: u32) -> u64 {
        let edge = self.border.edge(gate);
        let frame = self.frame(gate);
        let mut angle = 4.0;
        if !self.border.edge(edge.next).is_boundary {
            let next = frame.to_local(self.position(self.border.target(edge.next)));
            let arm = subtract(next, [0.5, 0.0, 0.0]);
            let cosine = -arm[0] / dot(arm, arm).sqrt().max(1e-9);
            // Monotonic in the angle: 0 to 4 for 0 to 360°.
            angle = if arm[1] >= 0.0 { 1.0 - cosine } else { 3.0 + cosine };
        }
        let root = frame.length.sqrt();
        // Positive floats are ordered like their bits.
        (angle.max(0.3) / (root * root.sqrt())).to_bits()
    }
}
