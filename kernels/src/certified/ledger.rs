//! What is proven of the current mesh and of the input, and what has to be looked at again after a change.

use super::history::History;
use crate::certify::{self, Certificate, Deviation, Surface, Verdict, decide};
use crate::error::KernelError;
use crate::geometry::{Vec3, position};
use crate::patch::Whole;
use crate::progress::Progress;
use crate::tracked::Bound;

/// A triangle of the mesh as it was looked at last.
struct Known {
    /// Triangle of the input.
    source: u32,
    /// Vertices of the input.
    corners: [u32; 3],
    places: [Vec3; 3],
    verdict: Verdict,
}

/// Until it is looked at.
const UNKNOWN: Verdict = Verdict {
    bound: Deviation { shape: f64::INFINITY, color: f64::INFINITY },
    attained: Deviation { shape: 0.0, color: 0.0 },
};

/// Triangles without a proof where there may be one.
pub struct Open {
    /// Places in the mesh.
    pub of_result: Vec<u32>,
    pub of_input: Vec<u32>,
}

impl Open {
    pub fn is_empty(&self) -> bool {
        self.of_result.is_empty() && self.of_input.is_empty()
    }
}

pub struct Ledger<'a> {
    surface: &'a Surface,
    /// With a limit.
    decision: certify::Options,
    bounds: Deviation,
    /// In the order of their sources; none before the first look.
    result: Vec<Known>,
    /// Places of those in the mesh.
    places: Vec<u32>,
    /// The greatest deviation seen in each triangle of the input.
    attained: Vec<[f32; 2]>,
    /// Triangles of the input without a proof.
    failing: Vec<u32>,
    /// Triangles of the input that not even the input is within the bounds of, in order.
    pub hopeless: Vec<u32>,
}

impl<'a> Ledger<'a> {
    pub fn new(surface: &'a Surface, decision: certify::Options) -> Self {
        let bounds = decision.limit.unwrap_or_default();
        Self {
            surface,
            decision,
            bounds,
            result: vec![],
            places: vec![],
            attained: vec![],
            failing: vec![],
            hopeless: vec![],
        }
    }

    /// Look at what has changed since the last time. Returns how many triangles of the mesh and of the input have no
    /// proof now.
    ///
    /// What is proven of a triangle of the mesh stays as long as it does. What is proven of one of the input says
    /// that nothing counts but what is within the bound on shape of it, and stays as long as all of that does.
    pub fn look<const D: usize>(
        &mut self,
        mesh: &Whole<D, Bound>,
        history: &History<'_, D>,
        progress: &mut Progress,
    ) -> Result<[usize; 2], KernelError> {
        let is_first = self.attained.is_empty();
        let mut near = vec![is_first; self.surface.len()];
        for known in self.result.iter().filter(|known| history.has_changed(&known.corners)) {
            self.mark_within_reach(&known.places, &mut near);
        }
        let mut places: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
        places.sort_unstable_by_key(|&i| mesh.triangle_source[i as usize]);
        let mut before = std::mem::take(&mut self.result).into_iter().peekable();
        let mut result = Vec::with_capacity(places.len());
        let (mut asked, mut asked_known) = (vec![], vec![]);
        for (number, &i) in places.iter().enumerate() {
            let source = mesh.triangle_source[i as usize];
            let vertices = mesh.triangles[i as usize];
            let corners = vertices.map(|v| mesh.vertex_source[v as usize]);
            let changed = is_first || history.has_changed(&corners);
            while before.peek().is_some_and(|known| known.source < source) {
                before.next();
            }
            let known = before.next_if(|known| known.source == source && !changed);
            match known {
                Some(known) if known.verdict.bound.within(self.bounds) => result.push(known),
                _ => {
                    let places = vertices.map(|v| position(&mesh.points[v as usize]));
                    if !is_first {
                        self.mark_within_reach(&places, &mut near);
                    }
                    asked.push(i);
                    asked_known.push(number);
                    result.push(Known { source, corners, places, verdict: UNKNOWN });
                }
            }
        }
        self.failing.iter().for_each(|&t| near[t as usize] = true);
        let asked_input: Vec<u32> = (0..near.len() as u32).filter(|&t| near[t as usize]).collect();

        let target = Surface::new(&mesh.points, &mesh.triangles)?;
        let [own, of_input] =
            decide(&target, self.surface, &self.decision, [&asked, &asked_input], progress)?;
        asked_known.into_iter().zip(own).for_each(|(number, verdict)| result[number].verdict = verdict);
        (self.result, self.places) = (result, places);
        self.attained.resize(self.surface.len(), [0.0; 2]);
        self.failing.clear();
        for (t, verdict) in asked_input.into_iter().zip(of_input) {
            // Never more than what is attained.
            let single = |x: f64| (x as f32).next_down().max(0.0);
            self.attained[t as usize] = [single(verdict.attained.shape), single(verdict.attained.color)];
            if !verdict.bound.within(self.bounds) {
                self.failing.push(t);
            }
        }
        Ok([self.failing_of_result().count(), self.failing.len()])
    }

    /// Triangles of the mesh without a proof, by their number in `result`.
    fn failing_of_result(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.result.len()).filter(|&i| !self.result[i].verdict.bound.within(self.bounds))
    }

    /// Triangles of the input that a triangle at `places` may be nearest to a point of, within the bounds.
    fn mark_within_reach(&self, places: &[Vec3; 3], near: &mut [bool]) {
        let margin = self.bounds.shape * (1.0 + 1e-9);
        let [a, b, c] = places;
        let low = [0, 1, 2].map(|i| a[i].min(b[i]).min(c[i]) - margin);
        let high = [0, 1, 2].map(|i| a[i].max(b[i]).max(c[i]) + margin);
        self.surface.triangles_meeting(&low, &high, |t| near[t as usize] = true);
    }

    /// Find out which of the triangles without a proof can have none: their bounds do not hold between the input
    /// and itself. Returns how many more there are now.
    pub fn look_for_hopeless(&mut self, progress: &mut Progress) -> Result<usize, KernelError> {
        let sources = self.failing_of_result().map(|i| self.result[i].source);
        let mut asked: Vec<u32> = sources.chain(self.failing.iter().copied()).collect();
        asked.sort_unstable();
        asked.dedup();
        asked.retain(|t| self.hopeless.binary_search(t).is_err());
        let [_, verdicts] = decide(self.surface, self.surface, &self.decision, [&[], &asked], progress)?;
        let before = self.hopeless.len();
        let found = asked.iter().zip(verdicts).filter(|(_, verdict)| !verdict.bound.within(self.bounds));
        self.hopeless.extend(found.map(|(&t, _)| t));
        self.hopeless.sort_unstable();
        Ok(self.hopeless.len() - before)
    }

    /// Triangles without a proof that are not hopeless.
    pub fn open(&self) -> Open {
        let hope = |t: u32| self.hopeless.binary_search(&t).is_err();
        Open {
            of_result: self
                .failing_of_result()
                .filter(|&i| hope(self.result[i].source))
                .map(|i| self.places[i])
                .collect(),
            of_input: self.failing.iter().copied().filter(|&t| hope(t)).collect(),
        }
    }

    /// The proof of all bounds, where none was looked at more closely. The mesh has `triangles`.
    pub fn certificate(&self, triangles: usize) -> Certificate {
        let with_color = !self.surface.colors.is_empty() && self.bounds.color < f64::INFINITY;
        let bound = Deviation { color: if with_color { self.bounds.color } else { 0.0 }, ..self.bounds };
        let of_input = self.attained.iter().map(|a| Deviation { shape: a[0].into(), color: a[1].into() });
        let of_result = self.result.iter().map(|known| known.verdict.attained);
        Certificate {
            result: vec![bound; triangles],
            own: vec![bound; triangles],
            original: vec![bound; self.surface.len()],
            bound,
            attained: of_input.chain(of_result).fold(Deviation::default(), Deviation::max),
            slack: certify::slack([self.surface; 2], self.decision.slack),
            color_slack: certify::COLOR_SLACK,
            pieces: 0,
        }
    }

    /// This proof and another of the same meshes: each bound is the lesser one. This one says nothing of colours without
    /// a bound on them.
    pub fn closer(&self, mut other: Certificate) -> Certificate {
        let this = self.certificate(other.result.len());
        let with_color = self.bounds.color < f64::INFINITY;
        let said = |d: Deviation| if with_color { d } else { Deviation { color: f64::INFINITY, ..d } };
        let both = |a: &mut [Deviation], b: &[Deviation]| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a = a.min(said(*b)));
        };
        both(&mut other.result, &this.result);
        both(&mut other.own, &this.own);
        both(&mut other.original, &this.original);
        other.bound = other.bound.min(said(this.bound));
        other.attained = other.attained.max(this.attained);
        other
    }
}
