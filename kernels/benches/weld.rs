//! Welding of triangles with separate vertices into one surface.

use criterion::Criterion;
use scanloom_kernels::seams::welding::weld;

use crate::common::{measure, plain_field};

pub fn bench(criterion: &mut Criterion) {
    let corners = |size| {
        let (_, triangles) = plain_field(size);
        let own = (0..triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect::<Vec<_>>();
        (triangles.concat(), own)
    };
    measure(criterion, "weld", corners, |(sets, triangles)| weld(&sets, &triangles).expect("a manifold"));
}
