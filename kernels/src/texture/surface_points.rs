//! Points of the surface, each with the few photos that show it best.

use super::view::{Seen, View};
use super::zbuffer::NOTHING;
use crate::base::errors::KernelError;
use crate::base::geometry::Vec3;
use crate::base::parallel::each;
use crate::base::progress::Progress;

/// Points a thread takes at a time, in whole triangles.
const PART: usize = 1 << 14;

/// A point in one photo.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// 0 where there is none.
    pub score: f32,
    pub view: u16,
    pub color: [u8; 3],
    pub blurred: [u8; 3],
}

/// Points of a mesh's surface, by their triangles.
#[derive(Debug)]
pub struct SurfacePoints {
    places: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    /// Places are stored from here.
    origin: Vec3,
    /// The first point of each triangle, and the number of points.
    first: Vec<u32>,
    /// Triangles around each vertex's triangles: by triangle, its corners.
    triangles: Vec<[u32; 3]>,
    vertices: usize,
    /// Of each point, the best first.
    samples: Vec<Sample>,
    kept: usize,
    /// Pixels a metre in the photo that is best, and how many photos show the point.
    pub density: Vec<f32>,
    pub seen: Vec<u16>,
}

impl SurfacePoints {
    /// Points in the order of their triangles.
    ///
    /// # Errors
    /// [`KernelError::OutOfMemory`] if there is no room for `kept` samples of each.
    pub fn new(
        points: &[Vec3],
        normals: Vec<[f32; 3]>,
        first: Vec<u32>,
        triangles: Vec<[u32; 3]>,
        vertices: usize,
        kept: usize,
    ) -> Result<Self, KernelError> {
        let origin = points.first().copied().unwrap_or_default();
        let mut samples = vec![];
        samples.try_reserve_exact(points.len() * kept).map_err(|_| KernelError::OutOfMemory)?;
        samples.resize(points.len() * kept, Sample::default());
        let places = points.iter().map(|p| [0, 1, 2].map(|i| (p[i] - origin[i]) as f32)).collect();
        let (density, seen) = (vec![0.0; points.len()], vec![0; points.len()]);
        Ok(Self { places, normals, origin, first, triangles, vertices, samples, kept, density, seen })
    }

    pub fn len(&self) -> usize {
        self.places.len()
    }

    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// The samples of a point, the best first; those of score 0 stand for none.
    pub fn samples(&self, point: usize) -> &[Sample] {
        &self.samples[point * self.kept..][..self.kept]
    }

    /// All samples, those of a point together.
    pub fn all_samples(&self) -> (&[Sample], usize) {
        (&self.samples, self.kept)
    }

    /// Look at all points from one more camera.
    ///
    /// # Errors
    /// As [`Progress::check`].
    pub fn see(
        &mut self,
        view: &View,
        number: u16,
        threads: usize,
        progress: &Progress,
    ) -> Result<(), KernelError> {
        let looked_at = self.looked_at(view);
        each(self.parts(&looked_at), threads, |part| part.see(view, number));
        progress.check()
    }

    /// Take the colours of a camera anew, where it is among the best.
    ///
    /// # Errors
    /// As [`Progress::check`].
    pub fn see_again(
        &mut self,
        view: &View,
        number: u16,
        threads: usize,
        progress: &Progress,
    ) -> Result<(), KernelError> {
        let looked_at = self.looked_at(view);
        each(self.parts(&looked_at), threads, |part| part.see_again(view, number));
        progress.check()
    }

    /// Triangles that may be seen: those of some pixel, and their neighbours, which may be smaller than one.
    fn looked_at(&self, view: &View) -> Vec<bool> {
        let mut near = vec![false; self.vertices];
        let mut last = NOTHING;
        for &triangle in &view.triangles {
            if triangle != last && triangle != NOTHING {
                for v in self.triangles[triangle as usize] {
                    near[v as usize] = true;
                }
            }
            last = triangle;
        }
        self.triangles.iter().map(|corners| corners.iter().any(|&v| near[v as usize])).collect()
    }

    /// The points of such triangles in parts for threads.
    fn parts(&mut self, looked_at: &[bool]) -> Vec<Part<'_>> {
        let (origin, kept) = (self.origin, self.kept);
        let (mut places, mut normals) = (self.places.as_slice(), self.normals.as_slice());
        let (mut samples, mut density, mut seen) =
            (self.samples.as_mut_slice(), self.density.as_mut_slice(), self.seen.as_mut_slice());
        let (mut parts, mut taken) = (vec![], 0);
        let mut start = 0;
        let count = looked_at.len();
        while start < count {
            // Runs of triangles that are all looked at or all not.
            let wanted = looked_at[start];
            let mut end = start + 1;
            let begin = self.first[start] as usize;
            while end < count && looked_at[end] == wanted && (self.first[end] as usize - begin) < PART {
                end += 1;
            }
            let size = self.first[end] as usize - taken;
            taken += size;
            let part = Part {
                origin,
                kept,
                places: split(&mut places, size),
                normals: split(&mut normals, size),
                samples: split_mut(&mut samples, size * kept),
                density: split_mut(&mut density, size),
                seen: split_mut(&mut seen, size),
            };
            if wanted && size > 0 {
                parts.push(part);
            }
            start = end;
        }
        parts
    }
}

fn split<'a, T>(rest: &mut &'a [T], size: usize) -> &'a [T] {
    let (part, after) = rest.split_at(size);
    *rest = after;
    part
}

fn split_mut<'a, T>(rest: &mut &'a mut [T], size: usize) -> &'a mut [T] {
    let (part, after) = std::mem::take(rest).split_at_mut(size);
    *rest = after;
    part
}

struct Part<'a> {
    origin: Vec3,
    kept: usize,
    places: &'a [[f32; 3]],
    normals: &'a [[f32; 3]],
    samples: &'a mut [Sample],
    density: &'a mut [f32],
    seen: &'a mut [u16],
}

impl Part<'_> {
    fn place(&self, i: usize) -> Vec3 {
        [0, 1, 2].map(|k| self.origin[k] + f64::from(self.places[i][k]))
    }

    fn see(mut self, view: &View, number: u16) {
        let kept = self.kept;
        for (i, samples) in std::mem::take(&mut self.samples).chunks_exact_mut(kept).enumerate() {
            let least = samples[kept - 1].score;
            let Some(seen) = view.of(&self.place(i), &self.normals[i].map(f64::from), least) else {
                continue;
            };
            self.seen[i] = self.seen[i].saturating_add(1);
            self.density[i] = self.density[i].max(seen.density);
            if seen.score > least {
                insert(samples, &seen, number);
            }
        }
    }

    fn see_again(mut self, view: &View, number: u16) {
        let kept = self.kept;
        for (i, samples) in std::mem::take(&mut self.samples).chunks_exact_mut(kept).enumerate() {
            if let Some(sample) = samples.iter_mut().find(|s| s.view == number && s.score > 0.0) {
                let (color, blurred) = view.again(&self.place(i));
                (sample.color, sample.blurred) = (color.map(level), blurred.map(level));
            }
        }
    }
}

/// The nearest whole level.
fn level(value: f32) -> u8 {
    (value + 0.5) as u8
}

/// Put a sample where it belongs, the worst one goes. Of equals the earlier one is the better.
fn insert(samples: &mut [Sample], seen: &Seen, view: u16) {
    let Some(place) = samples.iter().position(|sample| seen.score > sample.score) else { return };
    samples[place..].rotate_right(1);
    samples[place] =
        Sample { score: seen.score, view, color: seen.color.map(level), blurred: seen.blurred.map(level) };
}
