//! Consistency checks of a depth map with other views.

use super::cost_volume::ImageSize;
use crate::base::by_processor::by_processor;
use crate::base::parallel::{collect, for_each_part};

/// Projection from pixels into another view: maps (u z, v z, z, 1) to the other view's (u z, v z, z).
pub type PixelProjection = [[f64; 4]; 3];

/// Map of another view (depth or mask), with the projection into it.
pub struct OtherView<T> {
    pub from_pixels: PixelProjection,
    pub size: ImageSize,
    pub map: Vec<T>,
}

impl<T: Copy> OtherView<T> {
    /// Look up the map where the other view sees pixel (u, v) at depth z. Returns the value and the depth
    /// from the other view; None if the point is behind that view or outside its image.
    pub fn look_up(&self, u: usize, v: usize, z: f64) -> Option<(T, f64)> {
        let place = [u as f64 * z, v as f64 * z, z];
        let [x, y, ahead] =
            self.from_pixels.map(|row| row[0] * place[0] + row[1] * place[1] + row[2] * place[2] + row[3]);
        let (x, y) = (x / ahead, y / ahead);
        let (right, down) = ((self.size.width - 1) as f64, (self.size.height - 1) as f64);
        let holds = ahead > 0.0 && x >= 0.0 && y >= 0.0 && x <= right && y <= down;
        holds.then(|| (self.map[(y + 0.5) as usize * self.size.width + (x + 0.5) as usize], ahead))
    }
}

/// Row of a depth map, projected into another view.
pub struct ProjectedRow {
    /// Index of the pixel in the other view; −1 if the point is behind that view or outside its image.
    pub places: Vec<i32>,
    /// Depth from the other view.
    pub depths: Vec<f64>,
}

impl ProjectedRow {
    /// Create a row of the given width.
    pub fn new(width: usize) -> Self {
        Self { places: vec![-1; width], depths: vec![0.0; width] }
    }

    /// Project row `y` of a depth map into a view of `size`. Missing depth, 0, is outside.
    ///
    /// `border`: distance in pixels, up to one half, from the outermost pixel centres to the image border.
    #[inline(always)]
    pub fn project(
        &mut self,
        matrix: &PixelProjection,
        size: ImageSize,
        border: f64,
        y: usize,
        depth: impl Iterator<Item = f32>,
    ) {
        let y = y as f64;
        let (last_column, last_row) = (size.width as i32 - 1, size.height as i32 - 1);
        let (right, bottom) = (f64::from(last_column) + border, f64::from(last_row) + border);
        for (x, ((place, ahead), z)) in (0i32..).zip(self.places.iter_mut().zip(&mut self.depths).zip(depth))
        {
            let (x, z) = (f64::from(x), f64::from(z));
            let [u, v, w] = [0, 1, 2].map(|row: usize| {
                let row = matrix[row];
                row[0] * (x * z) + row[1] * (y * z) + row[2] * z + row[3]
            });
            let (u, v) = (u / w, v / w);
            let inside = z > 0.0 && w > 0.0 && u >= -border && v >= -border && u <= right && v <= bottom;
            let (u, v) = (if inside { u + 0.5 } else { 0.0 }, if inside { v + 0.5 } else { 0.0 });
            // SAFETY: both are at most the image size; pixels outside were set to 0.
            let (column, row): (i32, i32) = unsafe { (u.to_int_unchecked(), v.to_int_unchecked()) };
            let index = row.min(last_row) * (last_column + 1) + column.min(last_column);
            *place = if inside { index } else { -1 };
            *ahead = w;
        }
    }

    /// Look up the map of the other view at each pixel; the default where the point is outside.
    #[inline(always)]
    pub fn look_up<T: Copy + Default>(&self, map: &[T], found: &mut [T]) {
        for (found, &place) in found.iter_mut().zip(&self.places) {
            *found = if place < 0 { T::default() } else { map[place as usize] };
        }
    }
}

/// Limits for the support of a depth by other views, relative to the depth from there.
#[derive(Clone, Copy, Debug)]
pub struct SupportLimits {
    /// Maximum differences of a consistent and of a nearly consistent depth.
    pub tolerances: [f64; 2],
    /// Minimum depth of a view that is not occluded.
    pub min_depth_ratio: f64,
}

/// Count the other views with a consistent depth, with a nearly consistent depth, without occlusion, and with
/// any depth. 0 where the depth is missing.
pub fn count_supporting_views(
    depth: &[f32],
    size: ImageSize,
    others: &[OtherView<f32>],
    limits: SupportLimits,
    threads: usize,
) -> Vec<[u8; 4]> {
    let mut counts = vec![[0; 4]; depth.len()];
    let rows = counts.chunks_mut(size.width).zip(depth.chunks(size.width)).enumerate().collect();
    for_each_part(rows, threads, |(y, (counts, depth))| {
        if depth.iter().any(|&z| z > 0.0) {
            count_support_in_row(depth, y, others, limits, counts);
        }
    });
    counts
}

by_processor! {
    fn count_support_in_row(depth: &[f32], y: usize, others: &[OtherView<f32>], limits: SupportLimits, counts: &mut [[u8; 4]]) = count_support_scalar
}

#[inline(always)]
fn count_support_scalar(
    depth: &[f32],
    y: usize,
    others: &[OtherView<f32>],
    limits: SupportLimits,
    counts: &mut [[u8; 4]],
) {
    let (mut projected, mut there) = (ProjectedRow::new(depth.len()), vec![0.0; depth.len()]);
    let [narrow, wide] = limits.tolerances;
    for other in others {
        projected.project(&other.from_pixels, other.size, 0.0, y, depth.iter().copied());
        projected.look_up(&other.map, &mut there);
        for ((counts, &there), &ahead) in counts.iter_mut().zip(&there).zip(&projected.depths) {
            let there = f64::from(there);
            let off = (there - ahead).abs();
            // A point outside the view has the default, 0.
            let is_known = there > 0.0;
            let supports = [
                is_known & (off <= narrow * ahead),
                is_known & (off <= wide * ahead),
                is_known & (there > limits.min_depth_ratio * ahead),
                is_known,
            ];
            for (count, supports) in counts.iter_mut().zip(supports) {
                *count = count.saturating_add(supports.into());
            }
        }
    }
}

/// Check whether the point of each pixel is inside the masks of all views that see it.
pub fn is_inside_all_masks(
    depth: &[f32],
    size: ImageSize,
    masks: &[OtherView<bool>],
    threads: usize,
) -> Vec<bool> {
    collect(size.pixel_count(), threads, |i| {
        let z = f64::from(depth[i]);
        masks
            .iter()
            .all(|one| one.look_up(i % size.width, i / size.width, z).is_none_or(|(inside, _)| inside))
    })
}

/// Find the depth at which each wanted pixel's ray enters the visual hull: the nearest point inside the masks
/// of all views that see it, at least `least` of them. 0 if there is no such point. Depths from `near` to
/// `far` are sampled in `steps` steps of inverse depth; the last step is refined by bisection.
#[allow(clippy::too_many_arguments)]
pub fn find_hull_entry(
    wanted: &[bool],
    size: ImageSize,
    masks: &[OtherView<bool>],
    least: usize,
    [near, far]: [f64; 2],
    steps: usize,
    threads: usize,
) -> Vec<f32> {
    const HALVINGS: usize = 5;
    let step = (1.0 / near - 1.0 / far) / steps as f64;
    collect(size.pixel_count(), threads, |i| {
        let inside = |inverse: f64| {
            let mut seen = 0;
            masks.iter().all(|one| match one.look_up(i % size.width, i / size.width, 1.0 / inverse) {
                Some((inside, _)) => {
                    seen += 1;
                    inside
                }
                None => true,
            }) && seen >= least
        };
        let place = |at: usize| 1.0 / near - at as f64 * step;
        if !wanted[i] {
            return 0.0;
        }
        let Some(first) = (0..=steps).find(|&at| inside(place(at))) else { return 0.0 };
        let (mut outside, mut found) = (place(first.saturating_sub(1)), place(first));
        for _ in 0..HALVINGS {
            let middle = (outside + found) / 2.0;
            if inside(middle) { found = middle } else { outside = middle }
        }
        (1.0 / found) as f32
    })
}
