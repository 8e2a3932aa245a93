//! Selection of the best base and of the coarsest harmless quantisation.
//!
//! Distance and folds of the levels are only known after refinement, so a few bases are tried. Each is
//! weighted by the errors of the previous one. The best base is then repaired where triangles flip, and gets
//! additional input vertices where that fails. Without a given tolerance, it is finally refined again with
//! the coarsest steps that do no harm.

use super::base_mesh::Base;
use super::coarsening::CoarseMesh;
use super::coder_order::{OrderedBase, order_base};
use super::distance::Distance;
use super::fold::Fold;
use super::header::{MAX_LEVELS, choose_level_count, coarsen_steps};
use super::importance::{raise_at_folds, weight_by_error};
use super::input::Input;
use super::locking::Locking;
use super::noise::estimate_noise;
use super::normal_mesh::NormalMesh;
use super::refinement::{RefinementResult, SearchEffort, refine};
use super::settings::Settings;
use super::tolerance::{Tolerance, ToleranceSource, choose_doublings};
use crate::base::errors::KernelError;
use crate::base::geometry::{bounding_box, diagonal};
use crate::base::progress::Progress;
use crate::subdivision::snm_contents::Header;

/// Number of trial bases. The base with the best finest level wins.
const TRIAL_COUNT: u64 = 4;
/// Maximum number of further bases while triangles flip. With more than `FEW_FOLDS` folds, each base must reduce
/// their number to `MAX_REMAINING_RATIO` times the previous one, because some surfaces are crumpled everywhere.
const MAX_REPAIRS: u64 = 6;
const FEW_FOLDS: usize = 10;
const MAX_REMAINING_RATIO: f64 = 0.7;
/// Maximum number of rebuilds with locked vertices for folds that remain.
const MAX_LOCKINGS: u64 = 8;
/// Further rebuilds with locked vertices per quantisation attempt, if few triangles flip.
const MAX_RELOCKINGS: usize = 1;
/// Quantisation attempts if no tolerance is given, and the doublings taken back after each failed attempt.
const QUANTIZATION_ATTEMPTS: u64 = 4;
/// Quantisation attempts for a base with locked vertices, which has smaller triangles.
const LOCKED_QUANTIZATION_ATTEMPTS: u64 = 7;
const DOUBLINGS_PER_RETRY: u32 = 2;
/// Maximum number of refinement passes, for progress.
const MAX_PASSES: u64 = TRIAL_COUNT + MAX_REPAIRS + MAX_LOCKINGS + LOCKED_QUANTIZATION_ATTEMPTS;
/// Maximum factor by which quantisation may raise the RMS distance. About 1.05 is expected for a tolerance of
/// 1/3.
const MAX_DISTANCE_GROWTH: f64 = 1.15;
/// Quantisation may add one fold per this many existing folds.
const FOLDS_PER_NEW_FOLD: usize = 10;
/// Number of folds that counts like a doubled distance.
const FOLDS_PER_DOUBLED_DISTANCE: f64 = 10.0;
/// Factor on the distance when no levels follow, because rounding uses only a small part of the tolerance.
const BASE_ONLY_DISTANCE_FACTOR: f64 = 9.0;

/// Rank of a trial, smaller is better: has folds, number of levels, and mean squared distance penalised by
/// folds.
type Rank = (bool, usize, f64);

/// Result of refining one base.
pub struct Trial {
    pub base: OrderedBase,
    pub normal_mesh: NormalMesh,
    distance: Distance,
    /// Folds of all levels, with their base triangles.
    folds: Vec<Fold>,
    /// Vertex importance from which the base was built.
    importance: Vec<f64>,
    /// True if vertex positions were searched thoroughly.
    thorough: bool,
    /// Locked vertices of the base, if any.
    locking: Option<Locking>,
}

impl Trial {
    fn new(base: OrderedBase, refined: RefinementResult, importance: Vec<f64>, care: SearchEffort) -> Self {
        let RefinementResult { normal_mesh: made, distance, folds } = refined;
        Self { base, normal_mesh: made, distance, folds, importance, thorough: care.thorough, locking: None }
    }

    fn rank(&self) -> Rank {
        let unsound = self.normal_mesh.fold_count();
        let dearer = 1.0 + unsound as f64 / FOLDS_PER_DOUBLED_DISTANCE;
        (unsound > 0, self.normal_mesh.levels.len(), dearer * dearer * self.distance.mean_square)
    }

    /// Compute the vertex importance for the next base.
    fn compute_next_importance(&self, input: &Input<'_>) -> Vec<f64> {
        let mut importance = self.importance.clone();
        weight_by_error(
            &mut importance,
            &input.points,
            input.triangles,
            &self.base.base,
            &self.distance.input_distances2,
        );
        raise_at_folds(&mut importance, &self.base.base, self.folds.iter().map(|fold| fold.triangle));
        importance
    }

    fn is_better_than(&self, other: &Self) -> bool {
        self.rank() < other.rank()
    }
}

/// Shared input of all trials.
struct Trials<'a> {
    input: &'a Input<'a>,
    coarse: &'a CoarseMesh<'a>,
    settings: &'a Settings,
}

/// Find the best base and refine it, with the steps of `header` or coarser ones.
///
/// # Errors
/// [`KernelError::Interrupted`], [`KernelError::OutOfMemory`].
pub fn find_best_base(
    input: &Input<'_>,
    coarse: &CoarseMesh<'_>,
    mut header: Header,
    settings: &Settings,
    progress: &Progress,
) -> Result<Trial, KernelError> {
    let trials = Trials { input, coarse, settings };
    let best = trials.run_trials(&mut header, progress)?.ok_or(KernelError::Interrupted)?;
    let best = trials.repair_folds(best, &header, progress)?;
    let best = trials.lock_folds(best, &header, progress)?;
    trials.coarsen_quantization(best, progress)
}

impl Trials<'_> {
    /// Start the progress of one pass, which counts its levels including the base.
    fn start_pass<'p>(&self, number: u64, progress: &Progress<'p>) -> Result<Progress<'p>, KernelError> {
        let each = u64::from(self.settings.levels.unwrap_or(MAX_LEVELS)) + 1;
        let mut part = progress.for_part(number * each, MAX_PASSES * each);
        part.report(0, each)?;
        Ok(part)
    }

    fn build_base(&self, importance: &[f64], progress: &mut Progress) -> Result<Base, KernelError> {
        self.coarse.clone().build_base(importance, &self.input.slots, progress)
    }

    fn order_base(&self, base: Base, header: &Header) -> Result<OrderedBase, KernelError> {
        order_base(base, self.input, header, self.settings)
    }

    fn refine_base(
        &self,
        base: &OrderedBase,
        header: Header,
        care: SearchEffort,
        progress: &mut Progress,
    ) -> Result<Option<RefinementResult>, KernelError> {
        refine(self.input, base, header, self.settings, care, progress)
    }

    /// Check whether a trial cannot be improved.
    fn is_final(&self, trial: &Trial) -> bool {
        let is_whole = trial.base.base.triangles.len() == self.input.triangles.len();
        trial.distance.mean_square == 0.0 || self.settings.is_base_only() && is_whole
    }

    /// Try bases, each weighted by the errors of the previous one. If unspecified, the first one determines
    /// the number of levels.
    fn run_trials(&self, header: &mut Header, progress: &Progress) -> Result<Option<Trial>, KernelError> {
        let care = SearchEffort { thorough: false, max_folds: usize::MAX };
        let mut importance = vec![1.0; self.input.points.len()];
        let mut best: Option<Trial> = None;
        for number in 0..TRIAL_COUNT {
            let progress = &mut self.start_pass(number, progress)?;
            let base = self.build_base(&importance, progress)?;
            if self.settings.levels.is_none() && self.settings.max_error <= 0.0 && number == 0 {
                header.levels = choose_level_count(base.triangles.len(), self.input.triangles.len());
            }
            let base = self.order_base(base, header)?;
            let Some(refined) = self.refine_base(&base, *header, care, progress)? else { break };
            let trial = Trial::new(base, refined, importance, care);
            importance = trial.compute_next_importance(self.input);
            let is_final = self.is_final(&trial);
            if best.as_ref().is_none_or(|best| trial.is_better_than(best)) {
                best = Some(trial);
            }
            if is_final {
                break;
            }
        }
        Ok(best)
    }

    /// Rebuild the best base with more weight on folds, as long as folds remain and each rebuild helps.
    fn repair_folds(
        &self,
        mut best: Trial,
        header: &Header,
        progress: &Progress,
    ) -> Result<Trial, KernelError> {
        let care = SearchEffort { thorough: true, max_folds: usize::MAX };
        let mut before = usize::MAX;
        for number in TRIAL_COUNT..TRIAL_COUNT + MAX_REPAIRS {
            let now = best.normal_mesh.fold_count();
            if now == 0
                || now > FEW_FOLDS && now as f64 > MAX_REMAINING_RATIO * before as f64
                || self.is_final(&best)
            {
                break;
            }
            before = now;
            let progress = &mut self.start_pass(number, progress)?;
            raise_at_folds(
                &mut best.importance,
                &best.base.base,
                best.folds.iter().map(|fold| fold.triangle),
            );
            let base = self.order_base(self.build_base(&best.importance, progress)?, header)?;
            if best.thorough && best.base.contents == base.contents {
                break;
            }
            let Some(refined) = self.refine_base(&base, *header, care, progress)? else { break };
            let trial = Trial::new(base, refined, best.importance.clone(), care);
            if trial.is_better_than(&best) {
                best = trial;
            }
        }
        Ok(best)
    }

    /// Rebuild the best base with locked vertices at folds, until no folds remain.
    fn lock_folds(
        &self,
        mut best: Trial,
        header: &Header,
        progress: &Progress,
    ) -> Result<Trial, KernelError> {
        if best.normal_mesh.fold_count() == 0 || self.is_final(&best) {
            return Ok(best);
        }
        let care = SearchEffort { thorough: true, max_folds: usize::MAX };
        let mut locking = Locking::new(&best.base.base, self.input);
        let (mut base, mut folds) = (best.base.base.clone(), best.folds.clone());
        for number in 0..MAX_LOCKINGS {
            let progress = &mut self.start_pass(TRIAL_COUNT + MAX_REPAIRS + number, progress)?;
            locking.lock_around_folds(&folds, &base, self.input);
            let again =
                self.order_base(locking.rebuild_base(self.input, self.settings.target, progress)?, header)?;
            base = again.base.clone();
            let Some(refined) = self.refine_base(&again, *header, care, progress)? else { break };
            folds.clone_from(&refined.folds);
            let trial = Trial::new(again, refined, best.importance.clone(), care);
            if trial.is_better_than(&best) {
                best = Trial { locking: Some(locking.clone()), ..trial };
            }
            if folds.is_empty() {
                break;
            }
        }
        Ok(best)
    }

    /// Repeat the refinement with the coarsest harmless quantisation, unless a tolerance is given.
    fn coarsen_quantization(&self, best: Trial, progress: &Progress) -> Result<Trial, KernelError> {
        if self.settings.tolerance.is_some() {
            return Ok(best);
        }
        let (header, unsound) = (best.normal_mesh.header, best.normal_mesh.fold_count());
        let distance2 = best.distance.mean_square + self.input.sample_distance2;
        let (mut doublings, source) = self.choose_doublings(distance2.sqrt());
        // Without levels, rounding itself limits the rotation of triangles.
        let is_alone = self.settings.is_base_only();
        let most_unsound = if is_alone { usize::MAX } else { unsound + unsound / FOLDS_PER_NEW_FOLD };
        let attempts =
            if best.locking.is_some() { LOCKED_QUANTIZATION_ATTEMPTS } else { QUANTIZATION_ATTEMPTS };
        for attempt in 0..attempts {
            if doublings == 0 {
                break;
            }
            let progress =
                &mut self.start_pass(TRIAL_COUNT + MAX_REPAIRS + MAX_LOCKINGS + attempt, progress)?;
            let header = coarsen_steps(&header, doublings);
            if let Some(mut trial) = self.try_quantization(&best, header, most_unsound, progress)? {
                if let Some(origin) = &mut trial.normal_mesh.encoder_info {
                    origin.tolerance = Tolerance::from_doublings(doublings, source);
                }
                return Ok(trial);
            }
            doublings = doublings.saturating_sub(DOUBLINGS_PER_RETRY);
        }
        Ok(best)
    }

    /// Refine the best base with coarser steps. None if that does harm. A base with locked vertices may get
    /// further locks.
    fn try_quantization(
        &self,
        best: &Trial,
        header: Header,
        most_unsound: usize,
        progress: &mut Progress,
    ) -> Result<Option<Trial>, KernelError> {
        let few = if best.locking.is_some() { FEW_FOLDS } else { 0 };
        let care = SearchEffort { thorough: best.thorough, max_folds: most_unsound.max(few) };
        let apart2 = self.input.sample_distance2;
        let distance2 = best.distance.mean_square + apart2;
        let near2 = MAX_DISTANCE_GROWTH * MAX_DISTANCE_GROWTH * distance2.max(f64::from(header.step).powi(2));
        let mut locking = best.locking.clone();
        let mut base = self.order_base(best.base.base.clone(), &header)?;
        for _ in 0..=MAX_RELOCKINGS {
            let refined = self.refine_base(&base, header, care, progress)?;
            let is_good = |now: &RefinementResult| {
                now.distance.mean_square + apart2 <= near2
                    && self.meets_max_error(&now.normal_mesh) >= self.meets_max_error(&best.normal_mesh)
            };
            let Some(refined) = refined.filter(is_good) else { break };
            if refined.normal_mesh.fold_count() <= most_unsound {
                return Ok(Some(Trial::new(base, refined, best.importance.clone(), care)));
            }
            let Some(locking) = &mut locking else { break };
            locking.lock_around_folds(&refined.folds, &base.base, self.input);
            base =
                self.order_base(locking.rebuild_base(self.input, self.settings.target, progress)?, &header)?;
        }
        Ok(None)
    }

    /// Derive the number of tolerance doublings and its reason from the distance of the levels, in mesh
    /// units.
    fn choose_doublings(&self, distance: f64) -> (u32, ToleranceSource) {
        let Input { points, triangles, surface, .. } = self.input;
        let size = diagonal(&bounding_box(triangles.iter().flatten().map(|&v| points[v as usize])));
        let noise = estimate_noise(points, triangles, surface.normals());
        let told = if self.settings.is_base_only() { BASE_ONLY_DISTANCE_FACTOR } else { 1.0 };
        choose_doublings(told * distance / size, noise / size, self.settings.max_error / size)
    }

    /// Check whether the finest level meets the maximum error.
    fn meets_max_error(&self, made: &NormalMesh) -> bool {
        let reached = made.encoder_info.as_ref().and_then(|origin| origin.max_distances.last());
        reached.is_none_or(|reached| *reached <= self.settings.max_error)
    }
}
