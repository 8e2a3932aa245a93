//! Bounds between a surface and its simplification to a tenth of the triangles.

use std::rc::Rc;

use criterion::Criterion;
use scanloom_kernels::certify::{Options, Surface, certify};

use crate::common::{alone, field, measure};
use crate::quadric::simplified;

pub fn bench(criterion: &mut Criterion) {
    let options = Options { threads: 1, ..Options::default() };
    let pair = |size| {
        let (points, triangles) = field(size);
        let original = Surface::new(&points, &triangles, 1).expect("finite");
        let light = simplified(points, triangles, size / 10, false).mesh.into_compact();
        let light = Surface::new(&light.points, &light.triangles, 1).expect("finite");
        Rc::new((light, original))
    };
    measure(criterion, "certify", pair, |pair| {
        alone(|progress| certify(&pair.0, &pair.1, &options, progress)).expect("nobody interrupts")
    });
}
