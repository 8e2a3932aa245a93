//! Benchmark of halfedge construction from triangles.

use criterion::Criterion;
use scanloom_kernels::mesh::connectivity::Connectivity;

use crate::common::{measure, plain_field};

pub fn bench(criterion: &mut Criterion) {
    measure(criterion, "connectivity", plain_field, |(points, triangles)| {
        Connectivity::from_triangles(points.len(), &triangles).expect("a manifold")
    });
}
