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

/// Some of the triangles: of 64 that follow each other, which are meant; none where nothing is.
type Bits = Vec<(u32, u64)>;

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
    triangles: Vec<[u32; 3]>,
    around: Around,
    /// Of each point, the best first.
    samples: Vec<Sample>,
    kept: usize,
    /// The triangles that each view may show, of those that are to be remembered.
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
        let around = Around::new(&triangles, vertices);
        Ok(Self {
            places,
            normals,
            origin,
            first,
            triangles,
            around,
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

    /// Look at all points from one more camera, which `see_again` knows if it is to be remembered. Returns the triangles
    /// that it may show, in ascending order.
    ///
    /// # Errors
    /// As [`Progress::check`].
    pub fn see(
        &mut self,
        view: &View,
        number: u16,
        remember: bool,
        threads: usize,
        progress: &Progress,
    ) -> Result<Vec<u32>, KernelError> {
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
        progress.check()?;
        let triangles = looked_at.iter().flat_map(|&word| numbers(word)).collect();
        if remember {
            self.looked_at.insert(number, looked_at);
        }
        Ok(triangles)
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
    fn looked_at(&mut self, view: &View) -> Bits {
        let mut last = NOTHING;
        for &triangle in &view.triangles {
            if triangle != last && triangle != NOTHING {
                self.around.mark(&self.triangles[triangle as usize]);
            }
            last = triangle;
        }
        self.around.marked()
    }

    /// Do something at each point of some triangles, on several threads.
    fn over(&mut self, triangles: &[(u32, u64)], threads: usize, change: impl Fn(Point<'_>) + Sync) {
        let (origin, kept) = (self.origin, self.kept);
        let mut rest = triangles;
        let mut parts = self.parts();
        // Most are elsewhere.
        parts.retain(|part| {
            let before = rest.partition_point(|&(word, _)| (word as usize + 1) * 64 <= part.start);
            rest = &rest[before..];
            rest.first().is_some_and(|&(word, _)| (word as usize) * 64 < part.start + part.first.len() - 1)
        });
        each(parts, threads, |part: Part<'_>| {
            let end = part.start + part.first.len() - 1;
            let from = triangles.partition_point(|&(word, _)| (word as usize + 1) * 64 <= part.start);
            let words = triangles[from..].iter().take_while(|&&(word, _)| (word as usize) * 64 < end);
            for t in words.flat_map(|&word| numbers(word)).map(|t| t as usize) {
                if t < part.start || t >= end {
                    continue;
                }
                let ends = [part.first[t - part.start], part.first[t - part.start + 1]];
                let [begin, end] = ends.map(|point| (point - part.first[0]) as usize);
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

/// The numbers that a word of bits stands for.
fn numbers((word, bits): (u32, u64)) -> impl Iterator<Item = u32> {
    let mut rest = bits;
    std::iter::from_fn(move || {
        let bit = (rest != 0).then(|| rest.trailing_zeros())?;
        rest &= rest - 1;
        Some(word * 64 + bit)
    })
}

/// The triangles around vertices, to find those around a few without a look at all.
#[derive(Debug)]
struct Around {
    /// Of each vertex, where its triangles begin; and where the last one's end.
    first: Vec<u32>,
    triangles: Vec<u32>,
    is_marked: Vec<bool>,
    marked: Vec<u32>,
    /// 0 but while `marked` is at work.
    words: Vec<u64>,
}

impl Around {
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

    /// The triangles around all vertices that are marked, which are forgotten.
    fn marked(&mut self) -> Bits {
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
