//! Disparity of a rectified pair, and depth of a view among others, by semi-global matching.
//!
//! | file | what |
//! | --- | --- |
//! | [`volume`] | a number for each pixel and disparity |
//! | [`cost`] | how unlike two pixels are: census and gradient |
//! | [`support`] | costs averaged over what has the pixel's colour |
//! | [`paths`] | costs summed along eight paths |
//! | [`pick`] | the best disparity of each pixel, and what tells how sure it is |
//! | [`ranges`], [`planes`] | the same for a view with poses among others: planes of depth, a range of them for each pixel |
//! | [`seen_by`] | what other views say of the places that a depth map names |
//! | [`median`] | weighted medians of disparities, along the edges of the image |
//!
//! Costs are whole numbers, so that results are the same for any number of threads and any set of instructions.

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

/// The disparity of each pixel of the left image, and how sure it is.
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

/// The planes on which the pixels of a view lie, of those that `ranges` names, as its partners show.
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
