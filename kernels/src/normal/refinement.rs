//! Refinement of a base, level by level.

use super::boundary_chains::BoundaryChains;
use super::coder_order::OrderedBase;
use super::distance::{Distance, LocatedLevel, measure_maximum, measure_mean_square};
use super::domain::Domain;
use super::fold::Fold;
use super::fold_repair::{find_base_folds, repair_folds};
use super::input::Input;
use super::level::Level;
use super::new_vertex::NewVertex;
use super::normal_mesh::{EncoderInfo, NormalMesh, RefinementStep};
use super::quantization::{QuantizationSteps, quantize_channels};
use super::settings::Settings;
use super::surface::Surface;
use super::tolerance::{FINEST_TOLERANCE, Tolerance, ToleranceSource};
use super::vertex_attributes::VertexAttributes;
use super::vertex_search::{LevelPositions, SearchContext, VertexSearch};
use crate::base::errors::KernelError;
use crate::base::memory_reserve::Reserve;
use crate::base::progress::Progress;
use crate::subdivision::snm_contents::{Header, Refinement};

/// Search effort for vertex positions, and the number of folds above which the refinement is abandoned.
#[derive(Clone, Copy, Debug)]
pub struct SearchEffort {
    pub thorough: bool,
    pub max_folds: usize,
}

/// All levels of a base.
pub struct RefinementResult {
    pub normal_mesh: NormalMesh,
    /// Distance between the finest level and the input.
    pub distance: Distance,
    /// Folds of all levels, with their base triangles.
    pub folds: Vec<Fold>,
}

/// Refine a base into its levels. None if there are more than `care.max_folds` folds.
///
/// # Errors
/// [`KernelError::Interrupted`], [`KernelError::OutOfMemory`].
pub fn refine(
    input: &Input<'_>,
    ordered: &OrderedBase,
    header: Header,
    settings: &Settings,
    care: SearchEffort,
    progress: &mut Progress,
) -> Result<Option<RefinementResult>, KernelError> {
    let Input { points, triangles, attributes: carried, surface, slots, surface_points: places, .. } = input;
    let OrderedBase { base, contents } = ordered;
    let first = Level::from_base(&header, contents)?;
    let rims = BoundaryChains::new(&base.chains, |t| triangles[t].map(|v| points[v as usize]), slots);
    let domain = Domain::new(base, &first.topology, surface);
    let original =
        SearchContext { surface, sets: &base.sets, rims: &rims, domain: &domain, threads: settings.threads };
    let mut rim: Vec<_> =
        base.chains.iter().enumerate().map(|(i, chain)| (chain.ends, rims.full_span(i as u32))).collect();
    rim.sort_unstable_by_key(|(ends, _)| *ends);
    let mut placed = LevelPositions {
        surface_points: base.vertex_source.iter().map(|&v| places[v as usize]).collect(),
        base_points: base.vertex_source.iter().map(|&v| base.base_points[v as usize]).collect(),
        boundary_spans: rim,
    };
    let mut folds = find_base_folds(&first, &placed, &base.vertex_source, surface, settings.threads);
    let mut unsound = vec![folds.len()];
    let (mut levels, mut steps, mut reached) = (vec![first], vec![], vec![]);
    let mut distance = None;
    while let Some(level) = levels.last() {
        let number = levels.len() - 1;
        let is_finest = number == usize::from(header.levels);
        // Levels can become larger than the input.
        let _reserve = Reserve::for_rows(if is_finest { level.row_count() } else { level.next_row_count() })?;
        if is_finest || settings.max_error > 0.0 {
            let slots: Vec<u32> = placed.surface_points.iter().map(|place| place.slot).collect();
            let fine = LocatedLevel { level, slots: &slots };
            let mut is_last = is_finest;
            if settings.max_error > 0.0 {
                reached.push(measure_maximum(points, triangles, surface, &fine, settings.threads));
                is_last |= reached[number] <= settings.max_error;
            }
            if is_last {
                distance = Some(measure_mean_square(points, triangles, surface, &fine, settings.threads));
                break;
            }
        }
        progress.report(levels.len() as u64, u64::from(header.levels) + 1)?;
        let (predicted, step) =
            (level.predict_vertices(&header), QuantizationSteps::for_level(&header, number));
        let search = VertexSearch {
            context: &original,
            level,
            level_index: number,
            positions: &placed,
            predicted: &predicted,
            steps: &step,
        };
        let mut found = search.find_vertices();
        progress.check()?;
        let turned = repair_folds(&search, &mut found, care.thorough);
        progress.check()?;
        unsound.push(turned.len());
        if unsound.iter().sum::<usize>() > care.max_folds {
            return Ok(None);
        }
        folds.extend(turned.iter().map(|fold| Fold { triangle: fold.triangle >> (2 * number), ..*fold }));
        let rim = search.split_spans(&found);
        let parameters: Vec<_> =
            found.iter().enumerate().map(|(edge, f)| search.map_to_base(edge, &f.surface_point)).collect();
        placed.base_points.extend(parameters);
        placed.surface_points.extend(found.iter().map(|f| f.surface_point));
        placed.boundary_spans = rim;
        let refinement = Refinement {
            offsets: found.iter().map(|f| f.offset).collect(),
            channels: quantize_vertex_channels(&found, level, carried, surface, &header),
        };
        progress.check()?;
        let next = level.refine(&header, &step, &predicted, &refinement);
        steps.push(RefinementStep { predicted, refinement });
        levels.push(next);
    }
    progress.check()?;
    let distance = distance.ok_or(KernelError::Interrupted)?;
    if steps.len() < usize::from(header.levels) {
        // Quantisation steps depend on the number of levels, so refine again with the final number.
        let header = Header { levels: steps.len() as u8, ..header };
        return refine(input, ordered, header, settings, care, progress);
    }
    let source =
        if settings.tolerance.is_some() { ToleranceSource::Given } else { ToleranceSource::Precision };
    let origin = Some(EncoderInfo {
        base_source: base.vertex_source.clone(),
        vertex_triangles: placed.surface_points.iter().map(|place| surface.triangle(place.slot)).collect(),
        fold_counts: unsound,
        max_distances: reached,
        tolerance: Tolerance { relative: settings.tolerance.unwrap_or(FINEST_TOLERANCE), source },
    });
    let made = NormalMesh { header, levels, steps, file: vec![], ends: vec![], encoder_info: origin };
    Ok(Some(RefinementResult { normal_mesh: made, distance, folds }))
}

fn quantize_vertex_channels(
    found: &[NewVertex],
    level: &Level,
    carried: &VertexAttributes,
    surface: &Surface,
    header: &Header,
) -> Vec<[i32; 4]> {
    if header.channels == 0 {
        return vec![];
    }
    let of = |(edge, f): (usize, &NewVertex)| {
        quantize_channels(
            &carried.interpolate_channels(surface, &f.surface_point),
            &level.predict_channels(edge),
            header,
        )
    };
    found.iter().enumerate().map(of).collect()
}
