//! Surface to remesh, with line intersection and nearest-point queries.

use crate::base::geometry::{
    Vec3, add_scaled, bounding_box, cross, dot, nearest_on_triangle, norm2, normalize, sub,
    triangle_distance2,
};
use crate::mesh::bvh::Bvh;

/// Tolerance of line hits outside a triangle, in barycentric coordinates. It prevents lines from slipping
/// through between two triangles.
const HIT_TOLERANCE: f64 = 1e-9;
/// Relative difference below which squared distances are equal, because callers may measure in 32-bit floats.
const TIE_TOLERANCE: f64 = 1e-5;
/// Barycentric coordinate below which a point is on an edge.
const EDGE_TOLERANCE: f64 = 1e-3;

/// Point on the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Slot of the triangle; see [`Surface::triangle`].
    pub slot: u32,
    pub barycentric: [f64; 3],
    pub point: Vec3,
}

/// Triangle soup in the order of a bounding volume hierarchy. A *slot* is an index in that order.
#[derive(Clone, Debug)]
pub struct Surface {
    tree: Bvh,
    /// Triangle of each slot.
    triangle_of_slot: Vec<u32>,
    corners: Vec<[Vec3; 3]>,
    /// Vertex indices of each slot.
    vertices: Vec<[u32; 3]>,
    normals: Vec<Vec3>,
    /// True for slots whose triangle is flipped against the surrounding surface.
    is_flipped: Vec<bool>,
}

impl Surface {
    /// Build the surface and its search tree.
    pub fn new(points: &[Vec3], triangles: &[[u32; 3]], threads: usize) -> Self {
        let of = |t: usize| triangles[t].map(|v| points[v as usize]);
        let (tree, order) = Bvh::new(triangles.len(), threads, |t| bounding_box(of(t).into_iter()));
        let corners = order.iter().map(|&t| of(t as usize)).collect();
        let vertices = order.iter().map(|&t| triangles[t as usize]).collect();
        let normals = compute_vertex_normals(points, triangles);
        let turned = detect_flipped(points, triangles, &normals);
        let turned = order.iter().map(|&t| turned[t as usize]).collect();
        Self { tree, triangle_of_slot: order, corners, vertices, normals, is_flipped: turned }
    }

    /// Number of triangles, equal to the number of slots.
    pub fn len(&self) -> usize {
        self.triangle_of_slot.len()
    }

    pub fn is_empty(&self) -> bool {
        self.triangle_of_slot.is_empty()
    }

    /// Compute the slot of each triangle.
    pub fn slots(&self) -> Vec<u32> {
        let mut slots = vec![0; self.triangle_of_slot.len()];
        self.triangle_of_slot.iter().enumerate().for_each(|(slot, &t)| slots[t as usize] = slot as u32);
        slots
    }

    /// Return the triangle of a slot.
    #[inline]
    pub fn triangle(&self, slot: u32) -> u32 {
        self.triangle_of_slot[slot as usize]
    }

    /// Return the vertex indices of a slot.
    #[inline]
    pub fn vertices(&self, slot: u32) -> [u32; 3] {
        self.vertices[slot as usize]
    }

    /// Build the surface point at barycentric coordinates of a slot.
    pub fn point_at(&self, slot: u32, barycentric: [f64; 3]) -> SurfacePoint {
        let [a, b, c] = &self.corners[slot as usize];
        let [u, v, w] = barycentric;
        SurfacePoint { slot, barycentric, point: [0, 1, 2].map(|i| u * a[i] + v * b[i] + w * c[i]) }
    }

    /// Unit vertex normals.
    pub fn normals(&self) -> &[Vec3] {
        &self.normals
    }

    /// Interpolate the normal at a surface point. The result is not normalised.
    pub fn normal_at(&self, place: &SurfacePoint) -> Vec3 {
        let [a, b, c] = self.vertices(place.slot).map(|v| self.normals[v as usize]);
        let [u, v, w] = place.barycentric;
        [0, 1, 2].map(|i| u * a[i] + v * b[i] + w * c[i])
    }

    /// Check whether the cosine between a triangle's normal and a direction exceeds `least`.
    #[inline]
    fn is_facing(&self, slot: u32, direction: &Vec3, least: f64) -> bool {
        let [a, b, c] = &self.corners[slot as usize];
        let normal = cross(&sub(b, a), &sub(c, a));
        dot(&normal, direction) > least * (norm2(&normal) * norm2(direction)).sqrt()
    }

    /// Compute the cosine between the normal of a slot's triangle and a direction. It is 1 for triangles that
    /// are flipped against the surrounding surface, because their normals mean nothing.
    pub fn compute_cosine(&self, slot: u32, direction: &Vec3) -> f64 {
        if self.is_flipped[slot as usize] {
            return 1.0;
        }
        let [a, b, c] = &self.corners[slot as usize];
        let normal = cross(&sub(b, a), &sub(c, a));
        let lengths = (norm2(&normal) * norm2(direction)).sqrt();
        if lengths > 0.0 { dot(&normal, direction) / lengths } else { 1.0 }
    }

    /// Compute the minimum of [`Self::compute_cosine`] over the triangles nearest to `p`. Several triangles are
    /// equally near if `p` projects to a shared edge or vertex.
    pub fn compute_min_cosine(&self, p: &Vec3, direction: &Vec3, near: impl IntoIterator<Item = u32>) -> f64 {
        let (slot, d2) = self.find_nearest_slot(p, near);
        let least = std::cell::Cell::new(self.compute_cosine(slot, direction));
        let (barycentric, _) = nearest_on_triangle(p, self.corners[slot as usize].each_ref());
        if barycentric.iter().all(|&share| share > EDGE_TOLERANCE) {
            return least.get();
        }
        self.tree.find_nearest(p, (slot, d2 * (1.0 + TIE_TOLERANCE)), |slot| {
            if triangle_distance2(p, self.corners[slot as usize].each_ref()) <= d2 * (1.0 + TIE_TOLERANCE) {
                least.set(least.get().min(self.compute_cosine(slot, direction)));
            }
            f64::INFINITY
        });
        least.get()
    }

    /// Intersect the line through `p` along the unit vector `n` with triangles that face along it. Returns
    /// the nearest hit within `reach` that `accept` admits, with its signed distance.
    pub fn intersect_line(
        &self,
        p: &Vec3,
        n: &Vec3,
        reach: f64,
        least_cosine: f64,
        accept: impl Fn(u32, &[f64; 3]) -> bool,
    ) -> Option<(f64, SurfacePoint)> {
        let mut best: Option<(f64, SurfacePoint)> = None;
        self.tree.visit_along_line(p, n, reach, |slot, reach| {
            let Some((t, barycentric)) = intersect_triangle(&self.corners[slot as usize], p, n) else {
                return reach;
            };
            // For equal distances the slot decides, so the result does not depend on the traversal order.
            let nearer = match &best {
                Some((d, place)) => t.abs() < d.abs() || (t.abs() == d.abs() && slot < place.slot),
                None => t.abs() <= reach,
            };
            if !nearer || !self.is_facing(slot, n, least_cosine) || !accept(slot, &barycentric) {
                return reach;
            }
            best = Some((t, SurfacePoint { slot, barycentric, point: add_scaled(p, t, n) }));
            t.abs()
        });
        best
    }

    /// Find the point nearest to `p` within `reach`, on triangles of `set` that face along `n`.
    pub fn find_nearest(
        &self,
        p: &Vec3,
        n: &Vec3,
        reach: f64,
        least_cosine: f64,
        set: impl Fn(u32) -> bool,
    ) -> Option<SurfacePoint> {
        let least = std::cell::Cell::new(reach * reach);
        let (slot, _) = self.tree.find_nearest(p, (u32::MAX, reach * reach), |slot| {
            let (_, d2) = nearest_on_triangle(p, self.corners[slot as usize].each_ref());
            // Set lookups come last, because most triangles are too far away.
            if d2 >= least.get() || !self.is_facing(slot, n, least_cosine) || !set(slot) {
                return f64::INFINITY;
            }
            least.set(d2);
            d2
        });
        let found = Some(slot).filter(|&slot| slot != u32::MAX)?;
        let (barycentric, _) = nearest_on_triangle(p, self.corners[found as usize].each_ref());
        Some(self.point_at(found, barycentric))
    }

    /// Find the point nearest to `p` on the given slots, which must not be empty.
    pub fn find_nearest_among(&self, p: &Vec3, slots: impl Iterator<Item = u32>) -> SurfacePoint {
        let mut best = (f64::INFINITY, 0, [1.0, 0.0, 0.0]);
        for slot in slots {
            let (barycentric, d2) = nearest_on_triangle(p, self.corners[slot as usize].each_ref());
            if d2 < best.0 {
                best = (d2, slot, barycentric);
            }
        }
        self.point_at(best.1, best.2)
    }

    /// Find the nearest triangle and return its slot and squared distance. Candidate slots in `near` speed up
    /// the search.
    pub fn find_nearest_slot(&self, p: &Vec3, near: impl IntoIterator<Item = u32>) -> (u32, f64) {
        let to = |slot: u32| triangle_distance2(p, self.corners[slot as usize].each_ref());
        let closer = |best: (u32, f64), slot: u32| {
            let d = to(slot);
            if d < best.1 { (slot, d) } else { best }
        };
        self.tree.find_nearest(p, near.into_iter().fold((0, f64::INFINITY), closer), to)
    }
}

/// Intersect a line with a triangle. Returns the multiple of `n` and the barycentric coordinates of the hit.
#[inline]
fn intersect_triangle([a, b, c]: &[Vec3; 3], p: &Vec3, n: &Vec3) -> Option<(f64, [f64; 3])> {
    let (ab, ac) = (sub(b, a), sub(c, a));
    let across = cross(n, &ac);
    let volume = dot(&ab, &across);
    if volume == 0.0 {
        return None;
    }
    let to_p = sub(p, a);
    let v = dot(&to_p, &across) / volume;
    if !(-HIT_TOLERANCE..=1.0 + HIT_TOLERANCE).contains(&v) {
        return None;
    }
    let along = cross(&to_p, &ab);
    let w = dot(n, &along) / volume;
    if w < -HIT_TOLERANCE || v + w > 1.0 + HIT_TOLERANCE {
        return None;
    }
    Some((dot(&ac, &along) / volume, [1.0 - v - w, v, w]))
}

/// Compute unit vertex normals, with triangles weighted as on a sphere through their corners. Source: Max,
/// "Weights for computing vertex normals from facet normals", 1999. Zero for vertices without triangles.
pub fn compute_vertex_normals(points: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut normals = vec![[0.0; 3]; points.len()];
    for corners in triangles {
        let p = corners.map(|v| points[v as usize]);
        let normal = cross(&sub(&p[1], &p[0]), &sub(&p[2], &p[0]));
        for i in 0..3 {
            let (next, last) = (sub(&p[(i + 1) % 3], &p[i]), sub(&p[(i + 2) % 3], &p[i]));
            let sides = norm2(&next) * norm2(&last);
            if sides > 0.0 {
                let sum = &mut normals[corners[i] as usize];
                *sum = add_scaled(sum, 1.0 / sides, &normal);
            }
        }
    }
    normals.iter_mut().for_each(|n| *n = normalize(n));
    normals
}

/// Flag triangles that oppose the sum of their corner normals under all three weightings: as on a sphere,
/// uniform, and by area.
fn detect_flipped(points: &[Vec3], triangles: &[[u32; 3]], normals: &[Vec3]) -> Vec<bool> {
    let (mut alike, mut by_area) = (vec![[0.0; 3]; points.len()], vec![[0.0; 3]; points.len()]);
    let of = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|v| &points[v as usize]);
        cross(&sub(b, a), &sub(c, a))
    };
    for corners in triangles {
        let normal = of(corners);
        for v in corners.map(|v| v as usize) {
            alike[v] = add_scaled(&alike[v], 1.0, &normalize(&normal));
            by_area[v] = add_scaled(&by_area[v], 1.0, &normal);
        }
    }
    let against = |corners: &[u32; 3], normals: &[Vec3]| {
        let normal = of(corners);
        corners.iter().map(|&v| dot(&normal, &normals[v as usize])).sum::<f64>() <= 0.0
    };
    let kinds = [normals, &alike, &by_area];
    triangles.iter().map(|corners| kinds.iter().all(|normals| against(corners, normals))).collect()
}
