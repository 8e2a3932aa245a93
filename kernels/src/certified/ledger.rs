//! Cache of proofs: results per triangle of the mesh and of the input, and what a change invalidates.

use super::original::Original;
use super::tracker::Bound;
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, norm2, position, sub, triangle_distance2};
use crate::base::memory;
use crate::base::parallel::{self, map};
use crate::base::progress::Progress;
use crate::certify::{self, Certificate, Deviation, Surface, Verdict, decide};
use crate::collapse::whole::Whole;
use crate::mesh::triangle_mesh::Compact;

/// A triangle of the mesh with the last verdict on it.
struct Known<const D: usize> {
    /// Index of its input triangle.
    source: u32,
    corners: [[f64; D]; 3],
    verdict: Verdict,
}

/// Marks the absence of a triangle.
const NONE: u32 = u32::MAX;

/// Relative rounding error of deviations that are stored in single precision.
const ROUNDING: f64 = 1e-6;

/// Input triangles certified at a time, which limits the memory of the results.
const AT_ONCE: usize = 1 << 15;

/// Minimum number of triangles per batch of partitions.
const TOGETHER: usize = 8 * AT_ONCE;

/// With at least this many partitions per thread, one thread certifies each partition.
const MANY: usize = 8;

/// Maximum number of threads per partition while other partitions are certified in parallel.
const BESIDE: usize = 4;

/// An input triangle that is not within the limit of its partition.
struct Failing {
    triangle: u32,
    bound: Deviation,
    /// Mesh triangles (by source) that may be nearest to it; empty if it is within the requested bounds.
    within_reach: Vec<u32>,
}

/// Partitions of the input, each certified only against the triangles that are left of it.
pub struct Apart<'c> {
    /// Partition of each input triangle, numbered from 0 without gaps.
    pub part: &'c [u32],
    /// Tolerances for the bounds of a partition; `limit` is ignored.
    pub close: &'c certify::Options,
}

/// A partition of the mesh that is certified independently.
struct Part {
    /// Indices of input triangles, ascending.
    triangles: Vec<u32>,
    surface: Surface,
    /// Limit that its triangles are decided against; set by the first proof.
    limit: Option<Deviation>,
}

/// A request to certify triangles of one partition.
///
/// `left` are all mesh triangles of the partition. `own` are the mesh triangles to certify, each with its
/// index in the result. `near` are the input triangles to certify, in BVH order of the partition.
struct Asked<'l> {
    part: usize,
    left: &'l [u32],
    own: &'l [(u32, usize)],
    near: Vec<u32>,
}

/// Results for a request, without the values stored per input triangle.
struct Looked {
    limit: Option<Deviation>,
    of_mesh: Vec<Verdict>,
    failing: Vec<Failing>,
}

/// Values stored per input triangle.
#[derive(Clone, Copy)]
struct Kept {
    attained: [f32; 2],
    reach: f32,
}

impl Kept {
    fn of(Verdict { attained, reach, .. }: Verdict) -> Self {
        // Round conservatively: `attained` down, `reach` up.
        let single = |x: f64| (x as f32).next_down().max(0.0);
        Self { attained: [single(attained.shape), single(attained.color)], reach: (reach as f32).next_up() }
    }
}

/// Unproven triangles that may still be provable.
pub struct Open {
    /// Triangles of the mesh, by source.
    pub of_result: Vec<u32>,
    pub of_input: Vec<u32>,
    /// For each entry of `of_input`: mesh triangles (by source) that may be nearest to it.
    pub within_reach: Vec<Vec<u32>>,
}

impl Open {
    pub fn is_empty(&self) -> bool {
        self.of_result.is_empty() && self.of_input.is_empty()
    }
}

/// Proofs of the current mesh and of the input, updated after changes.
pub struct Ledger<'a, const D: usize> {
    original: &'a Original<D>,
    parts: Vec<Part>,
    /// By input triangle: its partition, and its index in the partition.
    place: Vec<[u32; 2]>,
    /// Options for decisions; `limit` is set.
    decision: certify::Options,
    /// Tolerances for the bounds of each partition, if partitions are certified separately.
    close: Option<certify::Options>,
    bounds: Deviation,
    /// Sorted by source; empty before the first call of [`Self::look`].
    result: Vec<Known<D>>,
    /// By input triangle: largest measured deviation.
    attained: Vec<[f32; 2]>,
    /// By input triangle: maximum distance of mesh triangles that affect its proof, if below the bound on
    /// shape.
    reach: Vec<f32>,
    /// Sorted by triangle.
    failing: Vec<Failing>,
    /// Sorted input triangles whose bounds do not even hold between the input and itself.
    pub hopeless: Vec<u32>,
}

impl<'a, const D: usize> Ledger<'a, D> {
    /// Create a cache without proofs.
    ///
    /// # Errors
    /// As [`Surface::new`].
    pub fn new(
        original: &'a Original<D>,
        decision: certify::Options,
        apart: Option<&Apart<'_>>,
    ) -> Result<Self, KernelError> {
        let count = original.triangles.len();
        let part_of = |t: usize| apart.map_or(0, |apart| apart.part[t] as usize);
        let mut triangles = vec![vec![]; (0..count).map(part_of).max().map_or(1, |last| last + 1)];
        let mut place = Vec::with_capacity(count);
        for t in 0..count {
            let part = &mut triangles[part_of(t)];
            place.push([part_of(t), part.len()].map(|i| i as u32));
            part.push(t as u32);
        }
        let alone = triangles.len() == 1;
        let part = |triangles: &[u32]| {
            let threads = if alone { decision.threads } else { 1 };
            Surface::of_some(&original.points, &original.triangles, triangles, threads)
        };
        let (count, threads) = (triangles.len(), parallel::threads(decision.threads));
        let parts = map(count, threads, || (), |(), i| part(&triangles[i]));
        let parts = parts
            .into_iter()
            .zip(triangles)
            .map(|(surface, triangles)| Ok(Part { triangles, surface: surface?, limit: None }));
        let parts = parts.collect::<Result<_, KernelError>>()?;
        memory::give_back();
        Ok(Self {
            original,
            parts,
            place,
            decision,
            close: apart.map(|apart| *apart.close),
            bounds: decision.limit.unwrap_or_default(),
            result: vec![],
            attained: vec![],
            reach: vec![],
            failing: vec![],
            hopeless: vec![],
        })
    }

    /// Return the requested bounds.
    pub fn bounds(&self) -> Deviation {
        self.bounds
    }

    /// Return the surface of the input, if it is certified as a whole.
    pub fn surface(&self) -> &Surface {
        &self.parts[0].surface
    }

    /// Certify all triangles that changed since the last call.
    ///
    /// Returns the number of unproven triangles of the mesh and of the input. The verdict on a mesh triangle
    /// stays valid while the triangle exists. The verdict on an input triangle stays valid while all mesh
    /// triangles that may be nearest to it exist.
    pub fn look(
        &mut self,
        mesh: &Whole<D, Bound>,
        progress: &mut Progress,
    ) -> Result<[usize; 2], KernelError> {
        let is_first = self.attained.is_empty();
        let count = self.place.len();
        let threads = parallel::threads(self.decision.threads);
        // By input triangle: index in the current mesh, and index in the previous result.
        let (mut now, mut then) = (vec![NONE; count], vec![NONE; count]);
        (0..).zip(&mesh.triangle_source).for_each(|(i, &source)| now[source as usize] = i);
        (0..).zip(&self.result).for_each(|(i, known)| then[known.source as usize] = i);
        let sources: Vec<u32> = (0..count as u32).filter(|&t| now[t as usize] != NONE).collect();
        let before = std::mem::take(&mut self.result);
        let mut result = parallel::collect(sources.len(), threads, |number| {
            let source = sources[number];
            let corners = mesh.triangles[now[source as usize] as usize].map(|v| mesh.points[v as usize]);
            let before = before.get(then[source as usize] as usize);
            let verdict = before.filter(|known| known.corners == corners).map(|known| known.verdict);
            Known { source, corners, verdict: verdict.unwrap_or(Verdict::UNKNOWN) }
        });
        // Changed triangles in their old and new shape, and triangles that vanished.
        let mut asked = vec![vec![]; self.parts.len()];
        let mut changed: Vec<Vec<&Known<D>>> = vec![vec![]; self.parts.len()];
        for (number, known) in result.iter().enumerate() {
            let before = before.get(then[known.source as usize] as usize);
            if before.is_none_or(|before| before.corners != known.corners) {
                let part = self.part_of(known.source);
                asked[part].push((now[known.source as usize], number));
                changed[part].extend(before.into_iter().chain([known]));
            }
        }
        for gone in before.iter().filter(|known| now[known.source as usize] == NONE) {
            changed[self.part_of(gone.source)].push(gone);
        }
        let near_in_part = |(): &mut (), part: usize| match is_first {
            true => vec![true; self.parts[part].triangles.len()],
            false => self.within_reach_of(&self.parts[part], &changed[part]),
        };
        let near = map(self.parts.len(), threads, || (), near_in_part);
        let is_touched: Vec<bool> = changed.iter().map(|changed| is_first || !changed.is_empty()).collect();
        drop(before);
        self.attained.resize(count, [0.0; 2]);
        self.reach.resize(count, f32::INFINITY);
        let place = &self.place;
        self.failing.retain(|failing| {
            let [part, place] = place[failing.triangle as usize].map(|i| i as usize);
            !near[part].get(place).copied().unwrap_or(false)
        });
        let mut left = vec![vec![]; self.parts.len()];
        for (i, &source) in (0..).zip(&mesh.triangle_source) {
            let part = self.part_of(source);
            if is_touched[part] {
                left[part].push(i);
            }
        }
        let mut all = vec![];
        for (part, (own, left)) in asked.iter().zip(&left).enumerate().filter(|(part, _)| is_touched[*part]) {
            // BVH order, so that triangles certified together are neighbours.
            let order = self.parts[part].surface.order.iter().copied();
            let near: Vec<u32> = order.filter(|&t| near[part][t as usize]).collect();
            if !(own.is_empty() && near.is_empty()) {
                all.push(Asked { part, left, own, near });
            }
        }
        let mut rest = &all[..];
        while !rest.is_empty() {
            let (mut count, mut some) = (0, 0);
            while some < rest.len() && count < TOGETHER {
                count += rest[some].own.len() + rest[some].near.len();
                some += 1;
            }
            let (now, later) = rest.split_at(some);
            for (asked, looked) in now.iter().zip(self.look_at_parts(now, mesh, progress)?) {
                for (&(_, number), verdict) in asked.own.iter().zip(&looked.of_mesh) {
                    result[number].verdict = *verdict;
                }
                self.parts[asked.part].limit = looked.limit;
                for failing in &looked.failing {
                    self.reach[failing.triangle as usize] = f32::INFINITY;
                }
                self.failing.extend(looked.failing);
            }
            rest = later;
        }
        self.result = result;
        self.failing.sort_unstable_by_key(|failing| failing.triangle);
        Ok([self.failing_of_result().count(), self.failing_of_input().count()])
    }

    fn part_of(&self, source: u32) -> usize {
        self.place[source as usize][0] as usize
    }

    /// Group the triangles of a mesh by partition, given their sources; ascending in each group.
    fn left_of_parts(&self, sources: &[u32]) -> Vec<Vec<u32>> {
        let mut left = vec![vec![]; self.parts.len()];
        (0..).zip(sources).for_each(|(i, &source)| left[self.part_of(source)].push(i));
        left
    }

    /// Certify several partitions in parallel, and store the values of their input triangles.
    fn look_at_parts(
        &mut self,
        asked: &[Asked<'_>],
        mesh: &Whole<D, Bound>,
        progress: &Progress,
    ) -> Result<Vec<Looked>, KernelError> {
        let threads = parallel::threads(self.decision.threads);
        if let [asked] = asked {
            // A single partition may be the whole input: store each result directly instead of buffering it.
            let (mut attained, mut reach) =
                (std::mem::take(&mut self.attained), std::mem::take(&mut self.reach));
            let keep = |t: usize, kept: Kept| (attained[t], reach[t]) = (kept.attained, kept.reach);
            let looked = self.look_at_part(asked, mesh, threads, keep, &mut progress.clone());
            (self.attained, self.reach) = (attained, reach);
            return Ok(vec![looked?]);
        }
        let inner = if asked.len() < MANY * threads { threads.min(BESIDE) } else { 1 };
        // Largest first, so that no thread starts a large partition at the end.
        let mut order: Vec<usize> = (0..asked.len()).collect();
        order.sort_by_key(|&i| std::cmp::Reverse(asked[i].own.len() + asked[i].near.len()));
        let one = |(): &mut (), i: usize| {
            let mut found = Vec::with_capacity(asked[order[i]].near.len());
            let keep = |t: usize, kept: Kept| found.push((t, kept));
            let looked = self.look_at_part(&asked[order[i]], mesh, inner, keep, &mut progress.clone())?;
            Ok((order[i], looked, found))
        };
        let looked = map(asked.len(), threads, || (), one);
        let mut looked = looked.into_iter().collect::<Result<Vec<_>, KernelError>>()?;
        looked.sort_unstable_by_key(|(i, ..)| *i);
        let in_order = looked.into_iter().map(|(_, looked, found)| {
            for (t, kept) in found {
                (self.attained[t], self.reach[t]) = (kept.attained, kept.reach);
            }
            looked
        });
        Ok(in_order.collect())
    }

    /// Certify one partition; `keep` receives the values to store for each input triangle.
    fn look_at_part(
        &self,
        Asked { part, left, own, near }: &Asked<'_>,
        mesh: &Whole<D, Bound>,
        threads: usize,
        mut keep: impl FnMut(usize, Kept),
        progress: &mut Progress,
    ) -> Result<Looked, KernelError> {
        let Part { triangles, surface, limit } = &self.parts[*part];
        let mut limit = *limit;
        let target = Surface::of_some(&mesh.points, &mesh.triangles, left, threads)?;
        let place = |i: u32| left.partition_point(|&other| other < i) as u32;
        let mut own: Vec<u32> = own.iter().map(|&(i, _)| place(i)).collect();
        // If partitions are bounded separately, colours are certified even without a limit on colour.
        let decision = certify::Options { limit: limit.or(self.decision.limit), threads, ..self.decision };
        let decision = match self.close {
            Some(_) => certify::Options { limit: None, ..decision },
            None => decision,
        };
        let mut found = Looked { limit, of_mesh: vec![], failing: vec![] };
        let mut rest = near.chunks(AT_ONCE);
        let mut some = rest.next();
        while !own.is_empty() || some.is_some() {
            let now = [std::mem::take(&mut own), some.map_or(vec![], <[u32]>::to_vec)];
            let at_corners = |attained| limit.unwrap_or_else(|| self.limit_of(attained));
            let lists = now.each_ref().map(Vec::as_slice);
            let (within, [of_mesh, of_input]) =
                certify::decide_within(&target, surface, &decision, lists, at_corners, progress)?;
            limit = Some(within);
            found.of_mesh.extend(of_mesh);
            for (&t, verdict) in now[1].iter().zip(of_input) {
                let bound = verdict.bound;
                keep(triangles[t as usize] as usize, Kept::of(verdict));
                if !bound.within(within) {
                    let triangle = triangles[t as usize];
                    let source = |i: u32| mesh.triangle_source[left[i as usize] as usize];
                    let fails = !bound.within(self.bounds);
                    let within_reach =
                        if fails { self.within_reach(triangle, &target, source) } else { vec![] };
                    found.failing.push(Failing { triangle, bound, within_reach });
                }
            }
            some = rest.next();
        }
        found.limit = limit;
        Ok(found)
    }

    /// Compute the limit of a partition from the deviation at its corners.
    ///
    /// The limit is the requested bounds; for colour, the tolerance of the partition applies if that is less.
    fn limit_of(&self, attained: Deviation) -> Deviation {
        match &self.close {
            Some(close) => {
                Deviation { color: self.bounds.color.min(close.enough(attained).color), ..self.bounds }
            }
            None => self.bounds,
        }
    }

    /// Find the mesh triangles that may be nearest to an input triangle.
    ///
    /// `source` maps their indices in `target` to sources.
    fn within_reach(&self, triangle: u32, target: &Surface, source: impl Fn(u32) -> u32) -> Vec<u32> {
        let corners = self.original.triangles[triangle as usize].map(|v| self.original.points[v as usize]);
        let [low, high] = box_around(&corners, self.bounds.shape);
        let mut within_reach = vec![];
        target.triangles_meeting(&low, &high, |i| within_reach.push(source(i)));
        within_reach
    }

    /// Iterate over the unproven triangles of the mesh, as indices into `result`.
    fn failing_of_result(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.result.len()).filter(|&i| !self.result[i].verdict.bound.within(self.bounds))
    }

    fn failing_of_input(&self) -> impl Iterator<Item = &Failing> + '_ {
        self.failing.iter().filter(|failing| !failing.bound.within(self.bounds))
    }

    /// Mark the triangles of a partition that a change may affect.
    ///
    /// An input triangle is affected if a changed mesh triangle may be nearest to one of its points, given
    /// its `reach`. Empty if `changed` is empty.
    fn within_reach_of(&self, part: &Part, changed: &[&Known<D>]) -> Vec<bool> {
        let mut near = vec![false; if changed.is_empty() { 0 } else { part.triangles.len() }];
        let reach = self.bounds.shape * (1.0 + 1e-9);
        for known in changed {
            let [low, high] = box_around(&known.corners, reach);
            let places = known.corners.map(|c| position(&c));
            part.surface.triangles_meeting(&low, &high, |place| {
                let t = part.triangles[place as usize] as usize;
                let [a, b, c] =
                    self.original.triangles[t].map(|v| position(&self.original.points[v as usize]));
                let centre = [0, 1, 2].map(|i| (a[i] + b[i] + c[i]) / 3.0);
                let radius2 = [a, b, c].iter().map(|p| norm2(&sub(p, &centre))).fold(0.0, f64::max);
                let far = (1.0 + 1e-9) * (reach.min(self.reach[t].into()) + radius2.sqrt());
                near[place as usize] |= triangle_distance2(&centre, places.each_ref()) <= far * far;
            });
        }
        near
    }

    /// Find the unproven triangles that can never be proven: their bounds fail between the input and itself.
    ///
    /// Returns the number of new ones.
    pub fn look_for_hopeless(&mut self, progress: &mut Progress) -> Result<usize, KernelError> {
        let sources = self.failing_of_result().map(|i| self.result[i].source);
        let failing = sources.chain(self.failing_of_input().map(|failing| failing.triangle));
        let mut asked: Vec<u32> = failing.collect();
        asked.sort_unstable();
        asked.dedup();
        asked.retain(|t| self.hopeless.binary_search(t).is_err());
        let before = self.hopeless.len();
        let mut of_parts = vec![vec![]; self.parts.len()];
        asked.iter().for_each(|&t| of_parts[self.part_of(t)].push(self.place[t as usize][1]));
        for (part, asked) in of_parts.iter().enumerate().filter(|(_, asked)| !asked.is_empty()) {
            let Part { triangles, surface, .. } = &self.parts[part];
            let [_, verdicts] = decide(surface, surface, &self.decision, [&[], asked], progress)?;
            let found = asked.iter().zip(verdicts).filter(|(_, verdict)| !verdict.bound.within(self.bounds));
            let found = found.map(|(&t, _)| triangles[t as usize]).collect();
            self.give_up(found);
        }
        Ok(self.hopeless.len() - before)
    }

    /// Give up the proofs of these input triangles and of the mesh triangles left of them.
    pub fn give_up(&mut self, hopeless: Vec<u32>) {
        self.hopeless.extend(hopeless);
        self.hopeless.sort_unstable();
        self.hopeless.dedup();
    }

    /// Collect the unproven triangles that have not been given up.
    pub fn open(&self) -> Open {
        let hope = |t: &u32| self.hopeless.binary_search(t).is_err();
        let of_input = self.failing_of_input().filter(|failing| hope(&failing.triangle));
        let (of_input, within_reach) = of_input.map(|f| (f.triangle, f.within_reach.clone())).unzip();
        let of_result = self.failing_of_result().map(|i| self.result[i].source).filter(hope).collect();
        Open { of_result, of_input, within_reach }
    }

    /// Create the certificate of `mesh`, which must be the mesh of the last [`Self::look`].
    ///
    /// Proven triangles get the requested bounds; unproven triangles are bounded according to `options`.
    pub fn certificate(
        &self,
        mesh: &Compact<D>,
        options: &certify::Options,
        progress: &mut Progress,
    ) -> Result<Certificate, KernelError> {
        let mut all = self.bounds_everywhere();
        let own: Vec<u32> = self.failing_of_result().map(|i| i as u32).collect();
        let original: Vec<u32> = self.failing_of_input().map(|failing| failing.triangle).collect();
        if own.is_empty() && original.is_empty() {
            return Ok(all);
        }
        let threads = self.decision.threads;
        let result = Surface::new(&mesh.points, &mesh.triangles, threads)?;
        let options = certify::Options { limit: None, threads, ..*options };
        let instead = certify::certify_some(&result, self.surface(), &options, [&own, &original], progress)?;
        // Without a bound on colour, the colours of the other triangles are unknown.
        let said = |d: Deviation| if self.with_color() { d } else { Deviation { color: 0.0, ..d } };
        combine(&mut all, &instead, |a, b| a.max(said(b)));
        all.attained = all.attained.max(said(instead.attained));
        Ok(all)
    }

    /// Bound each partition that `wanted` selects, to the requested tolerances.
    ///
    /// `mesh` must be the mesh of the last [`Self::look`]. Partitions that are not selected get
    /// [`Verdict::UNKNOWN`].
    ///
    /// # Errors
    /// [`KernelError::Interrupted`].
    pub fn bounds_of_parts(
        &self,
        mesh: &Whole<D, Bound>,
        wanted: impl Fn(usize) -> bool + Sync,
        progress: &Progress,
    ) -> Result<Vec<Verdict>, KernelError> {
        let left = self.left_of_parts(&mesh.triangle_source);
        let mut own: Vec<Vec<usize>> = vec![vec![]; self.parts.len()];
        (0..self.result.len()).for_each(|i| own[self.part_of(self.result[i].source)].push(i));
        let mut failing: Vec<Vec<u32>> = vec![vec![]; self.parts.len()];
        for Failing { triangle, .. } in &self.failing {
            let [part, place] = self.place[*triangle as usize];
            failing[part as usize].push(place);
        }
        let threads = parallel::threads(self.decision.threads);
        let inner = if self.parts.len() < MANY * threads { threads.min(BESIDE) } else { 1 };
        let one = |(): &mut (), part: usize| match &self.close {
            Some(close) if wanted(part) => {
                let close = certify::Options { limit: None, threads: inner, ..*close };
                self.bound_of_part(part, mesh, &left[part], &own[part], &failing[part], &close, progress)
            }
            _ => Ok(Verdict::UNKNOWN),
        };
        map(self.parts.len(), threads, || (), one).into_iter().collect()
    }

    #[allow(clippy::too_many_arguments)]
    fn bound_of_part(
        &self,
        part: usize,
        mesh: &Whole<D, Bound>,
        left: &[u32],
        own: &[usize],
        failing: &[u32],
        close: &certify::Options,
        progress: &Progress,
    ) -> Result<Verdict, KernelError> {
        let Part { triangles, surface, limit } = &self.parts[part];
        let mut progress = progress.clone().silent();
        let mut limit = limit.unwrap_or(self.bounds);
        let of_input = triangles.iter().map(|&t| self.attained[t as usize]);
        let of_input = of_input.map(|[shape, color]| Deviation { shape: shape.into(), color: color.into() });
        let of_result = own.iter().map(|&i| self.result[i].verdict.attained);
        let attained = of_input.chain(of_result).fold(Deviation::default(), Deviation::max);
        let is_close = limit.within(close.enough(attained).map(|most| (1.0 + ROUNDING) * most));
        let target = || Surface::of_some(&mesh.points, &mesh.triangles, left, 1);
        if !is_close {
            let mut found = certify::greatest(&target()?, surface, close, &mut progress)?;
            let of_result = own.iter().map(|&i| self.result[i].verdict.bound.shape);
            let of_input = self.failing.iter().filter(|f| self.part_of(f.triangle) == part);
            if of_result.chain(of_input.map(|f| f.bound.shape)).all(|shape| shape <= limit.shape) {
                found.bound.shape = found.bound.shape.min(limit.shape);
            }
            return Ok(found);
        }
        let is_failing = |&&i: &&usize| !self.result[i].verdict.bound.within(limit);
        let sources = own.iter().filter(is_failing).map(|&i| self.result[i].source);
        let mut sources: Vec<u32> = sources.collect();
        sources.sort_unstable();
        let place =
            |&i: &u32| sources.binary_search(&mesh.triangle_source[left[i as usize] as usize]).is_ok();
        let own: Vec<u32> = (0..left.len() as u32).filter(place).collect();
        if surface.colors.is_empty() {
            limit.color = 0.0;
        }
        if own.is_empty() && failing.is_empty() {
            return Ok(Verdict { bound: limit, attained, reach: limit.shape });
        }
        let instead = certify::certify_some(&target()?, surface, close, [&own, failing], &mut progress)?;
        let bound = limit.max(instead.bound);
        Ok(Verdict { bound, attained: attained.max(instead.attained), reach: bound.shape })
    }

    fn with_color(&self) -> bool {
        !self.surface().colors.is_empty() && self.bounds.color < f64::INFINITY
    }

    /// Create a certificate that assigns the requested bounds to every triangle.
    fn bounds_everywhere(&self) -> Certificate {
        let bound =
            Deviation { color: if self.with_color() { self.bounds.color } else { 0.0 }, ..self.bounds };
        let of_input = self.attained.iter().map(|a| Deviation { shape: a[0].into(), color: a[1].into() });
        let of_result = self.result.iter().map(|known| known.verdict.attained);
        Certificate {
            result: vec![bound; self.result.len()],
            own: vec![bound; self.result.len()],
            original: vec![bound; self.place.len()],
            bound,
            attained: of_input.chain(of_result).fold(Deviation::default(), Deviation::max),
            slack: certify::slack(self.surface().bounds.into_iter(), self.decision.slack),
            color_slack: certify::COLOR_SLACK,
            pieces: 0,
        }
    }

    /// Combine this proof with another one of the same meshes: the lower bound wins.
    ///
    /// Without a bound on colour, this proof adds nothing to the colours of `other`.
    pub fn closer(&self, mut other: Certificate) -> Certificate {
        let this = self.bounds_everywhere();
        let with_color = self.bounds.color < f64::INFINITY;
        let said = |d: Deviation| if with_color { d } else { Deviation { color: f64::INFINITY, ..d } };
        combine(&mut other, &this, |a, b| a.min(said(b)));
        other.attained = other.attained.max(this.attained);
        other
    }
}

/// Combine the bounds of two certificates of the same meshes, triangle by triangle.
fn combine(all: &mut Certificate, other: &Certificate, one: impl Fn(Deviation, Deviation) -> Deviation) {
    let each = |a: &mut [Deviation], b: &[Deviation]| a.iter_mut().zip(b).for_each(|(a, b)| *a = one(*a, *b));
    each(&mut all.result, &other.result);
    each(&mut all.own, &other.own);
    each(&mut all.original, &other.original);
    all.bound = one(all.bound, other.bound);
}

/// Compute the bounding box of three corners, enlarged by a margin.
fn box_around<const D: usize>([a, b, c]: &[[f64; D]; 3], margin: f64) -> [Vec3; 2] {
    let low = [0, 1, 2].map(|i| a[i].min(b[i]).min(c[i]) - margin);
    [low, [0, 1, 2].map(|i| a[i].max(b[i]).max(c[i]) + margin)]
}

#[cfg(test)]
mod tests;
