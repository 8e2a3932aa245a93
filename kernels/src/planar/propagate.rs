//! Growing patches, layer by layer, from the flattest triangles first.
//!
//! A patch grows with its mean normal, as in the paper. If in the end it does not suit its final plane and colours,
//! its triangles are set free, and it grows again from its seed against these, which no longer change. What is left
//! over in patches too small to matter may join a neighbour that holds it within its bounds.

use super::fit::{Fit, Moments, frame};
use super::overlap::{Flat, Sheet};
use super::patches::{Facet, Options, Patch, Patches};
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, dot, norm2, position, sub};
use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::base::progress::Progress;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::{Lock, Mesh};

const NONE: u32 = u32::MAX;

/// In a patch that is not to be changed.
const TAKEN: u32 = u32::MAX - 1;

/// Part of the distance that the two planes of a patch may take; 0.6 of it is left for the border, at least.
pub const FOR_THICKNESS: f64 = 0.8;

/// Part of the bound on colour that a vertex may be off the linear function: twice that counts.
const FOR_RESIDUAL: f64 = 0.4;

/// A triangle may be set free so often; then it only joins patches that never set any free. Keeps the time linear.
const MOST_RELEASES: u8 = 3;

/// Seen along the normal of its patch, no triangle may be turned over or near to it: cosine of 80°.
const LEAST_COSINE: f64 = 0.173_648;

/// Until it has so many vertices, noise may tilt the colours of a patch, and their mean will do as well.
const YOUNG: f64 = 16.0;

/// Patches of less area than so many squares of the largest distance count as noise.
const NOISE_AREA: f64 = 4.0;

/// Classes of flatness that seeds are taken from, flattest first.
const CLASSES: usize = 256;

/// # Errors
/// [`KernelError::Interrupted`].
pub fn propagate<const D: usize, const K: usize>(
    mesh: &Mesh<D>,
    facets: &[Facet],
    options: &Options,
    progress: &mut Progress,
) -> Result<Patches, KernelError> {
    let mut growth = Growth::<D, K>::new(mesh, facets, options);
    let all: Vec<u32> = (0..facets.len() as u32).collect();
    let seeds = growth.flattest_first(&all);
    growth.grow_all(&seeds, progress)?;
    if options.noise <= 1.0 {
        growth.absorb();
        growth.grow_all(&seeds, progress)?;
    }
    Ok(growth.largest_first().0)
}

/// Grow those patches again that lie over themselves, seen along their normals, as several that do not. Returns
/// also which of the former patches each is; none for those that are new.
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
    let mut growth = Growth::<D, K>::new(mesh, facets, options);
    let free = |t: &u32| is_folded[patches.of[*t as usize] as usize];
    let all: Vec<u32> = (0..facets.len() as u32).filter(free).collect();
    growth.of.fill(TAKEN);
    let seeds = growth.flattest_first(&all);
    seeds.iter().for_each(|&t| growth.of[t as usize] = NONE);
    growth.were = &patches.of;
    growth.grow_all(&seeds, progress)?;
    let (again, _) = growth.largest_first();
    // The patches that stand, and these.
    let kept: Vec<u32> = (0..is_folded.len() as u32).filter(|&p| !is_folded[p as usize]).collect();
    let mut number = vec![NONE; is_folded.len()];
    kept.iter().zip(0..).for_each(|(&p, new)| number[p as usize] = new);
    let all = kept.iter().map(|&p| patches.patches[p as usize]).chain(again.patches).collect();
    let of = patches
        .of
        .iter()
        .zip(&again.of)
        .map(|(&was, &now)| if now == TAKEN { number[was as usize] } else { now + kept.len() as u32 });
    let (patches, order) = by_area(all, of.collect(), patches.looks + again.looks);
    Ok((patches, order.into_iter().map(|id| kept.get(id as usize).copied()).collect()))
}

struct Growth<'a, const D: usize, const K: usize> {
    mesh: &'a Mesh<D>,
    options: &'a Options,
    facets: &'a [Facet],
    has_locks: bool,
    of: Vec<u32>,
    grown: Vec<Grown<K>>,
    releases: Vec<u8>,
    /// The patches that are being separated: triangles that were in the same one are alike, but must not lie over
    /// each other. Empty for none.
    were: &'a [u32],
    /// How many triangles joined the patch while its normal moved, and how far from the seed.
    extent: (usize, f64),
    /// Triangles of the patch that grows, in the order they joined.
    members: Vec<u32>,
    /// Their vertices: those of the seed, then the one that each other triangle brought with it.
    vertices: Vec<VertexId>,
    /// Of the members.
    area: f64,
    thickness: f64,
    residual2: f64,
    looks: u64,
}

/// A patch as it grew, with the fit it is held to.
struct Grown<const K: usize> {
    patch: Patch,
    fit: Fit<K>,
    heights: [f64; 2],
    residual2: f64,
    /// Whether others may join: not one that has to stay a single triangle.
    is_open: bool,
}

impl<'a, const D: usize, const K: usize> Growth<'a, D, K> {
    fn new(mesh: &'a Mesh<D>, facets: &'a [Facet], options: &'a Options) -> Self {
        let count = facets.len();
        Self {
            mesh,
            options,
            facets,
            has_locks: mesh.locks.iter().any(|lock| *lock != Lock::Free),
            of: vec![NONE; count],
            grown: vec![],
            releases: vec![0; count],
            were: &[],
            extent: (0, 0.0),
            members: vec![],
            vertices: vec![],
            area: 0.0,
            thickness: FOR_THICKNESS * options.max_distance,
            residual2: (FOR_RESIDUAL * options.max_color).powi(2),
            looks: 0,
        }
    }

    /// Some triangles sorted by the sharpest of their edges; in a class as they were.
    fn flattest_first(&self, triangles: &[u32]) -> Vec<u32> {
        let mut classes = vec![0u8; triangles.len()];
        crate::base::parallel::fill(&mut classes, self.options.threads, |i| {
            let t = triangles[i];
            let sharpest = self
                .beside(t)
                .map(|other| dot(&self.facets[t as usize].0, &self.facets[other as usize].0))
                .fold(1.0, f64::min);
            // By angle, roughly: 1 − cosine grows with its square.
            let angle = (0.5 * (1.0 - sharpest)).max(0.0).sqrt();
            (angle * (CLASSES - 1) as f64) as u8
        });
        let mut next = [0usize; CLASSES + 1];
        classes.iter().for_each(|&class| next[class as usize + 1] += 1);
        (0..CLASSES).for_each(|class| next[class + 1] += next[class]);
        let mut sorted = vec![0; classes.len()];
        for (&t, &class) in triangles.iter().zip(&classes) {
            sorted[next[class as usize]] = t;
            next[class as usize] += 1;
        }
        sorted
    }

    /// The triangles beside one.
    #[inline]
    fn beside(&self, t: u32) -> impl Iterator<Item = u32> + '_ {
        let connectivity = &self.mesh.connectivity;
        (3 * t..3 * t + 3)
            .map(move |h| connectivity.twin(HalfedgeId(h)))
            .filter(|twin| twin.is_some())
            .map(|twin| Connectivity::triangle(twin).0)
    }

    fn corners(&self, t: u32) -> [&[f64; D]; 3] {
        self.mesh.connectivity.corners(TriangleId(t)).map(|v| self.mesh.point(v))
    }

    fn is_locked(&self, t: u32) -> bool {
        let is_locked = |&v: &VertexId| self.mesh.lock(v) != Lock::Free;
        self.has_locks && self.mesh.connectivity.corners(TriangleId(t)).iter().any(is_locked)
    }

    fn grow_all(&mut self, seeds: &[u32], progress: &mut Progress) -> Result<(), KernelError> {
        let total = seeds.len() as u64;
        for (done, &seed) in seeds.iter().enumerate() {
            progress.tick(|| (done as u64 / 2, total))?;
            if self.of[seed as usize] == NONE {
                // Asked to be content, what is left stays as it is.
                let alone =
                    self.is_locked(seed) || self.facets[seed as usize].1 == 0.0 || progress.is_enough();
                self.grow(seed, alone);
            }
        }
        Ok(())
    }

    fn grow(&mut self, seed: u32, alone: bool) {
        let id = self.grown.len() as u32;
        let mut moments = self.start(seed, id);
        let own = moments.fit();
        let alone_fits = self.measured(&own);
        // A triangle whose own colours are too far from linear over it, as the fit sees it, stays as it is.
        if alone || alone_fits.is_none() {
            return self.finish(seed, own, None);
        }
        self.extent = (1, self.facets[seed as usize].1.sqrt());
        if self.releases[seed as usize] >= MOST_RELEASES {
            self.spread_fixed(id, &own);
            let measured = self.measured(&own);
            return self.finish(seed, own, measured);
        }
        let fit = self.spread_moving(id, &mut moments);
        let measured = self.measured(&fit);
        if self.were.is_empty() && measured.is_some() {
            return self.finish(seed, fit, measured);
        }
        if !self.were.is_empty() {
            let at = |t: u32| position(self.corners(t)[0]);
            let away = self.members.iter().map(|&t| norm2(&sub(&at(t), &at(seed)))).fold(0.0, f64::max);
            self.extent = (self.members.len(), away.sqrt());
        }
        for i in 0..self.members.len() {
            let t = self.members[i] as usize;
            self.of[t] = NONE;
            self.releases[t] = self.releases[t].saturating_add(1);
        }
        self.start(seed, id);
        // The seed need not be typical of what grew from it.
        let fit = if self.measured(&fit).is_some() { fit } else { own };
        self.spread_fixed(id, &fit);
        let measured = self.measured(&fit);
        self.finish(seed, fit, measured);
    }

    fn start(&mut self, seed: u32, id: u32) -> Moments<D, K> {
        self.members.clear();
        self.vertices.clear();
        self.area = 0.0;
        self.vertices.extend(self.mesh.connectivity.corners(TriangleId(seed)));
        self.join(seed, id);
        let corners = self.corners(seed);
        let mut moments = Moments::new(position(corners[0]));
        corners.iter().for_each(|p| moments.add_vertex(p));
        moments.add_normal(&self.facets[seed as usize]);
        moments
    }

    #[inline]
    fn join(&mut self, t: u32, id: u32) {
        self.of[t as usize] = id;
        self.members.push(t);
        self.area += self.facets[t as usize].1;
    }

    /// The paper's growth: the mean normal, and here the plane and the colours, follow after each layer.
    fn spread_moving(&mut self, id: u32, moments: &mut Moments<D, K>) -> Fit<K> {
        let mut fit = moments.fit();
        let (mut layer, half) = (0, 0.5 * self.thickness);
        while layer < self.members.len() {
            let end = self.members.len();
            let is_young = moments.count() < YOUNG;
            for at in layer..end {
                let from = self.members[at];
                for h in 3 * from..3 * from + 3 {
                    let twin = self.mesh.connectivity.twin(HalfedgeId(h));
                    if twin.is_none() {
                        continue;
                    }
                    let to = Connectivity::triangle(twin).0;
                    self.looks += 1;
                    if self.of[to as usize] != NONE || self.releases[to as usize] >= MOST_RELEASES {
                        continue;
                    }
                    if !self.is_alike(from, to, &fit.normal) {
                        continue;
                    }
                    let across = self.mesh.connectivity.origin(Connectivity::prev(twin));
                    let p = self.mesh.point(across);
                    let suits = K == 0
                        || fit.residual2(p) <= self.residual2
                        || (is_young && fit.residual2_of_mean(p) <= self.residual2);
                    let fits = fit.height(p).abs() <= half && suits;
                    if fits && !self.is_locked(to) {
                        self.join(to, id);
                        self.vertices.push(across);
                        moments.add_vertex(p);
                        moments.add_normal(&self.facets[to as usize]);
                    }
                }
            }
            layer = end;
            if self.members.len() > end {
                fit = moments.fit();
            }
        }
        fit
    }

    /// Growth against a fit that stays, so that whatever joins suits it in the end.
    fn spread_fixed(&mut self, id: u32, fit: &Fit<K>) {
        let mut heights = around(self.corners(self.members[0]).map(|p| fit.height(p)));
        let mut sheet = self.sheet(&fit.normal);
        let mut at = 0;
        while at < self.members.len() {
            let from = self.members[at];
            at += 1;
            for h in 3 * from..3 * from + 3 {
                let twin = self.mesh.connectivity.twin(HalfedgeId(h));
                if twin.is_none() {
                    continue;
                }
                let to = Connectivity::triangle(twin).0;
                self.looks += 1;
                if self.of[to as usize] != NONE {
                    continue;
                }
                let is_alike = if sheet.is_some() {
                    self.was_alike(from, to, &fit.normal)
                } else {
                    self.is_alike(from, to, &fit.normal)
                };
                if !is_alike {
                    continue;
                }
                let across = self.mesh.connectivity.origin(Connectivity::prev(twin));
                let p = self.mesh.point(across);
                let height = fit.height(p);
                let wider = [heights[0].min(height), heights[1].max(height)];
                let is_flat = wider[1] - wider[0] <= self.thickness;
                let fits = is_flat && (K == 0 || fit.residual2(p) <= self.residual2) && !self.is_locked(to);
                let is_over = |sheet: &mut Sheet| !sheet.add(self.flat(to, &frame(&fit.normal)));
                if fits && !sheet.as_mut().is_some_and(is_over) {
                    heights = wider;
                    self.join(to, id);
                    self.vertices.push(across);
                }
            }
        }
    }

    /// What keeps patches that are being separated from lying over themselves, with the first triangle.
    fn sheet(&self, normal: &Vec3) -> Option<Sheet> {
        if self.were.is_empty() {
            return None;
        }
        let across = frame(normal);
        let seed = self.flat(self.members[0], &across);
        let count = self.extent.0.max(1);
        let reach = self.extent.1;
        let [low, high] = [-reach, reach].map(|r| seed[0].map(|x| x + r));
        let mut sheet = Sheet::new(low, high, count);
        sheet.add(seed);
        Some(sheet)
    }

    fn flat(&self, t: u32, [e, f]: &[Vec3; 2]) -> Flat {
        self.corners(t).map(|p| [dot(e, &position(p)), dot(f, &position(p))])
    }

    fn was_alike(&self, from: u32, to: u32, mean: &Vec3) -> bool {
        let (normal, area) = &self.facets[to as usize];
        self.were[from as usize] == self.were[to as usize]
            && (*area == 0.0 || dot(normal, mean) > LEAST_COSINE)
    }

    #[inline]
    fn have_one_label(&self, a: u32, b: u32) -> bool {
        let label = |t: u32| self.options.labels.get(self.mesh.triangle_source[t as usize] as usize);
        self.options.labels.is_empty() || label(a) == label(b)
    }

    /// The paper's two criteria, and what else keeps triangles apart. A triangle without area has no normal, and goes with any.
    #[inline]
    fn is_alike(&self, from: u32, to: u32, mean: &Vec3) -> bool {
        let (normal, area) = &self.facets[to as usize];
        let fidelity = self.options.fidelity.max(LEAST_COSINE);
        let is_flat = *area == 0.0
            || (dot(normal, mean) > fidelity
                && (self.facets[from as usize].1 == 0.0
                    || dot(normal, &self.facets[from as usize].0) > self.options.detail));
        is_flat && self.have_one_label(from, to)
    }

    /// Least and greatest height, and squared residual, of all members over a fit; none if they are not within its
    /// bounds.
    fn measured(&self, fit: &Fit<K>) -> Option<([f64; 2], f64)> {
        let (mut heights, mut residual2) = ([f64::MAX, f64::MIN], 0.0f64);
        for &t in &self.members {
            let (normal, area) = &self.facets[t as usize];
            if *area > 0.0 && dot(normal, &fit.normal) <= LEAST_COSINE {
                return None;
            }
        }
        for &v in &self.vertices {
            let p = self.mesh.point(v);
            let height = fit.height(p);
            heights = [heights[0].min(height), heights[1].max(height)];
            residual2 = residual2.max(fit.residual2(p));
            if heights[1] - heights[0] > self.thickness || (K > 0 && residual2 > self.residual2) {
                return None;
            }
        }
        Some((heights, residual2))
    }

    /// What has no measure is a single triangle, and needs none.
    fn finish(&mut self, seed: u32, fit: Fit<K>, measured: Option<([f64; 2], f64)>) {
        let is_open = measured.is_some();
        let (heights, residual2) = measured.unwrap_or_default();
        let patch = Patch {
            seed,
            faces: self.members.len() as u32,
            area: self.area,
            normal: fit.normal,
            origin: fit.origin,
            heights: [0.0; 2],
            residual: 0.0,
            gradient: fit.gradient(),
        };
        self.grown.push(Grown { patch, fit, heights, residual2, is_open });
    }

    /// Set the triangles of small patches free, and let the others take in, layer by layer, what their bounds hold.
    fn absorb(&mut self) {
        let least = NOISE_AREA * self.options.max_distance * self.options.max_distance;
        let is_loose: Vec<bool> = self.grown.iter().map(|grown| grown.patch.area < least).collect();
        let mut wave: Vec<u32> = vec![];
        for t in 0..self.of.len() as u32 {
            let own = self.of[t as usize] as usize;
            if !is_loose[own] && self.beside(t).any(|other| is_loose[self.of[other as usize] as usize]) {
                wave.push(t);
            }
        }
        for t in 0..self.of.len() {
            if is_loose[self.of[t] as usize] {
                self.of[t] = NONE;
            }
        }
        let mut at = 0;
        while at < wave.len() {
            let from = wave[at];
            at += 1;
            let id = self.of[from as usize];
            for h in 3 * from..3 * from + 3 {
                let twin = self.mesh.connectivity.twin(HalfedgeId(h));
                if twin.is_some() && self.take_in(id, Connectivity::triangle(twin).0) {
                    wave.push(Connectivity::triangle(twin).0);
                }
            }
        }
        self.forget(&is_loose);
    }

    fn take_in(&mut self, id: u32, to: u32) -> bool {
        self.looks += 1;
        let (normal, area) = self.facets[to as usize];
        let grown = &self.grown[id as usize];
        let stands = area == 0.0 || dot(&normal, &grown.fit.normal) > self.options.noise.max(LEAST_COSINE);
        let stands = stands && self.have_one_label(grown.patch.seed, to);
        if !grown.is_open || self.of[to as usize] != NONE || !stands || self.is_locked(to) {
            return false;
        }
        let (mut heights, mut residual2) = (grown.heights, grown.residual2);
        for p in self.corners(to) {
            let height = grown.fit.height(p);
            heights = [heights[0].min(height), heights[1].max(height)];
            residual2 = residual2.max(grown.fit.residual2(p));
        }
        if heights[1] - heights[0] > self.thickness || (K > 0 && residual2 > self.residual2) {
            return false;
        }
        let grown = &mut self.grown[id as usize];
        (grown.heights, grown.residual2) = (heights, residual2);
        grown.patch.area += area;
        grown.patch.faces += 1;
        self.of[to as usize] = id;
        true
    }

    /// Number the patches that are left without gaps.
    fn forget(&mut self, is_loose: &[bool]) {
        let mut number = vec![NONE; is_loose.len()];
        let mut kept = 0;
        for (id, loose) in is_loose.iter().enumerate() {
            if !loose {
                number[id] = kept;
                kept += 1;
            }
        }
        let mut loose = is_loose.iter();
        self.grown.retain(|_| !loose.next().copied().unwrap_or(false));
        for of in self.of.iter_mut().filter(|of| **of != NONE) {
            *of = number[*of as usize];
        }
    }

    fn largest_first(self) -> (Patches, Vec<u32>) {
        let settled = |grown: &Grown<K>| Patch {
            heights: grown.heights,
            residual: grown.residual2.sqrt(),
            ..grown.patch
        };
        by_area(self.grown.iter().map(settled).collect(), self.of, self.looks)
    }
}

/// Patches numbered by area, largest first, and which each was before.
fn by_area(patches: Vec<Patch>, mut of: Vec<u32>, looks: u64) -> (Patches, Vec<u32>) {
    let mut order: Vec<u32> = (0..patches.len() as u32).collect();
    order.sort_by(|&a, &b| {
        let area = |id: u32| patches[id as usize].area;
        area(b).total_cmp(&area(a)).then(a.cmp(&b))
    });
    let mut number = vec![0; patches.len()];
    order.iter().zip(0..).for_each(|(&old, new)| number[old as usize] = new);
    of.iter_mut().filter(|id| **id != TAKEN).for_each(|id| *id = number[*id as usize]);
    let patches = order.iter().map(|&id| patches[id as usize]).collect();
    (Patches { patches, of, looks }, order)
}

fn around(heights: [f64; 3]) -> [f64; 2] {
    [heights.into_iter().fold(f64::MAX, f64::min), heights.into_iter().fold(f64::MIN, f64::max)]
}
