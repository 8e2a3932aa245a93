//! Consistency checks of a depth map with other views.

use super::cost_volume::ImageSize;
use crate::base::parallel::collect;

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

/// Count the other views with a consistent depth, for each of two relative tolerances. 0 where the depth is
/// missing.
pub fn count_consistent_views(
    depth: &[f32],
    size: ImageSize,
    others: &[OtherView<f32>],
    tolerances: [f64; 2],
    threads: usize,
) -> Vec<[u8; 2]> {
    collect(size.pixel_count(), threads, |i| {
        let mut count = [0u8; 2];
        if depth[i] > 0.0 {
            for other in others {
                if let Some((there, ahead)) = other.look_up(i % size.width, i / size.width, depth[i].into()) {
                    let off = (f64::from(there) - ahead).abs();
                    for (count, tolerance) in count.iter_mut().zip(tolerances) {
                        *count = count.saturating_add(u8::from(there > 0.0 && off <= tolerance * ahead));
                    }
                }
            }
        }
        count
    })
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

/// Count the other views in which nothing occludes the point: their depth is more than `min_depth_ratio`
/// times the point's depth. 0 where the depth is missing.
pub fn count_unoccluded_views(
    depth: &[f32],
    size: ImageSize,
    others: &[OtherView<f32>],
    min_depth_ratio: f64,
    threads: usize,
) -> Vec<u8> {
    collect(size.pixel_count(), threads, |i| {
        let mut count = 0u8;
        if depth[i] > 0.0 {
            for other in others {
                if let Some((there, ahead)) = other.look_up(i % size.width, i / size.width, depth[i].into()) {
                    count = count.saturating_add(u8::from(f64::from(there) > min_depth_ratio * ahead));
                }
            }
        }
        count
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
