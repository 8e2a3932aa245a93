//! Certified simplification to 0.3 of the vertex spacing and 16 levels, including the proof.

use criterion::Criterion;
use scanloom_kernels::certified::simplify::{Options, simplify};
use scanloom_kernels::certify::Deviation;
use scanloom_kernels::collapse::rounds::{Goal, REGION_TRIANGLES};

use crate::common::{alone, field, measure};

pub fn bench(criterion: &mut Criterion) {
    let mut options =
        Options { weight: 0.01, tight_bounds: false, ..Options::new(Deviation { shape: 0.3, color: 16.0 }) };
    options.proof.threads = 1;
    let goal = Goal {
        triangles: 0,
        threads: 1,
        region: REGION_TRIANGLES,
        min_collapse_ratio: 0.0,
        record_positions: false,
    };
    measure(criterion, "certified", field, |(points, triangles)| {
        alone(|progress| simplify::<6, 3>(points, triangles, vec![], &options, &goal, progress))
            .expect("a manifold")
    });
}
