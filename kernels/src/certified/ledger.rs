//! What is proven of the current mesh and of the input, and what has to be looked at again after a change.

use super::original::Original;
use super::tracker::Bound;
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, norm2, position, sub, triangle_distance2};
use crate::base::memory;
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

/// Triangles of the input that are looked at together: what is found of them takes memory.
const AT_ONCE: usize = 1 << 15;

/// A triangle of the input without a proof.
struct Failing {
    triangle: u32,
    /// Triangles of the mesh it may be nearest to, by their sources.
    within_reach: Vec<u32>,
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
    /// The input's.
    pub surface: Surface,
    /// With a limit.
    decision: certify::Options,
    bounds: Deviation,
    /// In the order of their sources; none before the first look.
    result: Vec<Known<D>>,
    /// The greatest deviation seen in each triangle of the input.
    attained: Vec<[f32; 2]>,
    /// Triangles of the input without a proof.
    failing: Vec<Failing>,
    /// Triangles of the input that not even the input is within the bounds of, in order.
    pub hopeless: Vec<u32>,
}

impl<'a, const D: usize> Ledger<'a, D> {
    /// # Errors
    /// As [`Surface::new`].
    pub fn new(original: &'a Original<D>, decision: certify::Options) -> Result<Self, KernelError> {
        let bounds = decision.limit.unwrap_or_default();
        let surface = Surface::new(&original.points, &original.triangles, decision.threads)?;
        memory::give_back();
        Ok(Self {
            original,
            surface,
            decision,
            bounds,
            result: vec![],
            attained: vec![],
            failing: vec![],
            hopeless: vec![],
        })
    }

    pub fn bounds(&self) -> Deviation {
        self.bounds
    }

    /// Look at what has changed since the last time. Returns how many triangles of the mesh and of the input have no
    /// proof now.
    ///
    /// What is found of a triangle of the mesh stays as long as it does. For one of the input nothing counts but what is
    /// within the bound on shape of it, and what is found stays as long as all of that does.
    pub fn look(
        &mut self,
        mesh: &Whole<D, Bound>,
        progress: &mut Progress,
    ) -> Result<[usize; 2], KernelError> {
        let is_first = self.attained.is_empty();
        let mut near = vec![is_first; self.surface.len()];
        let mut places: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
        places.sort_unstable_by_key(|&i| mesh.triangle_source[i as usize]);
        let mut before = std::mem::take(&mut self.result).into_iter().peekable();
        let mut result = Vec::with_capacity(places.len());
        let (mut asked, mut asked_known) = (vec![], vec![]);
        for (number, &i) in places.iter().enumerate() {
            let source = mesh.triangle_source[i as usize];
            let corners = mesh.triangles[i as usize].map(|v| mesh.points[v as usize]);
            while let Some(gone) = before.next_if(|known| known.source < source) {
                self.mark_within_reach(&gone.corners, &mut near);
            }
            let known = before.next_if(|known| known.source == source);
            let same = known.as_ref().is_some_and(|known| known.corners == corners);
            let verdict = match known {
                Some(known) if same => known.verdict,
                known => {
                    known.iter().for_each(|gone| self.mark_within_reach(&gone.corners, &mut near));
                    if !is_first {
                        self.mark_within_reach(&corners, &mut near);
                    }
                    asked.push(i);
                    asked_known.push(number);
                    Verdict::UNKNOWN
                }
            };
            result.push(Known { source, corners, verdict });
        }
        before.for_each(|gone| self.mark_within_reach(&gone.corners, &mut near));
        let target = Surface::new(&mesh.points, &mesh.triangles, self.decision.threads)?;
        let [own, _] = decide(&target, &self.surface, &self.decision, [&asked, &[]], progress)?;
        asked_known.into_iter().zip(own).for_each(|(number, verdict)| result[number].verdict = verdict);
        self.result = result;
        self.attained.resize(self.surface.len(), [0.0; 2]);
        self.failing.retain(|failing| !near[failing.triangle as usize]);
        // In the order of the tree, so that those looked at together are neighbours.
        let mut slots = 0..self.surface.len();
        loop {
            let near = slots.by_ref().map(|slot| self.surface.order[slot]).filter(|&t| near[t as usize]);
            let asked: Vec<u32> = near.take(AT_ONCE).collect();
            if asked.is_empty() {
                break;
            }
            let [_, verdicts] = decide(&target, &self.surface, &self.decision, [&[], &asked], progress)?;
            for (&t, verdict) in asked.iter().zip(verdicts) {
                // Never more than what is attained.
                let single = |x: f64| (x as f32).next_down().max(0.0);
                self.attained[t as usize] = [single(verdict.attained.shape), single(verdict.attained.color)];
                if !verdict.bound.within(self.bounds) {
                    self.failing.push(self.failing(t, &target, mesh));
                }
            }
        }
        self.failing.sort_unstable_by_key(|failing| failing.triangle);
        Ok([self.failing_of_result().count(), self.failing.len()])
    }

    fn failing(&self, triangle: u32, target: &Surface, mesh: &Whole<D, Bound>) -> Failing {
        let corners = self.original.triangles[triangle as usize].map(|v| self.original.points[v as usize]);
        let [low, high] = box_around(&corners, self.bounds.shape);
        let mut within_reach = vec![];
        target.triangles_meeting(&low, &high, |i| within_reach.push(mesh.triangle_source[i as usize]));
        Failing { triangle, within_reach }
    }

    /// Triangles of the mesh without a proof, by their number in `result`.
    fn failing_of_result(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.result.len()).filter(|&i| !self.result[i].verdict.bound.within(self.bounds))
    }

    /// Mark the triangles of the input that a triangle of the mesh may be nearest to a point of, within the bounds.
    fn mark_within_reach(&self, corners: &[[f64; D]; 3], near: &mut [bool]) {
        let reach = self.bounds.shape * (1.0 + 1e-9);
        let [low, high] = box_around(corners, reach);
        let places = corners.map(|c| position(&c));
        self.surface.triangles_meeting(&low, &high, |t| {
            let [a, b, c] =
                self.original.triangles[t as usize].map(|v| position(&self.original.points[v as usize]));
            let centre = [0, 1, 2].map(|i| (a[i] + b[i] + c[i]) / 3.0);
            let radius2 = [a, b, c].iter().map(|p| norm2(&sub(p, &centre))).fold(0.0, f64::max);
            let far = (1.0 + 1e-9) * (reach + radius2.sqrt());
            near[t as usize] |= triangle_distance2(&centre, places.each_ref()) <= far * far;
        });
    }

    /// Find out which of the triangles without a proof can have none: their bounds do not hold between the input
    /// and itself. Returns how many more there are now.
    pub fn look_for_hopeless(&mut self, progress: &mut Progress) -> Result<usize, KernelError> {
        let sources = self.failing_of_result().map(|i| self.result[i].source);
        let mut asked: Vec<u32> =
            sources.chain(self.failing.iter().map(|failing| failing.triangle)).collect();
        asked.sort_unstable();
        asked.dedup();
        asked.retain(|t| self.hopeless.binary_search(t).is_err());
        let [_, verdicts] = decide(&self.surface, &self.surface, &self.decision, [&[], &asked], progress)?;
        let before = self.hopeless.len();
        let found = asked.iter().zip(verdicts).filter(|(_, verdict)| !verdict.bound.within(self.bounds));
        self.give_up(found.map(|(&t, _)| t).collect());
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
        let of_input = self.failing.iter().filter(|failing| hope(&failing.triangle));
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
        let original: Vec<u32> = self.failing.iter().map(|failing| failing.triangle).collect();
        if own.is_empty() && original.is_empty() {
            return Ok(all);
        }
        let threads = self.decision.threads;
        let result = Surface::new(&mesh.points, &mesh.triangles, threads)?;
        let options = certify::Options { limit: None, threads, ..*options };
        let instead = certify::certify_some(&result, &self.surface, &options, [&own, &original], progress)?;
        // Without a bound on colours nothing is said of the others'.
        let said = |d: Deviation| if self.with_color() { d } else { Deviation { color: 0.0, ..d } };
        combine(&mut all, &instead, |a, b| a.max(said(b)));
        all.attained = all.attained.max(said(instead.attained));
        Ok(all)
    }

    fn with_color(&self) -> bool {
        !self.surface.colors.is_empty() && self.bounds.color < f64::INFINITY
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
            original: vec![bound; self.surface.len()],
            bound,
            attained: of_input.chain(of_result).fold(Deviation::default(), Deviation::max),
            slack: certify::slack(self.surface.bounds.into_iter(), self.decision.slack),
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
