//! Planar patches of a filtered mesh, grown from the flattest triangles.
//!
//! As in the growth of near-planar patches (see [`crate::planar`]), a patch first grows with a plane that
//! follows its triangles, and then again with the fitted plane. Heights are compared with the standard
//! deviation of each vertex instead of a fixed distance. A patch whose normals change steadily across it is
//! curved and dropped.

use crate::base::geometry::{Vec3, add_scaled, cross, dot, norm2, normalize, sub};
use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::base::parallel::collect;
use crate::mesh::connectivity::Connectivity;
use crate::planar::fit::complete_frame;

/// Label of a triangle or vertex without a plane.
pub const NO_PLANE: u32 = u32::MAX;

/// Limits of planar patches.
#[derive(Clone, Copy, Debug)]
pub struct PlaneLimits {
    /// Minimum cosine between the filtered normal of a triangle and its plane.
    pub min_cosine: f64,
    /// Maximum height of a vertex over its plane, in its standard deviations.
    pub max_deviations: f64,
    /// Minimum number of triangles.
    pub min_triangles: usize,
    /// Maximum RMS angle, in radians, by which normals change steadily across a patch.
    pub max_bend: f64,
}

/// Plane of all points p with normal · (p − origin) = 0.
#[derive(Clone, Copy, Debug, Default)]
pub struct Plane {
    pub normal: Vec3,
    pub origin: Vec3,
}

impl Plane {
    /// Compute the signed height of a point.
    #[inline]
    pub fn height(&self, p: &Vec3) -> f64 {
        dot(&self.normal, &sub(p, &self.origin))
    }

    /// Project a point onto the plane.
    pub fn project(&self, p: &Vec3) -> Vec3 {
        add_scaled(p, -self.height(p), &self.normal)
    }
}

/// Mesh whose planar patches are wanted.
#[derive(Clone, Copy, Debug)]
pub struct FilteredSurface<'a> {
    pub connectivity: &'a Connectivity,
    pub points: &'a [Vec3],
    /// Filtered unit normals of the triangles.
    pub normals: &'a [Vec3],
    /// Areas of the triangles.
    pub areas: &'a [f64],
    /// Standard deviation of each vertex along its normal.
    pub deviations: &'a [f64],
}

impl FilteredSurface<'_> {
    fn centroid(&self, t: usize) -> Vec3 {
        let [a, b, c] = self.connectivity.corners(TriangleId::from_index(t)).map(|v| self.points[v.index()]);
        [0, 1, 2].map(|i| (a[i] + b[i] + c[i]) / 3.0)
    }

    fn adjacent_triangles(&self, t: usize) -> impl Iterator<Item = usize> + '_ {
        (3 * t as u32..3 * t as u32 + 3)
            .map(|h| self.connectivity.twin(HalfedgeId(h)))
            .filter(|twin| twin.is_some())
            .map(|twin| Connectivity::triangle(twin).index())
    }
}

/// Find the planar patches. Returns their planes and the patch of each triangle, or [`NO_PLANE`].
pub fn grow_planes(
    surface: &FilteredSurface<'_>,
    limits: &PlaneLimits,
    threads: usize,
) -> (Vec<Plane>, Vec<u32>) {
    let count = surface.connectivity.triangle_slots();
    let mut labels = vec![NO_PLANE; count];
    let mut is_tried = vec![false; count];
    let mut planes = vec![];
    let mut members = vec![];
    for seed in sort_by_flatness(surface, threads) {
        let seed = seed as usize;
        if labels[seed] != NO_PLANE || is_tried[seed] {
            continue;
        }
        let label = planes.len() as u32;
        match grow(surface, limits, seed, label, &mut labels, &mut members) {
            Some(plane) => planes.push(plane),
            None => {
                for &t in &members {
                    is_tried[t] = true;
                    labels[t] = NO_PLANE;
                }
                is_tried[seed] = true;
            }
        }
    }
    (planes, labels)
}

/// Triangles by the largest angle to an adjacent one, in 256 classes, flattest first.
fn sort_by_flatness(surface: &FilteredSurface<'_>, threads: usize) -> Vec<u32> {
    let classes: Vec<u8> = collect(surface.normals.len(), threads, |t| {
        let sharpest = surface
            .adjacent_triangles(t)
            .map(|other| dot(&surface.normals[t], &surface.normals[other]))
            .fold(1.0, f64::min);
        ((0.5 * (1.0 - sharpest)).max(0.0).sqrt() * 255.0) as u8
    });
    let mut order: Vec<u32> = (0..classes.len() as u32).collect();
    order.sort_by_key(|&t| classes[t as usize]);
    order
}

/// Rounds of growth: the first with a moving plane, the others with the plane of the round before.
const ROUNDS: usize = 3;
/// Patches of fewer triangles take their normal from the mean of the triangles' normals.
const MIN_FITTED: usize = 32;

fn grow(
    surface: &FilteredSurface<'_>,
    limits: &PlaneLimits,
    seed: usize,
    label: u32,
    labels: &mut [u32],
    members: &mut Vec<usize>,
) -> Option<Plane> {
    let mut plane = Plane { normal: surface.normals[seed], origin: surface.centroid(seed) };
    for round in 0..ROUNDS {
        members.iter().for_each(|&t| {
            if labels[t] == label {
                labels[t] = NO_PLANE;
            }
        });
        members.clear();
        if !fits(surface, limits, seed, &plane) {
            return None;
        }
        members.push(seed);
        labels[seed] = label;
        let (mut next, mut refit_at) = (0, 8);
        while next < members.len() {
            let t = members[next];
            next += 1;
            for other in surface.adjacent_triangles(t) {
                if labels[other] == NO_PLANE && fits(surface, limits, other, &plane) {
                    labels[other] = label;
                    members.push(other);
                }
            }
            if round == 0 && members.len() >= refit_at {
                plane = PatchMoments::gather(surface, members).fit();
                refit_at *= 2;
            }
        }
        if members.len() < limits.min_triangles {
            return None;
        }
        plane = PatchMoments::gather(surface, members).fit();
    }
    (PatchMoments::gather(surface, members).bend(&plane) <= limits.max_bend).then_some(plane)
}

fn fits(surface: &FilteredSurface<'_>, limits: &PlaneLimits, t: usize, plane: &Plane) -> bool {
    dot(&surface.normals[t], &plane.normal) >= limits.min_cosine
        && surface.connectivity.corners(TriangleId::from_index(t)).iter().all(|v| {
            let height = plane.height(&surface.points[v.index()]).abs();
            height <= limits.max_deviations * surface.deviations[v.index()]
        })
}

/// Moments of the triangles of a patch, at centroids relative to an origin.
#[derive(Clone, Copy, Debug, Default)]
pub struct PatchMoments {
    origin: Vec3,
    triangles: usize,
    /// With weights area / variance.
    weight: f64,
    sum: Vec3,
    products: [Vec3; 3],
    /// With the areas as weights: centroids, their products, normals, and products of normals with centroids.
    area: f64,
    area_sum: Vec3,
    area_products: [Vec3; 3],
    normal: Vec3,
    normal_products: [Vec3; 3],
}

impl PatchMoments {
    /// Create empty moments relative to an origin.
    pub fn new(origin: Vec3) -> Self {
        Self { origin, ..Self::default() }
    }

    fn gather(surface: &FilteredSurface<'_>, members: &[usize]) -> Self {
        let mut moments = Self::new(surface.centroid(members[0]));
        members.iter().for_each(|&t| moments.add_triangle(surface, t));
        moments
    }

    /// Add a triangle.
    pub fn add_triangle(&mut self, surface: &FilteredSurface<'_>, t: usize) {
        let at = sub(&surface.centroid(t), &self.origin);
        let corners = surface.connectivity.corners(TriangleId::from_index(t));
        let variance: f64 = corners.iter().map(|v| surface.deviations[v.index()].powi(2)).sum();
        let (area, normal) = (surface.areas[t], &surface.normals[t]);
        let weight = area / variance.max(f64::MIN_POSITIVE);
        self.triangles += 1;
        self.weight += weight;
        self.sum = add_scaled(&self.sum, weight, &at);
        self.area += area;
        self.area_sum = add_scaled(&self.area_sum, area, &at);
        self.normal = add_scaled(&self.normal, area, normal);
        for i in 0..3 {
            self.products[i] = add_scaled(&self.products[i], weight * at[i], &at);
            self.area_products[i] = add_scaled(&self.area_products[i], area * at[i], &at);
            self.normal_products[i] = add_scaled(&self.normal_products[i], area * normal[i], &at);
        }
    }

    /// Add the moments of another patch with the same origin.
    pub fn add(&mut self, other: &Self) {
        self.triangles += other.triangles;
        self.weight += other.weight;
        self.area += other.area;
        for (own, added) in [
            (&mut self.sum, &other.sum),
            (&mut self.area_sum, &other.area_sum),
            (&mut self.normal, &other.normal),
        ] {
            *own = add_scaled(own, 1.0, added);
        }
        for (own, added) in [
            (&mut self.products, &other.products),
            (&mut self.area_products, &other.area_products),
            (&mut self.normal_products, &other.normal_products),
        ] {
            (0..3).for_each(|i| own[i] = add_scaled(&own[i], 1.0, &added[i]));
        }
    }

    /// Return the number of triangles.
    pub fn triangle_count(&self) -> usize {
        self.triangles
    }

    /// Compute the mean normal.
    pub fn mean_normal(&self) -> Vec3 {
        normalize(&self.normal)
    }

    /// Compute the RMS height of the triangles over a plane, in standard deviations of their vertices.
    pub fn rms_deviations(&self, plane: &Plane) -> f64 {
        let to_plane = sub(&self.origin, &plane.origin);
        let offset = dot(&plane.normal, &to_plane);
        let linear = dot(&plane.normal, &self.sum);
        let square: f64 = (0..3).map(|i| plane.normal[i] * dot(&plane.normal, &self.products[i])).sum();
        let heights = square + 2.0 * offset * linear + offset * offset * self.weight;
        // The variance of a weight is the sum over three vertices.
        (3.0 * heights.max(0.0) / self.area.max(f64::MIN_POSITIVE)).sqrt()
    }

    /// Fit the plane: least squares of the heights over the mean normal.
    pub fn fit(&self) -> Plane {
        let normal = self.mean_normal();
        let middle = self.sum.map(|x| x / self.weight);
        let origin = add_scaled(&self.origin, 1.0, &middle);
        if self.triangles < MIN_FITTED {
            return Plane { normal, origin };
        }
        let [e, f] = complete_frame(&normal);
        let covariance: [Vec3; 3] = std::array::from_fn(|i| {
            std::array::from_fn(|k| self.products[i][k] / self.weight - middle[i] * middle[k])
        });
        let form = |a: &Vec3, b: &Vec3| apply_form(&covariance, a, b);
        let (ee, ef, ff) = (form(&e, &e), form(&e, &f), form(&f, &f));
        let (eh, fh) = (form(&e, &normal), form(&f, &normal));
        let determinant = ee * ff - ef * ef;
        if determinant <= 1e-9 * (ee + ff) * (ee + ff) {
            return Plane { normal, origin };
        }
        let (a, b) = ((eh * ff - fh * ef) / determinant, (fh * ee - eh * ef) / determinant);
        Plane { normal: normalize(&add_scaled(&add_scaled(&normal, -a, &e), -b, &f)), origin }
    }

    /// RMS angle, in radians, by which normals change linearly across the patch.
    pub fn bend(&self, plane: &Plane) -> f64 {
        if self.area <= 0.0 {
            return 0.0;
        }
        let frame = complete_frame(&plane.normal);
        let (middle, normal) = (self.area_sum.map(|x| x / self.area), self.normal.map(|x| x / self.area));
        let center = |products: &[Vec3; 3], first: &Vec3| -> [Vec3; 3] {
            std::array::from_fn(|i| {
                std::array::from_fn(|k| products[i][k] / self.area - first[i] * middle[k])
            })
        };
        let spread = center(&self.area_products, &middle);
        let lean = center(&self.normal_products, &normal);
        let [xx, xy, yy] = [[0, 0], [0, 1], [1, 1]].map(|[i, k]| apply_form(&spread, &frame[i], &frame[k]));
        let determinant = xx * yy - xy * xy;
        if determinant <= 1e-9 * (xx + yy) * (xx + yy) {
            return 0.0;
        }
        let explained: f64 = (0..2)
            .map(|i| {
                let [px, py] = [0, 1].map(|k| apply_form(&lean, &frame[i], &frame[k]));
                let (a, b) = ((px * yy - py * xy) / determinant, (py * xx - px * xy) / determinant);
                a * px + b * py
            })
            .sum();
        explained.max(0.0).sqrt()
    }
}

/// Compute the product aᵀ M b.
fn apply_form(matrix: &[Vec3; 3], a: &Vec3, b: &Vec3) -> f64 {
    dot(a, &[0, 1, 2].map(|i| dot(&matrix[i], b)))
}

/// Labels of vertices: the plane of most of their triangles' area, then of neighbours whose plane is near
/// enough, layer by layer.
///
/// A vertex joins the plane of a neighbour if its height and its normal are within the limits.
pub fn label_vertices(
    surface: &FilteredSurface<'_>,
    planes: &[Plane],
    triangle_labels: &[u32],
    vertex_normals: &[Vec3],
    limits: &PlaneLimits,
    layers: usize,
    threads: usize,
) -> Vec<u32> {
    let connectivity = surface.connectivity;
    let count = connectivity.vertex_slots();
    let mut labels: Vec<u32> = collect(count, threads, |v| {
        let mut best = (NO_PLANE, 0.0);
        for h in connectivity.fan(VertexId::from_index(v)) {
            let label = triangle_labels[Connectivity::triangle(h).index()];
            if label == NO_PLANE || label == best.0 {
                continue;
            }
            let area: f64 = connectivity
                .fan(VertexId::from_index(v))
                .map(|h| Connectivity::triangle(h).index())
                .filter(|&t| triangle_labels[t] == label)
                .map(|t| surface.areas[t])
                .sum();
            if area > best.1 {
                best = (label, area);
            }
        }
        best.0
    });
    for _ in 0..layers {
        labels = collect(count, threads, |v| {
            if labels[v] != NO_PLANE {
                return labels[v];
            }
            let limit = limits.max_deviations * surface.deviations[v];
            let mut best = (NO_PLANE, limit);
            for (_, other) in connectivity.vertex_edges(VertexId::from_index(v)) {
                let label = labels[other.index()];
                if label == NO_PLANE || label == best.0 {
                    continue;
                }
                let plane = &planes[label as usize];
                let height = plane.height(&surface.points[v]).abs();
                if height < best.1 && dot(&plane.normal, &vertex_normals[v]) > limits.min_cosine {
                    best = (label, height);
                }
            }
            best.0
        });
    }
    labels
}

/// Direction of the line where two planes meet, and its squared length: the squared sine of their angle.
pub fn intersection_direction(a: &Plane, b: &Plane) -> (Vec3, f64) {
    let direction = cross(&a.normal, &b.normal);
    (direction, norm2(&direction))
}
