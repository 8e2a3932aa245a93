//! Certified simplification: samples stay within their limits after every collapse, and the final proof
//! holds.

use crate::promises::common::{Noise, coloured, gallery, sheet, torus};
use scanloom_kernels::base::geometry::{Vec3, nearest_on_triangle, position_of};
use scanloom_kernels::base::progress::{Progress, RunControl};
use scanloom_kernels::certified::bounded_qem::{BoundedQemState, Rules};
use scanloom_kernels::certified::input_surface::InputSurface;
use scanloom_kernels::certified::proof_cache::SeparatePartitions;
use scanloom_kernels::certified::sample_tracker::{DEFAULT_MIN_NEEDLE_RATIO, SampleLimits, SampleLists};
use scanloom_kernels::certified::simplify::{LoopState, Options, run_loop, simplify};
use scanloom_kernels::certify::{self, Deviation, Surface};
use scanloom_kernels::collapse::engine::{Engine, Step};
use scanloom_kernels::collapse::method_state::MethodState;
use scanloom_kernels::collapse::rounds::Goal;
use scanloom_kernels::collapse::whole_mesh::WholeMesh;
use scanloom_kernels::mesh::connectivity::Connectivity;

fn goal(threads: usize, region: usize) -> Goal {
    Goal { triangles: 0, threads, region, min_collapse_ratio: 0.0, record_positions: false }
}

/// Create a finely triangulated, slightly noisy torus with smooth colours.
fn painted_torus() -> (Vec<[f64; 6]>, Vec<[u32; 3]>) {
    let (points, triangles) = torus(60, 30);
    let mut noise = Noise(5);
    let painted = points.iter().map(|p| {
        let wave = |phase: f64| 128.0 + 60.0 * (p[0] + phase).sin() * (p[1] - phase).cos();
        let [x, y, z] = p.map(|x| x + 1e-3 * noise.next());
        [x, y, z, wave(0.0).round(), wave(1.0).round(), wave(2.0).round()]
    });
    (painted.collect(), triangles)
}

/// Find the nearest point on some triangles by brute force: distance and attributes.
fn nearest<const D: usize>(p: &Vec3, points: &[[f64; D]], triangles: &[[u32; 3]]) -> (f64, Vec<f64>) {
    let mut best = (f64::INFINITY, vec![]);
    for corners in triangles {
        let corners = corners.map(|v| &points[v as usize]);
        let (at, distance2) = nearest_on_triangle(p, corners.map(position_of).each_ref());
        if distance2 < best.0 {
            let attribute = |i: usize| (0..3).map(|k| at[k] * corners[k][i]).sum();
            best = (distance2, (3..D).map(attribute).collect());
        }
    }
    (best.0.sqrt(), best.1)
}

fn difference<const D: usize>(point: &[f64; D], attributes: &[f64]) -> f64 {
    point[3..].iter().zip(attributes).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

#[test]
fn after_every_collapse_all_samples_are_within_their_limits() {
    for (name, points, triangles) in gallery() {
        let points = coloured::<6>(&points, 0.2, 3);
        let original = InputSurface::new(points.clone(), triangles.clone());
        let mut factors = vec![1.0; points.len()];
        factors[0] = 0.25;
        let limits =
            SampleLimits { shape: 0.2, color: 60.0, factors, min_needle_ratio: DEFAULT_MIN_NEEDLE_RATIO };
        let records = BoundedQemState::<6, 3>::new(
            &original,
            &limits,
            0.01,
            vec![],
            SampleLists::of_input(&original),
            Rules::default(),
        );
        let mesh = WholeMesh::<6, ()>::new(points.clone(), triangles.clone(), vec![])
            .unwrap()
            .into_connected()
            .unwrap();
        let before = mesh.connectivity.vertices().count();
        let measure = records.load_region(&mesh);
        let mut engine = Engine::new(mesh, measure);
        let mut collapses = 0;
        loop {
            match engine.step() {
                Step::Finished => break,
                Step::Refused(..) => continue,
                Step::Collapsed(_) => collapses += 1,
            }
            let mesh = engine.mesh();
            let now: Vec<[u32; 3]> =
                mesh.connectivity.triangles().map(|t| mesh.connectivity.corners(t).map(|v| v.0)).collect();
            for v in triangles.iter().flatten().map(|&v| v as usize) {
                let point = &points[v];
                let (distance, _) = nearest(&position_of(point), &mesh.points, &now);
                let limit = limits.shape * f64::from(limits.factors[v]);
                assert!(distance <= limit * (1.0 + 1e-9), "{name}: vertex {v} is {distance} away");
            }
            for v in mesh.connectivity.vertices() {
                let (distance, _) = nearest(&position_of(mesh.point(v)), &points, &triangles);
                assert!(distance <= limits.shape * (1.0 + 1e-9), "{name}: {v:?} is {distance} away");
            }
        }
        assert_eq!(engine.mesh().connectivity.vertices().count(), before - collapses);
    }
}

#[test]
fn proven_bounds_hold_between_samples() {
    let (points, triangles) = painted_torus();
    let bounds = Deviation { shape: 0.03, color: 12.0 };
    let options = Options { weight: 0.0025, ..Options::new(bounds) };
    let control = RunControl::default();
    let result = simplify::<6, 3>(
        points.clone(),
        triangles.clone(),
        vec![],
        &options,
        &goal(1, 500),
        &mut Progress::new(&control),
    )
    .unwrap();
    assert!(result.proven && result.certificate.bound.is_within(bounds));
    assert!(result.mesh.triangles.len() < triangles.len() / 3, "{}", result.mesh.triangles.len());
    let mut noise = Noise(9);
    let meshes = [(&result.mesh.points, &result.mesh.triangles), (&points, &triangles)];
    for (from, to) in [(0, 1), (1, 0)] {
        let (points, triangles) = meshes[from];
        for _ in 0..400 {
            let corners = triangles[noise.below(triangles.len())].map(|v| &points[v as usize]);
            let (a, b) = (noise.next(), noise.next());
            let (a, b) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
            let at = [1.0 - a - b, a, b];
            let point: [f64; 6] = std::array::from_fn(|i| (0..3).map(|k| at[k] * corners[k][i]).sum());
            let (distance, attributes) = nearest(&position_of(&point), meshes[to].0, meshes[to].1);
            assert!(distance <= result.certificate.bound.shape);
            assert!(difference(&point, &attributes) <= result.certificate.bound.color);
        }
    }
}

#[test]
fn the_result_has_the_same_bits_for_any_number_of_threads() {
    let (points, triangles) = painted_torus();
    let options = Options { weight: 0.0025, ..Options::new(Deviation { shape: 0.02, color: f64::INFINITY }) };
    let run = |threads| {
        let control = RunControl::default();
        let mut progress = Progress::new(&control);
        let (points, triangles) = (points.clone(), triangles.clone());
        simplify::<6, 3>(points, triangles, vec![], &options, &goal(threads, 300), &mut progress).unwrap()
    };
    let (one, three) = (run(1), run(3));
    assert_eq!(one.mesh, three.mesh);
    assert_eq!(one.passes, three.passes);
    assert_eq!(one.certificate.result, three.certificate.result);
}

#[test]
fn zero_bounds_simplify_a_flat_sheet_and_keep_a_bent_one() {
    let (flat, triangles) = sheet(8, 8);
    let bent: Vec<[f64; 3]> =
        flat.iter().map(|p| [p[0], p[1], 0.01 * p[0] * p[0] + 0.02 * p[1] * p[1]]).collect();
    let options = Options::new(Deviation { shape: 0.0, color: f64::INFINITY });
    let left = |points: Vec<[f64; 3]>| {
        let control = RunControl::default();
        let mut progress = Progress::new(&control);
        let result =
            simplify::<3, 0>(points, triangles.clone(), vec![], &options, &goal(1, 8192), &mut progress);
        let result = result.unwrap();
        assert!(result.proven);
        result.mesh.triangles.len()
    };
    assert!(left(flat) <= 16);
    assert_eq!(left(bent), triangles.len());
}

#[test]
fn fixed_vertices_stay_and_the_topology_does_too() {
    let (points, triangles) = painted_torus();
    let mut locked = vec![false; points.len()];
    (0..points.len()).step_by(97).for_each(|v| locked[v] = true);
    let control = RunControl::default();
    let options = Options { weight: 0.01, ..Options::new(Deviation { shape: 0.1, color: f64::INFINITY }) };
    let result = simplify::<6, 3>(
        points.clone(),
        triangles,
        locked.clone(),
        &options,
        &goal(2, 600),
        &mut Progress::new(&control),
    )
    .unwrap();
    let mesh = result.mesh;
    for (v, _) in locked.iter().enumerate().filter(|(_, is_locked)| **is_locked) {
        let place =
            mesh.vertex_source.iter().position(|&s| s as usize == v).expect("a locked vertex was removed");
        assert_eq!(mesh.points[place], points[v]);
    }
    let connectivity = Connectivity::from_triangles(mesh.points.len(), &mesh.triangles).unwrap();
    let (v, e, f) = (mesh.points.len(), connectivity.edges().count(), mesh.triangles.len());
    assert_eq!(v + f, e);
    assert!(connectivity.edges().all(|e| !connectivity.is_boundary_edge(e)));
}

/// Create two rough sheets close to each other.
///
/// Between samples, the nearest point switches from one sheet to the other.
fn two_layers() -> (Vec<[f64; 6]>, Vec<[u32; 3]>) {
    let (flat, one) = sheet(40, 40);
    let mut noise = Noise(21);
    let mut layer = |height: f64, grey: f64| -> Vec<[f64; 6]> {
        let shake = |p: &[f64; 3]| {
            let z = height + 0.3 * (0.4 * p[0]).sin() + 0.06 * noise.next();
            [p[0], p[1], z, (grey + 40.0 * (0.3 * p[1]).cos() + 6.0 * noise.next()).round(), 0.0, 0.0]
        };
        flat.iter().map(shake).collect()
    };
    let mut points = layer(0.0, 100.0);
    points.extend(layer(0.25, 130.0));
    let mut triangles = one.clone();
    triangles.extend(one.iter().map(|t| t.map(|v| v + flat.len() as u32)));
    (points, triangles)
}

#[test]
fn partitions_are_proven_independently() {
    let (points, triangles) = two_layers();
    let half = triangles.len() / 2;
    let part: Vec<u32> = (0..triangles.len()).map(|t| u32::from(t >= half)).collect();
    let original = InputSurface::new(points.clone(), triangles.clone());
    let tolerance = Deviation { shape: 0.15, color: 0.2 };
    let close = certify::Options { tolerance, ..certify::Options::default() };
    let mut of_one = vec![];
    for threads in [1, 3] {
        let control = RunControl::default();
        let progress = &mut Progress::new(&control);
        let options =
            Options { weight: 0.004, ..Options::new(Deviation { shape: 0.2, color: f64::INFINITY }) };
        let start = LoopState::of_input(&original, true).unwrap();
        let apart = SeparatePartitions { partition_index: &part, tolerances: &close };
        let goal = goal(threads, 500);
        let reached =
            run_loop::<6, 3>(&original, start, vec![], Some(&apart), &options, &goal, progress).unwrap();
        assert!(reached.proven && reached.state.mesh.triangles.len() < half);
        let mesh = &reached.state.mesh;
        let proven = reached.ledger.bound_partitions(mesh, |_| true, progress).unwrap();
        for (p, verdict) in (0..2).zip(&proven) {
            let of_part = |t: usize| part[t] == p;
            let some = (0..triangles.len()).filter(|&t| of_part(t)).map(|t| triangles[t]).collect::<Vec<_>>();
            let left = (0..mesh.triangles.len()).filter(|&i| of_part(mesh.triangle_source[i] as usize));
            let left: Vec<_> = left.map(|i| mesh.triangles[i]).collect();
            let surfaces =
                [Surface::new(&mesh.points, &left, 1).unwrap(), Surface::new(&points, &some, 1).unwrap()];
            let [light, input] = &surfaces;
            let alone = certify::certify(light, input, &certify::Options::default(), progress).unwrap();
            assert!(alone.attained.is_within(verdict.bound), "{:?} {verdict:?}", alone.attained);
            assert!(verdict.attained.is_within(alone.bound), "{:?} {verdict:?}", alone.bound);
            assert!(verdict.bound.shape <= 0.2);
            let most = close.sufficient_bound(verdict.attained);
            assert!(verdict.bound.is_within(most.map(|x| 1.001 * x + 0.01)), "{verdict:?}");
        }
        of_one.push((mesh.points.clone(), proven));
    }
    assert_eq!(of_one[0], of_one[1]);
}

#[test]
fn incremental_proof_equals_full_proof() {
    let (points, triangles) = two_layers();
    let original = Surface::new(&points, &triangles, 1).unwrap();
    let mut again = 0;
    for (shape, color) in [(0.1, 60.0), (0.2, 80.0), (0.05, 40.0)] {
        let bounds = Deviation { shape, color };
        let options =
            Options { weight: 0.004, tight_bounds: false, sample_ratio: 1.0, ..Options::new(bounds) };
        let control = RunControl::default();
        let mut progress = Progress::new(&control);
        let result = simplify::<6, 3>(
            points.clone(),
            triangles.clone(),
            vec![],
            &options,
            &goal(2, 500),
            &mut progress,
        )
        .unwrap();
        again += result.passes.len() - 1;
        let light = Surface::new(&result.mesh.points, &result.mesh.triangles, 1).unwrap();
        let decision = certify::Options { limit: Some(bounds), ..certify::Options::default() };
        let whole = certify::certify(&light, &original, &decision, &mut progress).unwrap();
        assert_eq!(result.proven, whole.bound.is_within(bounds), "{:?}", result.passes);
        assert!(result.mesh.triangles.len() < triangles.len());
        assert!(whole.attained.is_within(result.certificate.bound));
    }
    assert!(again > 3, "no collapse was undone");
}
