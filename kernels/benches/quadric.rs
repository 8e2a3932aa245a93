//! Simplification by attribute quadrics to a tenth of the triangles.

use criterion::Criterion;
use scanloom_kernels::collapse::rounds::{Goal, Outcome, REGION_TRIANGLES, collapse};
use scanloom_kernels::collapse::whole_mesh::WholeMesh;
use scanloom_kernels::quadric::qem::QemState;

use crate::common::{Triangles, alone, field, measure};

pub fn bench(criterion: &mut Criterion) {
    measure(criterion, "quadric", field, |(points, triangles)| {
        let tenth = triangles.len() / 10;
        simplified(points, triangles, tenth, false)
    });
}

/// Simplify a coloured surface to `left` triangles.
pub fn simplified(
    points: Vec<[f64; 6]>,
    triangles: Triangles,
    left: usize,
    record: bool,
) -> Outcome<6, QemState<3>> {
    let goal = Goal {
        triangles: left,
        threads: 1,
        region: REGION_TRIANGLES,
        min_collapse_ratio: 0.0,
        record_positions: record,
    };
    let whole = WholeMesh::new(points, triangles, vec![]).expect("finite");
    let records = QemState { weight: 0.01, importance: vec![] };
    alone(|progress| collapse(whole, records, &goal, progress)).expect("a manifold")
}
