//! Points of the surface, each with the few photos that show it best.

use std::collections::BTreeMap;

use super::view::{Colors, Known, Look, Seen, View};
use super::zbuffer::NOTHING;
use crate::base::errors::KernelError;
use crate::base::geometry::Vec3;
use crate::base::parallel::each;
use crate::base::progress::Progress;

/// Points a thread takes at a time, in whole triangles.
const PART: u32 = 1 << 14;

/// Some of the triangles, a bit each.
type Bits = Vec<u64>;

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
    /// The triangles that each view may show.
    looked_at: BTreeMap<u16, Bits>,
    /// Pixels a metre in the photo that is nearest; 0 where none shows the point.
    pub density: Vec<f32>,
    /// How each point is seen best: samples and density are of such looks alone.
    pub looks: Vec<Look>,
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
        let density = vec![0.0; points.len()];
        let looks = vec![Look::None; points.len()];
        let looked_at = BTreeMap::new();
        Ok(Self {
            places,
            normals,
            origin,
            first,
            triangles,
            vertices,
            samples,
            kept,
            looked_at,
            density,
            looks,
        })
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
        self.over(&looked_at, threads, |point| {
            let least = point.samples[point.samples.len() - 1].score;
            let known = Known { look: *point.look, score: least, density: *point.density };
            let Some(seen) = view.of(&point.place, &point.normal.map(f64::from), &known) else { return };
            if seen.look != *point.look {
                // The first one, or a better one than all before: these count no more.
                point.samples.fill(Sample::default());
                (*point.look, *point.density) = (seen.look, 0.0);
            }
            *point.density = point.density.max(seen.density);
            if seen.score > point.samples[point.samples.len() - 1].score {
                insert(point.samples, &seen, number);
            }
        });
        self.looked_at.insert(number, looked_at);
        progress.check()
    }

    /// Take the colours of a camera anew, where it is among the best.
    ///
    /// # Errors
    /// As [`Progress::check`].
    pub fn see_again(
        &mut self,
        colors: &Colors,
        number: u16,
        threads: usize,
        progress: &Progress,
    ) -> Result<(), KernelError> {
        let looked_at = self.looked_at.remove(&number).unwrap_or_default();
        self.over(&looked_at, threads, |point| {
            if let Some(sample) = point.samples.iter_mut().find(|s| s.view == number && s.score > 0.0) {
                let (color, blurred) = colors.of(&point.place);
                (sample.color, sample.blurred) = (color.map(level), blurred.map(level));
            }
        });
        self.looked_at.insert(number, looked_at);
        progress.check()
    }

    /// Triangles that may be seen: those of some pixel, and their neighbours, which may be smaller than one.
    fn looked_at(&self, view: &View) -> Bits {
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
        let is_near = |corners: &[u32; 3]| corners.iter().any(|&v| near[v as usize]);
        let word = |some: &[[u32; 3]]| {
            some.iter().enumerate().fold(0, |word, (i, corners)| word | u64::from(is_near(corners)) << i)
        };
        self.triangles.chunks(64).map(word).collect()
    }

    /// Do something at each point of some triangles, on several threads.
    fn over(&mut self, triangles: &[u64], threads: usize, change: impl Fn(Point<'_>) + Sync) {
        let (origin, kept) = (self.origin, self.kept);
        each(self.parts(), threads, |part: Part<'_>| {
            for (triangle, ends) in (part.start..).zip(part.first.windows(2)) {
                if triangles.get(triangle / 64).is_none_or(|word| word >> (triangle % 64) & 1 == 0) {
                    continue;
                }
                let [begin, end] = [ends[0], ends[1]].map(|point| (point - part.first[0]) as usize);
                for i in begin..end {
                    change(Point {
                        place: [0, 1, 2].map(|k| origin[k] + f64::from(part.places[i][k])),
                        normal: &part.normals[i],
                        samples: &mut part.samples[i * kept..][..kept],
                        density: &mut part.density[i],
                        look: &mut part.looks[i],
                    });
                }
            }
        });
    }

    /// All points in parts for threads, whole triangles each.
    fn parts(&mut self) -> Vec<Part<'_>> {
        let kept = self.kept;
        let (mut places, mut normals) = (self.places.as_slice(), self.normals.as_slice());
        let (mut samples, mut density) = (self.samples.as_mut_slice(), self.density.as_mut_slice());
        let mut looks = self.looks.as_mut_slice();
        let (mut parts, mut start) = (vec![], 0);
        while start < self.triangles.len() {
            let begin = self.first[start];
            let more = self.first[start + 1..].partition_point(|&point| point - begin < PART);
            let end = (start + 1 + more).min(self.triangles.len());
            let size = (self.first[end] - begin) as usize;
            parts.push(Part {
                start,
                first: &self.first[start..=end],
                places: split(&mut places, size),
                normals: split(&mut normals, size),
                samples: split_mut(&mut samples, size * kept),
                density: split_mut(&mut density, size),
                looks: split_mut(&mut looks, size),
            });
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

/// The points of a few triangles.
struct Part<'a> {
    /// The first triangle; the first point of each, and the one after the last.
    start: usize,
    first: &'a [u32],
    places: &'a [[f32; 3]],
    normals: &'a [[f32; 3]],
    samples: &'a mut [Sample],
    density: &'a mut [f32],
    looks: &'a mut [Look],
}

/// One of them, with what is remembered of it.
struct Point<'a> {
    place: Vec3,
    normal: &'a [f32; 3],
    samples: &'a mut [Sample],
    density: &'a mut f32,
    look: &'a mut Look,
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
