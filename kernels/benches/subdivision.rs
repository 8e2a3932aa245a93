//! 1–4 subdivision and butterfly prediction; elements are triangles before subdivision.

use std::rc::Rc;

use criterion::Criterion;
use scanloom_kernels::subdivision::butterfly::compute_edge_points;
use scanloom_kernels::subdivision::topology::Topology;

use crate::common::{measure, plain_field};

pub fn bench(criterion: &mut Criterion) {
    let coarse = |size| {
        let (points, triangles) = plain_field(size);
        Rc::new((Topology::new(points.len(), triangles).expect("a manifold"), points))
    };
    measure(criterion, "subdivision/in four", coarse, |coarse| coarse.0.subdivide());
    measure(criterion, "subdivision/butterfly", coarse, |coarse| compute_edge_points(&coarse.0, &coarse.1));
}
