//! Least-squares fit of a mesh simplified to a tenth of the triangles.

use criterion::Criterion;
use scanloom_kernels::base::ids::VertexId;
use scanloom_kernels::fitting::least_squares::{FitInput, fit};
use scanloom_kernels::mesh::triangle_mesh::Mesh;

use crate::common::{alone, field, measure};
use crate::quadric::simplified;

pub fn bench(criterion: &mut Criterion) {
    let given = |size| {
        let (points, triangles) = field(size);
        let outcome = simplified(points.clone(), triangles.clone(), size / 10, true);
        let mut became = vec![VertexId::NONE; points.len()];
        for (new, &v) in outcome.mesh.vertex_source.iter().enumerate() {
            became[v as usize] = VertexId::from_index(new);
        }
        for merge in outcome.logs.iter().rev().flat_map(|log| log.merges.iter().rev()) {
            became[merge.removed.index()] = became[merge.survivor.index()];
        }
        let light = outcome.mesh.into_connected().expect("a manifold");
        (light, points, triangles, became)
    };
    measure(criterion, "fitting", given, |(mut mesh, points, triangles, became): (Mesh<6>, _, _, _)| {
        let input = FitInput { points: &points, triangles: &triangles, vertex_map: &became };
        alone(|progress| fit(&mut mesh, &input, 1, progress)).expect("nobody interrupts");
        mesh
    });
}
