//! Incremental proofs against proofs from scratch and against brute force.

use super::*;
use crate::base::progress::RunControl;

const SIDE: u32 = 9;

/// Return a deterministic pseudo-random number in [0, 1).
fn next_random(state: &mut u64) -> f64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state >> 40) as f64 / (1u64 << 24) as f64
}

/// Create a rough sheet with random colours, and a second one close below it.
fn two_sheets(state: &mut u64) -> InputSurface<6> {
    let (mut points, mut triangles) = (vec![], vec![]);
    for sheet in 0..2 {
        let first = points.len() as u32;
        for i in 0..SIDE * SIDE {
            let [x, y] = [i % SIDE, i / SIDE].map(f64::from);
            let z = 0.3 * next_random(state) - 0.9 * f64::from(sheet);
            let [r, g, b] = [0; 3].map(|_| 40.0 * next_random(state));
            points.push([x, y, z, r, g, b]);
        }
        for i in (0..SIDE - 1).flat_map(|y| (0..SIDE - 1).map(move |x| first + y * SIDE + x)) {
            triangles.extend([[i, i + 1, i + SIDE], [i + 1, i + SIDE + 1, i + SIDE]]);
        }
    }
    InputSurface::new(points, triangles)
}

fn input(original: &InputSurface<6>) -> WholeMesh<6, LimitKind> {
    WholeMesh::new(original.points.clone(), original.triangles.clone(), vec![]).unwrap()
}

fn ledger<'a>(original: &'a InputSurface<6>, bounds: Deviation) -> ProofCache<'a, 6> {
    // With effort 0, the decision about a triangle does not depend on the other triangles.
    let options = certify::Options { limit: Some(bounds), threads: 1, effort: 0.0, ..Default::default() };
    ProofCache::new(original, options, None).unwrap()
}

/// List the unproven triangles of the mesh (by source) and of the input.
fn failing(ledger: &ProofCache<'_, 6>) -> [Vec<u32>; 2] {
    let of_result = ledger.unproven_mesh_triangles().map(|i| ledger.mesh_triangles[i].source).collect();
    [of_result, ledger.unproven_input_triangles().map(|failing| failing.triangle).collect()]
}

/// Sample a triangle on a regular grid.
fn samples(corners: &[[f64; 6]; 3]) -> impl Iterator<Item = Vec3> {
    let [a, b, c] = corners.each_ref().map(position_of);
    (0..=6).flat_map(move |i| {
        (0..=6 - i).map(move |j| {
            let [u, v] = [i, j].map(|k| f64::from(k) / 6.0);
            [0, 1, 2].map(|k| a[k] + u * (b[k] - a[k]) + v * (c[k] - a[k]))
        })
    })
}

#[test]
fn cached_proofs_equal_proofs_from_scratch() {
    for seed in 1..=4 {
        let mut state = seed;
        let original = two_sheets(&mut state);
        let bounds = Deviation { shape: 0.35, color: 30.0 };
        let (mut kept, control) = (ledger(&original, bounds), RunControl::default());
        let mut progress = Progress::new(&control);
        let mut mesh = input(&original);
        kept.update(&mesh, &mut progress).unwrap();
        for _ in 0..12 {
            // Move some vertices, a few of them far; restore others.
            for _ in 0..4 {
                let v = (next_random(&mut state) * mesh.points.len() as f64) as usize;
                mesh.points[v] = original.points[v];
                let far = if next_random(&mut state) < 0.3 { 1.2 } else { 0.4 };
                (0..3).for_each(|k| mesh.points[v][k] += far * (next_random(&mut state) - 0.5));
            }
            kept.update(&mesh, &mut progress).unwrap();
            let mut anew = ledger(&original, bounds);
            anew.update(&mesh, &mut progress).unwrap();
            assert_eq!(failing(&kept), failing(&anew), "seed {seed}");
        }
    }
}

#[test]
fn reach_bounds_the_distance_to_the_mesh() {
    for seed in 1..=4 {
        let mut state = seed;
        let original = two_sheets(&mut state);
        let mut ledger = ledger(&original, Deviation { shape: 0.35, color: f64::INFINITY });
        let mut mesh = input(&original);
        let mut moved = |p: &mut [f64; 6]| (0..3).for_each(|k| p[k] += 0.5 * (next_random(&mut state) - 0.5));
        mesh.points.iter_mut().for_each(&mut moved);
        ledger.update(&mesh, &mut Progress::new(&RunControl::default())).unwrap();
        let there: Vec<[Vec3; 3]> =
            mesh.triangles.iter().map(|t| t.map(|v| position_of(&mesh.points[v as usize]))).collect();
        let mut close = 0;
        for (t, reach) in original.triangles.iter().zip(&ledger.reach) {
            let nearest2 = |p: &Vec3| {
                let each = there.iter().map(|corners| triangle_distance2(p, corners.each_ref()));
                each.fold(f64::INFINITY, f64::min)
            };
            let corners = t.map(|v| original.points[v as usize]);
            let far = samples(&corners).map(|p| nearest2(&p)).fold(0.0, f64::max).sqrt();
            assert!(far <= f64::from(*reach), "seed {seed}: {far} {reach}");
            close += usize::from(reach.is_finite());
        }
        assert!(close > original.triangles.len() / 4, "{close}");
        // Every input triangle that a new triangle may be nearest to must be rechecked.
        for _ in 0..40 {
            let at = original.points[(next_random(&mut state) * original.points.len() as f64) as usize];
            let corners = [0; 3].map(|_| at.map(|x| x + 0.8 * (next_random(&mut state) - 0.5)));
            let known = CertifiedTriangle { source: 0, corners, verdict: Verdict::UNKNOWN };
            let near = ledger.mark_affected_triangles(&ledger.partitions[0], &[&known]);
            assert_eq!(near.len(), original.triangles.len());
            let new = corners.each_ref().map(position_of);
            for (t, (is_near, reach)) in original.triangles.iter().zip(near.iter().zip(&ledger.reach)) {
                let reach = f64::from(*reach).min(0.35);
                let corners = t.map(|v| original.points[v as usize]);
                let may_be_nearest = |p: Vec3| triangle_distance2(&p, new.each_ref()) <= reach * reach;
                assert!(*is_near || !samples(&corners).any(may_be_nearest), "seed {seed}");
            }
        }
    }
}

#[test]
fn the_input_is_proven_to_equal_itself_even_if_its_triangles_are_needles() {
    let rim = 60;
    let on_rim = |i: u32| {
        let angle = 0.1 * f64::from(i);
        [angle.cos(), angle.sin(), 1e-3 * (7.3 * f64::from(i)).sin(), 0.0, 0.0, 0.0]
    };
    let points = std::iter::once([0.0; 6]).chain((0..=rim).map(on_rim)).collect();
    let original = InputSurface::new(points, (1..=rim).map(|i| [0, i, i + 1]).collect());
    let control = RunControl::default();
    let mut progress = Progress::new(&control);
    for (color, unproven) in [(f64::INFINITY, 0), (0.0, 1)] {
        let mut ledger = ledger(&original, Deviation { shape: 1e-5, color });
        let [of_mesh, of_input] = ledger.update(&input(&original), &mut progress).unwrap();
        assert!(of_mesh.min(of_input) >= unproven && (unproven > 0 || of_mesh.max(of_input) == 0));
    }
}
