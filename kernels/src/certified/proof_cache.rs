//! Cache of proofs: results per triangle of the mesh and of the input, and what a change invalidates.

use super::input_surface::InputSurface;
use super::sample_tracker::LimitKind;
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, norm2, position_of, sub, triangle_distance2};
use crate::base::memory;
use crate::base::parallel::{self, map};
use crate::base::progress::Progress;
use crate::certify::{self, Certificate, Deviation, Surface, Verdict, decide};
use crate::collapse::whole_mesh::WholeMesh;
use crate::mesh::triangle_mesh::CompactMesh;

/// A triangle of the mesh with the last verdict on it.
struct CertifiedTriangle<const D: usize> {
    /// Index of its input triangle.
    source: u32,
    corners: [[f64; D]; 3],
    verdict: Verdict,
}

/// Marks the absence of a triangle.
const NO_TRIANGLE: u32 = u32::MAX;

/// Relative rounding error of deviations that are stored in single precision.
const SINGLE_PRECISION_ERROR_RATIO: f64 = 1e-6;

/// Input triangles certified at a time, which limits the memory of the results.
const TRIANGLES_PER_BATCH: usize = 1 << 15;

/// Minimum number of triangles per batch of partitions.
const MIN_TRIANGLES_PER_PARTITION_BATCH: usize = 8 * TRIANGLES_PER_BATCH;

/// With at least this many partitions per thread, one thread certifies each partition.
const PARTITIONS_PER_THREAD: usize = 8;

/// Maximum number of threads per partition while other partitions are certified in parallel.
const MAX_THREADS_PER_PARTITION: usize = 4;

/// An input triangle that is not within the limit of its partition.
struct UnprovenTriangle {
    triangle: u32,
    bound: Deviation,
    /// Mesh triangles (by source) that may be nearest to it; empty if it is within the requested bounds.
    within_reach: Vec<u32>,
}

/// Partitions of the input, each certified only against the triangles that are left of it.
pub struct SeparatePartitions<'c> {
    /// Partition of each input triangle, numbered from 0 without gaps.
    pub partition_index: &'c [u32],
    /// Tolerances for the bounds of a partition; `limit` is ignored.
    pub tolerances: &'c certify::Options,
}

/// A partition of the mesh that is certified independently.
struct ProofPartition {
    /// Indices of input triangles, ascending.
    triangles: Vec<u32>,
    surface: Surface,
    /// Limit that its triangles are decided against; set by the first proof.
    limit: Option<Deviation>,
}

/// A request to certify triangles of one partition.
///
/// `all_mesh_triangles` are all mesh triangles of the partition. `mesh_triangles` are the mesh triangles to certify, each with its
/// index in the result. `input_triangles` are the input triangles to certify, in BVH order of the partition.
struct PartitionRequest<'l> {
    part: usize,
    all_mesh_triangles: &'l [u32],
    mesh_triangles: &'l [(u32, usize)],
    input_triangles: Vec<u32>,
}

/// Results for a request, without the values stored per input triangle.
struct PartitionVerdicts {
    limit: Option<Deviation>,
    mesh_verdicts: Vec<Verdict>,
    failing: Vec<UnprovenTriangle>,
}

/// Values stored per input triangle.
#[derive(Clone, Copy)]
struct StoredVerdict {
    attained: [f32; 2],
    reach: f32,
}

impl StoredVerdict {
    fn from_verdict(Verdict { attained, reach, .. }: Verdict) -> Self {
        // Round conservatively: `attained` down, `reach` up.
        let single = |x: f64| (x as f32).next_down().max(0.0);
        Self { attained: [single(attained.shape), single(attained.color)], reach: (reach as f32).next_up() }
    }
}

/// Unproven triangles that may still be provable.
pub struct UnprovenSet {
    /// Triangles of the mesh, by source.
    pub mesh_triangles: Vec<u32>,
    pub input_triangles: Vec<u32>,
    /// For each entry of `input_triangles`: mesh triangles (by source) that may be nearest to it.
    pub within_reach: Vec<Vec<u32>>,
}

impl UnprovenSet {
    pub fn is_empty(&self) -> bool {
        self.mesh_triangles.is_empty() && self.input_triangles.is_empty()
    }
}

/// Proofs of the current mesh and of the input, updated after changes.
pub struct ProofCache<'a, const D: usize> {
    original: &'a InputSurface<D>,
    partitions: Vec<ProofPartition>,
    /// By input triangle: its partition, and its index in the partition.
    partition_slots: Vec<[u32; 2]>,
    /// Options for decisions; `limit` is set.
    decision: certify::Options,
    /// Tolerances for the bounds of each partition, if partitions are certified separately.
    tolerances: Option<certify::Options>,
    bounds: Deviation,
    /// Sorted by source; empty before the first call of [`Self::update`].
    mesh_triangles: Vec<CertifiedTriangle<D>>,
    /// By input triangle: largest measured deviation.
    attained: Vec<[f32; 2]>,
    /// By input triangle: maximum distance of mesh triangles that affect its proof, if below the bound on
    /// shape.
    reach: Vec<f32>,
    /// Sorted by triangle.
    failing: Vec<UnprovenTriangle>,
    /// Sorted input triangles whose bounds do not even hold between the input and itself.
    pub unprovable: Vec<u32>,
}

impl<'a, const D: usize> ProofCache<'a, D> {
    /// Create a cache without proofs.
    ///
    /// # Errors
    /// As [`Surface::new`].
    pub fn new(
        original: &'a InputSurface<D>,
        decision: certify::Options,
        apart: Option<&SeparatePartitions<'_>>,
    ) -> Result<Self, KernelError> {
        let count = original.triangles.len();
        let part_of = |t: usize| apart.map_or(0, |apart| apart.partition_index[t] as usize);
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
            Surface::of_triangles(&original.points, &original.triangles, triangles, threads)
        };
        let (count, threads) = (triangles.len(), parallel::resolve_thread_count(decision.threads));
        let parts = map(count, threads, || (), |(), i| part(&triangles[i]));
        let parts = parts
            .into_iter()
            .zip(triangles)
            .map(|(surface, triangles)| Ok(ProofPartition { triangles, surface: surface?, limit: None }));
        let parts = parts.collect::<Result<_, KernelError>>()?;
        memory::release_free_memory();
        Ok(Self {
            original,
            partitions: parts,
            partition_slots: place,
            decision,
            tolerances: apart.map(|apart| *apart.tolerances),
            bounds: decision.limit.unwrap_or_default(),
            mesh_triangles: vec![],
            attained: vec![],
            reach: vec![],
            failing: vec![],
            unprovable: vec![],
        })
    }

    /// Return the requested bounds.
    pub fn bounds(&self) -> Deviation {
        self.bounds
    }

    /// Return the surface of the input, if it is certified as a whole.
    pub fn surface(&self) -> &Surface {
        &self.partitions[0].surface
    }

    /// Certify all triangles that changed since the last call.
    ///
    /// Returns the number of unproven triangles of the mesh and of the input. The verdict on a mesh triangle
    /// stays valid while the triangle exists. The verdict on an input triangle stays valid while all mesh
    /// triangles that may be nearest to it exist.
    pub fn update(
        &mut self,
        mesh: &WholeMesh<D, LimitKind>,
        progress: &mut Progress,
    ) -> Result<[usize; 2], KernelError> {
        let is_first = self.attained.is_empty();
        let count = self.partition_slots.len();
        let threads = parallel::resolve_thread_count(self.decision.threads);
        // By input triangle: index in the current mesh, and index in the previous result.
        let (mut now, mut then) = (vec![NO_TRIANGLE; count], vec![NO_TRIANGLE; count]);
        (0..).zip(&mesh.triangle_source).for_each(|(i, &source)| now[source as usize] = i);
        (0..).zip(&self.mesh_triangles).for_each(|(i, known)| then[known.source as usize] = i);
        let sources: Vec<u32> = (0..count as u32).filter(|&t| now[t as usize] != NO_TRIANGLE).collect();
        let before = std::mem::take(&mut self.mesh_triangles);
        let mut result = parallel::collect(sources.len(), threads, |number| {
            let source = sources[number];
            let corners = mesh.triangles[now[source as usize] as usize].map(|v| mesh.points[v as usize]);
            let before = before.get(then[source as usize] as usize);
            let verdict = before.filter(|known| known.corners == corners).map(|known| known.verdict);
            CertifiedTriangle { source, corners, verdict: verdict.unwrap_or(Verdict::UNKNOWN) }
        });
        // Changed triangles in their old and new shape, and triangles that vanished.
        let mut asked = vec![vec![]; self.partitions.len()];
        let mut changed: Vec<Vec<&CertifiedTriangle<D>>> = vec![vec![]; self.partitions.len()];
        for (number, known) in result.iter().enumerate() {
            let before = before.get(then[known.source as usize] as usize);
            if before.is_none_or(|before| before.corners != known.corners) {
                let part = self.partition_of(known.source);
                asked[part].push((now[known.source as usize], number));
                changed[part].extend(before.into_iter().chain([known]));
            }
        }
        for gone in before.iter().filter(|known| now[known.source as usize] == NO_TRIANGLE) {
            changed[self.partition_of(gone.source)].push(gone);
        }
        let near_in_part = |(): &mut (), part: usize| match is_first {
            true => vec![true; self.partitions[part].triangles.len()],
            false => self.mark_affected_triangles(&self.partitions[part], &changed[part]),
        };
        let near = map(self.partitions.len(), threads, || (), near_in_part);
        let is_touched: Vec<bool> = changed.iter().map(|changed| is_first || !changed.is_empty()).collect();
        drop(before);
        self.attained.resize(count, [0.0; 2]);
        self.reach.resize(count, f32::INFINITY);
        let place = &self.partition_slots;
        self.failing.retain(|failing| {
            let [part, place] = place[failing.triangle as usize].map(|i| i as usize);
            !near[part].get(place).copied().unwrap_or(false)
        });
        let mut left = vec![vec![]; self.partitions.len()];
        for (i, &source) in (0..).zip(&mesh.triangle_source) {
            let part = self.partition_of(source);
            if is_touched[part] {
                left[part].push(i);
            }
        }
        let mut all = vec![];
        for (part, (own, left)) in asked.iter().zip(&left).enumerate().filter(|(part, _)| is_touched[*part]) {
            // BVH order, so that triangles certified together are neighbours.
            let order = self.partitions[part].surface.triangle_of_slot.iter().copied();
            let near: Vec<u32> = order.filter(|&t| near[part][t as usize]).collect();
            if !(own.is_empty() && near.is_empty()) {
                all.push(PartitionRequest {
                    part,
                    all_mesh_triangles: left,
                    mesh_triangles: own,
                    input_triangles: near,
                });
            }
        }
        let mut rest = &all[..];
        while !rest.is_empty() {
            let (mut count, mut some) = (0, 0);
            while some < rest.len() && count < MIN_TRIANGLES_PER_PARTITION_BATCH {
                count += rest[some].mesh_triangles.len() + rest[some].input_triangles.len();
                some += 1;
            }
            let (now, later) = rest.split_at(some);
            for (asked, looked) in now.iter().zip(self.certify_partitions(now, mesh, progress)?) {
                for (&(_, number), verdict) in asked.mesh_triangles.iter().zip(&looked.mesh_verdicts) {
                    result[number].verdict = *verdict;
                }
                self.partitions[asked.part].limit = looked.limit;
                for failing in &looked.failing {
                    self.reach[failing.triangle as usize] = f32::INFINITY;
                }
                self.failing.extend(looked.failing);
            }
            rest = later;
        }
        self.mesh_triangles = result;
        self.failing.sort_unstable_by_key(|failing| failing.triangle);
        self.accept_unchanged_triangles();
        Ok([self.unproven_mesh_triangles().count(), self.unproven_input_triangles().count()])
    }

    /// Accept unproven triangles that the mesh and the input have in common: their distance is 0.
    ///
    /// Among many needles, the effort of a proof may not even suffice between the input and itself. Colours
    /// need the proof: another sheet in the same place may have other colours.
    fn accept_unchanged_triangles(&mut self) {
        let has_color = !self.surface().colors.is_empty();
        if has_color && (self.bounds.color < f64::INFINITY || self.tolerances.is_some()) {
            return;
        }
        let slack = certify::slack(self.surface().bounds.into_iter(), self.decision.slack);
        let (original, bounds, mesh_triangles) = (self.original, self.bounds, &mut self.mesh_triangles);
        let is_unchanged = |known: &CertifiedTriangle<D>| {
            known.corners == original.triangles[known.source as usize].map(|v| original.points[v as usize])
        };
        self.failing.retain(|failing| {
            let found = mesh_triangles.binary_search_by_key(&failing.triangle, |known| known.source);
            !found.is_ok_and(|i| is_unchanged(&mesh_triangles[i]))
        });
        for known in mesh_triangles.iter_mut() {
            if !known.verdict.bound.is_within(bounds) && is_unchanged(known) {
                let color = if has_color { f64::INFINITY } else { 0.0 };
                known.verdict.bound = Deviation { shape: slack, color };
            }
        }
    }

    fn partition_of(&self, source: u32) -> usize {
        self.partition_slots[source as usize][0] as usize
    }

    /// Group the triangles of a mesh by partition, given their sources; ascending in each group.
    fn group_by_partition(&self, sources: &[u32]) -> Vec<Vec<u32>> {
        let mut left = vec![vec![]; self.partitions.len()];
        (0..).zip(sources).for_each(|(i, &source)| left[self.partition_of(source)].push(i));
        left
    }

    /// Certify several partitions in parallel, and store the values of their input triangles.
    fn certify_partitions(
        &mut self,
        asked: &[PartitionRequest<'_>],
        mesh: &WholeMesh<D, LimitKind>,
        progress: &Progress,
    ) -> Result<Vec<PartitionVerdicts>, KernelError> {
        let threads = parallel::resolve_thread_count(self.decision.threads);
        if let [asked] = asked {
            // A single partition may be the whole input: store each result directly instead of buffering it.
            let (mut attained, mut reach) =
                (std::mem::take(&mut self.attained), std::mem::take(&mut self.reach));
            let keep = |t: usize, kept: StoredVerdict| (attained[t], reach[t]) = (kept.attained, kept.reach);
            let looked = self.certify_partition(asked, mesh, threads, keep, &mut progress.clone());
            (self.attained, self.reach) = (attained, reach);
            return Ok(vec![looked?]);
        }
        let inner = if asked.len() < PARTITIONS_PER_THREAD * threads {
            threads.min(MAX_THREADS_PER_PARTITION)
        } else {
            1
        };
        // Largest first, so that no thread starts a large partition at the end.
        let mut order: Vec<usize> = (0..asked.len()).collect();
        order.sort_by_key(|&i| {
            std::cmp::Reverse(asked[i].mesh_triangles.len() + asked[i].input_triangles.len())
        });
        let one = |(): &mut (), i: usize| {
            let mut found = Vec::with_capacity(asked[order[i]].input_triangles.len());
            let keep = |t: usize, kept: StoredVerdict| found.push((t, kept));
            let looked =
                self.certify_partition(&asked[order[i]], mesh, inner, keep, &mut progress.clone())?;
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
    fn certify_partition(
        &self,
        PartitionRequest { part, all_mesh_triangles: left, mesh_triangles: own, input_triangles: near }: &PartitionRequest<'_>,
        mesh: &WholeMesh<D, LimitKind>,
        threads: usize,
        mut keep: impl FnMut(usize, StoredVerdict),
        progress: &mut Progress,
    ) -> Result<PartitionVerdicts, KernelError> {
        let ProofPartition { triangles, surface, limit } = &self.partitions[*part];
        let mut limit = *limit;
        let target = Surface::of_triangles(&mesh.points, &mesh.triangles, left, threads)?;
        let place = |i: u32| left.partition_point(|&other| other < i) as u32;
        let mut own: Vec<u32> = own.iter().map(|&(i, _)| place(i)).collect();
        // If partitions are bounded separately, colours are certified even without a limit on colour.
        let decision = certify::Options { limit: limit.or(self.decision.limit), threads, ..self.decision };
        let decision = match self.tolerances {
            Some(_) => certify::Options { limit: None, ..decision },
            None => decision,
        };
        let mut found = PartitionVerdicts { limit, mesh_verdicts: vec![], failing: vec![] };
        let mut rest = near.chunks(TRIANGLES_PER_BATCH);
        let mut some = rest.next();
        while !own.is_empty() || some.is_some() {
            let now = [std::mem::take(&mut own), some.map_or(vec![], <[u32]>::to_vec)];
            let at_corners = |attained| limit.unwrap_or_else(|| self.partition_limit(attained));
            let lists = now.each_ref().map(Vec::as_slice);
            let (within, [of_mesh, of_input]) =
                certify::decide_with_limit(&target, surface, &decision, lists, at_corners, progress)?;
            limit = Some(within);
            found.mesh_verdicts.extend(of_mesh);
            for (&t, verdict) in now[1].iter().zip(of_input) {
                let bound = verdict.bound;
                keep(triangles[t as usize] as usize, StoredVerdict::from_verdict(verdict));
                if !bound.is_within(within) {
                    let triangle = triangles[t as usize];
                    let source = |i: u32| mesh.triangle_source[left[i as usize] as usize];
                    let fails = !bound.is_within(self.bounds);
                    let within_reach = if fails {
                        self.find_mesh_triangles_within_reach(triangle, &target, source)
                    } else {
                        vec![]
                    };
                    found.failing.push(UnprovenTriangle { triangle, bound, within_reach });
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
    fn partition_limit(&self, attained: Deviation) -> Deviation {
        match &self.tolerances {
            Some(close) => Deviation {
                color: self.bounds.color.min(close.sufficient_bound(attained).color),
                ..self.bounds
            },
            None => self.bounds,
        }
    }

    /// Find the mesh triangles that may be nearest to an input triangle.
    ///
    /// `source` maps their indices in `target` to sources.
    fn find_mesh_triangles_within_reach(
        &self,
        triangle: u32,
        target: &Surface,
        source: impl Fn(u32) -> u32,
    ) -> Vec<u32> {
        let corners = self.original.triangles[triangle as usize].map(|v| self.original.points[v as usize]);
        let [low, high] = bounding_box(&corners, self.bounds.shape);
        let mut within_reach = vec![];
        target.visit_triangles_in_box(&low, &high, |i| within_reach.push(source(i)));
        within_reach
    }

    /// Iterate over the unproven triangles of the mesh, as indices into `mesh_triangles`.
    fn unproven_mesh_triangles(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.mesh_triangles.len())
            .filter(|&i| !self.mesh_triangles[i].verdict.bound.is_within(self.bounds))
    }

    fn unproven_input_triangles(&self) -> impl Iterator<Item = &UnprovenTriangle> + '_ {
        self.failing.iter().filter(|failing| !failing.bound.is_within(self.bounds))
    }

    /// Mark the triangles of a partition that a change may affect.
    ///
    /// An input triangle is affected if a changed mesh triangle may be nearest to one of its points, given
    /// its `reach`. Empty if `changed` is empty.
    fn mark_affected_triangles(&self, part: &ProofPartition, changed: &[&CertifiedTriangle<D>]) -> Vec<bool> {
        let mut near = vec![false; if changed.is_empty() { 0 } else { part.triangles.len() }];
        let reach = self.bounds.shape * (1.0 + 1e-9);
        for known in changed {
            let [low, high] = bounding_box(&known.corners, reach);
            let places = known.corners.map(|c| position_of(&c));
            part.surface.visit_triangles_in_box(&low, &high, |place| {
                let t = part.triangles[place as usize] as usize;
                let [a, b, c] =
                    self.original.triangles[t].map(|v| position_of(&self.original.points[v as usize]));
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
    pub fn find_unprovable(&mut self, progress: &mut Progress) -> Result<usize, KernelError> {
        let sources = self.unproven_mesh_triangles().map(|i| self.mesh_triangles[i].source);
        let failing = sources.chain(self.unproven_input_triangles().map(|failing| failing.triangle));
        let mut asked: Vec<u32> = failing.collect();
        asked.sort_unstable();
        asked.dedup();
        asked.retain(|t| self.unprovable.binary_search(t).is_err());
        let before = self.unprovable.len();
        let mut of_parts = vec![vec![]; self.partitions.len()];
        asked.iter().for_each(|&t| of_parts[self.partition_of(t)].push(self.partition_slots[t as usize][1]));
        for (part, asked) in of_parts.iter().enumerate().filter(|(_, asked)| !asked.is_empty()) {
            let ProofPartition { triangles, surface, .. } = &self.partitions[part];
            let [_, verdicts] = decide(surface, surface, &self.decision, [&[], asked], progress)?;
            let found =
                asked.iter().zip(verdicts).filter(|(_, verdict)| !verdict.bound.is_within(self.bounds));
            let found = found.map(|(&t, _)| triangles[t as usize]).collect();
            self.mark_unprovable(found);
        }
        Ok(self.unprovable.len() - before)
    }

    /// Give up the proofs of these input triangles and of the mesh triangles left of them.
    pub fn mark_unprovable(&mut self, hopeless: Vec<u32>) {
        self.unprovable.extend(hopeless);
        self.unprovable.sort_unstable();
        self.unprovable.dedup();
    }

    /// Collect the unproven triangles that have not been given up.
    pub fn unproven_set(&self) -> UnprovenSet {
        let hope = |t: &u32| self.unprovable.binary_search(t).is_err();
        let of_input = self.unproven_input_triangles().filter(|failing| hope(&failing.triangle));
        let (of_input, within_reach) = of_input.map(|f| (f.triangle, f.within_reach.clone())).unzip();
        let of_result =
            self.unproven_mesh_triangles().map(|i| self.mesh_triangles[i].source).filter(hope).collect();
        UnprovenSet { mesh_triangles: of_result, input_triangles: of_input, within_reach }
    }

    /// Create the certificate of `mesh`, which must be the mesh of the last [`Self::update`].
    ///
    /// Proven triangles get the requested bounds; unproven triangles are bounded according to `options`.
    pub fn certificate(
        &self,
        mesh: &CompactMesh<D>,
        options: &certify::Options,
        progress: &mut Progress,
    ) -> Result<Certificate, KernelError> {
        let mut all = self.requested_bounds_certificate();
        let own: Vec<u32> = self.unproven_mesh_triangles().map(|i| i as u32).collect();
        let original: Vec<u32> = self.unproven_input_triangles().map(|failing| failing.triangle).collect();
        if own.is_empty() && original.is_empty() {
            return Ok(all);
        }
        let threads = self.decision.threads;
        let result = Surface::new(&mesh.points, &mesh.triangles, threads)?;
        let options = certify::Options { limit: None, threads, ..*options };
        let instead =
            certify::certify_triangles(&result, self.surface(), &options, [&own, &original], progress)?;
        // Without a bound on colour, the colours of the other triangles are unknown.
        let said = |d: Deviation| if self.with_color() { d } else { Deviation { color: 0.0, ..d } };
        combine_certificates(&mut all, &instead, |a, b| a.max(said(b)));
        all.attained = all.attained.max(said(instead.attained));
        Ok(all)
    }

    /// Bound each partition that `wanted` selects, to the requested tolerances.
    ///
    /// `mesh` must be the mesh of the last [`Self::update`]. Partitions that are not selected get
    /// [`Verdict::UNKNOWN`].
    ///
    /// # Errors
    /// [`KernelError::Interrupted`].
    pub fn bound_partitions(
        &self,
        mesh: &WholeMesh<D, LimitKind>,
        wanted: impl Fn(usize) -> bool + Sync,
        progress: &Progress,
    ) -> Result<Vec<Verdict>, KernelError> {
        let left = self.group_by_partition(&mesh.triangle_source);
        let mut own: Vec<Vec<usize>> = vec![vec![]; self.partitions.len()];
        (0..self.mesh_triangles.len())
            .for_each(|i| own[self.partition_of(self.mesh_triangles[i].source)].push(i));
        let mut failing: Vec<Vec<u32>> = vec![vec![]; self.partitions.len()];
        for UnprovenTriangle { triangle, .. } in &self.failing {
            let [part, place] = self.partition_slots[*triangle as usize];
            failing[part as usize].push(place);
        }
        let threads = parallel::resolve_thread_count(self.decision.threads);
        let inner = if self.partitions.len() < PARTITIONS_PER_THREAD * threads {
            threads.min(MAX_THREADS_PER_PARTITION)
        } else {
            1
        };
        let one = |(): &mut (), part: usize| match &self.tolerances {
            Some(close) if wanted(part) => {
                let close = certify::Options { limit: None, threads: inner, ..*close };
                self.bound_partition(part, mesh, &left[part], &own[part], &failing[part], &close, progress)
            }
            _ => Ok(Verdict::UNKNOWN),
        };
        map(self.partitions.len(), threads, || (), one).into_iter().collect()
    }

    #[allow(clippy::too_many_arguments)]
    fn bound_partition(
        &self,
        part: usize,
        mesh: &WholeMesh<D, LimitKind>,
        left: &[u32],
        own: &[usize],
        failing: &[u32],
        close: &certify::Options,
        progress: &Progress,
    ) -> Result<Verdict, KernelError> {
        let ProofPartition { triangles, surface, limit } = &self.partitions[part];
        let mut progress = progress.clone().silent();
        let mut limit = limit.unwrap_or(self.bounds);
        let of_input = triangles.iter().map(|&t| self.attained[t as usize]);
        let of_input = of_input.map(|[shape, color]| Deviation { shape: shape.into(), color: color.into() });
        let of_result = own.iter().map(|&i| self.mesh_triangles[i].verdict.attained);
        let attained = of_input.chain(of_result).fold(Deviation::default(), Deviation::max);
        let is_close = limit.is_within(
            close.sufficient_bound(attained).map(|most| (1.0 + SINGLE_PRECISION_ERROR_RATIO) * most),
        );
        let target = || Surface::of_triangles(&mesh.points, &mesh.triangles, left, 1);
        if !is_close {
            let mut found = certify::bound_whole(&target()?, surface, close, &mut progress)?;
            let of_result = own.iter().map(|&i| self.mesh_triangles[i].verdict.bound.shape);
            let of_input = self.failing.iter().filter(|f| self.partition_of(f.triangle) == part);
            if of_result.chain(of_input.map(|f| f.bound.shape)).all(|shape| shape <= limit.shape) {
                found.bound.shape = found.bound.shape.min(limit.shape);
            }
            return Ok(found);
        }
        let is_failing = |&&i: &&usize| !self.mesh_triangles[i].verdict.bound.is_within(limit);
        let sources = own.iter().filter(is_failing).map(|&i| self.mesh_triangles[i].source);
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
        let instead = certify::certify_triangles(&target()?, surface, close, [&own, failing], &mut progress)?;
        let bound = limit.max(instead.bound);
        Ok(Verdict { bound, attained: attained.max(instead.attained), reach: bound.shape })
    }

    fn with_color(&self) -> bool {
        !self.surface().colors.is_empty() && self.bounds.color < f64::INFINITY
    }

    /// Create a certificate that assigns the requested bounds to every triangle.
    fn requested_bounds_certificate(&self) -> Certificate {
        let bound =
            Deviation { color: if self.with_color() { self.bounds.color } else { 0.0 }, ..self.bounds };
        let of_input = self.attained.iter().map(|a| Deviation { shape: a[0].into(), color: a[1].into() });
        let of_result = self.mesh_triangles.iter().map(|known| known.verdict.attained);
        Certificate {
            result: vec![bound; self.mesh_triangles.len()],
            from_result: vec![bound; self.mesh_triangles.len()],
            original: vec![bound; self.partition_slots.len()],
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
    pub fn combine_with(&self, mut other: Certificate) -> Certificate {
        let this = self.requested_bounds_certificate();
        let with_color = self.bounds.color < f64::INFINITY;
        let said = |d: Deviation| if with_color { d } else { Deviation { color: f64::INFINITY, ..d } };
        combine_certificates(&mut other, &this, |a, b| a.min(said(b)));
        other.attained = other.attained.max(this.attained);
        other
    }
}

/// Combine the bounds of two certificates of the same meshes, triangle by triangle.
fn combine_certificates(
    all: &mut Certificate,
    other: &Certificate,
    one: impl Fn(Deviation, Deviation) -> Deviation,
) {
    let each = |a: &mut [Deviation], b: &[Deviation]| a.iter_mut().zip(b).for_each(|(a, b)| *a = one(*a, *b));
    each(&mut all.result, &other.result);
    each(&mut all.from_result, &other.from_result);
    each(&mut all.original, &other.original);
    all.bound = one(all.bound, other.bound);
}

/// Compute the bounding box of three corners, enlarged by a margin.
fn bounding_box<const D: usize>([a, b, c]: &[[f64; D]; 3], margin: f64) -> [Vec3; 2] {
    let low = [0, 1, 2].map(|i| a[i].min(b[i]).min(c[i]) - margin);
    [low, [0, 1, 2].map(|i| a[i].max(b[i]).max(c[i]) + margin)]
}

#[cfg(test)]
mod tests;
