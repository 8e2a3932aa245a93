//! Simplification by near-planar patches.

use criterion::Criterion;
use scanloom_kernels::mesh::triangle_mesh::Mesh;
use scanloom_kernels::planar::{Options, simplify};

use crate::common::{alone, field, measure};

pub fn bench(criterion: &mut Criterion) {
    let cosine = |degrees: f64| degrees.to_radians().cos();
    let options = Options {
        labels: vec![],
        fidelity: cosine(35.0),
        detail: cosine(35.0),
        noise: cosine(75.0),
        max_distance: 1.0,
        max_color: 60.0,
        threads: 1,
    };
    let mesh = |size| {
        let (points, triangles) = field(size);
        Mesh::new(points, &triangles).expect("a manifold")
    };
    measure(criterion, "planar", mesh, |mesh: Mesh<6>| {
        alone(|progress| simplify::<6, 3>(&mesh, &options, progress)).expect("nobody interrupts")
    });
}
