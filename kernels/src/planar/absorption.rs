//! Absorption of noise: triangles of tiny patches join a neighbouring patch whose bounds contain them.

use super::claims::Claims;
use super::growth_context::{GrowthContext, MIN_COSINE};
use super::patch_growth::GrownPatch;
use crate::base::geometry::dot;
use crate::base::parallel;

/// Maximum area of a noise patch, in squares of the maximum distance.
const NOISE_AREA: f64 = 4.0;

/// Triangles per parallel batch.
const BATCH: usize = 1 << 15;

/// Release the triangles of tiny patches, and let the other patches absorb them layer by layer within their
/// bounds. Returns the number of faces visited.
pub fn absorb_noise<const D: usize, const K: usize>(
    ground: &GrowthContext<'_, D>,
    claims: &mut Claims,
    grown: &mut Vec<GrownPatch<K>>,
) -> u64 {
    let least = NOISE_AREA * ground.options.max_distance * ground.options.max_distance;
    let is_loose: Vec<bool> = grown.iter().map(|grown| grown.patch.area < least).collect();
    if !is_loose.contains(&true) {
        return 0;
    }
    let (loose, mut wave) = find_loose_and_adjacent(ground, claims, &is_loose);
    loose.into_iter().for_each(|t| claims.release_settled(t));
    let (mut at, mut looks) = (0, 0);
    while at < wave.len() {
        let from = wave[at];
        at += 1;
        let Some(id) = claims.patch(from) else { continue };
        for to in ground.adjacent_triangles(from) {
            looks += 1;
            if claims.is_free(to) && try_absorb(ground, &mut grown[id as usize], to) {
                claims.settle(to, id);
                wave.push(to);
            }
        }
    }
    remove_loose(ground.options.threads, claims, grown, &is_loose);
    looks
}

/// List the triangles of loose patches, and the triangles of other patches adjacent to them.
fn find_loose_and_adjacent<const D: usize>(
    ground: &GrowthContext<'_, D>,
    claims: &Claims,
    is_loose: &[bool],
) -> (Vec<u32>, Vec<u32>) {
    let is_loose = |t: u32| claims.patch(t).is_some_and(|patch| is_loose[patch as usize]);
    let count = ground.facets.len();
    let found = parallel::map(
        count.div_ceil(BATCH),
        ground.options.threads,
        || (),
        |(), batch| {
            let (mut loose, mut beside) = (vec![], vec![]);
            for t in (batch * BATCH..count.min((batch + 1) * BATCH)).map(|t| t as u32) {
                if is_loose(t) {
                    loose.push(t);
                } else if ground.adjacent_triangles(t).any(is_loose) {
                    beside.push(t);
                }
            }
            (loose, beside)
        },
    );
    let (loose, beside): (Vec<_>, Vec<_>) = found.into_iter().unzip();
    (loose.concat(), beside.concat())
}

/// Add a triangle to a patch if the patch is open and its bounds contain the triangle.
fn try_absorb<const D: usize, const K: usize>(
    ground: &GrowthContext<'_, D>,
    grown: &mut GrownPatch<K>,
    to: u32,
) -> bool {
    let (normal, area) = ground.facets[to as usize];
    let stands = area == 0.0 || dot(&normal, &grown.fit.normal) > ground.options.noise.max(MIN_COSINE);
    let stands = stands && ground.have_same_label(grown.patch.seed, to);
    if !grown.is_open || !stands || ground.is_locked(to) {
        return false;
    }
    let (mut heights, mut residual2) = (grown.heights, grown.residual2);
    for p in ground.corners(to) {
        let height = grown.fit.height(p);
        heights = [heights[0].min(height), heights[1].max(height)];
        residual2 = residual2.max(grown.fit.residual2(p));
    }
    if ground.exceeds(heights, residual2, K > 0) {
        return false;
    }
    (grown.heights, grown.residual2) = (heights, residual2);
    grown.patch.area += area;
    grown.patch.faces += 1;
    true
}

/// Remove loose patches and renumber the others without gaps.
fn remove_loose<const K: usize>(
    threads: usize,
    claims: &mut Claims,
    grown: &mut Vec<GrownPatch<K>>,
    is_loose: &[bool],
) {
    let mut kept = 0;
    let number: Vec<u32> = is_loose
        .iter()
        .map(|&loose| {
            kept += u32::from(!loose);
            kept.wrapping_sub(1)
        })
        .collect();
    let mut loose = is_loose.iter();
    grown.retain(|_| !loose.next().copied().unwrap_or(false));
    claims.renumber(threads, &number);
}
