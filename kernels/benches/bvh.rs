//! Benchmark of the bounding volume hierarchy over triangles: construction, and nearest-triangle queries.

use std::rc::Rc;

use criterion::Criterion;
use scanloom_kernels::certify::Surface;
use scanloom_kernels::mesh::bvh::Bvh;

use crate::common::{measure, plain_field};

pub fn bench(criterion: &mut Criterion) {
    measure(criterion, "bvh/build", plain_field, |(points, triangles)| {
        Bvh::new(triangles.len(), 1, |t| {
            let corners = triangles[t].map(|v| points[v as usize]);
            let end = |more: fn(f64, f64) -> f64| {
                [0, 1, 2].map(|i| corners[1..].iter().fold(corners[0][i], |end, p| more(end, p[i])))
            };
            [end(f64::min), end(f64::max)]
        })
    });
    let asked = |size| {
        let (points, triangles) = plain_field(size);
        let surface = Surface::new(&points, &triangles, 1).expect("finite");
        // Query points above the centroid of each triangle.
        let above = triangles.iter().map(|t| {
            let [a, b, c] = t.map(|v| points[v as usize]);
            [0, 1, 2].map(|i| (a[i] + b[i] + c[i]) / 3.0 + if i == 2 { 0.5 } else { 0.0 })
        });
        Rc::new((above.collect::<Vec<_>>(), surface))
    };
    measure(criterion, "bvh/nearest", asked, |asked| {
        let (points, surface) = &*asked;
        let nearest =
            |p| surface.bvh.find_nearest(p, (0, f64::INFINITY), |slot| surface.distance2(slot, p)).1;
        points.iter().map(nearest).sum::<f64>()
    });
}
