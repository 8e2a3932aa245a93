//! Simplification of a textured surface with charts and seams to a tenth of its triangles, without fit.

use std::rc::Rc;

use criterion::Criterion;
use scanloom_kernels::collapse::rounds;
use scanloom_kernels::seams::{CostParameters, SeamGoal, SeamSurface, simplify};

use crate::common::{alone, field, measure};

const KNOBS: CostParameters = CostParameters {
    material_border_penalty: 0.5,
    part_border_penalty: 0.5,
    valence: 0.1,
    wedges: 0.1,
    shape: 1.0,
    seam_drift: f64::INFINITY,
};
/// The region size that `stages` uses.
const REGION_TRIANGLES: usize = 2048;
/// Side of a chart, in vertex spacings.
const CHART: f64 = 50.0;

pub fn bench(criterion: &mut Criterion) {
    measure(
        criterion,
        "seams",
        |size| Rc::new(textured(size)),
        |surface| {
            let triangles = surface.triangles.len() / 10;
            let rounds = rounds::Goal {
                triangles,
                threads: 1,
                region: REGION_TRIANGLES,
                min_collapse_ratio: 0.0,
                record_positions: false,
            };
            let goal = SeamGoal { rounds, fit: false };
            alone(|progress| simplify::<8, 5>(&surface, KNOBS, goal, progress)).expect("a manifold")
        },
    );
}

/// Build a height field with square charts in separate areas of the texture; corners have texture coordinates
/// and a colour.
fn textured(size: usize) -> SeamSurface<5> {
    let (points, triangles) = field(size);
    let corners = triangles.iter().flat_map(|t| {
        let middle = |i: usize| t.iter().map(|&v| points[v as usize][i]).sum::<f64>() / 3.0;
        let [left, low] = [0, 1].map(|i| (middle(i) / CHART).floor());
        t.map(|v| {
            let p = &points[v as usize];
            // The distance between charts is twice their size.
            [p[0] + left * CHART, p[1] + low * CHART, p[3], p[4], p[5]]
        })
    });
    let (count, vertices) = (triangles.len(), points.len());
    SeamSurface {
        corners: corners.collect(),
        points: points.iter().map(|p| [p[0], p[1], p[2]]).collect(),
        coincident_sets: (0..vertices as u32).collect(),
        triangles,
        textured: vec![true; count],
        materials: vec![0; count],
        parts: vec![0; count],
        importance: vec![],
        locked: vec![false; vertices],
    }
}
