//! Mesh split into spatial clusters of triangles, for view-frustum culling.

use super::pinhole_camera::PinholeCamera;
use crate::base::geometry::{Vec3, bounding_box};
use crate::mesh::spatial_order::compute_spatial_order;

/// Triangles per cluster: few enough for small boxes, enough to limit the duplication of points.
const CLUSTER_TRIANGLES: usize = 256;
/// Relative tolerance of the culling test, for rounding.
const CULLING_TOLERANCE: f64 = 1e-6;

/// Mesh for repeated rendering.
#[derive(Debug, Default)]
pub struct MeshClusters {
    /// Points of all clusters, cluster by cluster.
    points: Vec<Vec3>,
    /// Corners of the triangles, as indices into the points of the cluster.
    triangles: Vec<[u16; 3]>,
    /// Mesh index of each triangle.
    triangle_indices: Vec<u32>,
    clusters: Vec<ClusterExtent>,
}

/// End indices of a cluster's points and triangles, and its bounding box.
#[derive(Clone, Copy, Debug)]
struct ClusterExtent {
    points: usize,
    triangles: usize,
    middle: Vec3,
    half: Vec3,
}

/// Points of a cluster, and its triangles with their mesh indices.
pub type Cluster<'a> = (&'a [Vec3], &'a [[u16; 3]], &'a [u32]);

impl MeshClusters {
    /// Split a mesh into clusters. Indices must be in range.
    pub fn new(points: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let (_, order) = compute_spatial_order(points, triangles);
        let mut made = Self { triangle_indices: order, ..Self::default() };
        made.triangles.reserve_exact(triangles.len());
        // Last cluster that contains each point, and the point's index there.
        let mut known = vec![(u32::MAX, 0u16); points.len()];
        for (cluster, numbers) in (0..).zip(made.triangle_indices.chunks(CLUSTER_TRIANGLES)) {
            let first = made.points.len();
            for &t in numbers {
                made.triangles.push(triangles[t as usize].map(|v| {
                    let (last, place) = &mut known[v as usize];
                    if *last != cluster {
                        (*last, *place) = (cluster, (made.points.len() - first) as u16);
                        made.points.push(points[v as usize]);
                    }
                    *place
                }));
            }
            let [low, high] = bounding_box(made.points[first..].iter().copied());
            made.clusters.push(ClusterExtent {
                points: made.points.len(),
                triangles: made.triangles.len(),
                middle: [0, 1, 2].map(|i| (low[i] + high[i]) / 2.0),
                half: [0, 1, 2].map(|i| (high[i] - low[i]) / 2.0),
            });
        }
        made
    }

    /// Return the cluster of each mesh triangle. Consecutive clusters are close in space.
    pub fn triangle_clusters(&self) -> Vec<u32> {
        let mut found = vec![0; self.triangle_indices.len()];
        for (place, &t) in self.triangle_indices.iter().enumerate() {
            found[t as usize] = (place / CLUSTER_TRIANGLES) as u32;
        }
        found
    }

    /// Iterate over the clusters that may contain something visible to a camera beyond the distance `near`.
    pub fn visible_clusters(&self, camera: &PinholeCamera, near: f64) -> impl Iterator<Item = Cluster<'_>> {
        let sides = frustum_sides(camera, near);
        self.clusters.iter().enumerate().filter_map(move |(i, extent)| {
            let is_within = sides.iter().all(|side| side.may_contain(extent));
            let (point, triangle) =
                i.checked_sub(1).map_or((0, 0), |i| (self.clusters[i].points, self.clusters[i].triangles));
            let triangles = triangle..extent.triangles;
            is_within.then(|| {
                (
                    &self.points[point..extent.points],
                    &self.triangles[triangles.clone()],
                    &self.triangle_indices[triangles],
                )
            })
        })
    }
}

/// Half-space: `normal` · p + `shift` ≥ 0.
struct HalfSpace {
    normal: Vec3,
    shift: f64,
}

impl HalfSpace {
    fn may_contain(&self, box_: &ClusterExtent) -> bool {
        let [middle, half, size] = [
            (0..3).map(|i| self.normal[i] * box_.middle[i]).sum::<f64>(),
            (0..3).map(|i| self.normal[i].abs() * box_.half[i]).sum::<f64>(),
            (0..3).map(|i| (self.normal[i] * box_.middle[i]).abs()).sum::<f64>(),
        ];
        middle + half + self.shift >= -CULLING_TOLERANCE * (size + half + self.shift.abs())
    }
}

/// Compute the five half-spaces of the view frustum: in front of the camera, and between the image edges.
fn frustum_sides(camera: &PinholeCamera, near: f64) -> [HalfSpace; 5] {
    let [x, y, z] = camera.rotation;
    let [tx, ty, tz] = camera.translation;
    // Pixel column: x = fx X/Z + cx. The half-spaces are x Z ≥ 0, and (last column − x) Z ≥ 0.
    let of = |focal: f64, axis: Vec3, shift: f64, edge: f64, sign: f64| HalfSpace {
        normal: [0, 1, 2].map(|i| sign * (focal * axis[i] + edge * z[i])),
        shift: sign * (focal * shift + edge * tz),
    };
    let [fx, fy] = camera.focal;
    let [cx, cy] = camera.centre;
    [
        HalfSpace { normal: z, shift: tz - near },
        of(fx, x, tx, cx, 1.0),
        of(fx, x, tx, cx - (camera.width as f64 - 1.0), -1.0),
        of(fy, y, ty, cy, 1.0),
        of(fy, y, ty, cy - (camera.height as f64 - 1.0), -1.0),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_triangle_is_in_one_cluster_with_its_own_points() {
        // A long strip.
        let n = 1000u32;
        let points: Vec<Vec3> = (0..2 * n).map(|i| [f64::from(i / 2), f64::from(i % 2), 5.0]).collect();
        let triangles: Vec<[u32; 3]> = (0..2 * n - 2).map(|i| [i, i + 1, i + 2]).collect();
        let made = MeshClusters::new(&points, &triangles);
        let camera = PinholeCamera {
            focal: [100.0; 2],
            centre: [50.0, 40.0],
            width: 101,
            height: 81,
            rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            translation: [-300.0, 0.0, 0.0],
        };
        let mut seen = vec![];
        for (own, corners, numbers) in made.visible_clusters(&camera, 0.1) {
            for (corners, &number) in corners.iter().zip(numbers) {
                assert_eq!(
                    corners.map(|c| own[c as usize]),
                    triangles[number as usize].map(|v| points[v as usize])
                );
                seen.push(number);
            }
        }
        // 2.5 m to either side of 300 m, two triangles per metre, and the rest of these clusters.
        assert!((595..606).all(|t| seen.contains(&t)));
        assert!(seen.len() <= 3 * CLUSTER_TRIANGLES && seen.len() < triangles.len());
        let behind =
            PinholeCamera { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]], ..camera };
        assert_eq!(made.visible_clusters(&behind, 0.1).count(), 0);
        let of_triangles = made.triangle_clusters();
        assert!(of_triangles.is_sorted(), "along a strip");
        assert_eq!(of_triangles[triangles.len() - 1] as usize, (triangles.len() - 1) / CLUSTER_TRIANGLES);
    }
}
