//! Surface points, each with samples from the few photos that show it best.

use std::collections::BTreeMap;
use std::ops::Range;

use super::photo_sampling::ColorPair;
use super::photo_view::{
    POINTS_PER_BATCH, PhotoColors, PhotoView, PointSlices, PointState, ProjectedPoints, ViewKind,
};
use super::zbuffer::NO_TRIANGLE;
use crate::base::by_processor::by_processor;
use crate::base::errors::KernelError;
use crate::base::geometry::Vec3;
use crate::base::parallel::for_each_part;
use crate::base::progress::Progress;

/// Points per part of work, rounded to whole triangles.
const POINTS_PER_PART: u32 = 1 << 14;

/// Maximum number of photos kept per point.
pub const MAX_SAMPLES: usize = 16;

/// Sparse bit set of triangles: (word index, 64 bits); zero words are omitted.
type TriangleBits = Vec<(u32, u64)>;

/// Samples of a point in its best photos: scores, view indices, and colours in the photo and in the blurred
/// photo.
#[derive(Clone, Copy, Debug, Default)]
pub struct PointSamples<'a> {
    pub scores: &'a [f32],
    pub views: &'a [u16],
    pub colors: &'a [[[u8; 3]; 2]],
}

impl PointSamples<'_> {
    pub fn len(&self) -> usize {
        self.scores.len()
    }

    pub fn is_empty(&self) -> bool {
        self.scores.is_empty()
    }

    /// Compare two samples by score; at equal scores the lower view index is better.
    #[inline]
    pub fn is_better(&self, one: usize, other: usize) -> bool {
        let [this, that] = [one, other].map(|i| (self.scores[i], std::cmp::Reverse(self.views[i])));
        this > that
    }
}

/// Points on a mesh surface, grouped by triangle.
#[derive(Debug)]
pub struct SurfacePoints {
    /// Coordinates per axis, relative to `origin`.
    places: [Vec<f32>; 3],
    normals: [Vec<f32>; 3],
    origin: Vec3,
    /// First point of each triangle, and the total number of points.
    first: Vec<u32>,
    triangles: Vec<[u32; 3]>,
    around: VertexTriangles,
    /// Number of samples kept per point, unordered: score (0 for an empty entry), view index, and colours in
    /// the photo and in the blurred photo.
    kept: usize,
    scores: Vec<f32>,
    views: Vec<u16>,
    colors: Vec<[[u8; 3]; 2]>,
    /// Minimum score of each point's samples, which a new sample must exceed.
    min_scores: Vec<f32>,
    /// Triangles that each view may show, for the views to be revisited.
    looked_at: BTreeMap<u16, TriangleBits>,
    /// Maximum resolution over all photos, in pixels per metre; 0 where no photo shows the point.
    pub density: Vec<f32>,
    /// Best kind of view of each point; samples and density come only from views of this kind.
    pub looks: Vec<ViewKind>,
}

impl SurfacePoints {
    /// Create points in the order of their triangles. `samples_per_point` is at most [`MAX_SAMPLES`].
    ///
    /// # Errors
    /// [`KernelError::OutOfMemory`] if the samples do not fit in memory.
    pub fn new(
        points: &[Vec3],
        normals: Vec<[f32; 3]>,
        first: Vec<u32>,
        triangles: Vec<[u32; 3]>,
        vertices: usize,
        kept: usize,
    ) -> Result<Self, KernelError> {
        let origin = points.first().copied().unwrap_or_default();
        let samples = points.len() * kept;
        let places = [0, 1, 2].map(|k| points.iter().map(|p| (p[k] - origin[k]) as f32).collect());
        Ok(Self {
            places,
            normals: [0, 1, 2].map(|k| normals.iter().map(|n| n[k]).collect()),
            origin,
            kept,
            scores: allocate_default(samples)?,
            views: allocate_default(samples)?,
            colors: allocate_default(samples)?,
            min_scores: allocate_default(points.len())?,
            looked_at: BTreeMap::new(),
            density: allocate_default(points.len())?,
            looks: allocate_default(points.len())?,
            around: VertexTriangles::new(&triangles, vertices),
            first,
            triangles,
        })
    }

    pub fn len(&self) -> usize {
        self.looks.len()
    }

    pub fn is_empty(&self) -> bool {
        self.looks.is_empty()
    }

    /// Return the number of samples kept per point.
    pub fn samples_per_point(&self) -> usize {
        self.kept
    }

    /// Return the samples of a point, unordered.
    #[inline]
    pub fn samples(&self, point: usize) -> PointSamples<'_> {
        let all = point * self.kept..(point + 1) * self.kept;
        let scores = &self.scores[all.clone()];
        // Entries are filled from the front.
        let count = scores.iter().filter(|&&score| score > 0.0).count();
        PointSamples {
            scores: &scores[..count],
            views: &self.views[all.clone()][..count],
            colors: &self.colors[all][..count],
        }
    }

    /// Add the samples of one more view. With `remember`, [`SurfacePoints::update_view_colors`] can update them later.
    /// Returns the triangles that the view may show, in ascending order.
    pub fn add_view(
        &mut self,
        view: &PhotoView,
        number: u16,
        remember: bool,
        threads: usize,
        progress: &Progress,
    ) -> Result<Vec<u32>, KernelError> {
        let looked_at = self.visible_triangles(view);
        self.for_each_point_range(&looked_at, threads, ProjectedPoints::default, |some, appear| {
            see(view, number, some, appear)
        });
        progress.check()?;
        let triangles = looked_at.iter().flat_map(|&word| bit_indices(word)).collect();
        if remember {
            self.looked_at.insert(number, looked_at);
        }
        Ok(triangles)
    }

    /// Update the colours of a view's samples, where it is among the best.
    pub fn update_view_colors(
        &mut self,
        colors: &PhotoColors,
        number: u16,
        threads: usize,
        progress: &Progress,
    ) -> Result<(), KernelError> {
        let looked_at = self.looked_at.remove(&number).unwrap_or_default();
        self.for_each_point_range(&looked_at, threads, || (), |some, ()| see_again(colors, number, some));
        self.looked_at.insert(number, looked_at);
        progress.check()
    }

    /// Find the triangles that a view may show: those visible at a pixel, and their neighbours, which may be
    /// smaller than a pixel.
    fn visible_triangles(&mut self, view: &PhotoView) -> TriangleBits {
        let mut last = NO_TRIANGLE;
        for &triangle in &view.triangles {
            if triangle != last && triangle != NO_TRIANGLE {
                self.around.mark(&self.triangles[triangle as usize]);
            }
            last = triangle;
        }
        self.around.take_marked()
    }

    /// Call `change` on the points of some triangles, on several threads; consecutive triangles are passed
    /// together.
    fn for_each_point_range<S>(
        &mut self,
        triangles: &[(u32, u64)],
        threads: usize,
        scratch: impl Fn() -> S + Sync,
        change: impl Fn(PointRange<'_>, &mut S) + Sync,
    ) {
        let mut rest = triangles;
        let mut parts = self.parts();
        // Skip the parts that contain none of the triangles.
        parts.retain(|part| {
            let before = rest.partition_point(|&(word, _)| (word as usize + 1) * 64 <= part.start);
            rest = &rest[before..];
            rest.first().is_some_and(|&(word, _)| (word as usize) * 64 < part.start + part.first.len() - 1)
        });
        for_each_part(parts, threads, |mut part: PointPart<'_>| {
            let end = part.start + part.first.len() - 1;
            let from = triangles.partition_point(|&(word, _)| (word as usize + 1) * 64 <= part.start);
            let words = triangles[from..].iter().take_while(|&&(word, _)| (word as usize) * 64 < end);
            let here = words.flat_map(|&word| bit_indices(word)).map(|t| t as usize);
            let (mut points, mut scratch) = (0..0, scratch());
            for t in here.filter(|t| (part.start..end).contains(t)) {
                let [begin, end] = [0, 1].map(|k| (part.first[t - part.start + k] - part.first[0]) as usize);
                if begin != points.end {
                    change(part.points.slice(points), &mut scratch);
                    points = begin..begin;
                }
                points.end = end;
            }
            change(part.points.slice(points), &mut scratch);
        });
    }

    /// Split all points into parts of whole triangles.
    fn parts(&mut self) -> Vec<PointPart<'_>> {
        let mut rest = PointRange {
            places: PointSlices {
                origin: self.origin,
                coordinates: self.places.each_ref().map(Vec::as_slice),
                normals: self.normals.each_ref().map(Vec::as_slice),
            },
            kept: self.kept,
            scores: &mut self.scores,
            views: &mut self.views,
            colors: &mut self.colors,
            least: &mut self.min_scores,
            density: &mut self.density,
            looks: &mut self.looks,
        };
        let (mut parts, mut start) = (vec![], 0);
        while start < self.triangles.len() {
            let begin = self.first[start];
            let more = self.first[start + 1..].partition_point(|&point| point - begin < POINTS_PER_PART);
            let end = (start + 1 + more).min(self.triangles.len());
            let size = (self.first[end] - begin) as usize;
            let (points, after) = rest.split(size);
            parts.push(PointPart { start, first: &self.first[start..=end], points });
            (rest, start) = (after, end);
        }
        parts
    }
}

by_processor! {
    fn see(view: &PhotoView, number: u16, points: PointRange<'_>, appear: &mut ProjectedPoints) = add_view_samples_scalar
}

#[inline(always)]
fn add_view_samples_scalar(
    view: &PhotoView,
    number: u16,
    mut points: PointRange<'_>,
    appear: &mut ProjectedPoints,
) {
    let count = points.looks.len();
    for start in (0..count).step_by(POINTS_PER_BATCH) {
        let some = points.slice(start..(start + POINTS_PER_BATCH).min(count));
        view.project_points(&some.places, appear);
        for i in 0..some.looks.len() {
            let known = PointState { look: some.looks[i], score: some.least[i], density: some.density[i] };
            let Some(seen) = view.observe(appear, i, &known) else { continue };
            let samples = i * some.kept..(i + 1) * some.kept;
            if seen.look != some.looks[i] {
                // The first view of this kind, which is better than all views before: discard their samples.
                some.scores[samples.clone()].fill(0.0);
                (some.looks[i], some.density[i], some.least[i]) = (seen.look, 0.0, 0.0);
            }
            some.density[i] = some.density[i].max(seen.density);
            if seen.score > some.least[i] {
                let (scores, views) = (&mut some.scores[samples.clone()], &mut some.views[samples.clone()]);
                let worst = sample_to_replace(scores, views, some.least[i]);
                (scores[worst], views[worst]) = (seen.score, number);
                some.colors[samples.start + worst] = to_rgb_pair(seen.levels);
                some.least[i] = min_score(scores);
            }
        }
    }
}

by_processor! {
    fn see_again(colors: &PhotoColors, number: u16, points: PointRange<'_>) = update_samples_scalar
}

#[inline(always)]
fn update_samples_scalar(colors: &PhotoColors, number: u16, points: PointRange<'_>) {
    let kept = points.kept;
    let mut found = [0; POINTS_PER_BATCH];
    let mut places = [[0.0; POINTS_PER_BATCH]; 3];
    let mut count = 0;
    let mut take = |found: &[usize], places: &[[f64; POINTS_PER_BATCH]; 3]| {
        let mut pixels = [[0.0; POINTS_PER_BATCH]; 2];
        for i in 0..found.len() {
            let place = [0, 1, 2].map(|k| places[k][i]);
            [pixels[0][i], pixels[1][i]] = colors.camera.project(&colors.camera.to_camera(&place));
        }
        for (i, &sample) in found.iter().enumerate() {
            points.colors[sample] = to_rgb_pair(colors.sample([pixels[0][i], pixels[1][i]]).0);
        }
    };
    for (i, views) in points.views.chunks_exact(kept).enumerate() {
        let is_here = pack_bits(views.iter().map(|&view| view == number));
        if is_here == 0 {
            continue;
        }
        let sample = i * kept + is_here.trailing_zeros() as usize;
        if points.scores[sample] <= 0.0 {
            continue;
        }
        for (k, place) in points.places.position(i).into_iter().enumerate() {
            places[k][count] = place;
        }
        found[count] = sample;
        count += 1;
        if count == POINTS_PER_BATCH {
            take(&found, &places);
            count = 0;
        }
    }
    take(&found[..count], &places);
}

/// Pack booleans into bits.
#[inline(always)]
fn pack_bits(all: impl Iterator<Item = bool>) -> u32 {
    (0..).zip(all).fold(0, |bits, (k, is)| bits | u32::from(is) << k)
}

#[inline(always)]
fn to_rgb_pair(levels: ColorPair) -> [[u8; 3]; 2] {
    levels.map(|[red, green, blue, _]| [red, green, blue])
}

/// Return the index of the sample to replace: an empty entry, or the worst; at equal scores the highest view
/// index.
#[inline(always)]
fn sample_to_replace(scores: &[f32], views: &[u16], least: f32) -> usize {
    let is_least = |k: &usize| scores[*k] == least;
    let first = (0..scores.len()).find(is_least).unwrap_or(0);
    if least == 0.0 {
        return first;
    }
    (first + 1..scores.len())
        .filter(is_least)
        .fold(first, |worst, k| if views[k] > views[worst] { k } else { worst })
}

/// Compute the minimum of non-negative scores. Their bits are compared as integers, which have the same order
/// and vectorise.
#[inline(always)]
fn min_score(scores: &[f32]) -> f32 {
    let (fours, rest) = scores.as_chunks::<4>();
    let least = fours
        .iter()
        .fold([u32::MAX; 4], |least, four| std::array::from_fn(|k| least[k].min(four[k].to_bits())));
    let all = least.into_iter().chain(rest.iter().map(|score| score.to_bits()));
    f32::from_bits(all.fold(u32::MAX, u32::min))
}

/// Allocate default values.
///
/// # Errors
/// [`KernelError::OutOfMemory`] if they do not fit in memory.
fn allocate_default<T: Clone + Default>(count: usize) -> Result<Vec<T>, KernelError> {
    let mut values = vec![];
    values.try_reserve_exact(count).map_err(|_| KernelError::OutOfMemory)?;
    values.resize(count, T::default());
    Ok(values)
}

/// Iterate over the indices in one word of a bit set.
fn bit_indices((word, bits): (u32, u64)) -> impl Iterator<Item = u32> {
    let mut rest = bits;
    std::iter::from_fn(move || {
        let bit = (rest != 0).then(|| rest.trailing_zeros())?;
        rest &= rest - 1;
        Some(word * 64 + bit)
    })
}

/// Triangles around each vertex, with marks, to collect the triangles around a few vertices without a scan of
/// all.
#[derive(Debug)]
struct VertexTriangles {
    /// Start of each vertex's triangles, and the end of the last.
    first: Vec<u32>,
    triangles: Vec<u32>,
    is_marked: Vec<bool>,
    marked: Vec<u32>,
    /// Bit set that is zero outside of `take_marked`.
    words: Vec<u64>,
}

impl VertexTriangles {
    fn new(triangles: &[[u32; 3]], vertices: usize) -> Self {
        let mut first = vec![0u32; vertices + 1];
        triangles.iter().flatten().for_each(|&v| first[v as usize + 1] += 1);
        (0..vertices).for_each(|v| first[v + 1] += first[v]);
        let mut next = first.clone();
        let mut around = vec![0; 3 * triangles.len()];
        for (t, corners) in (0..).zip(triangles) {
            for &v in corners {
                around[next[v as usize] as usize] = t;
                next[v as usize] += 1;
            }
        }
        let words = vec![0; triangles.len().div_ceil(64)];
        Self { first, triangles: around, is_marked: vec![false; vertices], marked: vec![], words }
    }

    fn mark(&mut self, corners: &[u32; 3]) {
        for &v in corners {
            if !std::mem::replace(&mut self.is_marked[v as usize], true) {
                self.marked.push(v);
            }
        }
    }

    /// Collect the triangles around all marked vertices, and clear the marks.
    fn take_marked(&mut self) -> TriangleBits {
        let mut touched = vec![];
        for v in self.marked.drain(..) {
            self.is_marked[v as usize] = false;
            let [from, to] = [self.first[v as usize], self.first[v as usize + 1]].map(|i| i as usize);
            for &t in &self.triangles[from..to] {
                let word = &mut self.words[t as usize / 64];
                if *word == 0 {
                    touched.push(t / 64);
                }
                *word |= 1 << (t % 64);
            }
        }
        touched.sort_unstable();
        touched.into_iter().map(|w| (w, std::mem::take(&mut self.words[w as usize]))).collect()
    }
}

/// Points of consecutive triangles.
struct PointPart<'a> {
    /// First triangle; first point of each triangle, and the end of the last.
    start: usize,
    first: &'a [u32],
    points: PointRange<'a>,
}

/// Mutable view of consecutive points.
struct PointRange<'a> {
    places: PointSlices<'a>,
    kept: usize,
    scores: &'a mut [f32],
    views: &'a mut [u16],
    colors: &'a mut [[[u8; 3]; 2]],
    least: &'a mut [f32],
    density: &'a mut [f32],
    looks: &'a mut [ViewKind],
}

impl<'a> PointRange<'a> {
    /// Split after `count` points.
    fn split(self, count: usize) -> (Self, Self) {
        let kept = self.kept;
        let [first, after] = [0..count, count..self.looks.len()].map(|range| PointSlices {
            origin: self.places.origin,
            coordinates: self.places.coordinates.map(|axis| &axis[range.clone()]),
            normals: self.places.normals.map(|axis| &axis[range.clone()]),
        });
        let scores = self.scores.split_at_mut(count * kept);
        let views = self.views.split_at_mut(count * kept);
        let colors = self.colors.split_at_mut(count * kept);
        let least = self.least.split_at_mut(count);
        let density = self.density.split_at_mut(count);
        let looks = self.looks.split_at_mut(count);
        let one = |places, scores, views, colors, least, density, looks| Self {
            places,
            kept,
            scores,
            views,
            colors,
            least,
            density,
            looks,
        };
        (
            one(first, scores.0, views.0, colors.0, least.0, density.0, looks.0),
            one(after, scores.1, views.1, colors.1, least.1, density.1, looks.1),
        )
    }

    fn slice(&mut self, range: Range<usize>) -> PointRange<'_> {
        let samples = range.start * self.kept..range.end * self.kept;
        PointRange {
            places: PointSlices {
                origin: self.places.origin,
                coordinates: self.places.coordinates.map(|axis| &axis[range.clone()]),
                normals: self.places.normals.map(|axis| &axis[range.clone()]),
            },
            kept: self.kept,
            scores: &mut self.scores[samples.clone()],
            views: &mut self.views[samples.clone()],
            colors: &mut self.colors[samples],
            least: &mut self.least[range.clone()],
            density: &mut self.density[range.clone()],
            looks: &mut self.looks[range],
        }
    }
}
