//! Dense stereo by semi-global matching: disparity of a rectified pair, and depth of a view with several
//! posed partner views.
//!
//! | file | content |
//! | --- | --- |
//! | [`cost_volume`] | cost volume: one value per pixel and disparity |
//! | [`matching_cost`] | matching cost: census and gradient |
//! | [`cost_aggregation`] | cost aggregation over pixels of similar colour |
//! | [`path_aggregation`] | path costs along eight directions |
//! | [`winner_take_all`] | winner-take-all disparity and confidence measures |
//! | [`hypothesis_ranges`], [`plane_sweep`] | plane sweep over partner views, with a depth range per pixel |
//! | [`subplane_refinement`] | refinement of swept depth to fractions of a plane |
//! | [`cross_view_checks`] | consistency checks of a depth map with other views |
//! | [`visibility_fusion`] | fusion of the depth maps of several views |
//! | [`weighted_median`] | edge-preserving weighted median of disparities |
//!
//! Costs are integers, so that results are identical for any thread count and instruction set.

pub mod cost_aggregation;
pub mod cost_volume;
pub mod cross_view_checks;
pub mod hypothesis_ranges;
pub mod matching_cost;
pub mod path_aggregation;
pub mod plane_sweep;
pub mod subplane_refinement;
pub mod visibility_fusion;
pub mod weighted_median;
pub mod winner_take_all;

use crate::base::errors::KernelError;
use crate::base::progress::Progress;
use cost_volume::{DisparityRange, ImageSize, RgbImage};
use winner_take_all::StereoMatch;

/// Compute the disparity of each pixel of the left image, with confidence measures.
///
/// # Errors
/// As [`Progress::check`].
pub fn match_stereo_pair(
    left: &RgbImage,
    right: &RgbImage,
    size: ImageSize,
    search: DisparityRange,
    threads: usize,
    progress: &mut Progress<'_>,
) -> Result<StereoMatch, KernelError> {
    progress.report(0, 3)?;
    let (grey, grey_right) = (matching_cost::to_grey(left), matching_cost::to_grey(right));
    let pair = matching_cost::prepare_pair(&grey, &grey_right, size, search, threads);
    let costs =
        cost_aggregation::average_costs(left, size, search, threads, |y, row| pair.fill_row_costs(y, row));
    progress.report(1, 3)?;
    let mut sums = cost_volume::allocate_volume(size, search);
    path_aggregation::aggregate_paths(&grey, &costs, size, &search, threads, &mut sums);
    progress.report(2, 3)?;
    let matched = winner_take_all::select_disparities(&sums, &costs, size, search, threads);
    progress.report(3, 3)?;
    Ok(matched)
}

/// Find the best depth plane of each pixel of a view, within `hypothesis_ranges`, from its similarity to the partner
/// images.
///
/// # Errors
/// As [`Progress::check`].
pub fn sweep_planes(
    grey: &[u8],
    partners: &[plane_sweep::PartnerView],
    size: ImageSize,
    ranges: &hypothesis_ranges::HypothesisRanges,
    bound: Option<&plane_sweep::HullBound>,
    threads: usize,
    progress: &mut Progress<'_>,
) -> Result<plane_sweep::PlaneSweepResult, KernelError> {
    progress.report(0, 2)?;
    let words = plane_sweep::describe_pixels(grey, size, |_| plane_sweep::PixelContent::Scene, threads);
    let mut costs = plane_sweep::compute_costs(&words, partners, size, ranges, threads);
    if let Some(bound) = bound {
        plane_sweep::add_hull_costs(&mut costs, size, ranges, bound, threads);
    }
    progress.report(1, 2)?;
    let mut sums = vec![0; costs.len()];
    path_aggregation::aggregate_paths(grey, &costs, size, ranges, threads, &mut sums);
    let swept = plane_sweep::select_planes(&sums, size, ranges);
    progress.report(2, 2)?;
    Ok(swept)
}
