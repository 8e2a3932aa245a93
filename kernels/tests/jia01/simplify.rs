//! JIA01 on the collapse engine: bounds after every collapse, splits, stop rules, degenerate input.

use crate::promises::common::{Noise, coloured, gallery, sheet, tetrahedron, torus};
use scanloom_kernels::base::errors::KernelError;
use scanloom_kernels::base::geometry::{distance2, norm2, position_of, sub};
use scanloom_kernels::base::progress::{Progress, RunControl};
use scanloom_kernels::collapse::engine::{Engine, Step, Stop};
use scanloom_kernels::collapse::rounds::{Goal, REGION_TRIANGLES};
use scanloom_kernels::collapse::whole_mesh::WholeMesh;
use scanloom_kernels::jia01::{Jia01, JiaResult, Limits, Options, StopRule, simplify};
use scanloom_kernels::mesh::triangle_mesh::{Mesh, VertexLock};

const OPTIONS: Options = Options {
    bounds: Limits::NONE,
    scales: Limits { length: 1.0, shape: 0.1, texture: 100.0 },
    soft_length: false,
    attribute_scale: 1e-3,
    paper_rule: false,
    triangle_limit: 1_000_000,
};

const GOAL: Goal = Goal {
    triangles: 0,
    threads: 1,
    region: REGION_TRIANGLES,
    min_collapse_ratio: 0.0,
    record_positions: false,
};

fn run<const D: usize>(
    points: Vec<[f64; D]>,
    triangles: &[[u32; 3]],
    options: &Options,
) -> Result<JiaResult<D>, KernelError> {
    run_to(0, points, triangles, options)
}

fn run_to<const D: usize>(
    target: usize,
    points: Vec<[f64; D]>,
    triangles: &[[u32; 3]],
    options: &Options,
) -> Result<JiaResult<D>, KernelError> {
    let control = RunControl::default();
    let whole = WholeMesh::new(points, triangles.to_vec(), vec![])?;
    simplify(whole, options, &Goal { triangles: target, ..GOAL }, &mut Progress::new(&control))
}

#[test]
fn every_step_keeps_topology_and_bounds() {
    let bounds = Limits { length: f64::INFINITY, shape: 0.4, texture: 2000.0 };
    for (name, points, triangles) in gallery() {
        let mesh = Mesh::new(coloured::<6>(&points, 0.2, 5), &triangles).unwrap();
        let topology = mesh.connectivity.topology();
        let measure = Jia01::new(&mesh, &Options { bounds, ..OPTIONS });
        let mut engine = Engine::new(mesh, measure);
        loop {
            let step = engine.step();
            if step == Step::Finished {
                break;
            }
            if let Step::Collapsed(_) = step {
                let connectivity = &engine.mesh().connectivity;
                assert_eq!(connectivity.validate(), Ok(()), "{name}");
                assert_eq!(connectivity.topology(), topology, "{name}");
                for edge in connectivity.edges() {
                    let sums = engine.measure().accumulated(edge);
                    assert!(sums.shape <= bounds.shape && sums.texture <= bounds.texture, "{name}");
                }
            }
        }
    }
}

#[test]
fn every_edge_is_queued_or_refused_by_a_rule() {
    let (points, triangles) = torus(16, 10);
    let bounds = Limits { length: 1.2, shape: 0.05, texture: 700.0 };
    let result = run(coloured::<6>(&points, 0.1, 6), &triangles, &Options { bounds, ..OPTIONS }).unwrap();
    assert_eq!(result.stop, Stop::Exhausted);
    let s = result.refused;
    let edges = result.mesh.triangles.len() * 3 / 2;
    assert_eq!(s.length + s.shape + s.texture + s.topology + s.bridge + s.locked + s.fold, edges);
}

#[test]
fn long_edges_are_split_and_the_new_parts_know_their_origin() {
    let (points, triangles) = sheet(3, 2);
    let bounds = Limits { length: 0.3, shape: 0.0, texture: 0.0 };
    let points: Vec<[f64; 6]> = coloured(&points, 0.0, 7);
    let result = run(points.clone(), &triangles, &Options { bounds, ..OPTIONS }).unwrap();
    assert!(result.splits > 0);
    let mut area = vec![0.0; triangles.len()];
    for (corners, &source) in result.mesh.triangles.iter().zip(&result.mesh.triangle_source) {
        let [a, b, c] = corners.map(|v| result.mesh.points[v as usize]);
        for (p, q) in [(a, b), (b, c), (c, a)] {
            assert!(distance2(&p, &q).sqrt() <= 0.3);
        }
        let cross = scanloom_kernels::base::geometry::cross(
            &sub(&position_of(&b), &position_of(&a)),
            &sub(&position_of(&c), &position_of(&a)),
        );
        area[source as usize] += norm2(&cross).sqrt() / 2.0;
    }
    assert!(area.iter().all(|a| (a - 0.5).abs() < 1e-12), "{area:?}");
    for (vertex, &source) in result.mesh.vertex_source.iter().enumerate().take(points.len()) {
        assert_eq!((vertex as u32, result.mesh.points[vertex]), (source, points[vertex]));
    }
}

#[test]
fn the_split_of_an_edge_between_locked_vertices_is_locked() {
    for (locked, expected) in [([true, true, false], true), ([true, false, false], false)] {
        let points = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.5, 0.1, 0.0]];
        let whole: WholeMesh<3, StopRule> = WholeMesh::new(points, vec![[0, 1, 2]], locked.to_vec()).unwrap();
        let mut mesh = whole.into_connected().unwrap();
        let longest = mesh.connectivity.edges().find(|e| mesh.connectivity.ends(*e).iter().all(|v| v.0 < 2));
        mesh.split(longest.unwrap());
        assert_eq!((mesh.points[3], mesh.locks[3] == VertexLock::Locked), ([0.5, 0.0, 0.0], expected));
    }
}

#[test]
fn a_soft_length_splits_and_lets_longer_edges_collapse_last() {
    let (points, triangles) = sheet(12, 12);
    let bounds = Limits { length: 1.2, ..Limits::NONE };
    let points: Vec<[f64; 3]> = coloured(&points, 0.4, 11);
    let run = |soft_length, target| {
        let options = Options { bounds, soft_length, ..OPTIONS };
        run_to(target, points.clone(), &triangles, &options).unwrap()
    };
    let (strict, soft) = (run(false, 0), run(true, 40));
    assert!(strict.splits > 0 && strict.splits == soft.splits);
    assert!(strict.mesh.triangles.len() > 40 && strict.refused.length > 0);
    assert_eq!((soft.stop, soft.refused.length), (Stop::Target, 0));
    // Standard deviation of the lengths of the sides over their mean.
    let variation = |result: &JiaResult<3>| {
        let sides = result.mesh.triangles.iter().flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]]);
        let lengths: Vec<f64> = sides
            .map(|ends| ends.map(|v| &result.mesh.points[v as usize]))
            .map(|[a, b]| distance2(a, b).sqrt())
            .collect();
        let mean = lengths.iter().sum::<f64>() / lengths.len() as f64;
        let variance = lengths.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / lengths.len() as f64;
        variance.sqrt() / mean
    };
    // Without a bound on lengths, edges of any length collapse.
    let any = run_to(150, points.clone(), &triangles, &OPTIONS).unwrap();
    let (soft, any) = (variation(&run(true, 150)), variation(&any));
    assert!(soft < any, "{soft} {any}");
}

#[test]
fn splitting_stops_at_the_limit() {
    let (points, triangles) = sheet(3, 2);
    let options = |length, triangle_limit| Options {
        bounds: Limits { length, ..Limits::NONE },
        triangle_limit,
        ..OPTIONS
    };
    let refused = run(points.clone(), &triangles, &options(1e-9, 1_000_000)).unwrap_err();
    assert!(matches!(refused, KernelError::TooManyTriangles { limit: 1_000_000, .. }));
    assert!(run(points, &triangles, &options(0.9, 20)).is_err());
}

#[test]
fn the_target_is_reached_and_not_passed() {
    let (points, triangles) = torus(20, 12);
    let result = run_to(101, points, &triangles, &OPTIONS).unwrap();
    assert_eq!((result.stop, result.mesh.triangles.len()), (Stop::Target, 100));
}

#[test]
fn a_flat_sheet_of_one_colour_loses_its_inside_and_keeps_its_corners() {
    let (points, triangles) = sheet(12, 9);
    let points: Vec<[f64; 4]> = points.iter().map(|p| [p[0], p[1], p[2], 80.0]).collect();
    let bounds = Limits { length: f64::INFINITY, shape: 1e-9, texture: 0.0 };
    let result = run(points, &triangles, &Options { bounds, ..OPTIONS }).unwrap();
    assert!(result.mesh.triangles.len() < triangles.len() / 10);
    for corner in [[0.0, 0.0], [12.0, 0.0], [12.0, 9.0], [0.0, 9.0]] {
        assert!(result.mesh.points.iter().any(|p| p[..2] == corner && p[2..] == [0.0, 80.0]));
    }
}

#[test]
fn the_paper_rule_overshoots_and_the_default_does_not() {
    let (points, triangles) = torus(30, 20);
    let bounds = Limits { length: f64::INFINITY, shape: 0.05, texture: f64::INFINITY };
    let largest = |paper_rule| {
        let options = Options { bounds, paper_rule, ..OPTIONS };
        run(coloured::<3>(&points, 0.05, 8), &triangles, &options).unwrap().largest_shape_change
    };
    assert!(largest(false) <= 0.05);
    assert!(largest(true) > 0.05);
}

#[test]
fn equal_input_gives_equal_bits() {
    let (points, triangles) = torus(40, 25);
    let once = || run_to(200, coloured::<6>(&points, 0.1, 9), &triangles, &OPTIONS);
    assert_eq!(once().unwrap().mesh, once().unwrap().mesh);
}

#[test]
fn triangles_without_area_do_no_harm() {
    let mut noise = Noise(3);
    for (name, points, triangles) in gallery() {
        for share in [0.2, 1.0] {
            // Some vertices coincide or become collinear.
            let flat: Vec<[f64; 3]> = points
                .iter()
                .map(|p| if noise.next() < share { [p[0].round(), 0.0, 0.0] } else { *p })
                .collect();
            let mesh = Mesh::new(flat, &triangles).unwrap();
            let topology = mesh.connectivity.topology();
            let mut engine = Engine::new(mesh.clone(), Jia01::new(&mesh, &OPTIONS));
            while engine.step() != Step::Finished {}
            let connectivity = &engine.mesh().connectivity;
            assert_eq!((connectivity.validate(), connectivity.topology()), (Ok(()), topology), "{name}");
            assert!(engine.mesh().compact().points.iter().flatten().all(|x| x.is_finite()), "{name}");
        }
    }
}

/// Scaling by a power of two is exact, so the collapses must be the same.
#[test]
fn the_unit_of_length_does_not_matter() {
    let (points, triangles) = torus(24, 16);
    let points = coloured::<6>(&points, 0.1, 10);
    let scaled = |s: f64| {
        let points = points.iter().map(|p| [p[0] * s, p[1] * s, p[2] * s, p[3], p[4], p[5]]).collect();
        let limits = |l: Limits| Limits { length: l.length * s, shape: l.shape * s, ..l };
        let options = Options {
            bounds: limits(Limits { length: 2.0, shape: 0.8, texture: 9000.0 }),
            scales: limits(OPTIONS.scales),
            attribute_scale: OPTIONS.attribute_scale * s,
            ..OPTIONS
        };
        run(points, &triangles, &options).unwrap().mesh
    };
    let here = scaled(1.0);
    assert!(here.triangles.len() < triangles.len() / 2);
    for exponent in [-40, 40] {
        assert_eq!(scaled(2f64.powi(exponent)).triangles, here.triangles);
    }
}

#[test]
fn the_caller_can_stop_the_work() {
    let (points, triangles) = torus(300, 200);
    let run = |control: &RunControl| {
        let whole = WholeMesh::new(points.clone(), triangles.clone(), vec![]).unwrap();
        simplify(whole, &OPTIONS, &GOAL, &mut Progress::new(control))
    };
    let control = RunControl::default();
    control.abort();
    assert_eq!(run(&control).err(), Some(KernelError::Interrupted));

    let control = RunControl::default();
    control.stop_early();
    let result = run(&control).unwrap();
    assert_eq!(result.stop, Stop::StoppedByCaller);
    assert!(result.mesh.triangles.len() > triangles.len() / 2);
    assert!(Mesh::new(result.mesh.points, &result.mesh.triangles).is_ok());
}

#[test]
fn the_smallest_meshes_stay_as_they_are() {
    let (points, triangles) = tetrahedron();
    assert_eq!(run(points.clone(), &triangles, &OPTIONS).unwrap().mesh.triangles, triangles);
    assert_eq!(run(points, &[], &OPTIONS).unwrap().mesh.points.len(), 0);
}
