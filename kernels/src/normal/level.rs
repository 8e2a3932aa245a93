//! One level of a normal mesh and the step to the next, bit-identical in encoder and decoder.

use super::prediction::{PredictedVertices, predict};
use super::quantization::{QuantizationSteps, from_grid};
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, dot, sub};
use crate::subdivision::butterfly;
use crate::subdivision::snm_contents::{BaseContents, Header, Refinement, Scheme};
use crate::subdivision::topology::Topology;

/// Resolution of predicted offsets for the entropy coder, in fractions of a step.
const PREDICTION_PARTS: f64 = 16.0;

/// One level: connectivity, positions and attributes.
#[derive(Clone, Debug)]
pub struct Level {
    pub topology: Topology,
    /// Vertex positions relative to the header's origin.
    pub points: Vec<Vec3>,
    /// Vertex attributes; empty without attributes.
    pub channels: Vec<[f64; 4]>,
}

impl Level {
    /// Build the base level from the contents of a file.
    ///
    /// # Errors
    /// As [`Topology::new`].
    pub fn from_base(header: &Header, base: &BaseContents) -> Result<Self, KernelError> {
        let of_units = |k: &[i32; 4]| std::array::from_fn(|i| f64::from(k[i]) * f64::from(header.units[i]));
        Ok(Self {
            topology: Topology::new(base.positions.len(), base.triangles.clone())?,
            points: base.positions.iter().map(|k| from_grid(k, header)).collect(),
            channels: base.channels.iter().map(of_units).collect(),
        })
    }

    /// Number of vertices plus triangles.
    pub fn row_count(&self) -> usize {
        self.points.len() + self.topology.triangles.len()
    }

    /// Number of vertices plus triangles of the next level.
    pub fn next_row_count(&self) -> usize {
        self.points.len() + self.topology.edges.len() + 4 * self.topology.triangles.len()
    }

    /// Predict the vertices of the next level.
    pub fn predict_vertices(&self, header: &Header) -> PredictedVertices {
        predict(&self.topology, &self.points, header.scheme, header.relaxations)
    }

    /// Predict the quantised offsets for the entropy coder, in 1/16 steps. The prediction is the difference
    /// between the butterfly and the linear midpoint along the normal. Empty for the butterfly scheme.
    pub fn predict_offsets(
        &self,
        header: &Header,
        steps: &QuantizationSteps,
        predicted: &PredictedVertices,
    ) -> Vec<i32> {
        if header.scheme == Scheme::Butterfly {
            return vec![];
        }
        let curved = butterfly::compute_edge_points(&self.topology, &self.points);
        let along = |(edge, point): (usize, &Vec3)| {
            let bulge = dot(&sub(point, &predicted.points[edge]), &predicted.frames[edge][0]);
            (PREDICTION_PARTS * bulge / steps.scalar).round() as i32
        };
        curved.iter().enumerate().map(along).collect()
    }

    /// Predict the channels of an edge's new vertex.
    pub fn predict_channels(&self, edge: usize) -> [f64; 4] {
        let [a, b] = self.topology.edges[edge].map(|v| self.channels[v as usize]);
        std::array::from_fn(|i| 0.5 * (a[i] + b[i]))
    }

    /// Compute the next level.
    pub fn refine(
        &self,
        header: &Header,
        steps: &QuantizationSteps,
        predicted: &PredictedVertices,
        refinement: &Refinement,
    ) -> Self {
        let offsets = refinement.offsets.iter().enumerate();
        let mut points = self.points.clone();
        points.extend(offsets.map(|(edge, offset)| steps.apply_offset(predicted, edge, offset)));
        let mut channels = self.channels.clone();
        channels.extend(refinement.channels.iter().enumerate().map(|(edge, k)| {
            let between = self.predict_channels(edge);
            std::array::from_fn(|i| between[i] + f64::from(k[i]) * f64::from(header.units[i]))
        }));
        Self { topology: self.topology.subdivide(), points, channels }
    }
}
