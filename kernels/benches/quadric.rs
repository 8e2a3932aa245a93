//! Simplification by attribute quadrics to a tenth of the triangles.

use criterion::Criterion;
use scanloom_kernels::collapse::rounds::{Goal, Outcome, REGION_TRIANGLES, collapse};
use scanloom_kernels::collapse::whole::Whole;
use scanloom_kernels::quadric::qem::QemRecords;

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
) -> Outcome<6, QemRecords<3>> {
    let goal = Goal { triangles: left, threads: 1, region: REGION_TRIANGLES, least: 0.0, record };
    let whole = Whole::new(points, triangles, vec![]).expect("finite");
    let records = QemRecords { weight: 0.01, importance: vec![] };
    alone(|progress| collapse(whole, records, &goal, progress)).expect("a manifold")
}
