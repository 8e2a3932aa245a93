//! Bilinear samples of an image at the texels of an atlas.

use super::texel_sources::Corners;
use crate::atlas::texels::barycentric_weights;
use crate::base::parallel::{collect, for_each_part};

/// Fractional bits of the interpolation weights.
const WEIGHT_BITS: u32 = 8;
const WEIGHT_ONE: u32 = 1 << WEIGHT_BITS;

/// Continuation of an image beyond its edges (glTF wrap mode).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WrapMode {
    Repeat,
    Clamp,
    Mirror,
}

impl WrapMode {
    /// Convert a texture coordinate to texels, shifted by half a texel: the centre of the first texel is at
    /// 1.
    #[inline]
    fn to_texels(self, at: f64, count: usize) -> f64 {
        let at = match self {
            _ if (0.0..=1.0).contains(&at) => at,
            Self::Clamp => at.clamp(0.0, 1.0),
            Self::Repeat => at - at.floor(),
            Self::Mirror => 1.0 - (1.0 - (at - 2.0 * (0.5 * at).floor())).abs(),
        };
        at * count as f64 + 0.5
    }

    /// Return the texels before and after position `after` at one end of the image, with wrapping.
    fn adjacent_texels(self, after: usize, count: usize) -> [usize; 2] {
        match self {
            Self::Repeat => [(after + count - 1) % count, after % count],
            _ => [after.saturating_sub(1), after.min(count - 1)],
        }
    }
}

/// Image, row by row.
#[derive(Clone, Copy, Debug)]
pub struct SampledImage<'a> {
    pub pixels: &'a [u8],
    pub width: usize,
    pub height: usize,
    pub channels: usize,
    pub wrap: [WrapMode; 2],
}

impl SampledImage<'_> {
    /// Sample the first channels at a texture coordinate, v up.
    #[inline]
    fn sample<const C: usize>(&self, [u, v]: [f64; 2]) -> [u8; C] {
        let (x, y) = (self.wrap[0].to_texels(u, self.width), self.wrap[1].to_texels(1.0 - v, self.height));
        // A 32-bit integer, because processors convert it in one instruction; non-finite values become 0.
        let [column, row] = [x as i32, y as i32];
        let share =
            |at: f64, whole: i32| ((at - f64::from(whole)) * f64::from(WEIGHT_ONE) + 0.5) as i32 as u32;
        let (right, below) = (share(x, column).min(WEIGHT_ONE), share(y, row).min(WEIGHT_ONE));
        let (column, row) = (column as usize, row as usize);
        if (1..self.width).contains(&column) && (1..self.height).contains(&row) {
            let start = ((row - 1) * self.width + column - 1) * self.channels;
            let [above, under] = [start, start + self.width * self.channels]
                .map(|start| &self.pixels[start..start + self.channels + C]);
            let across = |texels: &[u8], k: usize| mix(texels[k], texels[self.channels + k], right);
            return std::array::from_fn(|k| round(across(above, k), across(under, k), below));
        }
        let columns = self.wrap[0].adjacent_texels(column.min(self.width), self.width);
        let rows = self.wrap[1].adjacent_texels(row.min(self.height), self.height);
        let [above, under] = rows.map(|row| {
            columns.map(|column| &self.pixels[(row * self.width + column) * self.channels..][..C])
        });
        let across = |texels: &[&[u8]; 2], k: usize| mix(texels[0][k], texels[1][k], right);
        std::array::from_fn(|k| round(across(&above, k), across(&under, k), below))
    }
}

#[inline]
fn mix(one: u8, other: u8, share: u32) -> u32 {
    u32::from(one) * (WEIGHT_ONE - share) + u32::from(other) * share
}

#[inline]
fn round(one: u32, other: u32, share: u32) -> u8 {
    ((one * (WEIGHT_ONE - share) + other * share + (1 << (2 * WEIGHT_BITS - 1))) >> (2 * WEIGHT_BITS)) as u8
}

/// Triangles drawn into an atlas.
#[derive(Clone, Copy)]
pub struct DrawnTriangles<'a> {
    /// Triangle of each texel of the atlas, row by row; negative for no triangle.
    pub triangles: &'a [i32],
    /// Corners in texels of the atlas, and texture coordinates in the image.
    pub corners: &'a [Corners],
    pub uvs: &'a [Corners],
    /// Mask of the triangles that use the image.
    pub uses_image: &'a [bool],
}

/// Write samples of an image into the texels of an atlas whose triangles use the image, C channels.
///
/// `texels` has one item per item of `drawn.triangles`. All triangle indices must be in range. `pixel_lookup` must
/// have at least C channels.
pub fn sample<const C: usize>(
    image: &SampledImage<'_>,
    drawn: &DrawnTriangles<'_>,
    texels: &mut [[u8; C]],
    width: usize,
    threads: usize,
) {
    let rows = texels.chunks_mut(width).zip(drawn.triangles.chunks(width)).enumerate().collect();
    for_each_part(rows, threads, |(row, (texels, triangles)): (usize, (&mut [[u8; C]], &[i32]))| {
        let y = row as f64 + 0.5;
        let mut column = 0;
        for run in triangles.chunk_by(|a, b| a == b) {
            let columns = column..column + run.len();
            column = columns.end;
            let Ok(t) = usize::try_from(run[0]) else { continue };
            if !drawn.uses_image[t] {
                continue;
            }
            let (corners, uvs) = (&drawn.corners[t], &drawn.uvs[t]);
            let across = RowWeights::new(corners, y);
            let at = |column: usize| across.shares(column as f64 + 0.5);
            let texels = &mut texels[columns.clone()];
            if let (Some(first), Some(last)) = (at(columns.start), at(columns.end - 1)) {
                // All texels between two points of a triangle are inside it.
                let [start, end] = [first, last].map(|shares| interpolate_uv(&shares, uvs));
                let step = [0, 1].map(|k| (end[k] - start[k]) / (run.len() - 1).max(1) as f64);
                for (i, texel) in texels.iter_mut().enumerate() {
                    *texel = image.sample([0, 1].map(|k| start[k] + i as f64 * step[k]));
                }
            } else {
                for (column, texel) in columns.zip(texels) {
                    let near = || barycentric_weights(corners, [column as f64 + 0.5, y]);
                    *texel = image.sample(interpolate_uv(&at(column).unwrap_or_else(near), uvs));
                }
            }
        }
    });
}

/// Sample the first C channels of an image at texture coordinates, v up.
pub fn sample_points<const C: usize>(
    image: &SampledImage<'_>,
    uvs: &[[f64; 2]],
    threads: usize,
) -> Vec<[u8; C]> {
    collect(uvs.len(), threads, |i| image.sample(uvs[i]))
}

/// Barycentric coordinates along a row.
struct RowWeights {
    has_area: bool,
    first: f64,
    values: [f64; 2],
    steps: [f64; 2],
}

impl RowWeights {
    fn new([a, b, c]: &Corners, y: f64) -> Self {
        let (ab, ac) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
        let area = ab[0] * ac[1] - ab[1] * ac[0];
        let below = y - a[1];
        Self {
            has_area: area != 0.0,
            first: a[0],
            values: [-below * ac[0] / area, ab[0] * below / area],
            steps: [ac[1] / area, -ab[1] / area],
        }
    }

    /// Compute the barycentric weights at a point; `None` outside the triangle.
    #[inline]
    fn shares(&self, x: f64) -> Option<[f64; 3]> {
        let [v, w] = [0, 1].map(|k| self.values[k] + (x - self.first) * self.steps[k]);
        let u = 1.0 - v - w;
        (self.has_area && u >= 0.0 && v >= 0.0 && w >= 0.0).then_some([u, v, w])
    }
}

#[inline]
fn interpolate_uv(shares: &[f64; 3], values: &Corners) -> [f64; 2] {
    [0, 1].map(|k| shares[0] * values[0][k] + shares[1] * values[1][k] + shares[2] * values[2][k])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_go_on_beyond_their_edges_as_they_say() {
        let pixels = [0u8, 100, 200];
        let at = |wrap: WrapMode, u: f64| {
            let image = SampledImage { pixels: &pixels, width: 3, height: 1, channels: 1, wrap: [wrap; 2] };
            image.sample::<1>([u, 0.5])[0]
        };
        for wrap in [WrapMode::Repeat, WrapMode::Clamp, WrapMode::Mirror] {
            for (column, &level) in pixels.iter().enumerate() {
                assert_eq!(at(wrap, (column as f64 + 0.5) / 3.0), level);
            }
        }
        for u in [-1.0, 0.0, 1.0, 2.0] {
            assert_eq!(at(WrapMode::Repeat, u), 100);
        }
        assert_eq!([-5.0, 0.0, 1.0, 5.0].map(|u| at(WrapMode::Clamp, u)), [0, 0, 200, 200]);
        assert_eq!([-1.0, 0.0, 1.0, 2.0, 3.0].map(|u| at(WrapMode::Mirror, u)), [200, 0, 200, 0, 200]);
        assert_eq!(at(WrapMode::Mirror, -0.5), 100);
        // Beyond the precision of coordinates, any texel is acceptable.
        for u in [1e300, -1e300, f64::MAX] {
            for wrap in [WrapMode::Repeat, WrapMode::Clamp, WrapMode::Mirror] {
                at(wrap, u);
            }
        }
    }

    #[test]
    fn a_texel_beside_a_triangle_gets_the_nearest_point() {
        let corners = [[[2.0, 2.0], [6.0, 2.0], [2.0, 6.0]]];
        let uvs = [[[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]]];
        let pixels: Vec<u8> = (0..=255).collect();
        let image =
            SampledImage { pixels: &pixels, width: 256, height: 1, channels: 1, wrap: [WrapMode::Clamp; 2] };
        let mut texels = vec![[0u8]; 64];
        let triangles = [0; 64];
        let drawn =
            DrawnTriangles { triangles: &triangles, corners: &corners, uvs: &uvs, uses_image: &[true] };
        sample(&image, &drawn, &mut texels, 8, 2);
        assert_eq!(texels[2 * 8 + 1], [0]);
        assert_eq!(texels[2 * 8 + 3], [96]);
        assert_eq!(texels[7], [255]);
    }
}
