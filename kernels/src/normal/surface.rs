//! The surface that is remeshed: where a line pierces it, and what is nearest.

use crate::base::geometry::{
    Vec3, add_scaled, around, cross, dot, nearest_on_triangle, norm2, sub, triangle_distance2, unit,
};
use crate::mesh::bvh::Bvh;

/// How far outside a triangle, in barycentric coordinates, a line still pierces it: it may not slip through between two.
const SLACK: f64 = 1e-9;
/// Squared distances that differ by less of themselves are equal: others may measure them in 32-bit floats.
const TIED: f64 = 1e-5;
/// A coordinate below which a place of a triangle is on its edge.
const ON_EDGE: f64 = 1e-3;

/// A place on the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Slot of the triangle, see [`Surface::triangle`].
    pub slot: u32,
    pub barycentric: [f64; 3],
    pub point: Vec3,
}

/// Triangles in the order of a tree over them; a *slot* is a place in it.
#[derive(Clone, Debug)]
pub struct Surface {
    tree: Bvh,
    /// The triangle in each slot.
    order: Vec<u32>,
    corners: Vec<[Vec3; 3]>,
    /// Vertices in each slot.
    vertices: Vec<[u32; 3]>,
    normals: Vec<Vec3>,
    /// Whether the triangle in each slot is turned against the surface around it.
    turned: Vec<bool>,
}

impl Surface {
    pub fn new(points: &[Vec3], triangles: &[[u32; 3]], threads: usize) -> Self {
        let of = |t: usize| triangles[t].map(|v| points[v as usize]);
        let (tree, order) = Bvh::new(triangles.len(), threads, |t| around(of(t).into_iter()));
        let corners = order.iter().map(|&t| of(t as usize)).collect();
        let vertices = order.iter().map(|&t| triangles[t as usize]).collect();
        let normals = vertex_normals(points, triangles);
        let turned = turned(points, triangles, &normals);
        let turned = order.iter().map(|&t| turned[t as usize]).collect();
        Self { tree, order, corners, vertices, normals, turned }
    }

    /// Triangles, and slots.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// The slot of each triangle.
    pub fn slots(&self) -> Vec<u32> {
        let mut slots = vec![0; self.order.len()];
        self.order.iter().enumerate().for_each(|(slot, &t)| slots[t as usize] = slot as u32);
        slots
    }

    #[inline]
    pub fn triangle(&self, slot: u32) -> u32 {
        self.order[slot as usize]
    }

    #[inline]
    pub fn vertices(&self, slot: u32) -> [u32; 3] {
        self.vertices[slot as usize]
    }

    /// A place by its triangle and coordinates there.
    pub fn place(&self, slot: u32, barycentric: [f64; 3]) -> Place {
        let [a, b, c] = &self.corners[slot as usize];
        let [u, v, w] = barycentric;
        Place { slot, barycentric, point: [0, 1, 2].map(|i| u * a[i] + v * b[i] + w * c[i]) }
    }

    /// Unit normals of the vertices.
    pub fn normals(&self) -> &[Vec3] {
        &self.normals
    }

    /// The normal at a place, interpolated from the corners; not of unit length.
    pub fn normal_at(&self, place: &Place) -> Vec3 {
        let [a, b, c] = self.vertices(place.slot).map(|v| self.normals[v as usize]);
        let [u, v, w] = place.barycentric;
        [0, 1, 2].map(|i| u * a[i] + v * b[i] + w * c[i])
    }

    /// Whether a triangle looks along a direction: least cosine of the angle between them.
    #[inline]
    fn faces(&self, slot: u32, direction: &Vec3, least: f64) -> bool {
        let [a, b, c] = &self.corners[slot as usize];
        let normal = cross(&sub(b, a), &sub(c, a));
        dot(&normal, direction) > least * (norm2(&normal) * norm2(direction)).sqrt()
    }

    /// The cosine between a direction and the triangle of a slot; 1 where that one is itself turned against the surface
    /// around it.
    pub fn facing(&self, slot: u32, direction: &Vec3) -> f64 {
        if self.turned[slot as usize] {
            return 1.0;
        }
        let [a, b, c] = &self.corners[slot as usize];
        let normal = cross(&sub(b, a), &sub(c, a));
        let lengths = (norm2(&normal) * norm2(direction)).sqrt();
        if lengths > 0.0 { dot(&normal, direction) / lengths } else { 1.0 }
    }

    /// The least of [`Self::facing`] of the triangles nearest to `p`: as near as others are those that share an edge or
    /// a vertex there.
    pub fn least_facing(&self, p: &Vec3, direction: &Vec3, near: impl IntoIterator<Item = u32>) -> f64 {
        let (slot, d2) = self.nearest_slot(p, near);
        let least = std::cell::Cell::new(self.facing(slot, direction));
        let (barycentric, _) = nearest_on_triangle(p, self.corners[slot as usize].each_ref());
        if barycentric.iter().all(|&share| share > ON_EDGE) {
            return least.get();
        }
        self.tree.nearest(p, (slot, d2 * (1.0 + TIED)), |slot| {
            if triangle_distance2(p, self.corners[slot as usize].each_ref()) <= d2 * (1.0 + TIED) {
                least.set(least.get().min(self.facing(slot, direction)));
            }
            f64::INFINITY
        });
        least.get()
    }

    /// Where the line through `p` along the unit vector `n` pierces triangles that look along it, nearest to `p` and no
    /// farther than `reach`, where `accept` agrees; with the distance along the line.
    pub fn pierced(
        &self,
        p: &Vec3,
        n: &Vec3,
        reach: f64,
        least_cosine: f64,
        accept: impl Fn(u32, &[f64; 3]) -> bool,
    ) -> Option<(f64, Place)> {
        let mut best: Option<(f64, Place)> = None;
        self.tree.along(p, n, reach, |slot, reach| {
            let Some((t, barycentric)) = crossing(&self.corners[slot as usize], p, n) else { return reach };
            // Equal distances: the slot decides, whatever the order of the search.
            let nearer = match &best {
                Some((d, place)) => t.abs() < d.abs() || (t.abs() == d.abs() && slot < place.slot),
                None => t.abs() <= reach,
            };
            if !nearer || !self.faces(slot, n, least_cosine) || !accept(slot, &barycentric) {
                return reach;
            }
            best = Some((t, Place { slot, barycentric, point: add_scaled(p, t, n) }));
            t.abs()
        });
        best
    }

    /// The place nearest to `p`, nearer than `reach`, on triangles of `set` that look along `n`.
    pub fn nearest(
        &self,
        p: &Vec3,
        n: &Vec3,
        reach: f64,
        least_cosine: f64,
        set: impl Fn(u32) -> bool,
    ) -> Option<Place> {
        let least = std::cell::Cell::new(reach * reach);
        let (slot, _) = self.tree.nearest(p, (u32::MAX, reach * reach), |slot| {
            let (_, d2) = nearest_on_triangle(p, self.corners[slot as usize].each_ref());
            // Sets are searched last: most triangles are too far anyway.
            if d2 >= least.get() || !self.faces(slot, n, least_cosine) || !set(slot) {
                return f64::INFINITY;
            }
            least.set(d2);
            d2
        });
        let found = Some(slot).filter(|&slot| slot != u32::MAX)?;
        let (barycentric, _) = nearest_on_triangle(p, self.corners[found as usize].each_ref());
        Some(self.place(found, barycentric))
    }

    /// The place nearest to `p` on some triangles, of which there is at least one.
    pub fn nearest_among(&self, p: &Vec3, slots: impl Iterator<Item = u32>) -> Place {
        let mut best = (f64::INFINITY, 0, [1.0, 0.0, 0.0]);
        for slot in slots {
            let (barycentric, d2) = nearest_on_triangle(p, self.corners[slot as usize].each_ref());
            if d2 < best.0 {
                best = (d2, slot, barycentric);
            }
        }
        self.place(best.1, best.2)
    }

    /// The slot of the nearest triangle of all, and its squared distance: sooner if one of the slots `near` is near.
    pub fn nearest_slot(&self, p: &Vec3, near: impl IntoIterator<Item = u32>) -> (u32, f64) {
        let to = |slot: u32| triangle_distance2(p, self.corners[slot as usize].each_ref());
        let closer = |best: (u32, f64), slot: u32| {
            let d = to(slot);
            if d < best.1 { (slot, d) } else { best }
        };
        self.tree.nearest(p, near.into_iter().fold((0, f64::INFINITY), closer), to)
    }
}

/// Where a line crosses the plane of a triangle, as a multiple of `n`, and the barycentric coordinates there.
#[inline]
fn crossing([a, b, c]: &[Vec3; 3], p: &Vec3, n: &Vec3) -> Option<(f64, [f64; 3])> {
    let (ab, ac) = (sub(b, a), sub(c, a));
    let across = cross(n, &ac);
    let volume = dot(&ab, &across);
    if volume == 0.0 {
        return None;
    }
    let to_p = sub(p, a);
    let v = dot(&to_p, &across) / volume;
    if !(-SLACK..=1.0 + SLACK).contains(&v) {
        return None;
    }
    let along = cross(&to_p, &ab);
    let w = dot(n, &along) / volume;
    if w < -SLACK || v + w > 1.0 + SLACK {
        return None;
    }
    Some((dot(&ac, &along) / volume, [1.0 - v - w, v, w]))
}

/// Unit normals of vertices: the mean of the triangles around, each weighted as on a sphere through its corners (Max,
/// "Weights for computing vertex normals from facet normals", 1999). Zero where there is none.
pub fn vertex_normals(points: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
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
    normals.iter_mut().for_each(|n| *n = unit(n));
    normals
}

/// Whether each triangle looks against the sum of the normals at its corners, however the triangles around these are
/// weighed: as on a sphere, all alike, or by their areas.
fn turned(points: &[Vec3], triangles: &[[u32; 3]], normals: &[Vec3]) -> Vec<bool> {
    let (mut alike, mut by_area) = (vec![[0.0; 3]; points.len()], vec![[0.0; 3]; points.len()]);
    let of = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|v| &points[v as usize]);
        cross(&sub(b, a), &sub(c, a))
    };
    for corners in triangles {
        let normal = of(corners);
        for v in corners.map(|v| v as usize) {
            alike[v] = add_scaled(&alike[v], 1.0, &unit(&normal));
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
