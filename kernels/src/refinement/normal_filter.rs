//! Bilateral filter of triangle normals, and vertex positions that fit the filtered normals.
//!
//! Normals are averaged over the triangles that share a vertex (Zheng, Fu, Au and Tai, "Bilateral normal
//! filtering for mesh denoising", 2011). The range weight is Tukey's biweight: normals that differ by more than
//! a cutoff are not averaged at all, so that creases stay sharp. It needs no exponential, whose last bit
//! depends on the processor. Vertices then move along the filtered normals of their triangles (Sun, Rosin,
//! Martin and Langbein, "Fast and effective feature-preserving mesh denoising", 2007).

use crate::base::geometry::{Vec3, add_scaled, cross, distance2, dot, norm2, normalize, sub};
use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::base::parallel::{collect, update};
use crate::mesh::connectivity::Connectivity;

/// Compute the normal of each triangle with twice its area as length.
pub fn area_normals(connectivity: &Connectivity, points: &[Vec3], threads: usize) -> Vec<Vec3> {
    collect(connectivity.triangle_slots(), threads, |t| {
        let [a, b, c] = corner_points(connectivity, points, t);
        cross(&sub(&b, &a), &sub(&c, &a))
    })
}

/// Compute the unit normal of each vertex, weighted by the areas of its triangles; zero for a vertex without
/// triangles.
pub fn vertex_normals(connectivity: &Connectivity, area_normals: &[Vec3], threads: usize) -> Vec<Vec3> {
    collect(connectivity.vertex_slots(), threads, |v| {
        let fan = connectivity.fan(VertexId::from_index(v));
        let sum = fan
            .fold([0.0; 3], |sum, h| add_scaled(&sum, 1.0, &area_normals[Connectivity::triangle(h).index()]));
        normalize(&sum)
    })
}

/// Filter the normals of all triangles.
///
/// `max_chords` limits for each triangle the distance of unit normals that are averaged. Returns unit normals.
pub fn filter_normals(
    connectivity: &Connectivity,
    points: &[Vec3],
    max_chords: Vec<f64>,
    iterations: usize,
    threads: usize,
) -> Vec<Vec3> {
    let count = connectivity.triangle_slots();
    let mut normals = area_normals(connectivity, points, threads);
    let areas: Vec<f64> = collect(count, threads, |t| norm2(&normals[t]).sqrt());
    update(&mut normals, threads, |_, normal| *normal = normalize(normal));
    let centroids = collect(count, threads, |t| centroid(connectivity, points, t));
    let spacing2 = mean_neighbour_distance2(connectivity, &centroids, threads);
    let mut ranges = max_chords;
    update(&mut ranges, threads, |_, range| *range = 1.0 / (*range * *range));
    for _ in 0..iterations {
        normals = collect(count, threads, |t| {
            let own = &normals[t];
            let mut sum = own.map(|x| x * areas[t]);
            for v in connectivity.corners(TriangleId::from_index(t)) {
                for h in connectivity.fan(v) {
                    let other = Connectivity::triangle(h).index();
                    // Neighbours across an edge are visited twice, which gives them twice the weight.
                    if other == t {
                        continue;
                    }
                    let unlike = 1.0 - norm2(&sub(own, &normals[other])) * ranges[t];
                    if unlike > 0.0 {
                        let far = distance2(&centroids[t], &centroids[other]);
                        let weight = areas[other] * unlike * unlike * spacing2 / (spacing2 + far);
                        sum = add_scaled(&sum, weight, &normals[other]);
                    }
                }
            }
            let filtered = normalize(&sum);
            if filtered == [0.0; 3] { *own } else { filtered }
        });
    }
    normals
}

/// Move vertices until their triangles fit the given normals, as far as `max_moves` allow.
pub fn fit_vertices(
    connectivity: &Connectivity,
    points: &[Vec3],
    normals: &[Vec3],
    max_moves: &[f64],
    iterations: usize,
    threads: usize,
) -> Vec<Vec3> {
    let mut moved = points.to_vec();
    // Only along these directions: other steps would slide vertices over each other and fold thin triangles.
    let directions = vertex_normals(connectivity, &area_normals(connectivity, points, threads), threads);
    for _ in 0..iterations {
        let centroids =
            collect(connectivity.triangle_slots(), threads, |t| centroid(connectivity, &moved, t));
        moved = collect(points.len(), threads, |v| {
            let at = moved[v];
            let (mut sum, mut triangles) = ([0.0; 3], 0.0);
            for h in connectivity.fan(VertexId::from_index(v)) {
                let t = Connectivity::triangle(h).index();
                sum = add_scaled(&sum, dot(&sub(&centroids[t], &at), &normals[t]), &normals[t]);
                triangles += 1.0;
            }
            if triangles == 0.0 {
                return at;
            }
            let step = dot(&sum, &directions[v]) / triangles;
            limit_move(&points[v], add_scaled(&at, step, &directions[v]), max_moves[v])
        });
    }
    moved
}

/// Move a point towards `to`, at most `max_move` away from `from`.
pub fn limit_move(from: &Vec3, to: Vec3, max_move: f64) -> Vec3 {
    let step = sub(&to, from);
    let length = norm2(&step).sqrt();
    if length <= max_move { to } else { add_scaled(from, max_move / length, &step) }
}

fn corner_points(connectivity: &Connectivity, points: &[Vec3], t: usize) -> [Vec3; 3] {
    connectivity.corners(TriangleId::from_index(t)).map(|v| points[v.index()])
}

fn centroid(connectivity: &Connectivity, points: &[Vec3], t: usize) -> Vec3 {
    let [a, b, c] = corner_points(connectivity, points, t);
    [0, 1, 2].map(|i| (a[i] + b[i] + c[i]) / 3.0)
}

/// Mean squared distance between the centroids of triangles that share an edge; 1 without such triangles.
fn mean_neighbour_distance2(connectivity: &Connectivity, centroids: &[Vec3], threads: usize) -> f64 {
    let sums: Vec<(f64, f64)> = collect(centroids.len(), threads, |t| {
        (3 * t as u32..3 * t as u32 + 3)
            .map(|h| connectivity.twin(HalfedgeId(h)))
            .filter(|twin| twin.is_some())
            .map(|twin| distance2(&centroids[t], &centroids[Connectivity::triangle(twin).index()]))
            .fold((0.0, 0.0), |(sum, count), one| (sum + one, count + 1.0))
    });
    // Summed in order, so that the result does not depend on the thread count.
    let (sum, count) = sums.iter().fold((0.0, 0.0), |(sum, count), one| (sum + one.0, count + one.1));
    if sum > 0.0 { sum / count } else { 1.0 }
}
