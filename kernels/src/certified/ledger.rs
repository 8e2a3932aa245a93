//! What is proven of the current mesh and of the input, and what has to be looked at again after a change.

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

/// A triangle of the mesh as it was looked at last.
struct Known<const D: usize> {
    /// Triangle of the input.
    source: u32,
    corners: [[f64; D]; 3],
    verdict: Verdict,
}

/// No triangle.
const NONE: u32 = u32::MAX;

/// Share of a deviation that is lost where it is kept in single precision.
const ROUNDING: f64 = 1e-6;

/// Triangles of the input that are looked at together: what is found of them takes memory.
const AT_ONCE: usize = 1 << 15;

/// Triangles of parts that are looked at together, at least.
const TOGETHER: usize = 8 * AT_ONCE;

/// With so many parts for each thread none has to be divided.
const MANY: usize = 8;

/// Threads that a part is divided among, at most, where others are looked at beside it.
const BESIDE: usize = 4;

/// A triangle of the input that is not within its part's limit.
struct Failing {
    triangle: u32,
    bound: Deviation,
    /// Triangles of the mesh it may be nearest to, by their sources; none if it is within the bounds asked for.
    within_reach: Vec<u32>,
}

/// Parts of the input that are each proven against what becomes of them alone, and bounded closely.
pub struct Apart<'c> {
    /// By triangle of the input, from 0 on without gaps.
    pub part: &'c [u32],
    /// How closely; the limit is not used.
    pub close: &'c certify::Options,
}

/// Triangles that are looked at as if there were no others.
struct Part {
    /// Of the input, in order.
    triangles: Vec<u32>,
    surface: Surface,
    /// What is decided of its triangles, from the first look on.
    limit: Option<Deviation>,
}

/// What is to be looked at in a part: triangles of the mesh with their places in the result; of the input, all in order of the
/// part's tree. `left` are all triangles of the mesh.
struct Asked<'l> {
    part: usize,
    left: &'l [u32],
    own: &'l [(u32, usize)],
    near: Vec<u32>,
}

/// What was found there, but for what is kept of each triangle of the input.
struct Looked {
    limit: Option<Deviation>,
    of_mesh: Vec<Verdict>,
    failing: Vec<Failing>,
}

/// What is kept of a triangle of the input.
#[derive(Clone, Copy)]
struct Kept {
    attained: [f32; 2],
    reach: f32,
}

impl Kept {
    fn of(Verdict { attained, reach, .. }: Verdict) -> Self {
        // Never more than what is attained, and nothing less than the reach.
        let single = |x: f64| (x as f32).next_down().max(0.0);
        Self { attained: [single(attained.shape), single(attained.color)], reach: (reach as f32).next_up() }
    }
}

/// Triangles without a proof where there may be one.
pub struct Open {
    /// Triangles of the mesh, by the number of that of the input they are what is left of.
    pub of_result: Vec<u32>,
    pub of_input: Vec<u32>,
    /// The triangles of the mesh that each of those of the input may be nearest to, named alike.
    pub within_reach: Vec<Vec<u32>>,
}

impl Open {
    pub fn is_empty(&self) -> bool {
        self.of_result.is_empty() && self.of_input.is_empty()
    }
}

pub struct Ledger<'a, const D: usize> {
    original: &'a Original<D>,
    parts: Vec<Part>,
    /// By triangle of the input: its part, and its place there.
    place: Vec<[u32; 2]>,
    /// With a limit.
    decision: certify::Options,
    /// How closely each part is bounded, if by itself.
    close: Option<certify::Options>,
    bounds: Deviation,
    /// In the order of their sources; none before the first look.
    result: Vec<Known<D>>,
    /// The greatest deviation seen in each triangle of the input.
    attained: Vec<[f32; 2]>,
    /// How far from each triangle of the input the mesh counts at most, where that is less than the bound on shape.
    reach: Vec<f32>,
    /// In order.
    failing: Vec<Failing>,
    /// Triangles of the input that not even the input is within the bounds of, in order.
    pub hopeless: Vec<u32>,
}

impl<'a, const D: usize> Ledger<'a, D> {
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

    pub fn bounds(&self) -> Deviation {
        self.bounds
    }

    /// The input's, where it is looked at as one.
    pub fn surface(&self) -> &Surface {
        &self.parts[0].surface
    }

    /// Look at what has changed since the last time. Returns how many triangles of the mesh and of the input have no
    /// proof now.
    ///
    /// What is found of a triangle of the mesh stays as long as it does. For one of the input nothing counts but what may be
    /// nearest to it, and what is found stays as long as all of that does.
    pub fn look(
        &mut self,
        mesh: &Whole<D, Bound>,
        progress: &mut Progress,
    ) -> Result<[usize; 2], KernelError> {
        let is_first = self.attained.is_empty();
        let count = self.place.len();
        let threads = parallel::threads(self.decision.threads);
        // By triangle of the input: its place in the mesh, and among those looked at last.
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
        // What is not what it was, as it was and as it is, and what has gone.
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
            // In the order of the tree, so that those looked at together are neighbours.
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

    /// The triangles of a mesh in each part, in order, given what they are left of.
    fn left_of_parts(&self, sources: &[u32]) -> Vec<Vec<u32>> {
        let mut left = vec![vec![]; self.parts.len()];
        (0..).zip(sources).for_each(|(i, &source)| left[self.part_of(source)].push(i));
        left
    }

    /// Look at several parts, on all threads, and keep what is found of their triangles of the input.
    fn look_at_parts(
        &mut self,
        asked: &[Asked<'_>],
        mesh: &Whole<D, Bound>,
        progress: &Progress,
    ) -> Result<Vec<Looked>, KernelError> {
        let threads = parallel::threads(self.decision.threads);
        if let [asked] = asked {
            // It may be all of the input: what is found goes where it is kept at once.
            let (mut attained, mut reach) =
                (std::mem::take(&mut self.attained), std::mem::take(&mut self.reach));
            let keep = |t: usize, kept: Kept| (attained[t], reach[t]) = (kept.attained, kept.reach);
            let looked = self.look_at_part(asked, mesh, threads, keep, &mut progress.clone());
            (self.attained, self.reach) = (attained, reach);
            return Ok(vec![looked?]);
        }
        let inner = if asked.len() < MANY * threads { threads.min(BESIDE) } else { 1 };
        // The largest ones first: what comes last is soon done.
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

    /// Look at one of them, and hand out what to keep of each of its triangles of the input.
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
        // Colours are looked at where they are to be bounded, too.
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

    /// What is decided of a part's triangles whose corners attain so much: the bounds asked for, and colours as closely as
    /// wanted.
    fn limit_of(&self, attained: Deviation) -> Deviation {
        match &self.close {
            Some(close) => {
                Deviation { color: self.bounds.color.min(close.enough(attained).color), ..self.bounds }
            }
            None => self.bounds,
        }
    }

    /// The triangles of a mesh that one of the input may be nearest to, named by `source`.
    fn within_reach(&self, triangle: u32, target: &Surface, source: impl Fn(u32) -> u32) -> Vec<u32> {
        let corners = self.original.triangles[triangle as usize].map(|v| self.original.points[v as usize]);
        let [low, high] = box_around(&corners, self.bounds.shape);
        let mut within_reach = vec![];
        target.triangles_meeting(&low, &high, |i| within_reach.push(source(i)));
        within_reach
    }

    /// Triangles of the mesh without a proof, by their number in `result`.
    fn failing_of_result(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.result.len()).filter(|&i| !self.result[i].verdict.bound.within(self.bounds))
    }

    fn failing_of_input(&self) -> impl Iterator<Item = &Failing> + '_ {
        self.failing.iter().filter(|failing| !failing.bound.within(self.bounds))
    }

    /// By triangle of a part: whether any of these triangles of the mesh may be nearest to a point of it, given how far the
    /// mesh is from it at most: others need not be looked at again when they come or go. Empty if there are none.
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

    /// Find out which of the triangles without a proof can have none: their bounds do not hold between the input
    /// and itself. Returns how many more there are now.
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

    /// No proof is looked for any more of these triangles of the input, and of what is left of them.
    pub fn give_up(&mut self, hopeless: Vec<u32>) {
        self.hopeless.extend(hopeless);
        self.hopeless.sort_unstable();
        self.hopeless.dedup();
    }

    /// Triangles without a proof that are not hopeless.
    pub fn open(&self) -> Open {
        let hope = |t: &u32| self.hopeless.binary_search(t).is_err();
        let of_input = self.failing_of_input().filter(|failing| hope(&failing.triangle));
        let (of_input, within_reach) = of_input.map(|f| (f.triangle, f.within_reach.clone())).unzip();
        let of_result = self.failing_of_result().map(|i| self.result[i].source).filter(hope).collect();
        Open { of_result, of_input, within_reach }
    }

    /// What is proven of `mesh`, which must be the one looked at last: the bounds, and what holds instead for triangles
    /// without a proof, as closely as `options` say.
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
        // Without a bound on colours nothing is said of the others'.
        let said = |d: Deviation| if self.with_color() { d } else { Deviation { color: 0.0, ..d } };
        combine(&mut all, &instead, |a, b| a.max(said(b)));
        all.attained = all.attained.max(said(instead.attained));
        Ok(all)
    }

    /// What is proven of each part that `wanted` says yes to, as closely as was asked for; `mesh` must be the one looked at
    /// last.
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

    /// The bounds that were asked for, for every triangle.
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

    /// This proof and another of the same meshes: each bound is the lesser one. This one says nothing of colours without
    /// a bound on them.
    pub fn closer(&self, mut other: Certificate) -> Certificate {
        let this = self.bounds_everywhere();
        let with_color = self.bounds.color < f64::INFINITY;
        let said = |d: Deviation| if with_color { d } else { Deviation { color: f64::INFINITY, ..d } };
        combine(&mut other, &this, |a, b| a.min(said(b)));
        other.attained = other.attained.max(this.attained);
        other
    }
}

/// Bounds of two certificates of the same meshes, made one by one.
fn combine(all: &mut Certificate, other: &Certificate, one: impl Fn(Deviation, Deviation) -> Deviation) {
    let each = |a: &mut [Deviation], b: &[Deviation]| a.iter_mut().zip(b).for_each(|(a, b)| *a = one(*a, *b));
    each(&mut all.result, &other.result);
    each(&mut all.own, &other.own);
    each(&mut all.original, &other.original);
    all.bound = one(all.bound, other.bound);
}

/// The box around three corners, with a margin.
fn box_around<const D: usize>([a, b, c]: &[[f64; D]; 3], margin: f64) -> [Vec3; 2] {
    let low = [0, 1, 2].map(|i| a[i].min(b[i]).min(c[i]) - margin);
    [low, [0, 1, 2].map(|i| a[i].max(b[i]).max(c[i]) + margin)]
}

#[cfg(test)]
mod tests;
