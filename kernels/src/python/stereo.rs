//! `scanloom.stages._kernels.match_pair`, `sweep_planes`, `refine_inverse_depth`, `count_supporting_views`,
//! `is_inside_all_masks`, `fuse_depth_maps`, `find_hull_entry` and
//! `compute_weighted_medians`.

use numpy::ndarray::Array2;
use numpy::{Element, IntoPyArray, PyArray2, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::atlas::shape_error;
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use crate::base::parallel::resolve_thread_count;
use crate::stereo::cost_volume::{DisparityRange, ImageSize, LANES};
use crate::stereo::cross_view_checks::{
    OtherView, PixelProjection, SupportLimits, count_supporting_views as count_support,
};
use crate::stereo::hypothesis_ranges::HypothesisRanges;
use crate::stereo::plane_sweep::{HullBound, PartnerView, PixelContent, describe_pixels};
use crate::stereo::subplane_refinement::{PartnerImage, refine_inverse_depth as refine_planes};
use crate::stereo::visibility_fusion::{FusedPixel, Measurement, OtherDepthMap, Tolerances};
use crate::stereo::weighted_median::compute_weighted_medians as medians_of;

type RgbArray<'py> = PyReadonlyArray3<'py, u8>;
type ImageArray<T> = Py<PyArray2<T>>;
/// Disparity of the left and of the right image; path sum, margin and cost of the best disparity.
type MatchArrays = (ImageArray<f32>, ImageArray<f32>, ImageArray<i16>, ImageArray<i16>, ImageArray<i16>);

fn copy_image(image: &RgbArray<'_>) -> PyResult<(Vec<[u8; 3]>, ImageSize)> {
    let levels = image.as_array();
    let [height, width, 3] = *levels.shape() else {
        return Err(PyValueError::new_err(format!(
            "an image has shape {:?}; h × w × 3 is expected",
            levels.shape()
        )));
    };
    if width == 0 || height == 0 {
        return Err(PyValueError::new_err("an image has no pixels"));
    }
    let standard = levels.as_standard_layout();
    let chunks = standard.as_slice().unwrap_or_default().chunks_exact(3);
    Ok((chunks.map(|c| [c[0], c[1], c[2]]).collect(), ImageSize { width, height }))
}

fn image_array<T: Element>(py: Python<'_>, size: ImageSize, values: Vec<T>) -> PyResult<ImageArray<T>> {
    Ok(Array2::from_shape_vec((size.height, size.width), values)
        .map_err(shape_error)?
        .into_pyarray(py)
        .unbind())
}

/// Estimate the memory of a search, in rows of 192 bytes: three volumes of two bytes per value.
fn reserve_rows(size: ImageSize, count: usize) -> usize {
    size.pixel_count().saturating_mul(count.saturating_mul(6) / 192 + 1)
}

/// Compute the disparities of a rectified pair by semi-global matching.
#[pyfunction]
#[pyo3(signature = (left, right, *, lowest, count, wanted_threads))]
pub fn match_pair(
    py: Python<'_>,
    left: RgbArray<'_>,
    right: RgbArray<'_>,
    lowest: i32,
    count: usize,
    wanted_threads: usize,
) -> PyResult<MatchArrays> {
    let [height, width, _] = *left.as_array().shape() else { unreachable!("an array of three dimensions") };
    if left.as_array().shape() != right.as_array().shape() {
        return Err(PyValueError::new_err("the two images have different sizes"));
    }
    if count == 0 || !count.is_multiple_of(LANES) || count > 1 << 14 || lowest.unsigned_abs() > 1 << 20 {
        return Err(PyValueError::new_err(format!(
            "{count} disparities from {lowest} on; a multiple of {LANES} up to 16384 is expected"
        )));
    }
    with_memory_reserve(reserve_rows(ImageSize { width, height }, count), || {
        let ((left, size), (right, _)) = (copy_image(&left)?, copy_image(&right)?);
        let threads = resolve_thread_count(wanted_threads);
        let search = DisparityRange { lowest, count };
        let found = run_detached(py, None, false, |progress| {
            crate::stereo::match_stereo_pair(&left, &right, size, search, threads, progress)
        })?;
        Ok((
            image_array(py, size, found.disparity)?,
            image_array(py, size, found.right_disparity)?,
            image_array(py, size, found.sum)?,
            image_array(py, size, found.margin)?,
            image_array(py, size, found.cost)?,
        ))
    })
}

/// Copy the values of an array, row by row.
fn copy_values<T: Element + Copy>(given: &PyReadonlyArray2<'_, T>) -> Vec<T> {
    // An iterator over an array is slower than a copy of its memory.
    given.as_slice().map_or_else(|_| given.as_array().iter().copied().collect(), <[T]>::to_vec)
}

type Grey<'py> = PyReadonlyArray2<'py, u8>;
/// Warped image of a partner, its mask ([`PixelContent`]), and the map of each plane.
type WarpedPartner<'py> = (Grey<'py>, Grey<'py>, PyReadonlyArray2<'py, f32>);

fn image_size(shape: &[usize]) -> PyResult<ImageSize> {
    match *shape {
        [height, width] if width > 0 && height > 0 && width.max(height) < 1 << 20 => {
            Ok(ImageSize { width, height })
        }
        _ => Err(PyValueError::new_err(format!(
            "an image has shape {shape:?}; h × w with sides from 1 to below 2²⁰ is expected"
        ))),
    }
}

fn copy_partner(given: &WarpedPartner<'_>, planes: usize, threads: usize) -> PyResult<PartnerView> {
    let (grey, shown, maps) = given;
    let size = image_size(grey.as_array().shape())?;
    if shown.as_array().shape() != grey.as_array().shape() || *maps.as_array().shape() != [planes, 3] {
        return Err(PyValueError::new_err("the mask or the maps of a partner do not match its image"));
    }
    let grey = copy_values(grey);
    let shown = copy_values(shown);
    let said = |i: usize| match shown[i] {
        0 => PixelContent::Outside,
        1 => PixelContent::Scene,
        _ => PixelContent::Background,
    };
    Ok(PartnerView {
        words: describe_pixels(&grey, size, said, threads),
        size,
        maps: maps.as_array().rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect(),
    })
}

/// Find the best depth plane of each pixel of a view, from its partners: plane index with a fraction, and
/// margin.
#[pyfunction]
#[pyo3(signature = (grey, partners, first, count, bound = None, *, planes, wanted_threads))]
#[allow(clippy::too_many_arguments)]
pub fn sweep_planes(
    py: Python<'_>,
    grey: Grey<'_>,
    partners: Vec<WarpedPartner<'_>>,
    first: PyReadonlyArray2<'_, i32>,
    count: PyReadonlyArray2<'_, u16>,
    bound: Option<(PyReadonlyArray2<'_, f32>, f32)>,
    planes: usize,
    wanted_threads: usize,
) -> PyResult<(ImageArray<f32>, ImageArray<i16>)> {
    let size = image_size(grey.as_array().shape())?;
    if first.as_array().shape() != grey.as_array().shape()
        || count.as_array().shape() != grey.as_array().shape()
        || bound.as_ref().is_some_and(|(nearest, _)| nearest.as_array().shape() != grey.as_array().shape())
    {
        return Err(PyValueError::new_err("the size of first, count or bound differs from the view"));
    }
    for (&first, &count) in first.as_array().iter().zip(count.as_array()) {
        let end = i64::from(first) + i64::from(count);
        if first < 0 || count == 0 || usize::from(count) % LANES != 0 || end > planes as i64 {
            return Err(PyValueError::new_err(format!(
                "planes {first} to {end} are not within 0 to {planes}, or not a multiple of {LANES}"
            )));
        }
    }
    let numbers: usize = count.as_array().iter().map(|&n| usize::from(n)).sum();
    let images: usize = partners.iter().map(|one| one.0.as_array().len()).sum();
    // Three volumes of two bytes per value, and the image descriptors, in rows of 192 bytes.
    with_memory_reserve(numbers / 32 + (images + size.pixel_count()) / 8, || {
        let threads = resolve_thread_count(wanted_threads);
        let partners =
            partners.iter().map(|one| copy_partner(one, planes, threads)).collect::<PyResult<Vec<_>>>()?;
        let ranges = HypothesisRanges::new(copy_values(&first), copy_values(&count));
        let grey = copy_values(&grey);
        let bound = bound
            .as_ref()
            .map(|(nearest, lean)| HullBound { nearest: copy_values(nearest), cost_per_plane: *lean });
        let found = run_detached(py, None, false, |progress| {
            crate::stereo::sweep_planes(&grey, &partners, size, &ranges, bound.as_ref(), threads, progress)
        })?;
        Ok((image_array(py, size, found.plane)?, image_array(py, size, found.margin)?))
    })
}

/// Refine swept inverse depth to fractions of a plane.
#[pyfunction]
#[pyo3(signature = (grey, partners, inverse, *, step, wanted_threads))]
pub fn refine_inverse_depth(
    py: Python<'_>,
    grey: Grey<'_>,
    partners: Vec<OtherViewArrays<'_, u8>>,
    inverse: PyReadonlyArray2<'_, f32>,
    step: f32,
    wanted_threads: usize,
) -> PyResult<ImageArray<f32>> {
    let size = image_size(grey.as_array().shape())?;
    if inverse.as_array().shape() != grey.as_array().shape() {
        return Err(PyValueError::new_err("the inverse depth and the image have different sizes"));
    }
    let images: usize = partners.iter().map(|one| one.1.as_array().len()).sum();
    // Five bytes per pixel of a partner and nine of the view, and the bands of each thread, in rows of 192 bytes.
    let threads = resolve_thread_count(wanted_threads);
    let bands = size.width.saturating_mul(72 * 4 * 11).saturating_mul(threads) / 192;
    with_memory_reserve((images + 2 * size.pixel_count()) / 32 + bands, || {
        let partners = partners
            .iter()
            .map(|(matrix, image)| {
                let levels = copy_values(image);
                let matrix = copy_projection(matrix)?.map(|row| row.map(|value| value as f32));
                Ok(PartnerImage::new(&levels, image_size(image.as_array().shape())?, matrix))
            })
            .collect::<PyResult<Vec<_>>>()?;
        let grey = copy_values(&grey);
        let inverse = copy_values(&inverse);
        let refined = py.detach(|| refine_planes(&grey, size, &partners, &inverse, step, threads));
        image_array(py, size, refined)
    })
}

/// Another view: the 3 × 4 projection from pixels into it, and its map.
type OtherViewArrays<'py, T> = (PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, T>);

fn copy_projection(given: &PyReadonlyArray2<'_, f64>) -> PyResult<PixelProjection> {
    let matrix = given.as_array();
    if *matrix.shape() != [3, 4] {
        return Err(PyValueError::new_err(format!(
            "a matrix has shape {:?}; 3 × 4 is expected",
            matrix.shape()
        )));
    }
    Ok(std::array::from_fn(|row| std::array::from_fn(|column| matrix[[row, column]])))
}

fn copy_other_view<T: Element + Copy>((matrix, map): &OtherViewArrays<'_, T>) -> PyResult<OtherView<T>> {
    let size = image_size(map.as_array().shape())?;
    Ok(OtherView { from_pixels: copy_projection(matrix)?, size, map: copy_values(map) })
}

/// Count the other views with a consistent depth, with a nearly consistent depth, without occlusion, and with
/// any depth.
#[pyfunction]
#[pyo3(signature = (depth, other_views, *, tolerances, min_depth_ratio, wanted_threads))]
pub fn count_supporting_views(
    py: Python<'_>,
    depth: PyReadonlyArray2<'_, f32>,
    other_views: Vec<OtherViewArrays<'_, f32>>,
    tolerances: [f64; 2],
    min_depth_ratio: f64,
    wanted_threads: usize,
) -> PyResult<[ImageArray<u8>; 4]> {
    let size = image_size(depth.as_array().shape())?;
    let images: usize = other_views.iter().map(|one| one.1.as_array().len()).sum();
    with_memory_reserve((images + 2 * size.pixel_count()) / 24, || {
        let other_views = other_views.iter().map(copy_other_view).collect::<PyResult<Vec<_>>>()?;
        let depth = copy_values(&depth);
        let limits = SupportLimits { tolerances, min_depth_ratio };
        let threads = resolve_thread_count(wanted_threads);
        let counts = py.detach(|| count_support(&depth, size, &other_views, limits, threads));
        let of = |which: usize| image_array(py, size, counts.iter().map(|count| count[which]).collect());
        Ok([of(0)?, of(1)?, of(2)?, of(3)?])
    })
}

/// Check whether points are inside the masks of all views that see them.
#[pyfunction]
#[pyo3(signature = (depth, masks, *, wanted_threads))]
pub fn is_inside_all_masks(
    py: Python<'_>,
    depth: PyReadonlyArray2<'_, f32>,
    masks: Vec<OtherViewArrays<'_, bool>>,
    wanted_threads: usize,
) -> PyResult<ImageArray<bool>> {
    let size = image_size(depth.as_array().shape())?;
    let images: usize = masks.iter().map(|one| one.1.as_array().len()).sum();
    with_memory_reserve((images + 4 * size.pixel_count()) / 96, || {
        let masks = masks.iter().map(copy_other_view).collect::<PyResult<Vec<_>>>()?;
        let depth = copy_values(&depth);
        let threads = resolve_thread_count(wanted_threads);
        let inside = py
            .detach(|| crate::stereo::cross_view_checks::is_inside_all_masks(&depth, size, &masks, threads));
        image_array(py, size, inside)
    })
}

/// Other depth map: the 3 × 4 projections into that view and from it, its depth, and its confidence.
type OtherMapArrays<'py> =
    (PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, f64>, PyReadonlyArray2<'py, f32>, Grey<'py>);
/// Fused depth; sums of confidence that confirms and contradicts; numbers of confirming views within the wide
/// and within the narrow tolerance.
type FusedArrays = (ImageArray<f32>, [ImageArray<u16>; 2], [ImageArray<u8>; 2]);

fn copy_measurements(depth: &PyReadonlyArray2<'_, f32>, confidence: &Grey<'_>) -> PyResult<Vec<Measurement>> {
    if depth.as_array().shape() != confidence.as_array().shape() {
        return Err(PyValueError::new_err("depth and confidence have different sizes"));
    }
    Ok(copy_values(depth).into_iter().zip(copy_values(confidence)).collect())
}

/// Fuse a depth map with the maps of other views, by the confidence that agrees with each depth.
#[pyfunction]
#[pyo3(signature = (depth, confidence, others, *, tolerances, wanted_threads))]
pub fn fuse_depth_maps(
    py: Python<'_>,
    depth: PyReadonlyArray2<'_, f32>,
    confidence: Grey<'_>,
    others: Vec<OtherMapArrays<'_>>,
    tolerances: [f32; 2],
    wanted_threads: usize,
) -> PyResult<FusedArrays> {
    let size = image_size(depth.as_array().shape())?;
    let [narrow, wide] = tolerances;
    // Sums of confidence are of 16 bits, and counts of views of 8 bits.
    if others.len() > 255 || !(narrow > 0.0 && narrow <= wide && wide.is_finite()) {
        return Err(PyValueError::new_err(
            "at most 255 other maps, and finite tolerances 0 < narrow ≤ wide, are expected",
        ));
    }
    let images: usize = others.iter().map(|one| one.2.as_array().len()).sum();
    // Eight bytes for each measurement and rendered measurement, and 24 for each result.
    with_memory_reserve((images + (others.len() + 5) * size.pixel_count()) / 24, || {
        let own = copy_measurements(&depth, &confidence)?;
        let others = others
            .iter()
            .map(|(into, back, depth, confidence)| {
                let size = image_size(depth.as_array().shape())?;
                let map = copy_measurements(depth, confidence)?;
                let view = OtherView { from_pixels: copy_projection(into)?, size, map };
                Ok(OtherDepthMap { view, back: copy_projection(back)? })
            })
            .collect::<PyResult<Vec<_>>>()?;
        let threads = resolve_thread_count(wanted_threads);
        let tolerances = Tolerances { narrow, wide };
        let fused = py.detach(|| {
            crate::stereo::visibility_fusion::fuse_depth_maps(&own, size, &others, tolerances, threads)
        });
        let sums = |value: fn(&FusedPixel) -> u16| image_array(py, size, fused.iter().map(value).collect());
        let counts =
            |which: usize| image_array(py, size, fused.iter().map(|one| one.counts[which]).collect());
        Ok((
            image_array(py, size, fused.iter().map(|one| one.depth).collect())?,
            [sums(|one| one.confirming)?, sums(|one| one.contradicting)?],
            [counts(0)?, counts(1)?],
        ))
    })
}

/// Find the depth at which pixels' rays enter the visual hull of the masks.
#[pyfunction]
#[pyo3(signature = (wanted, masks, *, min_views, depth_range, steps, wanted_threads))]
pub fn find_hull_entry(
    py: Python<'_>,
    wanted: PyReadonlyArray2<'_, bool>,
    masks: Vec<OtherViewArrays<'_, bool>>,
    min_views: usize,
    depth_range: [f64; 2],
    steps: usize,
    wanted_threads: usize,
) -> PyResult<ImageArray<f32>> {
    let size = image_size(wanted.as_array().shape())?;
    let [near, far] = depth_range;
    if !(near > 0.0 && far > near && far.is_finite() && steps > 0 && steps <= 1 << 20) {
        return Err(PyValueError::new_err("span must be 0 < near < far, and steps 1 to 2²⁰"));
    }
    let images: usize = masks.iter().map(|one| one.1.as_array().len()).sum();
    with_memory_reserve((images + 4 * size.pixel_count()) / 96, || {
        let masks = masks.iter().map(copy_other_view).collect::<PyResult<Vec<_>>>()?;
        let wanted = copy_values(&wanted);
        let threads = resolve_thread_count(wanted_threads);
        let found = py.detach(|| {
            crate::stereo::cross_view_checks::find_hull_entry(
                &wanted,
                size,
                &masks,
                min_views,
                depth_range,
                steps,
                threads,
            )
        });
        image_array(py, size, found)
    })
}

/// Compute weighted medians of disparities at the pixels in `wanted`, with weights from colour similarity.
#[pyfunction]
#[pyo3(signature = (image, disparity, wanted, *, lowest, count, radius, falloff, wanted_threads))]
#[allow(clippy::too_many_arguments)]
pub fn compute_weighted_medians(
    py: Python<'_>,
    image: RgbArray<'_>,
    disparity: PyReadonlyArray2<'_, f32>,
    wanted: PyReadonlyArray2<'_, bool>,
    lowest: i32,
    count: usize,
    radius: usize,
    falloff: f32,
    wanted_threads: usize,
) -> PyResult<(ImageArray<f32>, ImageArray<f32>, ImageArray<f32>)> {
    let [height, width, _] = *image.as_array().shape() else { unreachable!("an array of three dimensions") };
    let expected = [height, width];
    if disparity.as_array().shape() != expected || wanted.as_array().shape() != expected {
        return Err(PyValueError::new_err("the size of disparity or wanted differs from the image"));
    }
    if radius > 64 || count > 1 << 14 || falloff.is_nan() || falloff <= 0.0 {
        return Err(PyValueError::new_err(
            "radius must be at most 64, count at most 16384, and falloff above 0",
        ));
    }
    with_memory_reserve(width * height, || {
        let (image, size) = copy_image(&image)?;
        let disparity = copy_values(&disparity);
        let wanted = copy_values(&wanted);
        let threads = resolve_thread_count(wanted_threads);
        let medians = py.detach(|| {
            medians_of(&image, &disparity, &wanted, size, lowest, count, radius, falloff, threads)
        });
        Ok((
            image_array(py, size, medians.iter().map(|m| m.disparity).collect())?,
            image_array(py, size, medians.iter().map(|m| m.inlier_ratio).collect())?,
            image_array(py, size, medians.iter().map(|m| m.known_ratio).collect())?,
        ))
    })
}
