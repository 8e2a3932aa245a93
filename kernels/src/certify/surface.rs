//! A triangle soup ready to be asked for nearest points.

use std::ops::Range;

use super::facet::{Nearest, distance2, nearest};
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, around, cross, norm2, position, segment_distance2, sub};
use crate::base::parallel;
use crate::mesh::bvh::Bvh;

/// Beyond this the products of four lengths come near the end of double precision.
const LARGEST: f64 = 1e60;
/// Attributes are held in single precision, and their differences squared in double.
const LARGEST_ATTRIBUTE: f64 = 1e30;

/// Height over longest side below which single precision is not trusted to find a triangle. On a scan, Embree overlooked
/// them up to 1.2e-3, by more than the slack up to 0.7e-3.
pub const NEEDLE: f64 = 4e-3;

/// Triangles in the order of their tree; a *slot* is a place in that order.
#[derive(Clone, Debug)]
pub struct Surface {
    pub bvh: Bvh,
    /// Triangle of the input in each slot.
    pub order: Vec<u32>,
    /// Slot of each triangle of the input.
    pub slots: Vec<u32>,
    /// Vertices at the corners of the triangle in each slot, numbered by first use: neighbours are close in memory.
    pub vertices: Vec<[u32; 3]>,
    /// By vertex. Those that no triangle uses are left out.
    pub points: Vec<Vec3>,
    /// Attributes by vertex; empty where there are none. Single precision holds 8-bit levels exactly.
    pub colors: Vec<[f32; 3]>,
    /// The box around the colours below both branches of each node of the tree.
    pub color_boxes: Vec<[[[f32; 3]; 2]; 2]>,
    /// Lowest and highest corner of everything, and of the colours.
    pub bounds: [Vec3; 2],
    pub color_bounds: [Vec3; 2],
}

/// A point of the surface: the nearest one to some other point.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    pub slot: u32,
    pub distance: f64,
}

impl Surface {
    /// `points` are positions in metres, then attributes in 8-bit levels: none, one or three. Any triangles will do:
    /// holes, several layers, edges of many triangles, triangles without area. 0 threads for all processors.
    ///
    /// # Errors
    /// For an index out of range, and for a value that is not finite or is beyond ±1e60.
    pub fn new<const D: usize>(
        points: &[[f64; D]],
        triangles: &[[u32; 3]],
        threads: usize,
    ) -> Result<Self, KernelError> {
        const { assert!(D >= 3 && D <= 6, "a point has three coordinates and up to three attributes") };
        check(points, triangles)?;
        let threads = parallel::threads(threads);
        let (bvh, order) = Bvh::new(triangles.len(), threads, |t| {
            around(triangles[t].iter().map(|&v| position(&points[v as usize])))
        });
        let mut slots = vec![0; order.len()];
        order.iter().enumerate().for_each(|(slot, &t)| slots[t as usize] = slot as u32);
        let (vertices, source) = numbered_by_use(order.iter().map(|&t| triangles[t as usize]), points.len());
        let color =
            |v: &u32| [0, 1, 2].map(|i| points[*v as usize].get(3 + i).copied().unwrap_or(0.0) as f32);
        let mut surface = Self {
            bvh,
            order,
            slots,
            vertices,
            points: source.iter().map(|&v| position(&points[v as usize])).collect(),
            colors: if D == 3 { vec![] } else { source.iter().map(color).collect() },
            color_boxes: vec![],
            bounds: around([].into_iter()),
            color_bounds: around([].into_iter()),
        };
        surface.bounds = around(surface.points.iter().copied());
        surface.color_bounds = around(surface.colors.iter().map(|c| c.map(f64::from)));
        if D > 3 {
            let below = |slots: Range<usize>| {
                color_box(surface.vertices[slots].iter().flatten().map(|&v| &surface.colors[v as usize]))
            };
            surface.color_boxes = surface.bvh.gathered(below, |[a, b], [c, d]| color_box(&[a, b, c, d]));
        }
        Ok(surface)
    }

    /// The same of some triangles, numbered by their place in `some`, which comes in order and names each once.
    ///
    /// # Errors
    /// As [`Surface::new`].
    pub fn of_some<const D: usize>(
        points: &[[f64; D]],
        triangles: &[[u32; 3]],
        some: &[u32],
        threads: usize,
    ) -> Result<Self, KernelError> {
        if some.len() == triangles.len() {
            return Self::new(points, triangles, threads);
        }
        let mut used: Vec<u32> = some.iter().flat_map(|&t| triangles[t as usize]).collect();
        used.sort_unstable();
        used.dedup();
        let number = |v: u32| used.partition_point(|&u| u < v) as u32;
        let corners: Vec<_> = some.iter().map(|&t| triangles[t as usize].map(number)).collect();
        let points: Vec<_> = used.iter().map(|&v| points[v as usize]).collect();
        Self::new(&points, &corners, threads)
    }

    pub fn len(&self) -> usize {
        self.order.len()
    }

    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// Corners of the triangle in `slot`.
    #[inline]
    pub fn corners(&self, slot: u32) -> [Vec3; 3] {
        self.vertices[slot as usize].map(|v| self.points[v as usize])
    }

    /// The nearest point to `p`; `hint` is a slot likely near it, which makes the search short.
    #[inline]
    pub fn nearest(&self, p: &Vec3, hint: u32) -> Found {
        let first = (hint, self.distance2(hint, p));
        let (slot, least) = self.bvh.nearest(p, first, |slot| self.distance2(slot, p));
        Found { slot, distance: least.sqrt() }
    }

    /// Visit every triangle, by its number in the input, whose box meets the box `low`–`high`.
    pub fn triangles_meeting(&self, low: &Vec3, high: &Vec3, mut visit: impl FnMut(u32)) {
        self.bvh.meeting(
            low,
            high,
            |_, _| false,
            |slot| {
                visit(self.order[slot as usize]);
                true
            },
        );
    }

    #[inline]
    pub fn distance2(&self, slot: u32, p: &Vec3) -> f64 {
        distance2(p, &self.corners(slot))
    }

    /// A convex function that is nowhere less than the distance to the surface: that to the triangle in `slot`.
    ///
    /// A search in single precision overlooks needles and finds what is beside them: of those only the longest
    /// side counts.
    pub fn reach(&self, slot: u32) -> impl Fn(&Vec3) -> f64 {
        let [a, b, c] = self.corners(slot);
        let sides = [[a, b], [b, c], [c, a]];
        let longest = sides.into_iter().max_by(|s, t| length2(s).total_cmp(&length2(t))).unwrap_or([a, b]);
        let area2 = norm2(&cross(&sub(&b, &a), &sub(&c, &a)));
        let needle = area2 < (NEEDLE * length2(&longest)).powi(2);
        move |p: &Vec3| {
            let least = if needle {
                segment_distance2(p, &longest[0], &longest[1])
            } else {
                distance2(p, &[a, b, c])
            };
            least.sqrt()
        }
    }

    /// Colours at the corners; black where there are none.
    #[inline]
    pub fn corner_colors(&self, slot: u32) -> [Vec3; 3] {
        self.vertices[slot as usize].map(|v| self.vertex_color(v))
    }

    #[inline]
    pub fn vertex_color(&self, v: u32) -> Vec3 {
        self.colors.get(v as usize).map_or([0.0; 3], |c| c.map(f64::from))
    }

    /// The most that colours in a box differ from those below a branch of the tree.
    #[inline]
    pub fn colors_apart(&self, node: u32, branch: usize, [low, high]: &[Vec3; 2]) -> f64 {
        let [from, to] = &self.color_boxes[node as usize][branch];
        let most = |i: usize| (high[i] - f64::from(from[i])).max(f64::from(to[i]) - low[i]);
        norm2(&[0, 1, 2].map(most)).sqrt()
    }

    /// The most that colours in a box differ from those of the triangle in `slot`.
    #[inline]
    pub fn color_range(&self, slot: u32, [low, high]: &[Vec3; 2]) -> f64 {
        let [from, to] = around(self.corner_colors(slot).into_iter());
        norm2(&[0, 1, 2].map(|i| (high[i] - from[i]).max(to[i] - low[i]))).sqrt()
    }

    /// Colour at the point of a slot's triangle nearest to `p`.
    pub fn color(&self, slot: u32, p: &Vec3) -> Vec3 {
        blend(&nearest(p, &self.corners(slot)), &self.corner_colors(slot))
    }
}

#[inline]
pub fn blend(at: &Nearest, colors: &[Vec3; 3]) -> Vec3 {
    combine(&at.weights, colors)
}

#[inline]
pub fn combine(weights: &Vec3, values: &[Vec3; 3]) -> Vec3 {
    [0, 1, 2].map(|i| weights[0] * values[0][i] + weights[1] * values[1][i] + weights[2] * values[2][i])
}

#[inline]
pub fn difference(a: &Vec3, b: &Vec3) -> f64 {
    norm2(&sub(a, b)).sqrt()
}

/// Triangles in numbers that follow their first use, and what the numbers stand for.
fn numbered_by_use(triangles: impl Iterator<Item = [u32; 3]>, vertices: usize) -> (Vec<[u32; 3]>, Vec<u32>) {
    let mut number = vec![u32::MAX; vertices];
    let mut source = vec![];
    let mut numbered = |v: u32| {
        let number = &mut number[v as usize];
        if *number == u32::MAX {
            *number = source.len() as u32;
            source.push(v);
        }
        *number
    };
    let triangles = triangles.map(|t| t.map(&mut numbered)).collect();
    (triangles, source)
}

fn length2([a, b]: &[Vec3; 2]) -> f64 {
    norm2(&sub(a, b))
}

fn color_box<'a>(colors: impl IntoIterator<Item = &'a [f32; 3]>) -> [[f32; 3]; 2] {
    colors.into_iter().fold([[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]], |[low, high], c| {
        [[0, 1, 2].map(|i| low[i].min(c[i])), [0, 1, 2].map(|i| high[i].max(c[i]))]
    })
}

fn check<const D: usize>(points: &[[f64; D]], triangles: &[[u32; 3]]) -> Result<(), KernelError> {
    // NaN fails the comparison too.
    let sound = |p: &[f64; D]| {
        p[..3].iter().all(|x| x.abs() <= LARGEST) && p[3..].iter().all(|x| x.abs() <= LARGEST_ATTRIBUTE)
    };
    if let Some(vertex) = points.iter().position(|p| !sound(p)) {
        return Err(KernelError::NotFinite { vertex });
    }
    let vertices = points.len();
    for (triangle, corners) in triangles.iter().enumerate() {
        if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= vertices) {
            return Err(KernelError::IndexOutOfRange { triangle, vertex: vertex.into(), vertices });
        }
    }
    Ok(())
}
