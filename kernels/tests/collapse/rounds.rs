//! Simplification by regions: valid for any partition, bit-identical for any number of threads, and as far as
//! requested.

use crate::promises::common::{Noise, Triangles, coloured, large_gallery, sheet, sheet_with_hole, torus};
use scanloom_kernels::base::errors::KernelError;
use scanloom_kernels::base::geometry::{Vec3, cross, dot, position_of, sub};
use scanloom_kernels::base::progress::{Progress, RunControl};
use scanloom_kernels::collapse::collapse_log::CollapseSequence;
use scanloom_kernels::collapse::engine::Stop;
use scanloom_kernels::collapse::rounds::{Goal, Outcome, REGION_TRIANGLES, collapse};
use scanloom_kernels::collapse::whole_mesh::WholeMesh;
use scanloom_kernels::jia01::{self, Limits, Options};
use scanloom_kernels::mesh::triangle_mesh::{CompactMesh, Mesh};
use scanloom_kernels::quadric::qem::{Qem, QemState};
use scanloom_kernels::quadrics::quadric::Quadric;

const GOAL: Goal = Goal {
    triangles: 0,
    threads: 1,
    region: REGION_TRIANGLES,
    min_collapse_ratio: 0.0,
    record_positions: false,
};

type Result<const D: usize, const K: usize> = std::result::Result<Outcome<D, QemState<K>>, KernelError>;

fn simplified<const D: usize, const K: usize>(
    points: &[[f64; D]],
    triangles: &[[u32; 3]],
    locked: Vec<bool>,
    goal: Goal,
) -> Result<D, K> {
    let whole = WholeMesh::new(points.to_vec(), triangles.to_vec(), locked)?;
    let records = QemState { weight: 1e-3, importance: vec![] };
    collapse(whole, records, &goal, &mut Progress::new(&RunControl::default()))
}

fn compact(outcome: Outcome<6, QemState<3>>) -> CompactMesh<6> {
    outcome.mesh.into_compact()
}

/// Create a noisy torus of 2 · w · h triangles with random colours.
fn wavy(w: u32, h: u32) -> (Vec<[f64; 6]>, Triangles) {
    let (points, triangles) = torus(w, h);
    (coloured(&points, 0.02, 3), triangles)
}

#[test]
fn every_partition_keeps_every_invariant() {
    for (name, points, triangles) in large_gallery() {
        let points = coloured::<6>(&points, 0.1, 1);
        let mesh = Mesh::new(points.clone(), &triangles).unwrap();
        let (topology, vertices) = (mesh.connectivity.topology(), mesh.connectivity.vertices().count());
        for region in [1, 7, 40, 300, REGION_TRIANGLES] {
            // Very small regions are only tested on small meshes.
            if triangles.len() > 100 * region {
                continue;
            }
            for share in [1, 3, 10, triangles.len()] {
                let goal = Goal { triangles: triangles.len() / share, region, ..GOAL };
                let outcome = simplified(&points, &triangles, vec![], goal).unwrap();
                let (stop, merges) = (outcome.stop, outcome.collapses);
                let result = compact(outcome);
                let left = result.triangles.len();
                let mesh = Mesh::new(result.points, &result.triangles).unwrap();
                assert_eq!(mesh.connectivity.validate(), Ok(()), "{name} {region} {share}");
                assert_eq!(mesh.connectivity.topology(), topology, "{name} {region} {share}");
                assert_eq!(stop == Stop::Target, left <= goal.triangles, "{name} {region} {share}");
                // A collapse removes two triangles, or one at a boundary.
                assert!(left + 1 >= goal.triangles, "{name} {region} {share}: {left}");
                assert_eq!(result.vertex_source.len() + merges, vertices, "{name} {region} {share}");
            }
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let (points, triangles) = wavy(120, 90);
    for goal in
        [Goal { triangles: 3000, region: 500, ..GOAL }, Goal { region: 900, record_positions: true, ..GOAL }]
    {
        let run =
            |threads| simplified::<6, 3>(&points, &triangles, vec![], Goal { threads, ..goal }).unwrap();
        let once = run(1);
        for threads in [2, 3, 8] {
            let again = run(threads);
            assert_eq!(again.logs, once.logs);
            assert_eq!(again.mesh.points, once.mesh.points);
            assert_eq!(again.mesh.triangles, once.mesh.triangles);
        }
    }
}

#[test]
fn jia01_keeps_its_bounds_in_regions_too() {
    let (points, triangles) = wavy(100, 60);
    let bounds = Limits { length: f64::INFINITY, shape: 0.15, texture: 3000.0 };
    let options = Options {
        bounds,
        scales: Limits { length: 1.0, ..bounds },
        soft_length: false,
        attribute_scale: 1e-4,
        paper_rule: false,
        triangle_limit: 1_000_000,
    };
    let run_to = |goal| {
        let whole = WholeMesh::new(points.clone(), triangles.clone(), vec![]).unwrap();
        jia01::simplify(whole, &options, &goal, &mut Progress::new(&RunControl::default())).unwrap()
    };
    let run = |region, threads| run_to(Goal { region, threads, ..GOAL });
    let one_queue = run(REGION_TRIANGLES * 10, 1);
    for region in [1000, 3000] {
        let result = run(region, 1);
        assert!(
            result.largest_shape_change <= bounds.shape && result.largest_texture_change <= bounds.texture
        );
        assert_eq!(result.stop, Stop::Exhausted);
        let s = result.refused;
        let edges = result.mesh.triangles.len() * 3 / 2;
        assert_eq!(s.length + s.shape + s.texture + s.topology + s.bridge + s.locked + s.fold, edges);
        let ratio = result.mesh.triangles.len() as f64 / one_queue.mesh.triangles.len() as f64;
        assert!((0.8..1.25).contains(&ratio), "{region}: {ratio}");
        assert_eq!(run(region, 2).mesh, result.mesh);
    }
    // With a minimum ratio of collapses it ends sooner, with hardly more triangles.
    let (all, most) = (run(100, 1), run_to(Goal { region: 100, min_collapse_ratio: 0.02, ..GOAL }));
    assert_eq!((all.stop, most.stop), (Stop::Exhausted, Stop::Stalled));
    assert!(most.largest_shape_change <= bounds.shape);
    let ratio = most.mesh.triangles.len() as f64 / all.mesh.triangles.len() as f64;
    assert!((1.0..1.1).contains(&ratio), "{ratio}");
}

#[test]
fn errors_do_not_depend_on_the_partition() {
    let (points, triangles) = sheet(12, 9);
    let refused = |extra: [u32; 3], region| {
        let mut triangles = triangles.clone();
        triangles.push(extra);
        simplified::<3, 0>(&points, &triangles, vec![], Goal { region, ..GOAL }).err()
    };
    for region in [10, 50, REGION_TRIANGLES] {
        // Vertices 40 and 41 are the ends of an interior edge; 5 and 6 of a boundary edge.
        assert_eq!(refused([40, 41, 0], region), Some(KernelError::NonManifoldEdges(vec![[40, 41]])));
        assert_eq!(refused([5, 6, 80], region), Some(KernelError::InconsistentEdges(vec![[5, 6]])));
        assert!(matches!(refused([0, 60, 129], region), Some(KernelError::PinchedVertices(_))));
    }
}

#[test]
fn fixed_vertices_stay_bit_for_bit() {
    let (points, triangles) = wavy(40, 30);
    // Isolated locked vertices, and pairs joined by an edge.
    for (locks, region) in [(1, 150), (1, REGION_TRIANGLES), (2, 150), (2, REGION_TRIANGLES)] {
        let locked: Vec<bool> = (0..points.len()).map(|v| v % 17 < locks).collect();
        let goal = Goal { triangles: 200, region, ..GOAL };
        let result = compact(simplified(&points, &triangles, locked.clone(), goal).unwrap());
        let left: Vec<u32> = result.vertex_source.iter().copied().filter(|&v| locked[v as usize]).collect();
        assert_eq!(left.len(), locked.iter().filter(|f| **f).count());
        for (point, &v) in result.points.iter().zip(&result.vertex_source) {
            assert!(!locked[v as usize] || *point == points[v as usize]);
        }
    }
}

#[test]
fn important_places_keep_more_triangles() {
    let (points, triangles) = wavy(60, 40);
    let right = |p: &[f64; 6]| p[0] > 0.0;
    let share = |importance: f64| {
        let whole = WholeMesh::new(points.clone(), triangles.clone(), vec![]).unwrap();
        let factor = |p| if right(p) { importance } else { 1.0 };
        let records = QemState::<3> { weight: 1e-3, importance: points.iter().map(factor).collect() };
        let goal = Goal { triangles: 800, region: 1000, ..GOAL };
        let outcome = collapse(whole, records, &goal, &mut Progress::new(&RunControl::default())).unwrap();
        let result = outcome.mesh.into_compact();
        result.points.iter().filter(|p| right(p)).count() as f64 / result.points.len() as f64
    };
    assert!((share(1.0) - 0.5).abs() < 0.1);
    assert!(share(100.0) > 0.6);
}

#[test]
fn a_record_leads_to_the_result() {
    let (points, triangles) = wavy(50, 40);
    let goal = Goal { triangles: 400, region: 700, record_positions: true, ..GOAL };
    let outcome = simplified(&points, &triangles, vec![], goal).unwrap();
    let mut replayed = points.clone();
    let mut becomes: Vec<usize> = (0..points.len()).collect();
    let way = CollapseSequence::new(&outcome.logs);
    for ((&removed, &survivor), to) in way.removed.iter().zip(&way.survivor).zip(&way.survivor_points) {
        becomes[removed as usize] = survivor as usize;
        replayed[survivor as usize] = *to;
    }
    let last = |mut v: usize| {
        while becomes[v] != v {
            v = becomes[v];
        }
        v
    };
    let result = compact(outcome);
    for (point, &v) in result.points.iter().zip(&result.vertex_source) {
        assert_eq!((last(v as usize), &replayed[v as usize]), (v as usize, point));
    }
    let left = triangles.iter().map(|t| t.map(|v| last(v as usize)));
    assert_eq!(left.filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]).count(), result.triangles.len());
}

/// Compute a quadric directly.
///
/// It is the integral of the squared distance to the plane of a triangle and of the squared difference to its
/// attributes.
fn direct(p: &[f64; 6], triangles: &[[[f64; 6]; 3]], weight: f64) -> f64 {
    let mut sum = 0.0;
    for [a, b, c] in triangles {
        let (u, v) = (sub(&position_of(b), &position_of(a)), sub(&position_of(c), &position_of(a)));
        let n = cross(&u, &v);
        let to_p = sub(&position_of(p), &position_of(a));
        let area2 = dot(&n, &n);
        let foot: Vec3 = std::array::from_fn(|i| to_p[i] - dot(&to_p, &n) / area2 * n[i]);
        let (s, t) = (dot(&cross(&foot, &v), &n) / area2, dot(&cross(&u, &foot), &n) / area2);
        let off = dot(&to_p, &n).powi(2) / area2;
        let change: f64 = (3..6).map(|j| (a[j] + s * (b[j] - a[j]) + t * (c[j] - a[j]) - p[j]).powi(2)).sum();
        sum += 0.5 * area2.sqrt() * (off + weight * weight * change);
    }
    sum
}

#[test]
fn quadric_equals_the_direct_sum() {
    let mut noise = Noise(11);
    for _ in 0..50 {
        let corner = |noise: &mut Noise| {
            std::array::from_fn(|i| if i < 3 { noise.next() } else { 100.0 * noise.next() })
        };
        let triangles: Vec<[[f64; 6]; 3]> =
            (0..6).map(|_| std::array::from_fn(|_| corner(&mut noise))).collect();
        let weight = 0.01;
        let mut quadric = Quadric::<3>::default();
        for t in &triangles {
            quadric.add(&Quadric::of_triangle(t.each_ref(), weight));
        }
        let (place, error) = quadric.minimum(&[0.5; 3], 0.0);
        let best = quadric.with_attributes(&place, weight, &[0.0; 6]);
        let least = direct(&best, &triangles, weight);
        assert!((least - error).abs() < 1e-9 * (1.0 + error), "{least} {error}");
        assert!((quadric.error(&place) - error).abs() < 1e-9 * (1.0 + error));
        // The minimum is a minimum.
        for i in 0..6 {
            for step in [-1e-3, 1e-3] {
                let mut other = best;
                other[i] += step * if i < 3 { 1.0 } else { 100.0 };
                assert!(direct(&other, &triangles, weight) >= least - 1e-12);
            }
        }
    }
}

/// Quadrics updated collapse by collapse are equal to quadrics of the current triangles.
#[test]
fn quadrics_follow_the_mesh() {
    use scanloom_kernels::collapse::engine::{Engine, Step};
    use scanloom_kernels::collapse::method_state::MethodState;
    let (hole, hole_triangles) = sheet_with_hole(4);
    for (points, triangles) in [wavy(16, 12), (coloured(&hole, 0.2, 4), hole_triangles)] {
        let records = QemState::<3> { weight: 1e-3, importance: vec![] };
        let mesh = Mesh::new(points, &triangles).unwrap();
        let measure: Qem<6, 3> = records.load_region(&mesh);
        let mut engine = Engine::new(mesh, measure);
        for _ in 0..60 {
            if engine.step() == Step::Finished {
                break;
            }
        }
        let afresh: Qem<6, 3> = records.load_region(engine.mesh());
        for v in engine.mesh().connectivity.vertices() {
            let p = [0.3, -0.2, 0.7];
            let (kept, made) = (engine.measure().quadric(v).error(&p), afresh.quadric(v).error(&p));
            assert!((kept - made).abs() < 1e-9 * (1.0 + made), "{kept} {made}");
        }
    }
}
