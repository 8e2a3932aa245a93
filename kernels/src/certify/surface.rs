//! Triangle soup with a search tree for nearest points.

use std::ops::Range;

use super::facet::{NearestWeights, distance2, nearest_point};
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, bounding_box, cross, norm2, position_of, segment_distance2, sub};
use crate::base::parallel;
use crate::mesh::bvh::Bvh;

/// Maximum coordinate in metres: products of four lengths must not overflow in double precision.
const MAX_COORDINATE: f64 = 1e60;
/// Maximum attribute: stored in single precision, squared in double.
const MAX_ATTRIBUTE: f64 = 1e30;

/// Ratio of height to longest side below which a single-precision search may miss a triangle. On a scan,
/// Embree missed triangles up to 1.2e-3, and by more than the slack up to 0.7e-3.
pub const NEEDLE_RATIO: f64 = 4e-3;

/// Triangles in BVH order; a *slot* is an index in that order.
#[derive(Clone, Debug)]
pub struct Surface {
    pub bvh: Bvh,
    /// Input triangle in each slot.
    pub triangle_of_slot: Vec<u32>,
    /// Slot of each input triangle.
    pub slot_of_triangle: Vec<u32>,
    /// Vertices of the triangle in each slot, numbered by first use: neighbours are close in memory.
    pub vertices: Vec<[u32; 3]>,
    /// By vertex, without unused vertices.
    pub points: Vec<Vec3>,
    /// Attributes by vertex, or empty. Single precision stores 8-bit levels exactly.
    pub colors: Vec<[f32; 3]>,
    /// Bounding box of the colours below both branches of each node.
    pub color_boxes: Vec<[[[f32; 3]; 2]; 2]>,
    /// Bounding box of the positions, and of the colours.
    pub bounds: [Vec3; 2],
    pub color_bounds: [Vec3; 2],
}

/// Result of a nearest-triangle query.
#[derive(Clone, Copy, Debug)]
pub struct NearestTriangle {
    pub slot: u32,
    pub distance: f64,
}

impl Surface {
    /// Build a searchable surface.
    ///
    /// `points` are positions in metres followed by 0, 1 or 3 attributes in 8-bit levels. Any triangles are
    /// valid: holes, several layers, non-manifold edges, no area. `threads` 0 means all processors.
    ///
    /// # Errors
    /// For an index out of range, and for a value that is not finite or beyond ±1e60.
    pub fn new<const D: usize>(
        points: &[[f64; D]],
        triangles: &[[u32; 3]],
        threads: usize,
    ) -> Result<Self, KernelError> {
        const { assert!(D >= 3 && D <= 6, "a point has three coordinates and up to three attributes") };
        check_input(points, triangles)?;
        let threads = parallel::resolve_thread_count(threads);
        let (bvh, order) = Bvh::new(triangles.len(), threads, |t| {
            bounding_box(triangles[t].iter().map(|&v| position_of(&points[v as usize])))
        });
        let mut slots = vec![0; order.len()];
        order.iter().enumerate().for_each(|(slot, &t)| slots[t as usize] = slot as u32);
        let (vertices, source) =
            renumber_by_first_use(order.iter().map(|&t| triangles[t as usize]), points.len());
        let color =
            |v: &u32| [0, 1, 2].map(|i| points[*v as usize].get(3 + i).copied().unwrap_or(0.0) as f32);
        let mut surface = Self {
            bvh,
            triangle_of_slot: order,
            slot_of_triangle: slots,
            vertices,
            points: source.iter().map(|&v| position_of(&points[v as usize])).collect(),
            colors: if D == 3 { vec![] } else { source.iter().map(color).collect() },
            color_boxes: vec![],
            bounds: bounding_box([].into_iter()),
            color_bounds: bounding_box([].into_iter()),
        };
        surface.bounds = bounding_box(surface.points.iter().copied());
        surface.color_bounds = bounding_box(surface.colors.iter().map(|c| c.map(f64::from)));
        if D > 3 {
            let below = |slots: Range<usize>| {
                color_box(surface.vertices[slots].iter().flatten().map(|&v| &surface.colors[v as usize]))
            };
            surface.color_boxes =
                surface.bvh.gather_bottom_up(below, |[a, b], [c, d]| color_box(&[a, b, c, d]));
        }
        Ok(surface)
    }

    /// As [`Surface::new`], for some triangles.
    ///
    /// `some` is sorted and unique. Triangles are numbered by their index in `some`.
    ///
    /// # Errors
    /// As [`Surface::new`].
    pub fn of_triangles<const D: usize>(
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
        self.triangle_of_slot.len()
    }

    pub fn is_empty(&self) -> bool {
        self.triangle_of_slot.is_empty()
    }

    /// Return the corners of the triangle in `slot`.
    #[inline]
    pub fn corners(&self, slot: u32) -> [Vec3; 3] {
        self.vertices[slot as usize].map(|v| self.points[v as usize])
    }

    /// Find the triangle nearest to `p`; a `hint` slot near it shortens the search.
    #[inline]
    pub fn nearest(&self, p: &Vec3, hint: u32) -> NearestTriangle {
        let first = (hint, self.distance2(hint, p));
        let (slot, least) = self.bvh.find_nearest(p, first, |slot| self.distance2(slot, p));
        NearestTriangle { slot, distance: least.sqrt() }
    }

    /// Visit every triangle (input index) whose bounding box intersects the box `low`–`high`.
    pub fn visit_triangles_in_box(&self, low: &Vec3, high: &Vec3, mut visit: impl FnMut(u32)) {
        self.bvh.visit_overlapping(
            low,
            high,
            |_, _| false,
            |slot| {
                visit(self.triangle_of_slot[slot as usize]);
                true
            },
        );
    }

    /// Compute the squared distance of `p` from the triangle in `slot`.
    #[inline]
    pub fn distance2(&self, slot: u32, p: &Vec3) -> f64 {
        distance2(p, &self.corners(slot))
    }

    /// Create a convex upper bound on the distance to the surface: the distance to the triangle in `slot`.
    ///
    /// A single-precision search may miss needles, so only the longest side of a needle counts.
    pub fn distance_bound(&self, slot: u32) -> impl Fn(&Vec3) -> f64 {
        let [a, b, c] = self.corners(slot);
        let sides = [[a, b], [b, c], [c, a]];
        let longest = sides.into_iter().max_by(|s, t| length2(s).total_cmp(&length2(t))).unwrap_or([a, b]);
        let area2 = norm2(&cross(&sub(&b, &a), &sub(&c, &a)));
        let needle = area2 < (NEEDLE_RATIO * length2(&longest)).powi(2);
        move |p: &Vec3| {
            let least = if needle {
                segment_distance2(p, &longest[0], &longest[1])
            } else {
                distance2(p, &[a, b, c])
            };
            least.sqrt()
        }
    }

    /// Return the colours at the corners; black if the surface has no colours.
    #[inline]
    pub fn corner_colors(&self, slot: u32) -> [Vec3; 3] {
        self.vertices[slot as usize].map(|v| self.vertex_color(v))
    }

    /// Return the colour of a vertex; black if the surface has no colours.
    #[inline]
    pub fn vertex_color(&self, v: u32) -> Vec3 {
        self.colors.get(v as usize).map_or([0.0; 3], |c| c.map(f64::from))
    }

    /// Bound the difference between colours in a box and below a branch.
    #[inline]
    pub fn bound_color_difference_below(&self, node: u32, branch: usize, [low, high]: &[Vec3; 2]) -> f64 {
        let [from, to] = &self.color_boxes[node as usize][branch];
        let most = |i: usize| (high[i] - f64::from(from[i])).max(f64::from(to[i]) - low[i]);
        norm2(&[0, 1, 2].map(most)).sqrt()
    }

    /// Bound the difference between colours in a box and in a slot.
    #[inline]
    pub fn bound_color_difference(&self, slot: u32, [low, high]: &[Vec3; 2]) -> f64 {
        let [from, to] = bounding_box(self.corner_colors(slot).into_iter());
        norm2(&[0, 1, 2].map(|i| (high[i] - from[i]).max(to[i] - low[i]))).sqrt()
    }

    /// Interpolate the colour at the nearest point of the triangle in `slot`.
    pub fn color_at(&self, slot: u32, p: &Vec3) -> Vec3 {
        interpolate_colors(&nearest_point(p, &self.corners(slot)), &self.corner_colors(slot))
    }
}

/// Interpolate colours at a nearest point.
#[inline]
pub fn interpolate_colors(at: &NearestWeights, colors: &[Vec3; 3]) -> Vec3 {
    weighted_sum(&at.weights, colors)
}

/// Compute the weighted sum of three vectors.
#[inline]
pub fn weighted_sum(weights: &Vec3, values: &[Vec3; 3]) -> Vec3 {
    [0, 1, 2].map(|i| weights[0] * values[0][i] + weights[1] * values[1][i] + weights[2] * values[2][i])
}

/// Compute the Euclidean distance of two vectors.
#[inline]
pub fn difference(a: &Vec3, b: &Vec3) -> f64 {
    norm2(&sub(a, b)).sqrt()
}

/// Renumber vertices by first use; also returns the old index of each new one.
fn renumber_by_first_use(
    triangles: impl Iterator<Item = [u32; 3]>,
    vertices: usize,
) -> (Vec<[u32; 3]>, Vec<u32>) {
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

fn check_input<const D: usize>(points: &[[f64; D]], triangles: &[[u32; 3]]) -> Result<(), KernelError> {
    // Written so that NaN fails.
    let sound = |p: &[f64; D]| {
        p[..3].iter().all(|x| x.abs() <= MAX_COORDINATE) && p[3..].iter().all(|x| x.abs() <= MAX_ATTRIBUTE)
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
