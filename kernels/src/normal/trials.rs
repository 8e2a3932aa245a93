//! Which base is the best one, and how coarsely it can be written.
//!
//! How far the levels over a base come from the input, and whether they turn over, shows only when they are made: a few
//! bases are tried, each weighed by what the one before has shown. The best is mended where its triangles turn over, gets
//! more of the input's vertices where they still do, and is made once more with the coarsest steps that do no harm, if
//! nobody says how exact it should be.

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

/// Bases that are tried; the one whose finest level comes closest is taken.
const TRIALS: u64 = 4;
/// Bases that are tried beyond that at most, as long as triangles turn over; where more than a few do, as long as each
/// leaves no more than this part of them: some surfaces are crumpled all over.
const MENDS: u64 = 6;
const FEW: usize = 10;
const HELPED: f64 = 0.7;
/// Bases that are made of the best one where triangles turn over all the same.
const LOCKINGS: u64 = 8;
/// The same for each of the tolerances below, where few triangles turn over.
const RELOCKINGS: usize = 1;
/// Tolerances that are tried where nobody gives one, and how many doublings are taken back from one to the next.
const ROUNDINGS: u64 = 4;
/// And where a base has locked vertices, among which triangles are small.
const MOST_ROUNDINGS: u64 = 7;
const TAKEN_BACK: u32 = 2;
/// All that is tried, at most.
const PASSES: u64 = TRIALS + MENDS + LOCKINGS + MOST_ROUNDINGS;
/// By how much rounding may take the finest level farther off at most: its share of that is a third.
const LOSS: f64 = 1.15;
/// And by this part of their number more triangles may be unsound.
const MORE: usize = 10;
/// So many unsound triangles count as twice the distance.
const DOUBLING: f64 = 10.0;
/// Where no levels follow, so many times the distance is told: rounding leaves a small part of the tolerance.
const DISTANCE_ALONE: f64 = 9.0;

/// Whether triangles are unsound, how many levels there are, and how far off the last is, times what unsound triangles
/// count: less is better.
type Rank = (bool, usize, f64);

/// What was made of a base.
pub struct Trial {
    pub base: Ordered,
    pub made: NormalMesh,
    distance: Distance,
    /// What is not sound; the triangles are those of the base.
    folds: Vec<Fold>,
    /// What the base was made with.
    importance: Vec<f64>,
    /// How places of its vertices were sought.
    thorough: bool,
    /// What its base was made with, if it has locked vertices.
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

    /// What the next base is made with.
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

/// All that trials have in common.
struct Trials<'a> {
    input: &'a Input<'a>,
    coarse: &'a Coarse<'a>,
    settings: &'a Settings,
}

/// The levels over the best base that is found, in the steps of `header` or coarser ones.
///
/// # Errors
/// [`KernelError::Interrupted`], [`KernelError::Memory`].
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
    /// Progress of one pass, which is counted as its levels, the base among them.
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

    /// Whether nothing can be better.
    fn is_final(&self, trial: &Trial) -> bool {
        let is_whole = trial.base.base.triangles.len() == self.input.triangles.len();
        trial.distance.mean_square == 0.0 || self.settings.is_alone() && is_whole
    }

    /// Each base made with what the one before has shown. The first one says how many levels there are, if nobody does.
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

    /// The same base but where triangles turn over, as long as there are any and that helps.
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

    /// The same base with more vertices where triangles turn over, until none does.
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

    /// Once more, as coarse as does no harm, if nobody says how exact it should be.
    fn rounded(&self, best: Trial, progress: &Progress) -> Result<Trial, KernelError> {
        if self.settings.tolerance.is_some() {
            return Ok(best);
        }
        let (header, unsound) = (best.made.header, best.made.unsound());
        let distance2 = best.distance.mean_square + self.input.apart2;
        let (mut doublings, source) = self.doublings(distance2.sqrt());
        // Alone, no triangle turns by much against what it was.
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

    /// The best in coarser steps, if that does no harm. What was locked already may get a few more locks.
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

    /// How often the finest tolerance may be doubled, and why, where levels are so far from the input.
    fn doublings(&self, distance: f64) -> (u32, Source) {
        let Input { points, triangles, surface, .. } = self.input;
        let size = diagonal(&around(triangles.iter().flatten().map(|&v| points[v as usize])));
        let noise = noise(points, triangles, surface.normals());
        let told = if self.settings.is_alone() { DISTANCE_ALONE } else { 1.0 };
        doublings(told * distance / size, noise / size, self.settings.max_error / size)
    }

    /// Whether the finest level is as near as is asked for.
    fn reaches(&self, made: &NormalMesh) -> bool {
        let reached = made.origin.as_ref().and_then(|origin| origin.reached.last());
        reached.is_none_or(|reached| *reached <= self.settings.max_error)
    }
}
