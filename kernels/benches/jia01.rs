//! JIA01 to a tenth of the triangles.

use criterion::Criterion;
use scanloom_kernels::collapse::rounds::{Goal, REGION_TRIANGLES};
use scanloom_kernels::collapse::whole_mesh::WholeMesh;
use scanloom_kernels::jia01::{Limits, Options, simplify};

use crate::common::{alone, field, measure};

const OPTIONS: Options = Options {
    bounds: Limits::NONE,
    scales: Limits { length: 1.0, shape: 0.1, texture: 100.0 },
    soft_length: false,
    attribute_scale: 0.01,
    paper_rule: false,
    triangle_limit: 10_000_000,
};

pub fn bench(criterion: &mut Criterion) {
    measure(criterion, "jia01", field, |(points, triangles)| {
        let goal = Goal {
            triangles: triangles.len() / 10,
            threads: 1,
            region: REGION_TRIANGLES,
            min_collapse_ratio: 0.0,
            record_positions: false,
        };
        let whole = WholeMesh::new(points, triangles, vec![]).expect("finite");
        alone(|progress| simplify(whole, &OPTIONS, &goal, progress)).expect("a manifold")
    });
}
