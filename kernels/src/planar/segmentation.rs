//! Growth of all patches of a mesh, starting at the flattest triangles.

use super::absorption::absorb_noise;
use super::claims::Claims;
use super::growth_context::GrowthContext;
use super::patch_growth::GrownPatch;
use super::patches::{Facet, Options, Patch, Patches};
use super::speculative_growth::grow_all;
use crate::base::errors::KernelError;
use crate::base::geometry::dot;
use crate::base::parallel::collect;
use crate::base::progress::Progress;
use crate::mesh::triangle_mesh::Mesh;

/// Number of flatness classes that order the seeds, flattest first.
const FLATNESS_CLASSES: usize = 256;

/// Partition a mesh into near-planar patches.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn segment_patches<const D: usize, const K: usize>(
    mesh: &Mesh<D>,
    facets: &[Facet],
    options: &Options,
    progress: &mut Progress,
) -> Result<Patches, KernelError> {
    let ground = GrowthContext::new(mesh, facets, options, &[]);
    let mut claims = Claims::new(facets.len(), options.threads, |_| false);
    let mut grown: Vec<GrownPatch<K>> = vec![];
    let seeds = sort_by_flatness(&ground, facets.len(), |i| i as u32);
    let mut looks = grow_all(&ground, &mut claims, &seeds, &mut grown, progress)?;
    if options.noise <= 1.0 {
        looks += absorb_noise(&ground, &mut claims, &mut grown);
        looks += grow_all(&ground, &mut claims, &seeds, &mut grown, progress)?;
    }
    let (patches, number, _) = sort_by_area(&finish_patches(&grown));
    let of = collect(facets.len(), options.threads, |t| number[claims.patch(t as u32).unwrap_or(0) as usize]);
    Ok(Patches { patches, patch_of_triangle: of, visited_faces: looks })
}

/// Split patches that overlap themselves in projection, by growing them again without overlaps. Also returns
/// the previous index of each patch; None for new ones.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn split_folded_patches<const D: usize, const K: usize>(
    mesh: &Mesh<D>,
    facets: &[Facet],
    patches: &Patches,
    is_folded: &[bool],
    options: &Options,
    progress: &mut Progress,
) -> Result<(Patches, Vec<Option<u32>>), KernelError> {
    let is_open = |t: usize| is_folded[patches.patch_of_triangle[t] as usize];
    let ground = GrowthContext::new(mesh, facets, options, &patches.patch_of_triangle);
    let mut claims = Claims::new(facets.len(), options.threads, |t| !is_open(t));
    let mut grown: Vec<GrownPatch<K>> = vec![];
    let open: Vec<u32> = (0..facets.len() as u32).filter(|&t| is_open(t as usize)).collect();
    let seeds = sort_by_flatness(&ground, open.len(), |i| open[i]);
    let looks = grow_all(&ground, &mut claims, &seeds, &mut grown, progress)?;
    // Sort the new patches first, so that ties in area keep this order among all patches.
    let unfolded: Vec<u32> = (0..is_folded.len() as u32).filter(|&p| !is_folded[p as usize]).collect();
    let (again, again_number, _) = sort_by_area(&finish_patches(&grown));
    let unfolded_number = invert_order(is_folded.len(), &unfolded);
    let kept = unfolded.iter().map(|&p| patches.patches[p as usize]);
    let all: Vec<Patch> = kept.chain(again).collect();
    let (all, number, order) = sort_by_area(&all);
    let of = collect(facets.len(), options.threads, |t| {
        let among_all = match claims.patch(t as u32) {
            None => unfolded_number[patches.patch_of_triangle[t] as usize],
            Some(patch) => unfolded.len() as u32 + again_number[patch as usize],
        };
        number[among_all as usize]
    });
    let was = order.into_iter().map(|id| unfolded.get(id as usize).copied()).collect();
    Ok((Patches { patches: all, patch_of_triangle: of, visited_faces: patches.visited_faces + looks }, was))
}

/// Sort `count` triangles by the class of their sharpest edge; the sort is stable.
fn sort_by_flatness<const D: usize>(
    ground: &GrowthContext<'_, D>,
    count: usize,
    triangle: impl Fn(usize) -> u32 + Sync,
) -> Vec<u32> {
    let classes: Vec<u8> = collect(count, ground.options.threads, |i| {
        let t = triangle(i);
        let sharpest = ground
            .adjacent_triangles(t)
            .map(|other| dot(&ground.facets[t as usize].0, &ground.facets[other as usize].0))
            .fold(1.0, f64::min);
        // Roughly proportional to the angle, as 1 − cosine grows with its square.
        let angle = (0.5 * (1.0 - sharpest)).max(0.0).sqrt();
        (angle * (FLATNESS_CLASSES - 1) as f64) as u8
    });
    let mut next = [0usize; FLATNESS_CLASSES + 1];
    classes.iter().for_each(|&class| next[class as usize + 1] += 1);
    (0..FLATNESS_CLASSES).for_each(|class| next[class + 1] += next[class]);
    let mut sorted = vec![0; classes.len()];
    for (i, &class) in classes.iter().enumerate() {
        sorted[next[class as usize]] = triangle(i);
        next[class as usize] += 1;
    }
    sorted
}

/// Return the patches with their final heights and residuals.
fn finish_patches<const K: usize>(grown: &[GrownPatch<K>]) -> Vec<Patch> {
    let settled = |grown: &GrownPatch<K>| Patch {
        heights: grown.heights,
        residual: grown.residual2.sqrt(),
        ..grown.patch
    };
    grown.iter().map(settled).collect()
}

/// Sort patches by decreasing area. Returns them, the new index of each, and the old index of each.
fn sort_by_area(patches: &[Patch]) -> (Vec<Patch>, Vec<u32>, Vec<u32>) {
    let mut order: Vec<u32> = (0..patches.len() as u32).collect();
    order.sort_by(|&a, &b| {
        let area = |id: u32| patches[id as usize].area;
        area(b).total_cmp(&area(a)).then(a.cmp(&b))
    });
    let sorted = order.iter().map(|&id| patches[id as usize]).collect();
    (sorted, invert_order(patches.len(), &order), order)
}

/// Invert an order of some of `count` elements; `u32::MAX` for the others.
fn invert_order(count: usize, order: &[u32]) -> Vec<u32> {
    let mut numbers = vec![u32::MAX; count];
    order.iter().zip(0..).for_each(|(&one, number)| numbers[one as usize] = number);
    numbers
}
