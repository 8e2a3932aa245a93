//! Normal meshes: base, three levels and the search for their vertices.

use criterion::Criterion;
use scanloom_kernels::base::geometry::Vec3;
use scanloom_kernels::normal::coarsening::Target;
use scanloom_kernels::normal::normal_mesh::NormalMesh;
use scanloom_kernels::normal::remesh::remesh;
use scanloom_kernels::normal::settings::Settings;
use scanloom_kernels::normal::vertex_attributes::VertexAttributes;
use scanloom_kernels::subdivision::snm_contents::Scheme;

use crate::common::{Triangles, alone, measure, plain_field};

pub const LEVELS: u8 = 3;

pub fn bench(criterion: &mut Criterion) {
    measure(criterion, "normal", plain_field, remeshed);
}

/// Remesh so that the last level has about as many triangles as the surface.
pub fn remeshed((points, triangles): (Vec<Vec3>, Triangles)) -> NormalMesh {
    let settings = Settings {
        levels: Some(LEVELS),
        target: Target {
            triangles: triangles.len() >> (2 * LEVELS),
            error: f64::INFINITY,
            ignore_cost_limit: true,
        },
        max_error: 0.0,
        scheme: Scheme::Linear,
        relaxations: 1,
        tolerance: Some(1e-4),
        color_tolerance: 2.0,
        up: None,
        threads: 1,
    };
    let carried = VertexAttributes::default();
    alone(|progress| remesh(&points, &triangles, &carried, None, &settings, progress)).expect("a manifold")
}
