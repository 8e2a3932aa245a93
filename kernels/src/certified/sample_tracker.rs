//! Samples of the input that limit which collapses are allowed.
//!
//! Every input vertex is a sample and belongs to a triangle of the current mesh within its limits. After a
//! collapse, the distance of each sample of the star to the new star must be within its limits. The new
//! vertex and check points on the new edges must be within the limits of the input. Points between the
//! samples are not certified here: see [`crate::certified`].
//!
//! Local tracking of the input against the current mesh goes back to Ciampalini, Cignoni, Montani and
//! Scopigno, "Multiresolution decimation based on global error", 1997.

use super::collapsed_star::{CollapsedStar, NearestFanPoint};
use super::input_surface::{InputSurface, NearestPoint};
use crate::base::geometry::{distance2, position_of};
use crate::certify::NEEDLE_RATIO;
use crate::mesh::edge_star::EdgeStar;
use crate::mesh::triangle_mesh::Mesh;

/// Samples that cost as much time as one triangle of a region.
pub const SAMPLES_PER_TRIANGLE_COST: usize = 32;

/// Check points along a new edge, as ratios of its length: the distance past the end of an input triangle,
/// and the minimum and maximum step between two check points.
const STEP_PAST_BORDER: f64 = 1.0 / 256.0;
const MIN_STEP: f64 = 1.0 / 16.0;
const MAX_STEP: f64 = 0.5;

/// Default minimum ratio of height to longest side of a triangle. Proofs reduce thinner triangles to their
/// longest side; the factor leaves a margin.
pub const DEFAULT_MIN_NEEDLE_RATIO: f64 = 1.25 * NEEDLE_RATIO;

/// Marks the end of a sample list.
const NO_SAMPLE: u32 = u32::MAX;

/// Maximum distance of a sample from the current mesh, and maximum colour difference there.
#[derive(Clone, Debug)]
pub struct SampleLimits {
    /// Metres; infinite for no limit.
    pub shape: f64,
    /// Levels, Euclidean norm over the channels; infinite for no limit.
    pub color: f64,
    /// Factor on both limits, by input vertex.
    pub factors: Vec<f32>,
    /// Minimum ratio of height to longest side; must be above [`NEEDLE`].
    pub min_needle_ratio: f64,
}

/// The limit that a collapse would break.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum LimitKind {
    Shape,
    Color,
    /// A triangle would become so thin that single-precision searches miss it; the proof does not cover such
    /// triangles.
    Needle,
}

/// An input vertex, in a linked list of samples per triangle.
#[derive(Clone, Copy)]
struct Sample<const D: usize> {
    point: [f64; D],
    factor: f32,
    /// Input vertex.
    vertex: u32,
    /// Next sample of the same triangle.
    next: u32,
}

/// Samples of a region.
pub struct SampleTracker<'a, const D: usize> {
    original: &'a InputSurface<D>,
    limits: &'a SampleLimits,
    samples: Vec<Sample<D>>,
    /// First sample of each triangle.
    heads: Vec<u32>,
    /// Samples of the gathered star, and the wing each would move to.
    star_samples: Vec<(u32, u32)>,
    fan: CollapsedStar<D>,
}

impl<'a, const D: usize> SampleTracker<'a, D> {
    /// Load the samples of the triangles of a region.
    pub fn load(
        original: &'a InputSurface<D>,
        limits: &'a SampleLimits,
        lists: &SampleLists,
        region: &Mesh<D>,
    ) -> Self {
        let mut heads = Vec::with_capacity(region.triangle_source.len());
        let mut samples = vec![];
        for &t in &region.triangle_source {
            let mut head = NO_SAMPLE;
            for &vertex in lists.of_triangle(t as usize) {
                let point = original.points[vertex as usize];
                let factor = limits.factors[vertex as usize];
                samples.push(Sample { point, factor, vertex, next: head });
                head = samples.len() as u32 - 1;
            }
            heads.push(head);
        }
        Self { original, limits, samples, heads, star_samples: vec![], fan: CollapsedStar::default() }
    }

    /// Return the samples of the remaining triangles, in triangle order.
    pub fn unload(&self, region: &Mesh<D>) -> RegionSamples {
        let (mut counts, mut samples) = (vec![], Vec::with_capacity(self.samples.len()));
        for t in region.connectivity.triangles() {
            let before = samples.len();
            samples.extend(self.samples_of(t.index()).map(|s| self.samples[s as usize].vertex));
            counts.push((samples.len() - before) as u32);
        }
        RegionSamples { counts, samples }
    }

    /// Apply the collapse that [`Self::check`] accepted last: move each sample to the wing found for it.
    pub fn commit(&mut self, star: &EdgeStar<D>) {
        for triangle in star.remaining.iter().map(|w| w.triangle).chain(star.vanishing.iter().map(|v| v.0)) {
            self.heads[triangle.index()] = NO_SAMPLE;
        }
        for &(s, wing) in &self.star_samples {
            let head = &mut self.heads[star.remaining[wing as usize].triangle.index()];
            self.samples[s as usize].next = std::mem::replace(head, s);
        }
    }

    /// Iterate over the samples of a triangle.
    fn samples_of(&self, triangle: usize) -> impl Iterator<Item = u32> + '_ {
        let some = |s: u32| (s != NO_SAMPLE).then_some(s);
        std::iter::successors(some(self.heads[triangle]), move |&s| some(self.samples[s as usize].next))
    }

    /// Collect the samples of a star, for [`Self::check`] and [`Self::commit`].
    pub fn gather_samples(&mut self, star: &EdgeStar<D>) {
        let mut inside = std::mem::take(&mut self.star_samples);
        inside.clear();
        for (wing, triangle) in star.remaining.iter().map(|w| w.triangle).enumerate() {
            inside.extend(self.samples_of(triangle.index()).map(|s| (s, wing as u32)));
        }
        for (triangle, ..) in &star.vanishing {
            inside.extend(self.samples_of(triangle.index()).map(|s| (s, 0)));
        }
        self.star_samples = inside;
    }

    /// Check the limits for the star with both ends moved to `tip`.
    pub fn check(&mut self, star: &EdgeStar<D>, tip: &[f64; D]) -> Result<(), LimitKind> {
        self.fan.rebuild(star, tip);
        if self.fan.creates_needle(star, self.limits.min_needle_ratio) {
            return Err(LimitKind::Needle);
        }
        for i in 0..self.star_samples.len() {
            let sample = &self.samples[self.star_samples[i].0 as usize];
            // Try the projection onto the previous triangle first: if that is within the limits, the nearest
            // point is not needed.
            let place = position_of(&sample.point);
            let is_within = |foot: &NearestFanPoint<D>| {
                self.check_distance(sample.factor, foot.distance2, &sample.point, &foot.point)
            };
            if self
                .fan
                .project_onto_wing(&place, self.star_samples[i].1)
                .is_some_and(|foot| is_within(&foot).is_ok())
            {
                continue;
            }
            let Some(foot) = self.fan.find_nearest(&place) else { return Err(LimitKind::Shape) };
            let within = is_within(&foot);
            self.star_samples[i].1 = foot.wing;
            if let Err(bound) = within {
                // The sample that refuses one position probably refuses the next one too: test it first.
                self.star_samples.swap(0, i);
                return Err(bound);
            }
        }
        let start = self.check_point(tip, self.find_nearest_sample(tip)?)?;
        for wing in &star.remaining {
            self.check_spoke(tip, &wing.from_point, start)?;
        }
        // A boundary star has one more spoke than wings.
        if let Some(last) = star.boundary_neighbours.and_then(|_| self.find_last_spoke(star)) {
            self.check_spoke(tip, &last, start)?;
        }
        Ok(())
    }

    /// Find the last neighbour of a boundary star, which starts no wing.
    fn find_last_spoke(&self, star: &EdgeStar<D>) -> Option<[f64; D]> {
        let starts = |v| star.remaining.iter().any(|w| w.side_start == v);
        star.remaining.iter().find(|w| !starts(w.side_end)).map(|w| w.to_point)
    }

    /// Check that a new edge is within the limits of the input.
    ///
    /// The distance to an input triangle is largest where the edge leaves it. The edge is therefore tested
    /// shortly after each crossing between input triangles.
    fn check_spoke(&self, tip: &[f64; D], to: &[f64; D], start: NearestPoint<D>) -> Result<(), LimitKind> {
        let (a, b) = (position_of(tip), position_of(to));
        let (mut t, mut foot) = (0.0, start);
        loop {
            let (end, side) = self.original.find_prism_exit(foot.triangle, &a, &b, t);
            t = (end + STEP_PAST_BORDER).clamp(t + MIN_STEP, t + MAX_STEP);
            if t >= 1.0 {
                return Ok(());
            }
            let point = std::array::from_fn(|i| tip[i] + t * (to[i] - tip[i]));
            // Usually the neighbouring triangle is near enough; if not, search for a nearer one.
            let next = self.original.neighbour_across(foot.triangle, side).unwrap_or(foot.triangle);
            let beside = self.original.nearest_on(&position_of(&point), next);
            foot = match self.check_nearest(&point, beside) {
                Ok(()) => beside,
                Err(_) => self.check_point(&point, foot.vertex)?,
            };
        }
    }

    /// Find the sample of the star that is nearest to a point.
    fn find_nearest_sample(&self, point: &[f64; D]) -> Result<u32, LimitKind> {
        let mut nearest = (f64::INFINITY, NO_SAMPLE);
        for (s, _) in &self.star_samples {
            let sample = &self.samples[*s as usize];
            let distance2 = distance2(&sample.point, point);
            if distance2 < nearest.0 {
                nearest = (distance2, sample.vertex);
            }
        }
        if nearest.1 == NO_SAMPLE { Err(LimitKind::Shape) } else { Ok(nearest.1) }
    }

    /// Check a point of the new surface against the input, searching from vertex `start`.
    fn check_point(&self, point: &[f64; D], start: u32) -> Result<NearestPoint<D>, LimitKind> {
        let Some(foot) = self.original.find_near(&position_of(point), start) else {
            return Err(LimitKind::Shape);
        };
        self.check_nearest(point, foot).map(|()| foot)
    }

    /// Check a point of the new surface against a point of the input.
    #[inline]
    fn check_nearest(&self, point: &[f64; D], foot: NearestPoint<D>) -> Result<(), LimitKind> {
        self.check_distance(self.limits.factors[foot.vertex as usize], foot.distance2, point, &foot.point)
    }

    #[inline]
    fn check_distance(
        &self,
        factor: f32,
        distance2: f64,
        a: &[f64; D],
        b: &[f64; D],
    ) -> Result<(), LimitKind> {
        let factor = f64::from(factor);
        let shape = self.limits.shape * factor;
        if distance2 > shape * shape {
            return Err(LimitKind::Shape);
        }
        let color = self.limits.color * factor;
        let color2: f64 = (3..D).map(|i| (a[i] - b[i]) * (a[i] - b[i])).sum();
        if color2 > color * color { Err(LimitKind::Color) } else { Ok(()) }
    }
}

/// Samples (input vertices) by triangle of the whole mesh.
pub struct SampleLists {
    /// Samples of triangle t: `samples[starts[t]..starts[t + 1]]`.
    pub starts: Vec<u32>,
    pub samples: Vec<u32>,
}

impl SampleLists {
    /// Assign each input vertex to the first triangle that uses it.
    pub fn of_input<const D: usize>(original: &InputSurface<D>) -> Self {
        let mut owned = vec![false; original.points.len()];
        let mut starts = Vec::with_capacity(original.triangles.len() + 1);
        let mut samples = Vec::with_capacity(original.points.len());
        starts.push(0);
        for corners in &original.triangles {
            for &v in corners {
                if !std::mem::replace(&mut owned[v as usize], true) {
                    samples.push(v);
                }
            }
            starts.push(samples.len() as u32);
        }
        Self { starts, samples }
    }

    /// Return the samples of a triangle.
    pub fn of_triangle(&self, triangle: usize) -> &[u32] {
        &self.samples[self.starts[triangle] as usize..self.starts[triangle + 1] as usize]
    }

    /// Return the samples of some triangles, as loading and unloading a tracker would.
    pub fn unchanged_region(&self, triangles: &[u32]) -> RegionSamples {
        let lists = || triangles.iter().map(|&t| self.of_triangle(t as usize));
        RegionSamples {
            counts: lists().map(|list| list.len() as u32).collect(),
            // A tracker inserts samples at the head of a list, so it returns them in reverse.
            samples: lists().flat_map(|list| list.iter().rev()).copied().collect(),
        }
    }

    /// Concatenate the samples of all regions.
    pub fn join(&self, pieces: Vec<RegionSamples>) -> Self {
        let mut starts = Vec::with_capacity(1 + pieces.iter().map(|p| p.counts.len()).sum::<usize>());
        let mut samples = Vec::with_capacity(self.samples.len());
        starts.push(0);
        for piece in pieces {
            for count in piece.counts {
                starts.push(starts.last().unwrap_or(&0) + count);
            }
            samples.extend(piece.samples);
        }
        Self { starts, samples }
    }
}

/// Samples of the triangles of a region, in triangle order.
pub struct RegionSamples {
    counts: Vec<u32>,
    samples: Vec<u32>,
}
