//! Growth of all patches of a mesh, starting at the flattest triangles.

use super::absorb::absorb;
use super::ahead::grow_all;
use super::claims::Claims;
use super::ground::Ground;
use super::growth::Grown;
use super::patches::{Facet, Options, Patch, Patches};
use crate::base::errors::KernelError;
use crate::base::geometry::dot;
use crate::base::parallel::collect;
use crate::base::progress::Progress;
use crate::mesh::triangle_mesh::Mesh;

/// Number of flatness classes that order the seeds, flattest first.
const CLASSES: usize = 256;

/// Partition a mesh into near-planar patches.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn propagate<const D: usize, const K: usize>(
    mesh: &Mesh<D>,
    facets: &[Facet],
    options: &Options,
    progress: &mut Progress,
) -> Result<Patches, KernelError> {
    let ground = Ground::new(mesh, facets, options, &[]);
    let mut claims = Claims::new(facets.len(), options.threads, |_| false);
    let mut grown: Vec<Grown<K>> = vec![];
    let seeds = flattest_first(&ground, facets.len(), |i| i as u32);
    let mut looks = grow_all(&ground, &mut claims, &seeds, &mut grown, progress)?;
    if options.noise <= 1.0 {
        looks += absorb(&ground, &mut claims, &mut grown);
        looks += grow_all(&ground, &mut claims, &seeds, &mut grown, progress)?;
    }
    let (patches, number, _) = by_area(&settled(&grown));
    let of = collect(facets.len(), options.threads, |t| number[claims.patch(t as u32).unwrap_or(0) as usize]);
    Ok(Patches { patches, of, looks })
}

/// Split patches that overlap themselves in projection, by growing them again without overlaps. Also returns
/// the previous index of each patch; None for new ones.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn separate<const D: usize, const K: usize>(
    mesh: &Mesh<D>,
    facets: &[Facet],
    patches: &Patches,
    is_folded: &[bool],
    options: &Options,
    progress: &mut Progress,
) -> Result<(Patches, Vec<Option<u32>>), KernelError> {
    let is_open = |t: usize| is_folded[patches.of[t] as usize];
    let ground = Ground::new(mesh, facets, options, &patches.of);
    let mut claims = Claims::new(facets.len(), options.threads, |t| !is_open(t));
    let mut grown: Vec<Grown<K>> = vec![];
    let open: Vec<u32> = (0..facets.len() as u32).filter(|&t| is_open(t as usize)).collect();
    let seeds = flattest_first(&ground, open.len(), |i| open[i]);
    let looks = grow_all(&ground, &mut claims, &seeds, &mut grown, progress)?;
    // Sort the new patches first, so that ties in area keep this order among all patches.
    let unfolded: Vec<u32> = (0..is_folded.len() as u32).filter(|&p| !is_folded[p as usize]).collect();
    let (again, again_number, _) = by_area(&settled(&grown));
    let unfolded_number = numbers(is_folded.len(), &unfolded);
    let kept = unfolded.iter().map(|&p| patches.patches[p as usize]);
    let all: Vec<Patch> = kept.chain(again).collect();
    let (all, number, order) = by_area(&all);
    let of = collect(facets.len(), options.threads, |t| {
        let among_all = match claims.patch(t as u32) {
            None => unfolded_number[patches.of[t] as usize],
            Some(patch) => unfolded.len() as u32 + again_number[patch as usize],
        };
        number[among_all as usize]
    });
    let was = order.into_iter().map(|id| unfolded.get(id as usize).copied()).collect();
    Ok((Patches { patches: all, of, looks: patches.looks + looks }, was))
}

/// Sort `count` triangles by the class of their sharpest edge; the sort is stable.
fn flattest_first<const D: usize>(
    ground: &Ground<'_, D>,
    count: usize,
    triangle: impl Fn(usize) -> u32 + Sync,
) -> Vec<u32> {
    let classes: Vec<u8> = collect(count, ground.options.threads, |i| {
        let t = triangle(i);
        let sharpest = ground
            .beside(t)
            .map(|other| dot(&ground.facets[t as usize].0, &ground.facets[other as usize].0))
            .fold(1.0, f64::min);
        // Roughly proportional to the angle, as 1 − cosine grows with its square.
        let angle = (0.5 * (1.0 - sharpest)).max(0.0).sqrt();
        (angle * (CLASSES - 1) as f64) as u8
    });
    let mut next = [0usize; CLASSES + 1];
    classes.iter().for_each(|&class| next[class as usize + 1] += 1);
    (0..CLASSES).for_each(|class| next[class + 1] += next[class]);
    let mut sorted = vec![0; classes.len()];
    for (i, &class) in classes.iter().enumerate() {
        sorted[next[class as usize]] = triangle(i);
        next[class as usize] += 1;
    }
    sorted
}

/// Return the patches with their final heights and residuals.
fn settled<const K: usize>(grown: &[Grown<K>]) -> Vec<Patch> {
    let settled =
        |grown: &Grown<K>| Patch { heights: grown.heights, residual: grown.residual2.sqrt(), ..grown.patch };
    grown.iter().map(settled).collect()
}

/// Sort patches by decreasing area. Returns them, the new index of each, and the old index of each.
fn by_area(patches: &[Patch]) -> (Vec<Patch>, Vec<u32>, Vec<u32>) {
    let mut order: Vec<u32> = (0..patches.len() as u32).collect();
    order.sort_by(|&a, &b| {
        let area = |id: u32| patches[id as usize].area;
        area(b).total_cmp(&area(a)).then(a.cmp(&b))
    });
    let sorted = order.iter().map(|&id| patches[id as usize]).collect();
    (sorted, numbers(patches.len(), &order), order)
}

/// Invert an order of some of `count` elements; `u32::MAX` for the others.
fn numbers(count: usize, order: &[u32]) -> Vec<u32> {
    let mut numbers = vec![u32::MAX; count];
    order.iter().zip(0..).for_each(|(&one, number)| numbers[one as usize] = number);
    numbers
}
