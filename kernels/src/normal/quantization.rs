//! Quantisation of offsets and base vertices, shared by encoder and decoder.

use super::prediction::{Frame, PredictedVertices};
use crate::base::geometry::{Vec3, add_scaled, dot, sub};
use crate::subdivision::snm_contents::{Header, Offset};

/// Maximum quantisation error of an offset, in steps.
pub const MAX_ROUNDING_ERROR: f64 = 0.6;

/// Quantisation steps of one level, in mesh units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuantizationSteps {
    pub scalar: f64,
    pub vector: f64,
}

impl QuantizationSteps {
    /// Compute the steps for the offsets that refine `level`.
    pub fn for_level(header: &Header, level: usize) -> Self {
        let coarser = usize::from(header.levels).saturating_sub(level + 1);
        let ratio = f64::from(header.step_ratio);
        let factor = (0..coarser).fold(1.0, |factor, _| factor * ratio);
        Self { scalar: factor * f64::from(header.step), vector: f64::from(header.grid) }
    }

    /// Quantise a distance along the normal with a dead zone. Distances below [`MAX_ROUNDING_ERROR`] steps become 0,
    /// because zeros take far fewer bits in the file.
    pub fn scalar(&self, distance: f64) -> i32 {
        let steps = (distance.abs() / self.scalar + 1.0 - MAX_ROUNDING_ERROR).floor();
        steps.copysign(distance) as i32
    }

    /// Quantise the vector from a predicted point to `point`.
    pub fn vector(&self, predicted: &Vec3, frame: &Frame, point: &Vec3) -> Offset {
        let off = sub(point, predicted);
        Offset::Vector([0, 1, 2].map(|i| (dot(&off, &frame[i]) / self.vector).round() as i32))
    }

    /// Apply a quantised offset to the predicted vertex of an edge.
    pub fn apply_offset(&self, predicted: &PredictedVertices, edge: usize, offset: &Offset) -> Vec3 {
        let (point, frame) = (&predicted.points[edge], &predicted.frames[edge]);
        match offset {
            Offset::Scalar(d) => add_scaled(point, f64::from(*d) * self.scalar, &frame[0]),
            Offset::Unrelaxed(d) => {
                add_scaled(&predicted.unrelaxed[edge], f64::from(*d) * self.scalar, &frame[0])
            }
            Offset::Vector(d) => {
                (0..3).fold(*point, |p, i| add_scaled(&p, f64::from(d[i]) * self.vector, &frame[i]))
            }
        }
    }
}

/// Round a base vertex to grid coordinates. The inverse is [`from_grid`].
pub fn to_grid(p: &Vec3, header: &Header) -> [i32; 3] {
    p.map(|x| (x / f64::from(header.grid)).round() as i32)
}

/// Convert grid coordinates to a position relative to the header's origin.
pub fn from_grid(k: &[i32; 3], header: &Header) -> Vec3 {
    k.map(|x| f64::from(x) * f64::from(header.grid))
}

/// Quantise the difference between channels and their prediction, in channel units.
pub fn quantize_channels(channels: &[f64; 4], expected: &[f64; 4], header: &Header) -> [i32; 4] {
    std::array::from_fn(|i| {
        let used = i < usize::from(header.channels);
        if used { ((channels[i] - expected[i]) / f64::from(header.units[i])).round() as i32 } else { 0 }
    })
}
