//! Samples of the input that say whether a collapse may take place.
//!
//! Every vertex of the input is a sample, and belongs to a triangle of the current mesh within its limits. A collapse has to
//! keep each sample of its star within the limits of the new star, and the new vertex and the middles of its edges
//! within those of the input. Between the samples nothing is certain yet: see [`crate::certified`].
//!
//! Local tracking of the input against the current mesh goes back to Ciampalini, Cignoni, Montani and Scopigno,
//! "Multiresolution decimation based on global error", 1997.

use super::fan::{Fan, FanFoot};
use super::original::{Foot, Original};
use crate::base::geometry::{distance2, position};
use crate::certify::NEEDLE;
use crate::mesh::star::Star;
use crate::mesh::triangle_mesh::Mesh;

/// Samples that take as long as a triangle of a region does.
pub const SAMPLES: usize = 32;

/// Along a new edge: how far to look beyond the end of a triangle, and the steps from look to look.
const BEYOND: f64 = 1.0 / 256.0;
const LEAST_STEP: f64 = 1.0 / 16.0;
const LARGEST_STEP: f64 = 0.5;

/// Height over longest side below which no triangle comes by default: those that a proof takes for a side, and a few more.
pub const LEAST_HEIGHT: f64 = 1.25 * NEEDLE;

/// No sample.
const NONE: u32 = u32::MAX;

/// What a sample may be away from the current mesh, and its colour from the colour there.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Metres; infinite for any.
    pub shape: f64,
    /// Levels, Euclidean over the channels; infinite for any.
    pub color: f64,
    /// By vertex of the input: what both are multiplied with there.
    pub factors: Vec<f32>,
    /// Height over longest side below which no triangle may come: more than [`NEEDLE`].
    pub needle: f64,
}

/// Which limit a collapse would break.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Bound {
    Shape,
    Color,
    /// A triangle would become so thin that searches in single precision overlook it: nothing is proven of those.
    Needle,
}

#[derive(Clone, Copy)]
struct Sample<const D: usize> {
    point: [f64; D],
    factor: f32,
    /// Vertex of the input.
    vertex: u32,
    /// The next sample of the same triangle.
    next: u32,
}

/// The samples of a region.
pub struct Tracker<'a, const D: usize> {
    original: &'a Original<D>,
    limits: &'a Limits,
    samples: Vec<Sample<D>>,
    /// The first sample of each triangle.
    heads: Vec<u32>,
    /// Samples of the star at hand, and the wing each would go to.
    inside: Vec<(u32, u32)>,
    fan: Fan<D>,
}

impl<'a, const D: usize> Tracker<'a, D> {
    /// Samples of a region's triangles.
    pub fn load(original: &'a Original<D>, limits: &'a Limits, lists: &Lists, region: &Mesh<D>) -> Self {
        let mut heads = Vec::with_capacity(region.triangle_source.len());
        let mut samples = vec![];
        for &t in &region.triangle_source {
            let mut head = NONE;
            for &vertex in lists.of(t as usize) {
                let point = original.points[vertex as usize];
                let factor = limits.factors[vertex as usize];
                samples.push(Sample { point, factor, vertex, next: head });
                head = samples.len() as u32 - 1;
            }
            heads.push(head);
        }
        Self { original, limits, samples, heads, inside: vec![], fan: Fan::default() }
    }

    /// Samples of the triangles that are left, in their order.
    pub fn unload(&self, region: &Mesh<D>) -> Sampled {
        let (mut counts, mut samples) = (vec![], Vec::with_capacity(self.samples.len()));
        for t in region.connectivity.triangles() {
            let before = samples.len();
            samples.extend(self.samples_of(t.index()).map(|s| self.samples[s as usize].vertex));
            counts.push((samples.len() - before) as u32);
        }
        Sampled { counts, samples }
    }

    /// The star has become the fan that was allowed last: its samples go to the triangles they were found on.
    pub fn commit(&mut self, star: &Star<D>) {
        for triangle in star.wings.iter().map(|w| w.triangle).chain(star.vanishing.iter().map(|v| v.0)) {
            self.heads[triangle.index()] = NONE;
        }
        for &(s, wing) in &self.inside {
            let head = &mut self.heads[star.wings[wing as usize].triangle.index()];
            self.samples[s as usize].next = std::mem::replace(head, s);
        }
    }

    /// Samples of a triangle.
    fn samples_of(&self, triangle: usize) -> impl Iterator<Item = u32> + '_ {
        let some = |s: u32| (s != NONE).then_some(s);
        std::iter::successors(some(self.heads[triangle]), move |&s| some(self.samples[s as usize].next))
    }

    /// Find the samples of a star; [`Self::allows`] and [`Self::commit`] are about that star then.
    pub fn gather(&mut self, star: &Star<D>) {
        let mut inside = std::mem::take(&mut self.inside);
        inside.clear();
        for (wing, triangle) in star.wings.iter().map(|w| w.triangle).enumerate() {
            inside.extend(self.samples_of(triangle.index()).map(|s| (s, wing as u32)));
        }
        for (triangle, ..) in &star.vanishing {
            inside.extend(self.samples_of(triangle.index()).map(|s| (s, 0)));
        }
        self.inside = inside;
    }

    /// Whether the star may become the fan around `tip`.
    pub fn allows(&mut self, star: &Star<D>, tip: &[f64; D]) -> Result<(), Bound> {
        self.fan.spread(star, tip);
        if self.fan.has_needle(star, self.limits.needle) {
            return Err(Bound::Needle);
        }
        for i in 0..self.inside.len() {
            let sample = &self.samples[self.inside[i].0 as usize];
            // What is above the triangle it belonged to mostly stays there, and then need not be the nearest.
            let place = position(&sample.point);
            let is_within =
                |foot: &FanFoot<D>| self.within(sample.factor, foot.distance2, &sample.point, &foot.point);
            if self.fan.straight(&place, self.inside[i].1).is_some_and(|foot| is_within(&foot).is_ok()) {
                continue;
            }
            let Some(foot) = self.fan.nearest(&place) else { return Err(Bound::Shape) };
            let within = is_within(&foot);
            self.inside[i].1 = foot.wing;
            if let Err(bound) = within {
                // Who refuses now is likely to refuse the next place too.
                self.inside.swap(0, i);
                return Err(bound);
            }
        }
        let start = self.near_original(tip, self.nearest_sample(tip)?)?;
        for wing in &star.wings {
            self.spoke_near_original(tip, &wing.from_point, start)?;
        }
        // A boundary has one more edge than triangles.
        if let Some(last) = star.boundary_neighbours.and_then(|_| self.last_spoke(star)) {
            self.spoke_near_original(tip, &last, start)?;
        }
        Ok(())
    }

    /// The corner of a boundary star that starts no wing.
    fn last_spoke(&self, star: &Star<D>) -> Option<[f64; D]> {
        let starts = |v| star.wings.iter().any(|w| w.from == v);
        star.wings.iter().find(|w| !starts(w.to)).map(|w| w.to_point)
    }

    /// Whether an edge of the new surface is within the limits of the input: looked at wherever it passes from one
    /// triangle of the input to the next, since it is farthest from a triangle at the end of its way along it.
    fn spoke_near_original(&self, tip: &[f64; D], to: &[f64; D], start: Foot<D>) -> Result<(), Bound> {
        let (a, b) = (position(tip), position(to));
        let (mut t, mut foot) = (0.0, start);
        loop {
            let (end, side) = self.original.leaves(foot.triangle, &a, &b, t);
            t = (end + BEYOND).clamp(t + LEAST_STEP, t + LARGEST_STEP);
            if t >= 1.0 {
                return Ok(());
            }
            let point = std::array::from_fn(|i| tip[i] + t * (to[i] - tip[i]));
            // Most often the next triangle will do; if not, there may be a nearer one.
            let next = self.original.across(foot.triangle, side).unwrap_or(foot.triangle);
            let beside = self.original.foot(&position(&point), next);
            foot = match self.foot_within(&point, beside) {
                Ok(()) => beside,
                Err(_) => self.near_original(&point, foot.vertex)?,
            };
        }
    }

    /// The sample of the star that is nearest to a point.
    fn nearest_sample(&self, point: &[f64; D]) -> Result<u32, Bound> {
        let mut nearest = (f64::INFINITY, NONE);
        for (s, _) in &self.inside {
            let sample = &self.samples[*s as usize];
            let distance2 = distance2(&sample.point, point);
            if distance2 < nearest.0 {
                nearest = (distance2, sample.vertex);
            }
        }
        if nearest.1 == NONE { Err(Bound::Shape) } else { Ok(nearest.1) }
    }

    /// Whether a point of the new surface is within the limits of the input, which is searched from the vertex `start`.
    fn near_original(&self, point: &[f64; D], start: u32) -> Result<Foot<D>, Bound> {
        let Some(foot) = self.original.walk(&position(point), start) else { return Err(Bound::Shape) };
        self.foot_within(point, foot).map(|()| foot)
    }

    /// Whether a point of the new surface is within the limits of one of the input.
    #[inline]
    fn foot_within(&self, point: &[f64; D], foot: Foot<D>) -> Result<(), Bound> {
        self.within(self.limits.factors[foot.vertex as usize], foot.distance2, point, &foot.point)
    }

    #[inline]
    fn within(&self, factor: f32, distance2: f64, a: &[f64; D], b: &[f64; D]) -> Result<(), Bound> {
        let factor = f64::from(factor);
        let shape = self.limits.shape * factor;
        if distance2 > shape * shape {
            return Err(Bound::Shape);
        }
        let color = self.limits.color * factor;
        let color2: f64 = (3..D).map(|i| (a[i] - b[i]) * (a[i] - b[i])).sum();
        if color2 > color * color { Err(Bound::Color) } else { Ok(()) }
    }
}

/// Samples by triangle of the whole mesh. Samples are vertices of the input.
pub struct Lists {
    /// Samples of triangle t: `samples[starts[t]..starts[t + 1]]`.
    pub starts: Vec<u32>,
    pub samples: Vec<u32>,
}

impl Lists {
    /// Those of the input itself: each vertex belongs to the first triangle that has it.
    pub fn of_input<const D: usize>(original: &Original<D>) -> Self {
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

    pub fn of(&self, triangle: usize) -> &[u32] {
        &self.samples[self.starts[triangle] as usize..self.starts[triangle + 1] as usize]
    }

    /// Those of some triangles, as a tracker that was not used leaves them.
    pub fn untouched(&self, triangles: &[u32]) -> Sampled {
        let lists = || triangles.iter().map(|&t| self.of(t as usize));
        Sampled {
            counts: lists().map(|list| list.len() as u32).collect(),
            // Each sample is put before those that are there.
            samples: lists().flat_map(|list| list.iter().rev()).copied().collect(),
        }
    }

    /// Those of the next whole mesh: the triangles of each piece.
    pub fn join(&self, pieces: Vec<Sampled>) -> Self {
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

/// Samples of a region's triangles, in their order.
pub struct Sampled {
    counts: Vec<u32>,
    samples: Vec<u32>,
}
