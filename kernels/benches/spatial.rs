//! Benchmark of the Z-order sorting of a mesh.

use criterion::Criterion;
use scanloom_kernels::mesh::spatial_order::compute_spatial_order;

use crate::common::{measure, plain_field};

pub fn bench(criterion: &mut Criterion) {
    measure(criterion, "spatial", plain_field, |(points, triangles)| {
        compute_spatial_order(&points, &triangles)
    });
}
