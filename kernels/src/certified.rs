//! Simplification as far as a proof allows.
//!
//! ```text
//! limits of all samples ← a share of the bounds
//! repeat:
//!     simplify the input, every sample within its limits          tracked
//!     which triangles stay within the bounds, everywhere?         certify
//!     all: done
//!     tighten the limits of the samples around the others; at last, hold them where they are
//! ```
//!
//! What is held on all sides is the input itself, which is why this ends.

use crate::certify::{self, Certificate, Deviation, Surface};
use crate::engine::{Refusal, Stop};
use crate::error::KernelError;
use crate::mesh::Compact;
use crate::original::Original;
use crate::patch::Whole;
use crate::progress::Progress;
use crate::rounds::{Goal, collapse};
use crate::tracked::{Bound, Limits, TrackedRecords};

/// What samples may use of a bound, so that the points between them have some left.
const SHARE: f64 = 0.9;

/// What a limit is multiplied with where the proof failed.
const TIGHTER: f32 = 0.6;

/// Proofs that may fail before it is asked whether they can succeed at all.
const HOPE: usize = 6;

/// Proofs that may fail before nothing is simplified any more.
const PATIENCE: usize = 20;

#[derive(Clone, Debug)]
pub struct Options {
    /// Two-sided distance in metres and difference of colour in levels, infinite for none. What is less than
    /// [`least_bounds`] counts as that.
    pub bounds: Deviation,
    /// Length that counts as much as one level when a vertex is placed.
    pub weight: f64,
    /// By vertex: multiplies the error there, and divides what a sample may use of the bounds; empty for 1.
    pub importance: Vec<f64>,
    /// How the proof is made; its limit is not used.
    pub proof: certify::Options,
    /// Whether to bound each triangle as closely as `proof` says, and not only by the bounds that were asked for.
    pub close: bool,
    /// What samples may use of a bound, so that the points between them have some left.
    pub share: f64,
}

impl Options {
    pub fn new(bounds: Deviation) -> Self {
        Self {
            bounds,
            weight: 0.0,
            importance: vec![],
            proof: certify::Options::default(),
            close: true,
            share: SHARE,
        }
    }
}

/// One turn of the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pass {
    pub triangles: usize,
    /// Triangles of the result, and of the input, without a proof.
    pub unproven: [usize; 2],
    pub collapses: usize,
    pub attempts: u64,
}

#[derive(Clone, Debug)]
pub struct Certified<const D: usize> {
    pub mesh: Compact<D>,
    pub certificate: Certificate,
    /// Whether the bounds are proven. If not, the caller stopped the work, or they do not even hold between the input
    /// and itself: where sheets of different colours touch.
    pub proven: bool,
    pub stop: Stop,
    pub passes: Vec<Pass>,
    /// Why edges stand.
    pub held: Vec<Refusal<Bound>>,
}

/// The least bounds that can be proven for surfaces of this size: a proof spends the slack of single precision.
pub fn least_bounds(surface: &Surface, options: &certify::Options) -> Deviation {
    Deviation { shape: 2.0 * certify::slack([surface; 2], options.slack), color: 2.0 * certify::COLOR_SLACK }
}

/// Simplify as far as the bounds can be proven to hold for every point of both surfaces.
///
/// # Errors
/// As [`crate::connectivity::Connectivity::from_triangles`], and [`KernelError::Interrupted`].
pub fn simplify<const D: usize, const K: usize>(
    points: Vec<[f64; D]>,
    triangles: Vec<[u32; 3]>,
    fixed: Vec<bool>,
    options: &Options,
    goal: &Goal,
    progress: &mut Progress,
) -> Result<Certified<D>, KernelError> {
    let whole = Whole::<D, Bound>::new(points, triangles, fixed)?;
    let (proper, mut fixed) = (whole.triangle_source, whole.fixed);
    let original = Original::new(whole.points, whole.triangles);
    let surface = Surface::new(&original.points, &original.triangles)?;
    let least = least_bounds(&surface, &options.proof);
    let bounds = options.bounds.max(least);
    let importance = |v: usize| options.importance.get(v).map_or(1.0, |i| i.max(1.0) as f32);
    let mut limits = Limits {
        shape: options.share * (bounds.shape - 0.5 * least.shape),
        color: options.share * (bounds.color - 0.5 * least.color),
        factors: (0..original.points.len()).map(|v| 1.0 / importance(v)).collect(),
    };
    let decision = certify::Options { limit: Some(bounds), threads: goal.threads, ..options.proof };
    let proof = options.close.then_some(certify::Options { limit: None, ..decision });
    let mut passes = vec![];
    let mut hopeless = vec![];
    loop {
        let whole = Whole::new(original.points.clone(), original.triangles.clone(), fixed.clone())?;
        let records =
            TrackedRecords::<D, K>::new(&original, &limits, options.weight, options.importance.clone());
        let outcome = collapse(whole, records, goal, progress)?;
        let held = outcome.mesh.held_edges();
        let owned =
            Owned::new(outcome.records.starts, outcome.records.samples, &outcome.mesh.triangle_source);
        let mut mesh = outcome.mesh.into_compact();
        let result = Surface::new(&mesh.points, &mesh.triangles)?;
        let verdict = certify::certify(&result, &surface, &decision, progress)?;
        let unproven = [&verdict.own, &verdict.original].map(|all| beyond(all, bounds));
        passes.push(Pass {
            triangles: mesh.triangles.len(),
            unproven: unproven.each_ref().map(Vec::len),
            collapses: outcome.merges.len(),
            attempts: outcome.attempts,
        });
        let proven = unproven.iter().all(Vec::is_empty);
        if passes.len() == HOPE {
            hopeless = hopeless_triangles(&surface, &decision, progress)?;
        }
        let source = &mesh.triangle_source;
        let open = [
            unproven[0]
                .iter()
                .copied()
                .filter(|&t| !is_set(&hopeless, source[t as usize]))
                .collect::<Vec<_>>(),
            unproven[1].iter().copied().filter(|&t| !is_set(&hopeless, t)).collect(),
        ];
        let settled = open.iter().all(Vec::is_empty) && (proven || passes.len() > HOPE);
        if settled || outcome.stop == Stop::Enough || outcome.merges.is_empty() {
            let certificate = match proof {
                Some(proof) => {
                    closer(certify::certify(&result, &surface, &proof, progress)?, &verdict, bounds)
                }
                None => verdict,
            };
            mesh.triangle_source.iter_mut().for_each(|t| *t = proper[*t as usize]);
            return Ok(Certified { mesh, certificate, proven, stop: outcome.stop, passes, held });
        }
        let around = samples_around(&original, &mesh, &owned, &open);
        around.iter().for_each(|&v| limits.factors[v as usize] *= TIGHTER);
        if passes.len() == HOPE || passes.len() >= PATIENCE {
            fixed.resize(original.points.len(), false);
            let all = passes.len() >= PATIENCE;
            let held = (0..original.triangles.len()).filter(|&t| all || hopeless.get(t) == Some(&true));
            held.flat_map(|t| original.triangles[t]).for_each(|v| fixed[v as usize] = true);
        }
    }
}

/// Triangles of the input whose bounds cannot be proven against the input itself: no result can do better.
fn hopeless_triangles(
    surface: &Surface,
    decision: &certify::Options,
    progress: &mut Progress,
) -> Result<Vec<bool>, KernelError> {
    let verdict = certify::certify(surface, surface, decision, progress)?;
    let limit = decision.limit.unwrap_or_default();
    Ok(verdict.original.iter().map(|bound| !bound.within(limit)).collect())
}

fn is_set(flags: &[bool], i: u32) -> bool {
    flags.get(i as usize) == Some(&true)
}

/// Triangles that are not within the bounds.
fn beyond(all: &[Deviation], bounds: Deviation) -> Vec<u32> {
    (0..all.len() as u32).filter(|&t| !all[t as usize].within(bounds)).collect()
}

/// Two proofs at once: each bound is the lesser one. The decision `b` on `bounds` says nothing of colours without a
/// bound on them.
fn closer(mut a: Certificate, b: &Certificate, bounds: Deviation) -> Certificate {
    let said =
        |d: Deviation| if bounds.color < f64::INFINITY { d } else { Deviation { color: f64::INFINITY, ..d } };
    let both =
        |a: &mut [Deviation], b: &[Deviation]| a.iter_mut().zip(b).for_each(|(a, b)| *a = a.min(said(*b)));
    both(&mut a.result, &b.result);
    both(&mut a.own, &b.own);
    both(&mut a.original, &b.original);
    a.bound = a.bound.min(said(b.bound));
    a.attained = a.attained.max(b.attained);
    a
}

/// The samples of each triangle of the result.
struct Owned {
    starts: Vec<u32>,
    samples: Vec<u32>,
    /// Place of each triangle of the compact mesh in the whole one.
    order: Vec<u32>,
}

impl Owned {
    fn new(starts: Vec<u32>, samples: Vec<u32>, triangle_source: &[u32]) -> Self {
        let mut order: Vec<u32> = (0..triangle_source.len() as u32).collect();
        order.sort_unstable_by_key(|&t| triangle_source[t as usize]);
        Self { starts, samples, order }
    }

    fn of(&self, triangle: usize) -> &[u32] {
        let place = self.order[triangle] as usize;
        &self.samples[self.starts[place] as usize..self.starts[place + 1] as usize]
    }
}

/// Samples of the triangles of the result without a proof, or of those beside one that has none, and corners of those of
/// the input; each once.
fn samples_around<const D: usize>(
    original: &Original<D>,
    mesh: &Compact<D>,
    owned: &Owned,
    [of_result, of_input]: &[Vec<u32>; 2],
) -> Vec<u32> {
    let mut around: Vec<u32> = of_input.iter().flat_map(|&t| original.triangles[t as usize]).collect();
    let mut bare = vec![false; mesh.points.len()];
    for &t in of_result {
        let samples = owned.of(t as usize);
        around.extend_from_slice(samples);
        if samples.is_empty() {
            mesh.triangles[t as usize].iter().for_each(|&v| bare[v as usize] = true);
        }
    }
    for (t, corners) in mesh.triangles.iter().enumerate() {
        if corners.iter().any(|&v| bare[v as usize]) {
            around.extend_from_slice(owned.of(t));
        }
    }
    around.sort_unstable();
    around.dedup();
    around
}
