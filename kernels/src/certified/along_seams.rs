//! Method `seams` with a bound on shape, for textured surfaces.
//!
//! Every collapse must keep the samples of the input within their limits. Points between samples are not
//! checked here, as in [`super::tracked`]. The caller certifies the result, tightens the limits where that
//! fails, and calls again.

use super::original::Original;
use super::simplify::least_bounds;
use super::tracker::{Bound, LEAST_HEIGHT, Limits, Lists, SAMPLES, Sampled, Tracker};
use crate::base::errors::KernelError;
use crate::base::ids::EdgeId;
use crate::base::progress::Progress;
use crate::certify;
use crate::collapse::engine::{Collapsed, Measure, Proposal, Reach};
use crate::collapse::records::Records;
use crate::collapse::rounds::{self, collapse};
use crate::mesh::star::Star;
use crate::mesh::triangle_mesh::Mesh;
use crate::seams::records::{Remains, SeamRecords};
use crate::seams::state::{Rule, Seams};
use crate::seams::{Goal, Knobs, Outcome, Surface, simplify_by};

/// Distance limits of the samples.
#[derive(Clone, Debug)]
pub struct Within {
    /// Bound on shape in metres. Values below the smallest provable bound are raised to it.
    pub shape: f64,
    /// Ratio of the bound that samples may use. The rest is a margin for the points between samples.
    pub share: f64,
    /// Factor on the limit, by vertex of the input.
    pub factors: Vec<f32>,
}

/// Simplify along seams up to `goal`, with every sample within its limit.
///
/// Also returns the bound that can be proven: `within.shape`, or the smallest provable bound if that is
/// larger.
///
/// # Errors
/// As [`crate::seams::simplify`].
pub fn simplify<const D: usize, const K: usize>(
    surface: &Surface<K>,
    knobs: Knobs,
    within: &Within,
    goal: Goal,
    progress: &mut Progress,
) -> Result<(Outcome<K>, f64), KernelError> {
    let mut provable = within.shape;
    let outcome = simplify_by::<D, K>(surface, knobs, goal, progress, |whole, seams, sources, progress| {
        let original = Original::new(whole.points.clone(), whole.triangles.clone());
        let least = least_bounds(&original, &certify::Options::default());
        provable = within.shape.max(least.shape);
        let limits = Limits {
            shape: within.share * (provable - 0.5 * least.shape),
            color: f64::INFINITY,
            factors: sources.iter().map(|&v| within.factors[v as usize]).collect(),
            needle: LEAST_HEIGHT,
        };
        let lists = Lists::of_input(&original);
        let records = BoundedRecords { seams, original: &original, limits: &limits, lists };
        let done = collapse(whole, records, &goal.rounds, progress)?;
        let rounds::Outcome { mesh, records, stop, collapses, logs, attempts } = done;
        Ok(rounds::Outcome { mesh, records: records.seams, stop, collapses, logs, attempts })
    })?;
    Ok((outcome, provable))
}

/// Measure of a region: the method `seams` plus sample limits.
pub struct Bounded<'a, 'b, const D: usize, const K: usize> {
    seams: Seams<'a, D, K>,
    tracker: Tracker<'b, 3>,
}

impl<const D: usize, const K: usize> Measure<3> for Bounded<'_, '_, D, K> {
    type Bound = Rule;
    type Change = ();

    const REACH: Reach = <Seams<'_, D, K> as Measure<3>>::REACH;

    fn priority(&self, mesh: &Mesh<3>, edge: EdgeId) -> Result<f64, Rule> {
        self.seams.priority(mesh, edge)
    }

    fn propose(&mut self, mesh: &Mesh<3>, star: &Star<3>) -> Result<Proposal<3, ()>, Rule> {
        let Self { seams, tracker } = self;
        tracker.gather(star);
        seams.propose_among(mesh, star, |place| tracker.allows(star, place).map_err(rule))
    }

    fn judge(&mut self, _: &Mesh<3>, _: &Star<3>, _: &mut Proposal<3, ()>) -> Result<(), Rule> {
        Ok(())
    }

    fn cost(&self, proposal: &Proposal<3, ()>) -> f64 {
        self.seams.cost(proposal)
    }

    fn commit(&mut self, mesh: &Mesh<3>, star: &Star<3>, collapsed: &Collapsed, (): ()) {
        self.seams.commit(mesh, star, collapsed, ());
        self.tracker.commit(star);
    }
}

fn rule(bound: Bound) -> Rule {
    match bound {
        Bound::Needle => Rule::Needle,
        Bound::Shape | Bound::Color => Rule::Shape,
    }
}

/// Seam records plus the samples of each triangle.
struct BoundedRecords<'a, 'b, const D: usize, const K: usize> {
    seams: SeamRecords<'a, D, K>,
    original: &'b Original<3>,
    limits: &'b Limits,
    lists: Lists,
}

impl<'a, 'b, const D: usize, const K: usize> Records<3> for BoundedRecords<'a, 'b, D, K> {
    type Measure = Bounded<'a, 'b, D, K>;
    type Remains = (Remains<K>, Sampled);

    fn size(&self, triangles: usize) -> usize {
        triangles + self.lists.samples.len() / SAMPLES
    }

    fn keep_together(&self, owner: &mut [u32]) {
        self.seams.keep_together(owner);
    }

    fn load(&self, region: &Mesh<3>) -> Bounded<'a, 'b, D, K> {
        Bounded {
            seams: self.seams.load(region),
            tracker: Tracker::load(self.original, self.limits, &self.lists, region),
        }
    }

    fn unload(measure: Bounded<'a, 'b, D, K>, region: &Mesh<3>) -> (Remains<K>, Sampled) {
        let sampled = measure.tracker.unload(region);
        (<SeamRecords<'a, D, K> as Records<3>>::unload(measure.seams, region), sampled)
    }

    fn join(self, rim: &[u32], pieces: Vec<(Remains<K>, Sampled)>) -> Self {
        let (seams, sampled) = pieces.into_iter().unzip();
        Self { seams: self.seams.join(rim, seams), lists: self.lists.join(sampled), ..self }
    }
}
