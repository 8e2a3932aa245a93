//! A mesh in clusters of triangles that lie near each other, of which a camera looks at few.

use super::pinhole::Pinhole;
use crate::base::geometry::{Vec3, around};
use crate::mesh::spatial::spatial_order;

/// Triangles of a cluster: few enough for small boxes, enough that it has hardly more points than a share of the mesh.
const SIZE: usize = 256;
/// Of what is compared, for rounding: a box this little beyond an edge of the image is looked at.
const SLACK: f64 = 1e-6;

/// A mesh to be drawn often.
#[derive(Debug, Default)]
pub struct Clusters {
    /// Of each cluster, one cluster after another.
    points: Vec<Vec3>,
    /// Corners by their places among the cluster's points.
    triangles: Vec<[u16; 3]>,
    /// Of the triangles in the mesh.
    numbers: Vec<u32>,
    clusters: Vec<Extent>,
}

/// One of them: where its points and triangles end, and the box around them.
#[derive(Clone, Copy, Debug)]
struct Extent {
    points: usize,
    triangles: usize,
    middle: Vec3,
    half: Vec3,
}

/// A cluster's points, and its triangles with their numbers.
pub type Cluster<'a> = (&'a [Vec3], &'a [[u16; 3]], &'a [u32]);

impl Clusters {
    /// Indices must be in range.
    pub fn new(points: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let (_, order) = spatial_order(points, triangles);
        let mut made = Self { numbers: order, ..Self::default() };
        made.triangles.reserve_exact(triangles.len());
        // The last cluster that has a point, and its place there.
        let mut known = vec![(u32::MAX, 0u16); points.len()];
        for (cluster, numbers) in (0..).zip(made.numbers.chunks(SIZE)) {
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
            let [low, high] = around(made.points[first..].iter().copied());
            made.clusters.push(Extent {
                points: made.points.len(),
                triangles: made.triangles.len(),
                middle: [0, 1, 2].map(|i| (low[i] + high[i]) / 2.0),
                half: [0, 1, 2].map(|i| (high[i] - low[i]) / 2.0),
            });
        }
        made
    }

    /// The cluster of each triangle of the mesh; clusters that follow each other are near each other.
    pub fn of_triangles(&self) -> Vec<u32> {
        let mut found = vec![0; self.numbers.len()];
        for (place, &t) in self.numbers.iter().enumerate() {
            found[t as usize] = (place / SIZE) as u32;
        }
        found
    }

    /// Those of which a camera may see something that is no nearer than `near`.
    pub fn before(&self, camera: &Pinhole, near: f64) -> impl Iterator<Item = Cluster<'_>> {
        let sides = sides(camera, near);
        self.clusters.iter().enumerate().filter_map(move |(i, extent)| {
            let is_within = sides.iter().all(|side| side.has_some_of(extent));
            let (point, triangle) =
                i.checked_sub(1).map_or((0, 0), |i| (self.clusters[i].points, self.clusters[i].triangles));
            let triangles = triangle..extent.triangles;
            is_within.then(|| {
                (
                    &self.points[point..extent.points],
                    &self.triangles[triangles.clone()],
                    &self.numbers[triangles],
                )
            })
        })
    }
}

/// A half of the space: where `normal` · p + `shift` is not below 0.
struct Side {
    normal: Vec3,
    shift: f64,
}

impl Side {
    fn has_some_of(&self, box_: &Extent) -> bool {
        let [middle, half, size] = [
            (0..3).map(|i| self.normal[i] * box_.middle[i]).sum::<f64>(),
            (0..3).map(|i| self.normal[i].abs() * box_.half[i]).sum::<f64>(),
            (0..3).map(|i| (self.normal[i] * box_.middle[i]).abs()).sum::<f64>(),
        ];
        middle + half + self.shift >= -SLACK * (size + half + self.shift.abs())
    }
}

/// What a camera sees is in all of these: before it, and between the edges of its image.
fn sides(camera: &Pinhole, near: f64) -> [Side; 5] {
    let [x, y, z] = camera.turn;
    let [tx, ty, tz] = camera.shift;
    // A pixel's column is fx X/Z + cx: its sign, and that of what is left to the last one, times Z.
    let of = |focal: f64, axis: Vec3, shift: f64, edge: f64, sign: f64| Side {
        normal: [0, 1, 2].map(|i| sign * (focal * axis[i] + edge * z[i])),
        shift: sign * (focal * shift + edge * tz),
    };
    let [fx, fy] = camera.focal;
    let [cx, cy] = camera.centre;
    [
        Side { normal: z, shift: tz - near },
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
        let made = Clusters::new(&points, &triangles);
        let camera = Pinhole {
            focal: [100.0; 2],
            centre: [50.0, 40.0],
            width: 101,
            height: 81,
            turn: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            shift: [-300.0, 0.0, 0.0],
        };
        let mut seen = vec![];
        for (own, corners, numbers) in made.before(&camera, 0.1) {
            for (corners, &number) in corners.iter().zip(numbers) {
                assert_eq!(
                    corners.map(|c| own[c as usize]),
                    triangles[number as usize].map(|v| points[v as usize])
                );
                seen.push(number);
            }
        }
        // 2.5 m to either side of 300 m, two triangles a metre, and what else is in these clusters.
        assert!((595..606).all(|t| seen.contains(&t)));
        assert!(seen.len() <= 3 * SIZE && seen.len() < triangles.len());
        let behind = Pinhole { turn: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]], ..camera };
        assert_eq!(made.before(&behind, 0.1).count(), 0);
        let of_triangles = made.of_triangles();
        assert!(of_triangles.is_sorted(), "along a strip");
        assert_eq!(of_triangles[triangles.len() - 1] as usize, (triangles.len() - 1) / SIZE);
    }
}
