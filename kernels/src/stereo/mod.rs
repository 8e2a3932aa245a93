//! Dense stereo by semi-global matching: disparity of a rectified pair, and depth of a view with several
//! posed partner views.
//!
//! | file | content |
//! | --- | --- |
//! | [`volume`] | cost volume: one value per pixel and disparity |
//! | [`cost`] | matching cost: census and gradient |
//! | [`support`] | cost aggregation over pixels of similar colour |
//! | [`paths`] | path costs along eight directions |
//! | [`pick`] | winner-take-all disparity and confidence measures |
//! | [`ranges`], [`planes`] | plane sweep over partner views, with a depth range per pixel |
//! | [`seen_by`] | consistency checks of a depth map with other views |
//! | [`median`] | edge-preserving weighted median of disparities |
//!
//! Costs are integers, so that results are identical for any thread count and instruction set.

pub mod cost;
pub mod median;
pub mod paths;
pub mod pick;
pub mod planes;
pub mod ranges;
pub mod seen_by;
pub mod support;
pub mod volume;

use crate::base::errors::KernelError;
use crate::base::progress::Progress;
use pick::Matched;
use volume::{Pixels, Search, Size};

/// Compute the disparity of each pixel of the left image, with confidence measures.
///
/// # Errors
/// As [`Progress::check`].
pub fn match_pair(
    left: &Pixels,
    right: &Pixels,
    size: Size,
    search: Search,
    threads: usize,
    progress: &mut Progress<'_>,
) -> Result<Matched, KernelError> {
    progress.tell(0, 3)?;
    let (grey, grey_right) = (cost::grey(left), cost::grey(right));
    let pair = cost::pair(&grey, &grey_right, size, search, threads);
    let costs = support::averaged(left, size, search, threads, |y, row| pair.costs_of(y, row));
    progress.tell(1, 3)?;
    let mut sums = volume::zeros(size, search);
    paths::summed(&grey, &costs, size, &search, threads, &mut sums);
    progress.tell(2, 3)?;
    let matched = pick::picked(&sums, &costs, size, search, threads);
    progress.tell(3, 3)?;
    Ok(matched)
}

/// Find the best depth plane of each pixel of a view, within `ranges`, from its similarity to the partner
/// images.
///
/// # Errors
/// As [`Progress::check`].
pub fn sweep(
    grey: &[u8],
    partners: &[planes::Partner],
    size: Size,
    ranges: &ranges::Ranges,
    bound: Option<&planes::Bound>,
    threads: usize,
    progress: &mut Progress<'_>,
) -> Result<planes::Swept, KernelError> {
    progress.tell(0, 2)?;
    let words = planes::words(grey, size, |_| planes::Shown::Scene, threads);
    let mut costs = planes::costs(&words, partners, size, ranges, threads);
    if let Some(bound) = bound {
        planes::bounded(&mut costs, size, ranges, bound, threads);
    }
    progress.tell(1, 2)?;
    let mut sums = vec![0; costs.len()];
    paths::summed(grey, &costs, size, ranges, threads, &mut sums);
    let swept = planes::picked(&sums, size, ranges);
    progress.tell(2, 2)?;
    Ok(swept)
}
