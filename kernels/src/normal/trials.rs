//! Selection of the best base and of the coarsest harmless quantisation.
//!
//! Distance and folds of the levels are only known after refinement, so a few bases are tried. Each is
//! weighted by the errors of the previous one. The best base is then repaired where triangles flip, and gets
//! additional input vertices where that fails. Without a given tolerance, it is finally refined again with
//! the coarsest steps that do no harm.

use super::base_mesh::Base;
use super::coarsening::Coarse;
use super::distance::Distance;
use super::fold::Fold;
use super::header::{MOST_LEVELS, coarser, levels_for};
use super::importance::{insist, weigh};
use super::input::Input;
use super::locking::Locking;
use super::noise::noise;
use super::normal_mesh::NormalMesh;
use super::ordered::{Ordered, in_order};
use super::refining::{Care, Refined, refine};
use super::settings::Settings;
use super::tolerance::{Source, Tolerance, doublings};
use crate::base::errors::KernelError;
use crate::base::geometry::{around, diagonal};
use crate::base::progress::Progress;
use crate::subdivision::contents::Header;

/// Number of trial bases. The base with the best finest level wins.
const TRIALS: u64 = 4;
/// Maximum number of further bases while triangles flip. With more than `FEW` folds, each base must reduce
/// their number to `HELPED` times the previous one, because some surfaces are crumpled everywhere.
const MENDS: u64 = 6;
const FEW: usize = 10;
const HELPED: f64 = 0.7;
/// Maximum number of rebuilds with locked vertices for folds that remain.
const LOCKINGS: u64 = 8;
/// Further rebuilds with locked vertices per quantisation attempt, if few triangles flip.
const RELOCKINGS: usize = 1;
/// Quantisation attempts if no tolerance is given, and the doublings taken back after each failed attempt.
const ROUNDINGS: u64 = 4;
/// Quantisation attempts for a base with locked vertices, which has smaller triangles.
const MOST_ROUNDINGS: u64 = 7;
const TAKEN_BACK: u32 = 2;
/// Maximum number of refinement passes, for progress.
const PASSES: u64 = TRIALS + MENDS + LOCKINGS + MOST_ROUNDINGS;
/// Maximum factor by which quantisation may raise the RMS distance. About 1.05 is expected for a tolerance of
/// 1/3.
const LOSS: f64 = 1.15;
/// Quantisation may add one fold per this many existing folds.
const MORE: usize = 10;
/// Number of folds that counts like a doubled distance.
const DOUBLING: f64 = 10.0;
/// Factor on the distance when no levels follow, because rounding uses only a small part of the tolerance.
const DISTANCE_ALONE: f64 = 9.0;

/// Rank of a trial, smaller is better: has folds, number of levels, and mean squared distance penalised by
/// folds.
type Rank = (bool, usize, f64);

/// Result of refining one base.
pub struct Trial {
    pub base: Ordered,
    pub made: NormalMesh,
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
    fn new(base: Ordered, refined: Refined, importance: Vec<f64>, care: Care) -> Self {
        let Refined { made, distance, folds } = refined;
        Self { base, made, distance, folds, importance, thorough: care.thorough, locking: None }
    }

    fn rank(&self) -> Rank {
        let unsound = self.made.unsound();
        let dearer = 1.0 + unsound as f64 / DOUBLING;
        (unsound > 0, self.made.levels.len(), dearer * dearer * self.distance.mean_square)
    }

    /// Compute the vertex importance for the next base.
    fn weighed(&self, input: &Input<'_>) -> Vec<f64> {
        let mut importance = self.importance.clone();
        weigh(&mut importance, &input.points, input.triangles, &self.base.base, &self.distance.from_input);
        insist(&mut importance, &self.base.base, self.folds.iter().map(|fold| fold.triangle));
        importance
    }

    fn is_better_than(&self, other: &Self) -> bool {
        self.rank() < other.rank()
    }
}

/// Shared input of all trials.
struct Trials<'a> {
    input: &'a Input<'a>,
    coarse: &'a Coarse<'a>,
    settings: &'a Settings,
}

/// Find the best base and refine it, with the steps of `header` or coarser ones.
///
/// # Errors
/// [`KernelError::Interrupted`], [`KernelError::OutOfMemory`].
pub fn best(
    input: &Input<'_>,
    coarse: &Coarse<'_>,
    mut header: Header,
    settings: &Settings,
    progress: &Progress,
) -> Result<Trial, KernelError> {
    let trials = Trials { input, coarse, settings };
    let best = trials.first(&mut header, progress)?.ok_or(KernelError::Interrupted)?;
    let best = trials.mended(best, &header, progress)?;
    let best = trials.locked(best, &header, progress)?;
    trials.rounded(best, progress)
}

impl Trials<'_> {
    /// Start the progress of one pass, which counts its levels including the base.
    fn pass<'p>(&self, number: u64, progress: &Progress<'p>) -> Result<Progress<'p>, KernelError> {
        let each = u64::from(self.settings.levels.unwrap_or(MOST_LEVELS)) + 1;
        let mut part = progress.part(number * each, PASSES * each);
        part.tell(0, each)?;
        Ok(part)
    }

    fn base(&self, importance: &[f64], progress: &mut Progress) -> Result<Base, KernelError> {
        self.coarse.clone().base(importance, &self.input.slots, progress)
    }

    fn in_order(&self, base: Base, header: &Header) -> Result<Ordered, KernelError> {
        in_order(base, self.input, header, self.settings)
    }

    fn refined(
        &self,
        base: &Ordered,
        header: Header,
        care: Care,
        progress: &mut Progress,
    ) -> Result<Option<Refined>, KernelError> {
        refine(self.input, base, header, self.settings, care, progress)
    }

    /// Check whether a trial cannot be improved.
    fn is_final(&self, trial: &Trial) -> bool {
        let is_whole = trial.base.base.triangles.len() == self.input.triangles.len();
        trial.distance.mean_square == 0.0 || self.settings.is_alone() && is_whole
    }

    /// Try bases, each weighted by the errors of the previous one. If unspecified, the first one determines
    /// the number of levels.
    fn first(&self, header: &mut Header, progress: &Progress) -> Result<Option<Trial>, KernelError> {
        let care = Care { thorough: false, most_unsound: usize::MAX };
        let mut importance = vec![1.0; self.input.points.len()];
        let mut best: Option<Trial> = None;
        for number in 0..TRIALS {
            let progress = &mut self.pass(number, progress)?;
            let base = self.base(&importance, progress)?;
            if self.settings.levels.is_none() && self.settings.max_error <= 0.0 && number == 0 {
                header.levels = levels_for(base.triangles.len(), self.input.triangles.len());
            }
            let base = self.in_order(base, header)?;
            let Some(refined) = self.refined(&base, *header, care, progress)? else { break };
            let trial = Trial::new(base, refined, importance, care);
            importance = trial.weighed(self.input);
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
    fn mended(&self, mut best: Trial, header: &Header, progress: &Progress) -> Result<Trial, KernelError> {
        let care = Care { thorough: true, most_unsound: usize::MAX };
        let mut before = usize::MAX;
        for number in TRIALS..TRIALS + MENDS {
            let now = best.made.unsound();
            if now == 0 || now > FEW && now as f64 > HELPED * before as f64 || self.is_final(&best) {
                break;
            }
            before = now;
            let progress = &mut self.pass(number, progress)?;
            insist(&mut best.importance, &best.base.base, best.folds.iter().map(|fold| fold.triangle));
            let base = self.in_order(self.base(&best.importance, progress)?, header)?;
            if best.thorough && best.base.contents == base.contents {
                break;
            }
            let Some(refined) = self.refined(&base, *header, care, progress)? else { break };
            let trial = Trial::new(base, refined, best.importance.clone(), care);
            if trial.is_better_than(&best) {
                best = trial;
            }
        }
        Ok(best)
    }

    /// Rebuild the best base with locked vertices at folds, until no folds remain.
    fn locked(&self, mut best: Trial, header: &Header, progress: &Progress) -> Result<Trial, KernelError> {
        if best.made.unsound() == 0 || self.is_final(&best) {
            return Ok(best);
        }
        let care = Care { thorough: true, most_unsound: usize::MAX };
        let mut locking = Locking::new(&best.base.base, self.input);
        let (mut base, mut folds) = (best.base.base.clone(), best.folds.clone());
        for number in 0..LOCKINGS {
            let progress = &mut self.pass(TRIALS + MENDS + number, progress)?;
            locking.lock(&folds, &base, self.input);
            let again = self.in_order(locking.base(self.input, self.settings.target, progress)?, header)?;
            base = again.base.clone();
            let Some(refined) = self.refined(&again, *header, care, progress)? else { break };
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
    fn rounded(&self, best: Trial, progress: &Progress) -> Result<Trial, KernelError> {
        if self.settings.tolerance.is_some() {
            return Ok(best);
        }
        let (header, unsound) = (best.made.header, best.made.unsound());
        let distance2 = best.distance.mean_square + self.input.apart2;
        let (mut doublings, source) = self.doublings(distance2.sqrt());
        // Without levels, rounding itself limits the rotation of triangles.
        let is_alone = self.settings.is_alone();
        let most_unsound = if is_alone { usize::MAX } else { unsound + unsound / MORE };
        let attempts = if best.locking.is_some() { MOST_ROUNDINGS } else { ROUNDINGS };
        for attempt in 0..attempts {
            if doublings == 0 {
                break;
            }
            let progress = &mut self.pass(TRIALS + MENDS + LOCKINGS + attempt, progress)?;
            let header = coarser(&header, doublings);
            if let Some(mut trial) = self.rounded_to(&best, header, most_unsound, progress)? {
                if let Some(origin) = &mut trial.made.origin {
                    origin.tolerance = Tolerance::doubled(doublings, source);
                }
                return Ok(trial);
            }
            doublings = doublings.saturating_sub(TAKEN_BACK);
        }
        Ok(best)
    }

    /// Refine the best base with coarser steps. None if that does harm. A base with locked vertices may get
    /// further locks.
    fn rounded_to(
        &self,
        best: &Trial,
        header: Header,
        most_unsound: usize,
        progress: &mut Progress,
    ) -> Result<Option<Trial>, KernelError> {
        let few = if best.locking.is_some() { FEW } else { 0 };
        let care = Care { thorough: best.thorough, most_unsound: most_unsound.max(few) };
        let apart2 = self.input.apart2;
        let distance2 = best.distance.mean_square + apart2;
        let near2 = LOSS * LOSS * distance2.max(f64::from(header.step).powi(2));
        let mut locking = best.locking.clone();
        let mut base = self.in_order(best.base.base.clone(), &header)?;
        for _ in 0..=RELOCKINGS {
            let refined = self.refined(&base, header, care, progress)?;
            let is_good = |now: &Refined| {
                now.distance.mean_square + apart2 <= near2
                    && self.reaches(&now.made) >= self.reaches(&best.made)
            };
            let Some(refined) = refined.filter(is_good) else { break };
            if refined.made.unsound() <= most_unsound {
                return Ok(Some(Trial::new(base, refined, best.importance.clone(), care)));
            }
            let Some(locking) = &mut locking else { break };
            locking.lock(&refined.folds, &base.base, self.input);
            base = self.in_order(locking.base(self.input, self.settings.target, progress)?, &header)?;
        }
        Ok(None)
    }

    /// Derive the number of tolerance doublings and its reason from the distance of the levels, in mesh
    /// units.
    fn doublings(&self, distance: f64) -> (u32, Source) {
        let Input { points, triangles, surface, .. } = self.input;
        let size = diagonal(&around(triangles.iter().flatten().map(|&v| points[v as usize])));
        let noise = noise(points, triangles, surface.normals());
        let told = if self.settings.is_alone() { DISTANCE_ALONE } else { 1.0 };
        doublings(told * distance / size, noise / size, self.settings.max_error / size)
    }

    /// Check whether the finest level meets the maximum error.
    fn reaches(&self, made: &NormalMesh) -> bool {
        let reached = made.origin.as_ref().and_then(|origin| origin.reached.last());
        reached.is_none_or(|reached| *reached <= self.settings.max_error)
    }
}
