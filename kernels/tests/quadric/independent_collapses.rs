//! Collapse of independent edges: it keeps the surface a manifold of the same topology, keeps locked vertices,
//! and depends neither on the number of threads nor on the unit of length.

use crate::promises::common::{Triangles, coloured, large_gallery, torus};
use scanloom_kernels::base::progress::{Progress, RunControl};
use scanloom_kernels::collapse::collapse_log::{RegionLog, order_for_replay};
use scanloom_kernels::collapse::rounds::{Goal, REGION_TRIANGLES};
use scanloom_kernels::collapse::whole_mesh::WholeMesh;
use scanloom_kernels::mesh::triangle_mesh::Mesh;
use scanloom_kernels::quadric::independent_collapses::collapse_independent_edges;
use scanloom_kernels::quadric::qem::QemState;

const GOAL: Goal = Goal {
    triangles: 1,
    threads: 1,
    region: REGION_TRIANGLES,
    min_collapse_ratio: 0.0,
    record_positions: false,
};

fn collapse(
    points: &[[f64; 6]],
    triangles: &Triangles,
    locked: Vec<bool>,
    importance: Vec<f64>,
    left: usize,
    threads: usize,
) -> (WholeMesh<6, ()>, Vec<RegionLog<6>>) {
    let mesh = WholeMesh::new(points.to_vec(), triangles.clone(), locked).unwrap();
    let state = QemState::<3> { weight: 1e-3, importance };
    let control = RunControl::default();
    let goal = Goal { threads, ..GOAL };
    let (mesh, _, logs) =
        collapse_independent_edges(mesh, state, left, &goal, &mut Progress::new(&control)).unwrap();
    (mesh, logs)
}

#[test]
fn every_mesh_keeps_its_topology() {
    for (name, points, triangles) in large_gallery() {
        let points = coloured::<6>(&points, 0.1, 1);
        let before = Mesh::new(points.clone(), &triangles).unwrap();
        let (light, _) = collapse(&points, &triangles, vec![], vec![], 1, 1);
        assert!(light.points.as_flattened().iter().all(|x| x.is_finite()), "{name}");
        let after = light.into_connected().unwrap();
        after.connectivity.validate().unwrap();
        assert_eq!(before.connectivity.topology(), after.connectivity.topology(), "{name}");
    }
}

#[test]
fn boundary_of_a_flat_sheet_stays() {
    // A jagged outline would lose area; edges inside a straight side may collapse.
    let n = 24;
    let points: Vec<[f64; 6]> = (0..=n)
        .flat_map(|y| (0..=n).map(move |x| [f64::from(x), f64::from(y), 0.0, 50.0, 60.0, 70.0]))
        .collect();
    let square = |a: u32| [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]];
    let triangles: Triangles =
        (0..n).flat_map(|y| (0..n).flat_map(move |x| square(y * (n + 1) + x))).collect();
    let (light, _) = collapse(&points, &triangles, vec![], vec![], 100, 1);
    assert!(light.triangles.len() <= 110, "{}", light.triangles.len());
    let area: f64 = light
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|v| light.points[v as usize]);
            0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
        })
        .sum();
    assert!((area / f64::from(n * n) - 1.0).abs() < 1e-3, "{area}");
    assert!(light.points.iter().all(|p| p[2].abs() < 1e-6 && (p[3] - 50.0).abs() < 1e-3));
}

#[test]
fn as_many_triangles_are_left_as_wanted() {
    let (points, triangles) = torus(60, 50);
    let points = coloured::<6>(&points, 0.02, 3);
    let (light, logs) = collapse(&points, &triangles, vec![], vec![], 1800, 1);
    let gone: usize = logs.iter().flat_map(|log| &log.merges).map(|merge| usize::from(merge.triangles)).sum();
    assert_eq!(light.triangles.len() + gone, triangles.len());
    assert!((1799..=1800).contains(&light.triangles.len()), "{}", light.triangles.len());
    assert_eq!(collapse(&points, &triangles, vec![], vec![], 6000, 1).1, vec![]);
}

#[test]
fn two_threads_and_another_unit_change_nothing() {
    let (points, triangles) = torus(60, 50);
    let points = coloured::<6>(&points, 0.02, 3);
    let importance: Vec<f64> = (0..points.len()).map(|v| 1.0 + (v % 3) as f64).collect();
    let (one, logs) = collapse(&points, &triangles, vec![], importance.clone(), 1800, 1);
    let (two, same) = collapse(&points, &triangles, vec![], importance.clone(), 1800, 2);
    assert_eq!((&one.triangles, &one.vertex_source, &logs), (&two.triangles, &two.vertex_source, &same));
    // A power of two changes no digit; the weight is a length, too.
    let unit = 2.0_f64.powi(-60);
    let tiny: Vec<[f64; 6]> =
        points.iter().map(|p| std::array::from_fn(|i| if i < 3 { unit * p[i] } else { p[i] })).collect();
    let mesh = WholeMesh::new(tiny, triangles.clone(), vec![]).unwrap();
    let state = QemState::<3> { weight: 1e-3 * unit, importance };
    let control = RunControl::default();
    let (tiny, _, _) =
        collapse_independent_edges(mesh, state, 1800, &GOAL, &mut Progress::new(&control)).unwrap();
    assert_eq!((tiny.triangles, tiny.vertex_source), (one.triangles, one.vertex_source));
}

#[test]
fn locked_vertices_stay() {
    let (points, triangles) = torus(30, 20);
    let points = coloured::<6>(&points, 0.02, 3);
    let locked: Vec<bool> = (0..points.len()).map(|v| v % 7 == 0).collect();
    let (light, _) = collapse(&points, &triangles, locked.clone(), vec![], 1, 1);
    let moved = |(v, &source): (usize, &u32)| light.points[v] != points[source as usize];
    assert!(!light.vertex_source.iter().enumerate().any(|v| light.locked[v.0] && moved(v)));
    let kept = light.vertex_source.iter().filter(|&&v| locked[v as usize]).count();
    assert_eq!(kept, locked.iter().filter(|&&locked| locked).count());
    assert!(
        light.vertex_source.iter().zip(&light.locked).all(|(&v, &is_locked)| locked[v as usize] == is_locked)
    );
    assert!(light.vertex_source.len() < 3 * points.len() / 4);
}

#[test]
fn replayed_removals_give_the_mesh() {
    let (points, triangles) = torus(30, 20);
    let points = coloured::<6>(&points, 0.02, 3);
    let (light, logs) = collapse(&points, &triangles, vec![], vec![], 1, 1);
    let mut left = triangles;
    for (log, i) in order_for_replay(&logs) {
        let merge = logs[log].merges[i];
        left.iter_mut().flatten().filter(|v| **v == merge.removed.0).for_each(|v| *v = merge.survivor.0);
        left.retain(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]);
    }
    let of_sources: Triangles =
        light.triangles.iter().map(|t| t.map(|v| light.vertex_source[v as usize])).collect();
    assert_eq!(left, of_sources);
}

#[test]
fn where_the_mesh_is_not_manifold_nothing_is_removed() {
    // Two tetrahedra that share vertex 0, and a fan on edge 0–1.
    let tetrahedron = |a: u32, b: u32, c: u32, d: u32| [[a, b, c], [a, c, d], [a, d, b], [b, d, c]];
    let mut triangles: Triangles = tetrahedron(0, 1, 2, 3).to_vec();
    triangles.extend(tetrahedron(0, 4, 5, 6));
    triangles.push([0, 1, 7]);
    let points: Vec<[f64; 6]> = (0..8)
        .map(|v| std::array::from_fn(|i| f64::from((v * 37 + i as u32 * 11 + v * v * 5) % 17)))
        .collect();
    let (light, logs) = collapse(&points, &triangles, vec![], vec![], 1, 1);
    assert_eq!(light.triangles.len(), triangles.len());
    assert!(logs.iter().all(|log| log.merges.is_empty()));
}
