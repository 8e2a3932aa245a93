//! Rebuild of a base mesh with locked vertices.

use scanloom_kernels::base::progress::{Progress, RunControl};
use scanloom_kernels::mesh::triangle_mesh::Mesh;
use scanloom_kernels::normal::base_mesh::Base;
use scanloom_kernels::normal::coarsening::{Target, coarsen};
use scanloom_kernels::normal::fold::Fold;
use scanloom_kernels::normal::input::Input;
use scanloom_kernels::normal::locking::Locking;
use scanloom_kernels::normal::vertex_attributes::VertexAttributes;
use scanloom_kernels::subdivision::snm_contents::Scheme;

use super::remesh::{settings, sheet};

/// List the triangles of a base by sorted input vertices, independent of their order.
fn triangles_of(base: &Base) -> Vec<[u32; 3]> {
    let mut triangles: Vec<[u32; 3]> = base
        .triangles
        .iter()
        .map(|corners| {
            let mut sources = corners.map(|v| base.vertex_source[v as usize]);
            sources.sort_unstable();
            sources
        })
        .collect();
    triangles.sort_unstable();
    triangles
}

#[test]
fn a_base_once_more_is_the_same_but_where_vertices_are_locked() {
    let (points, triangles) = sheet(24);
    let settings = settings(1, Scheme::Linear);
    let target = Target { triangles: 60, error: f64::INFINITY, ignore_cost_limit: true };
    let carried = VertexAttributes::default();
    let input = Input::new(points.clone(), &triangles, &carried, None, &[0.0; 3], &settings);
    let control = RunControl::default();
    let progress = &mut Progress::new(&control);
    let mesh = Mesh::new(points.clone(), &triangles).unwrap();
    let coarse = coarsen(mesh, &input.surface, target, true, progress).unwrap();
    let base = coarse.build_base(&vec![1.0; points.len()], &input.slots, progress).unwrap();

    let mut locking = Locking::new(&base, &input);
    let again = locking.rebuild_base(&input, target, progress).unwrap();
    assert_eq!(triangles_of(&base), triangles_of(&again));

    // Simulate a fold at a removed vertex; the nearest input vertex must be locked.
    let gone = (0..points.len()).filter(|&v| base.base_points[v].barycentric.iter().all(|&x| x > 0.2));
    let v = gone.into_iter().next().unwrap();
    let fold = Fold { triangle: base.base_points[v].triangle as usize, middle: points[v] };
    locking.lock_around_folds(&[fold], &base, &input);
    let more = locking.rebuild_base(&input, target, progress).unwrap();
    assert!(more.vertex_source.contains(&(v as u32)));
    assert!(base.vertex_source.iter().all(|v| more.vertex_source.contains(v)));
    assert!((base.triangles.len() + 2..base.triangles.len() + 20).contains(&more.triangles.len()));
    let kept = triangles_of(&more).iter().filter(|t| triangles_of(&base).contains(t)).count();
    assert!(2 * kept > base.triangles.len());

    // Further folds at the same point lock all corners of the nearest triangle, then the ring around it.
    locking.lock_around_folds(&[fold], &base, &input);
    locking.lock_around_folds(&[fold], &base, &input);
    let most = locking.rebuild_base(&input, target, progress).unwrap();
    assert!(most.vertex_source.len() > more.vertex_source.len());
}
