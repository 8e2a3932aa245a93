//! Bilinear samples of an image under the texels of an atlas.

use super::texel_sources::Corners;
use crate::atlas::texels::shares;
use crate::base::parallel::{collect, each};

/// Bits of the share of a texel in a sample.
const BITS: u32 = 8;
const ONE: u32 = 1 << BITS;

/// How an image goes on beyond its edges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wrap {
    Repeat,
    Clamp,
    Mirror,
}

impl Wrap {
    /// Bring a coordinate in units of the image into the range from 0 to 1.
    fn place(self, at: f64) -> f64 {
        match self {
            Self::Clamp => at.clamp(0.0, 1.0),
            Self::Repeat if (0.0..=1.0).contains(&at) => at,
            Self::Repeat => at - at.floor(),
            Self::Mirror => 1.0 - (1.0 - (at - 2.0 * (0.5 * at).floor())).abs(),
        }
    }

    /// The texels before and after a coordinate, and the share of the second.
    fn texels(self, at: f64, count: usize) -> ([usize; 2], u32) {
        let place = self.place(at) * count as f64 + 0.5;
        // One too large, so that it is not negative.
        let after = (place as usize).min(count);
        let share = ((place - after as f64) * f64::from(ONE) + 0.5) as u32;
        let is_ring = self == Self::Repeat;
        let before = if after > 0 { after - 1 } else if is_ring { count - 1 } else { 0 };
        let after = if after < count { after } else if is_ring { 0 } else { count - 1 };
        ([before, after], share.min(ONE))
    }
}

/// An image, row after row.
#[derive(Clone, Copy, Debug)]
pub struct Image<'a> {
    pub pixels: &'a [u8],
    pub width: usize,
    pub height: usize,
    pub channels: usize,
    pub wrap: [Wrap; 2],
}

impl Image<'_> {
    /// Sample the first channels at a texture coordinate, v up.
    #[inline]
    fn sample<const C: usize>(&self, [u, v]: [f64; 2]) -> [u8; C] {
        let (columns, right) = self.wrap[0].texels(u, self.width);
        let (rows, below) = self.wrap[1].texels(1.0 - v, self.height);
        let [[a, b], [c, d]] = rows.map(|row| {
            columns.map(|column| {
                let start = (row * self.width + column) * self.channels;
                &self.pixels[start..start + C]
            })
        });
        std::array::from_fn(|k| {
            let across = |one: u8, other: u8| u32::from(one) * (ONE - right) + u32::from(other) * right;
            let sum = across(a[k], b[k]) * (ONE - below) + across(c[k], d[k]) * below;
            ((sum + (1 << (2 * BITS - 1))) >> (2 * BITS)) as u8
        })
    }
}

/// Triangles that are drawn into an atlas.
#[derive(Clone, Copy)]
pub struct Drawn<'a> {
    /// The triangle of each texel of the atlas, row by row; negative for none.
    pub triangles: &'a [i32],
    /// In texels of the atlas, and in units of the image.
    pub corners: &'a [Corners],
    pub uvs: &'a [Corners],
    /// Triangles that show the image.
    pub is_shown: &'a [bool],
}

/// Write samples of an image into the texels of an atlas, C channels, whose triangles show it.
///
/// `texels` has as many items as there are triangles of texels, all of which are in range. `image` has at least C
/// channels.
pub fn sample<const C: usize>(
    image: &Image<'_>,
    drawn: &Drawn<'_>,
    texels: &mut [[u8; C]],
    width: usize,
    threads: usize,
) {
    let rows = texels.chunks_mut(width).zip(drawn.triangles.chunks(width)).enumerate().collect();
    each(rows, threads, |(row, (texels, triangles)): (usize, (&mut [[u8; C]], &[i32]))| {
        let y = row as f64 + 0.5;
        let mut column = 0;
        for run in triangles.chunk_by(|a, b| a == b) {
            let columns = column..column + run.len();
            column = columns.end;
            let Ok(t) = usize::try_from(run[0]) else { continue };
            if !drawn.is_shown[t] {
                continue;
            }
            let (corners, uvs) = (&drawn.corners[t], &drawn.uvs[t]);
            let across = Across::new(corners, y);
            for (x, texel) in columns.clone().zip(&mut texels[columns]) {
                *texel = image.sample(mixed(&across.shares(corners, x as f64 + 0.5, y), uvs));
            }
        }
    });
}

/// Sample the first C channels of an image at texture coordinates, v up.
pub fn sample_points<const C: usize>(image: &Image<'_>, uvs: &[[f64; 2]], threads: usize) -> Vec<[u8; C]> {
    collect(uvs.len(), threads, |i| image.sample(uvs[i]))
}

/// Barycentric coordinates along a row.
struct Across {
    is_sound: bool,
    first: f64,
    values: [f64; 2],
    steps: [f64; 2],
}

impl Across {
    fn new([a, b, c]: &Corners, y: f64) -> Self {
        let (ab, ac) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
        let area = ab[0] * ac[1] - ab[1] * ac[0];
        let below = y - a[1];
        Self {
            is_sound: area != 0.0,
            first: a[0],
            values: [-below * ac[0] / area, ab[0] * below / area],
            steps: [ac[1] / area, -ab[1] / area],
        }
    }

    /// Shares of the corners in the nearest point of the triangle.
    #[inline]
    fn shares(&self, corners: &Corners, x: f64, y: f64) -> [f64; 3] {
        let [v, w] = [0, 1].map(|k| self.values[k] + (x - self.first) * self.steps[k]);
        let u = 1.0 - v - w;
        if self.is_sound && u >= 0.0 && v >= 0.0 && w >= 0.0 { [u, v, w] } else { shares(corners, [x, y]) }
    }
}

#[inline]
fn mixed(shares: &[f64; 3], values: &Corners) -> [f64; 2] {
    [0, 1].map(|k| shares[0] * values[0][k] + shares[1] * values[1][k] + shares[2] * values[2][k])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_go_on_beyond_their_edges_as_they_say() {
        let pixels = [0u8, 100, 200];
        let at = |wrap: Wrap, u: f64| {
            let image = Image { pixels: &pixels, width: 3, height: 1, channels: 1, wrap: [wrap; 2] };
            image.sample::<1>([u, 0.5])[0]
        };
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            for (column, &level) in pixels.iter().enumerate() {
                assert_eq!(at(wrap, (column as f64 + 0.5) / 3.0), level);
            }
        }
        for u in [-1.0, 0.0, 1.0, 2.0] {
            assert_eq!(at(Wrap::Repeat, u), 100);
        }
        assert_eq!([-5.0, 0.0, 1.0, 5.0].map(|u| at(Wrap::Clamp, u)), [0, 0, 200, 200]);
        assert_eq!([-1.0, 0.0, 1.0, 2.0, 3.0].map(|u| at(Wrap::Mirror, u)), [200, 0, 200, 0, 200]);
        assert_eq!(at(Wrap::Mirror, -0.5), 100);
        // Beyond all that is exact, any texel will do.
        for u in [1e300, -1e300, f64::MAX] {
            [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror].map(|wrap| at(wrap, u));
        }
    }

    #[test]
    fn a_texel_beside_a_triangle_gets_the_nearest_point() {
        let corners = [[[2.0, 2.0], [6.0, 2.0], [2.0, 6.0]]];
        let uvs = [[[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]]];
        let pixels: Vec<u8> = (0..=255).collect();
        let image =
            Image { pixels: &pixels, width: 256, height: 1, channels: 1, wrap: [Wrap::Clamp; 2] };
        let mut texels = vec![[0u8]; 64];
        let triangles = [0; 64];
        let drawn = Drawn { triangles: &triangles, corners: &corners, uvs: &uvs, is_shown: &[true] };
        sample(&image, &drawn, &mut texels, 8, 2);
        assert_eq!(texels[2 * 8 + 1], [0]);
        assert_eq!(texels[2 * 8 + 3], [96]);
        assert_eq!(texels[7], [255]);
    }
}
