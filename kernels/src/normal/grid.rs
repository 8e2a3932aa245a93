//! From real offsets to whole numbers and back, for encoder and decoder.

use super::predict::{Frame, Predicted};
use crate::base::geometry::{Vec3, add_scaled, dot, sub};
use crate::subdivision::contents::{Header, Offset};

/// The most that an offset can be off by, in steps.
pub const ROUNDED_OFF: f64 = 0.6;

/// Steps of one level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steps {
    pub scalar: f64,
    pub vector: f64,
}

impl Steps {
    /// Of the level that refines level `level`.
    pub fn of(header: &Header, level: usize) -> Self {
        let coarser = usize::from(header.levels).saturating_sub(level + 1);
        let ratio = f64::from(header.step_ratio);
        let factor = (0..coarser).fold(1.0, |factor, _| factor * ratio);
        Self { scalar: factor * f64::from(header.step), vector: f64::from(header.grid) }
    }

    /// A distance along the normal in whole steps. More than half a step is needed to leave 0: in the file a 0 is far
    /// shorter, and never farther off than [`ROUNDED_OFF`] steps.
    pub fn scalar(&self, distance: f64) -> i32 {
        let steps = (distance.abs() / self.scalar + 1.0 - ROUNDED_OFF).floor();
        steps.copysign(distance) as i32
    }

    /// The vector nearest to a point.
    pub fn vector(&self, predicted: &Vec3, frame: &Frame, point: &Vec3) -> Offset {
        let off = sub(point, predicted);
        Offset::Vector([0, 1, 2].map(|i| (dot(&off, &frame[i]) / self.vector).round() as i32))
    }

    /// Where the offset of an edge's new vertex leads.
    pub fn apply(&self, predicted: &Predicted, edge: usize, offset: &Offset) -> Vec3 {
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

/// Base vertices as grid points, and back.
pub fn on_grid(p: &Vec3, header: &Header) -> [i32; 3] {
    p.map(|x| (x / f64::from(header.grid)).round() as i32)
}

pub fn from_grid(k: &[i32; 3], header: &Header) -> Vec3 {
    k.map(|x| f64::from(x) * f64::from(header.grid))
}

/// What channels differ by from what is expected, in units.
pub fn in_units(channels: &[f64; 4], expected: &[f64; 4], header: &Header) -> [i32; 4] {
    std::array::from_fn(|i| {
        let used = i < usize::from(header.channels);
        if used { ((channels[i] - expected[i]) / f64::from(header.units[i])).round() as i32 } else { 0 }
    })
}
