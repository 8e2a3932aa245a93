//! Refinement of a base, level by level.

use super::carried::Carried;
use super::distance::{Distance, Fine, largest, mean_square};
use super::domain::Domain;
use super::fold::Fold;
use super::found::Found;
use super::grid::{Steps, in_units};
use super::input::Input;
use super::level::Level;
use super::normal_mesh::{NormalMesh, Origin, Step};
use super::ordered::Ordered;
use super::place::{Original, Placed, Search};
use super::rim::Rims;
use super::settings::Settings;
use super::surface::Surface;
use super::tolerance::{FINEST, Source, Tolerance};
use super::unfold::{unfold, unsound_in_base};
use crate::base::errors::KernelError;
use crate::base::progress::Progress;
use crate::base::reserve::Reserve;
use crate::subdivision::contents::{Header, Refinement};

/// Search effort for vertex positions, and the number of folds above which the refinement is abandoned.
#[derive(Clone, Copy, Debug)]
pub struct Care {
    pub thorough: bool,
    pub most_unsound: usize,
}

/// All levels of a base.
pub struct Refined {
    pub made: NormalMesh,
    /// Distance between the finest level and the input.
    pub distance: Distance,
    /// Folds of all levels, with their base triangles.
    pub folds: Vec<Fold>,
}

/// Refine a base into its levels. None if there are more than `care.most_unsound` folds.
///
/// # Errors
/// [`KernelError::Interrupted`], [`KernelError::OutOfMemory`].
pub fn refine(
    input: &Input<'_>,
    ordered: &Ordered,
    header: Header,
    settings: &Settings,
    care: Care,
    progress: &mut Progress,
) -> Result<Option<Refined>, KernelError> {
    let Input { points, triangles, carried, surface, slots, places, .. } = input;
    let Ordered { base, contents } = ordered;
    let first = Level::base(&header, contents)?;
    let rims = Rims::new(&base.chains, |t| triangles[t].map(|v| points[v as usize]), slots);
    let domain = Domain::new(base, &first.topology, surface);
    let original =
        Original { surface, sets: &base.sets, rims: &rims, domain: &domain, threads: settings.threads };
    let mut rim: Vec<_> =
        base.chains.iter().enumerate().map(|(i, chain)| (chain.ends, rims.whole(i as u32))).collect();
    rim.sort_unstable_by_key(|(ends, _)| *ends);
    let mut placed = Placed {
        places: base.vertex_source.iter().map(|&v| places[v as usize]).collect(),
        parameters: base.vertex_source.iter().map(|&v| base.parameters[v as usize]).collect(),
        rim,
    };
    let mut folds = unsound_in_base(&first, &placed, &base.vertex_source, surface, settings.threads);
    let mut unsound = vec![folds.len()];
    let (mut levels, mut steps, mut reached) = (vec![first], vec![], vec![]);
    let mut distance = None;
    while let Some(level) = levels.last() {
        let number = levels.len() - 1;
        let is_finest = number == usize::from(header.levels);
        // Levels can become larger than the input.
        let _reserve = Reserve::for_rows(if is_finest { level.rows() } else { level.next_rows() })?;
        if is_finest || settings.max_error > 0.0 {
            let slots: Vec<u32> = placed.places.iter().map(|place| place.slot).collect();
            let fine = Fine { level, slots: &slots };
            let mut is_last = is_finest;
            if settings.max_error > 0.0 {
                reached.push(largest(points, triangles, surface, &fine, settings.threads));
                is_last |= reached[number] <= settings.max_error;
            }
            if is_last {
                distance = Some(mean_square(points, triangles, surface, &fine, settings.threads));
                break;
            }
        }
        progress.tell(levels.len() as u64, u64::from(header.levels) + 1)?;
        let (predicted, step) = (level.predicted(&header), Steps::of(&header, number));
        let search = Search {
            original: &original,
            level,
            number,
            placed: &placed,
            predicted: &predicted,
            steps: &step,
        };
        let mut found = search.refine();
        progress.check()?;
        let turned = unfold(&search, &mut found, care.thorough);
        progress.check()?;
        unsound.push(turned.len());
        if unsound.iter().sum::<usize>() > care.most_unsound {
            return Ok(None);
        }
        folds.extend(turned.iter().map(|fold| Fold { triangle: fold.triangle >> (2 * number), ..*fold }));
        let rim = search.rim(&found);
        let parameters: Vec<_> =
            found.iter().enumerate().map(|(edge, f)| search.parameter(edge, &f.place)).collect();
        placed.parameters.extend(parameters);
        placed.places.extend(found.iter().map(|f| f.place));
        placed.rim = rim;
        let refinement = Refinement {
            offsets: found.iter().map(|f| f.offset).collect(),
            channels: channels_of(&found, level, carried, surface, &header),
        };
        progress.check()?;
        let next = level.refined(&header, &step, &predicted, &refinement);
        steps.push(Step { predicted, refinement });
        levels.push(next);
    }
    progress.check()?;
    let distance = distance.ok_or(KernelError::Interrupted)?;
    if steps.len() < usize::from(header.levels) {
        // Quantisation steps depend on the number of levels, so refine again with the final number.
        let header = Header { levels: steps.len() as u8, ..header };
        return refine(input, ordered, header, settings, care, progress);
    }
    let source = if settings.tolerance.is_some() { Source::Given } else { Source::Precision };
    let origin = Some(Origin {
        base_source: base.vertex_source.clone(),
        triangles: placed.places.iter().map(|place| surface.triangle(place.slot)).collect(),
        unsound,
        reached,
        tolerance: Tolerance { relative: settings.tolerance.unwrap_or(FINEST), source },
    });
    let made = NormalMesh { header, levels, steps, file: vec![], ends: vec![], origin };
    Ok(Some(Refined { made, distance, folds }))
}

fn channels_of(
    found: &[Found],
    level: &Level,
    carried: &Carried,
    surface: &Surface,
    header: &Header,
) -> Vec<[i32; 4]> {
    if header.channels == 0 {
        return vec![];
    }
    let of = |(edge, f): (usize, &Found)| {
        in_units(&carried.at(surface, &f.place), &level.channels_between(edge), header)
    };
    found.iter().enumerate().map(of).collect()
}
