//! Method `seams` with a bound on shape, for textured surfaces.
//!
//! Every collapse must keep the samples of the input within their limits. Points between samples are not
//! checked here, as in [`super::bounded_qem`]. The caller certifies the result, tightens the limits where that
//! fails, and calls again.

use super::input_surface::InputSurface;
use super::sample_tracker::{
    DEFAULT_MIN_NEEDLE_RATIO, LimitKind, RegionSamples, SAMPLES_PER_TRIANGLE_COST, SampleLimits, SampleLists,
    SampleTracker,
};
use super::simplify::min_provable_bounds;
use crate::base::errors::KernelError;
use crate::base::ids::EdgeId;
use crate::base::progress::Progress;
use crate::certify;
use crate::collapse::engine::{CollapseChange, Measure, PriorityScope, Proposal};
use crate::collapse::method_state::MethodState;
use crate::collapse::rounds::{self, collapse};
use crate::mesh::edge_star::EdgeStar;
use crate::mesh::triangle_mesh::Mesh;
use crate::seams::region_state::{RefusalReason, SeamMeasure};
use crate::seams::surface_state::{SeamRegion, SurfaceState};
use crate::seams::{CostParameters, SeamGoal, SeamSurface, SimplifiedSurface, simplify_with};

/// Distance limits of the samples.
#[derive(Clone, Debug)]
pub struct SampleBound {
    /// Bound on shape in metres. Values below the smallest provable bound are raised to it.
    pub shape: f64,
    /// Ratio of the bound that samples may use. The rest is a margin for the points between samples.
    pub sample_ratio: f64,
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
    surface: &SeamSurface<K>,
    knobs: CostParameters,
    within: &SampleBound,
    goal: SeamGoal,
    progress: &mut Progress,
) -> Result<(SimplifiedSurface<K>, f64), KernelError> {
    let mut provable = within.shape;
    let outcome =
        simplify_with::<D, K>(surface, knobs, goal, progress, |whole, seams, sources, progress| {
            let original = InputSurface::new(whole.points.clone(), whole.triangles.clone());
            let least = min_provable_bounds(&original, &certify::Options::default());
            provable = within.shape.max(least.shape);
            let limits = SampleLimits {
                shape: within.sample_ratio * (provable - 0.5 * least.shape),
                color: f64::INFINITY,
                factors: sources.iter().map(|&v| within.factors[v as usize]).collect(),
                min_needle_ratio: DEFAULT_MIN_NEEDLE_RATIO,
            };
            let lists = SampleLists::of_input(&original);
            let records = BoundedSeamState { seams, original: &original, limits: &limits, lists };
            let done = collapse(whole, records, &goal.rounds, progress)?;
            let rounds::Outcome { mesh, records, stop, collapses, logs, attempts } = done;
            Ok(rounds::Outcome { mesh, records: records.seams, stop, collapses, logs, attempts })
        })?;
    Ok((outcome, provable))
}

/// Measure of a region: the method `seams` plus sample limits.
pub struct BoundedSeams<'a, 'b, const D: usize, const K: usize> {
    seams: SeamMeasure<'a, D, K>,
    tracker: SampleTracker<'b, 3>,
}

impl<const D: usize, const K: usize> Measure<3> for BoundedSeams<'_, '_, D, K> {
    type Reason = RefusalReason;
    type Change = ();

    const PRIORITY_SCOPE: PriorityScope = <SeamMeasure<'_, D, K> as Measure<3>>::PRIORITY_SCOPE;

    fn priority(&self, mesh: &Mesh<3>, edge: EdgeId) -> Result<f64, RefusalReason> {
        self.seams.priority(mesh, edge)
    }

    fn propose(&mut self, mesh: &Mesh<3>, star: &EdgeStar<3>) -> Result<Proposal<3, ()>, RefusalReason> {
        let Self { seams, tracker } = self;
        tracker.gather_samples(star);
        seams.propose_if_allowed(mesh, star, |place| tracker.check(star, place).map_err(rule_of_bound))
    }

    fn judge(&mut self, _: &Mesh<3>, _: &EdgeStar<3>, _: &mut Proposal<3, ()>) -> Result<(), RefusalReason> {
        Ok(())
    }

    fn cost(&self, proposal: &Proposal<3, ()>) -> f64 {
        self.seams.cost(proposal)
    }

    fn commit(&mut self, mesh: &Mesh<3>, star: &EdgeStar<3>, collapsed: &CollapseChange, (): ()) {
        self.seams.commit(mesh, star, collapsed, ());
        self.tracker.commit(star);
    }
}

fn rule_of_bound(bound: LimitKind) -> RefusalReason {
    match bound {
        LimitKind::Needle => RefusalReason::Needle,
        LimitKind::Shape | LimitKind::Color => RefusalReason::Shape,
    }
}

/// Seam records plus the samples of each triangle.
struct BoundedSeamState<'a, 'b, const D: usize, const K: usize> {
    seams: SurfaceState<'a, D, K>,
    original: &'b InputSurface<3>,
    limits: &'b SampleLimits,
    lists: SampleLists,
}

impl<'a, 'b, const D: usize, const K: usize> MethodState<3> for BoundedSeamState<'a, 'b, D, K> {
    type Measure = BoundedSeams<'a, 'b, D, K>;
    type RegionState = (SeamRegion<K>, RegionSamples);

    fn workload(&self, triangles: usize) -> usize {
        triangles + self.lists.samples.len() / SAMPLES_PER_TRIANGLE_COST
    }

    fn share_linked_vertices(&self, owner: &mut [u32]) {
        self.seams.share_linked_vertices(owner);
    }

    fn load_region(&self, region: &Mesh<3>) -> BoundedSeams<'a, 'b, D, K> {
        BoundedSeams {
            seams: self.seams.load_region(region),
            tracker: SampleTracker::load(self.original, self.limits, &self.lists, region),
        }
    }

    fn unload_region(
        measure: BoundedSeams<'a, 'b, D, K>,
        region: &Mesh<3>,
    ) -> (SeamRegion<K>, RegionSamples) {
        let sampled = measure.tracker.unload(region);
        (<SurfaceState<'a, D, K> as MethodState<3>>::unload_region(measure.seams, region), sampled)
    }

    fn join_regions(self, rim: &[u32], pieces: Vec<(SeamRegion<K>, RegionSamples)>) -> Self {
        let (seams, sampled) = pieces.into_iter().unzip();
        Self { seams: self.seams.join_regions(rim, seams), lists: self.lists.join(sampled), ..self }
    }
}
