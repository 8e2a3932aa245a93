//! Vertex attributes as channels: luma, two chroma differences and a confidence.

use super::surface::{Surface, SurfacePoint};

/// Attributes of the input's vertices.
#[derive(Clone, Debug, Default)]
pub struct VertexAttributes {
    /// RGB, 0 to 255 per component; empty without colours.
    pub colors: Vec<[u8; 3]>,
    /// Confidence per vertex, any finite range; empty without confidences.
    pub confidence: Vec<f64>,
}

/// Quantisation units between the smallest and the largest confidence, and the limit for quantised values.
/// The limit keeps values with a large offset within 20 bits.
const CONFIDENCE_UNITS: f64 = 255.0;
const MAX_CONFIDENCE_UNITS: f64 = (1 << 20) as f64;
/// Part of the colour tolerance that rounding to 8-bit levels uses, in levels.
const LEVEL_ROUNDING_ERROR: f64 = 0.5;
/// Smallest unit of a colour channel, in 8-bit levels.
const MIN_COLOR_UNIT: f64 = 1.0 / 16.0;

/// Convert RGB levels to luma, orange–blue and green–magenta: the YCoCg transform (Malvar and Sullivan 2003)
/// on real numbers.
fn to_channels([r, g, b]: [f64; 3]) -> [f64; 3] {
    let side = 0.5 * (r + b);
    [0.5 * (g + side), r - b, g - side]
}

/// Convert luma and chroma back to rounded RGB levels.
pub fn to_rgb([y, orange, green]: [f64; 3]) -> [u8; 3] {
    let side = y - 0.5 * green;
    [side + 0.5 * orange, y + 0.5 * green, side - 0.5 * orange].map(|x| x.round().clamp(0.0, 255.0) as u8)
}

impl VertexAttributes {
    /// Number of channels: 3 for colours plus 1 for a confidence.
    pub fn channel_count(&self) -> u8 {
        3 * u8::from(!self.colors.is_empty()) + u8::from(!self.confidence.is_empty())
    }

    /// Compute the quantisation unit of each channel. Colours deviate by at most `tolerance` levels, rounding
    /// included.
    ///
    /// Quantisation errors add up to one unit at most: half a unit from luma and a quarter from each chroma
    /// channel.
    pub fn channel_units(&self, tolerance: f64) -> [f32; 4] {
        let color = (tolerance - LEVEL_ROUNDING_ERROR).max(MIN_COLOR_UNIT) as f32;
        let [low, high] = self
            .confidence
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &c| [low.min(c), high.max(c)]);
        let largest = low.abs().max(high.abs());
        // A constant confidence becomes one unit.
        let unit = if high > low {
            ((high - low) / CONFIDENCE_UNITS).max(largest / MAX_CONFIDENCE_UNITS)
        } else {
            largest
        };
        let confidence = if unit > 0.0 && unit.is_finite() { unit as f32 } else { 1.0 };
        match (self.colors.is_empty(), self.confidence.is_empty()) {
            (false, _) => [color, color, color, confidence],
            (true, _) => [confidence, 0.0, 0.0, 0.0],
        }
    }

    /// Interpolate the channels at a surface point.
    pub fn interpolate_channels(&self, surface: &Surface, place: &SurfacePoint) -> [f64; 4] {
        let vertices = surface.vertices(place.slot);
        let mixed = |of: &dyn Fn(usize) -> f64| {
            (0..3).map(|i| place.barycentric[i] * of(vertices[i] as usize)).sum::<f64>()
        };
        let mut channels = [0.0; 4];
        if !self.colors.is_empty() {
            let color = [0, 1, 2].map(|k| mixed(&|v| f64::from(self.colors[v][k])));
            channels[..3].copy_from_slice(&to_channels(color));
        }
        if !self.confidence.is_empty() {
            channels[if self.colors.is_empty() { 0 } else { 3 }] = mixed(&|v| self.confidence[v]);
        }
        channels
    }
}
