//! Surfaces with seams: copies stay joined in space, and no triangle folds in the texture.

use crate::promises::common::{Noise, torus};
use scanloom_kernels::base::progress::{Progress, RunControl};
use scanloom_kernels::collapse::engine::Stop;
use scanloom_kernels::collapse::rounds::{self, REGION_TRIANGLES};
use scanloom_kernels::mesh::connectivity::Connectivity;
use scanloom_kernels::seams::texture_space::signed_area;
use scanloom_kernels::seams::welding::{NO_SET, weld};
use scanloom_kernels::seams::{CostParameters, SeamGoal, SeamSurface, SimplifiedSurface, simplify};

const KNOBS: CostParameters = CostParameters {
    material_border_penalty: 0.5,
    part_border_penalty: 0.5,
    valence: 0.1,
    wedges: 0.1,
    shape: 1.0,
    seam_drift: f64::INFINITY,
};

/// Create a torus with its w × h grid as texture: one seam around and one along.
///
/// No vertex is shared between triangles, as in the worst files.
fn textured_torus(w: u32, h: u32) -> SeamSurface<2> {
    let (points, triangles) = torus(w, h);
    let mut noise = Noise(11);
    let points: Vec<[f64; 3]> = points.iter().map(|p| p.map(|x| x + 0.02 * noise.next())).collect();
    let grid = |i: usize| (i as u32 / 2 % w, i as u32 / 2 / w);
    let corners: Vec<[f64; 2]> = (0..triangles.len())
        .flat_map(|i| {
            let (x, y) = grid(i);
            let offsets = if i % 2 == 0 { [(0, 0), (1, 0), (1, 1)] } else { [(0, 0), (1, 1), (0, 1)] };
            offsets.map(|(dx, dy)| [f64::from(x + dx), f64::from(y + dy)])
        })
        .collect();
    let count = triangles.len();
    SeamSurface {
        points: triangles.iter().flatten().map(|&v| points[v as usize]).collect(),
        coincident_sets: triangles.iter().flatten().copied().collect(),
        triangles: (0..count as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
        corners,
        textured: vec![true; count],
        materials: vec![0; count],
        parts: vec![0; count],
        importance: vec![],
        locked: vec![false; 3 * count],
    }
}

fn run(surface: SeamSurface<2>, knobs: CostParameters, target: usize) -> SimplifiedSurface<2> {
    let control = RunControl::default();
    let rounds = rounds::Goal {
        triangles: target,
        threads: 1,
        region: REGION_TRIANGLES,
        min_collapse_ratio: 0.0,
        record_positions: true,
    };
    let goal = SeamGoal { rounds, fit: true };
    simplify::<5, 2>(&surface, knobs, goal, &mut Progress::new(&control)).expect("a valid surface")
}

fn euler(outcome: &SimplifiedSurface<2>) -> i64 {
    let connectivity =
        Connectivity::from_triangles(outcome.points.len(), &outcome.triangles).expect("an oriented manifold");
    assert!(connectivity.edges().all(|e| !connectivity.is_boundary_edge(e)), "a closed surface");
    outcome.points.len() as i64 - connectivity.edges().count() as i64 + outcome.triangles.len() as i64
}

#[test]
fn a_torus_cut_open_twice_stays_a_torus_at_every_number_of_triangles() {
    let surface = textured_torus(24, 16);
    let all = surface.triangles.len();
    for target in [all, all / 2, all / 4, all / 8, all / 16, 0] {
        let outcome = run(surface.clone(), KNOBS, target);
        assert_eq!(euler(&outcome), 0);
        assert!(outcome.triangles.len() <= target.max(60));
        assert_eq!(outcome.stop == Stop::Target, outcome.triangles.len() <= target);
        for corners in outcome.corners.chunks_exact(3) {
            assert!(signed_area(corners[0], corners[1], corners[2]) > 0.0);
        }
        let inside = |uv: &[f64; 2]| (0.0..=24.0).contains(&uv[0]) && (0.0..=16.0).contains(&uv[1]);
        assert!(outcome.corners.iter().all(inside));
    }
}

/// Region borders along and across seams, with one and three threads.
#[test]
fn regions_of_any_size_leave_a_torus_the_same_on_any_number_of_threads() {
    let surface = textured_torus(48, 32);
    for region in [40, 150, 700] {
        let [one, three] = [1, 3].map(|threads| {
            let rounds = rounds::Goal {
                triangles: 400,
                threads,
                region,
                min_collapse_ratio: 0.0,
                record_positions: true,
            };
            let control = RunControl::default();
            let goal = SeamGoal { rounds, fit: false };
            simplify::<5, 2>(&surface, KNOBS, goal, &mut Progress::new(&control)).expect("a valid surface")
        });
        assert_eq!(euler(&one), 0, "{region}");
        assert!((399..=400).contains(&one.triangles.len()), "{region}: {}", one.triangles.len());
        assert_eq!(one.points, three.points);
        assert_eq!((&one.triangles, &one.corners), (&three.triangles, &three.corners));
        for corners in one.corners.chunks_exact(3) {
            assert!(signed_area(corners[0], corners[1], corners[2]) > 0.0, "{region}");
        }
        // Every removed vertex is in the log, and the remaining ones are at logged positions.
        let log = one.log.expect("a record was requested");
        assert_eq!(log.removed.len(), one.collapses);
        let mut place = std::collections::BTreeMap::new();
        place.extend(log.survivor.iter().copied().zip(log.survivor_points));
        place.retain(|v, _| !log.removed.contains(v));
        let points: Vec<_> = one.points.iter().collect();
        assert!(place.values().all(|to| points.contains(&to)), "{region}");
    }
}

/// Two sheets cross along an edge that both contain twice: each fan gets a separate vertex.
#[test]
fn an_edge_is_known_by_its_vertices() {
    let ring = |v: u32| [[0, 1, v], [1, 0, v + 1], [v, 1, v + 1], [0, v, v + 1]];
    let triangles: Vec<[u32; 3]> = [2, 4].into_iter().flat_map(ring).collect();
    let welded = weld(&[0, 1, 2, 3, 4, 5], &triangles).expect("indices in range");
    let corners: Vec<[u32; 3]> =
        welded.corner_vertex.chunks_exact(3).map(|t| [t[0].0, t[1].0, t[2].0]).collect();
    let vertices = welded.connectivity().vertex_slots();
    let again = Connectivity::from_triangles(vertices, &corners).expect("a manifold");
    for e in again.edges() {
        let h = again.halfedge(e);
        assert_eq!(again.twin(h), welded.connectivity().twin(h));
    }
}

#[test]
fn straight_seams_do_not_drift_and_a_bound_of_zero_is_kept() {
    let surface = textured_torus(24, 16);
    let outcome = run(surface, CostParameters { seam_drift: 0.0, ..KNOBS }, 200);
    assert_eq!(outcome.seam_drift, 0.0);
    assert_eq!(outcome.stop, Stop::Target);
}

#[test]
fn unchanged_attributes_have_a_source_corner() {
    let surface = textured_torus(24, 16);
    let outcome = run(surface.clone(), KNOBS, 300);
    let sources = outcome.corners.iter().zip(&outcome.corner_source);
    let kept: Vec<_> = sources.filter(|(_, source)| **source != u32::MAX).collect();
    assert!(!kept.is_empty());
    assert!(kept.iter().all(|(uv, source)| surface.corners[**source as usize] == **uv));
    // Texture coordinates on the border come from vertices that were on the border.
    let on_border = |uv: &[f64; 2]| uv[0] == 0.0 || uv[0] == 24.0 || uv[1] == 0.0 || uv[1] == 16.0;
    let border = outcome.corners.iter().zip(&outcome.corner_source).filter(|(uv, _)| on_border(uv));
    assert!(border.clone().count() > 0);
    assert!(border.clone().all(|(_, source)| *source != u32::MAX));
}

#[test]
fn copies_are_welded_and_touching_vertices_are_marked() {
    // Two triangles that share an edge by copies, and one that touches at a corner only.
    let sets = [0, 1, 2, 1, 0, 3, 2, 4, 5];
    let welded = weld(&sets, &[[0, 1, 2], [3, 4, 5], [6, 7, 8]]).expect("indices in range");
    assert_eq!(welded.connectivity().vertices().count(), 7);
    let touching: Vec<bool> =
        welded.corner_vertex.iter().map(|v| welded.touching[v.index()] != NO_SET).collect();
    assert_eq!(touching, [false, false, true, false, false, false, true, false, false]);
}

#[test]
fn three_triangles_at_an_edge_and_two_back_to_back_stay_open_there() {
    let fan = weld(&[0, 1, 2, 3, 4], &[[0, 1, 2], [1, 0, 3], [0, 1, 4]]).expect("indices in range");
    let connectivity = fan.connectivity();
    assert!(connectivity.edges().all(|e| connectivity.is_boundary_edge(e)));
    let ends =
        |v: u32| fan.corner_vertex.iter().zip([0, 1, 2, 1, 0, 3, 0, 1, 4]).filter(move |(_, w)| *w == v);
    assert!(ends(0).chain(ends(1)).all(|(v, _)| fan.touching[v.index()] != NO_SET));
    let pillow = weld(&[0, 1, 2], &[[0, 1, 2], [0, 2, 1]]).expect("indices in range");
    let connectivity = pillow.connectivity();
    assert_eq!(connectivity.edges().filter(|&e| connectivity.is_boundary_edge(e)).count(), 6);
    assert!(pillow.touching.iter().all(|&touching| touching != NO_SET));
}

/// Three shallow pyramids over one triangle: their rims touch, and each of them could collapse to that
/// triangle.
#[test]
fn sheets_with_one_rim_do_not_become_the_same_triangle() {
    let rim = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let mut points = vec![];
    let mut triangles = vec![];
    for height in [0.1, 0.2, -0.1] {
        let first = points.len() as u32;
        points.extend(rim);
        points.push([0.3, 0.3, height]);
        triangles.extend([[0, 1, 3], [1, 2, 3], [2, 0, 3]].map(|t: [u32; 3]| t.map(|v| first + v)));
    }
    let sets = (0..points.len() as u32).map(|v| if v % 4 == 3 { v } else { v % 4 }).collect();
    let outcome = run(flat(points, sets, triangles), KNOBS, 0);
    assert_eq!(count_duplicates(&outcome), 0);
    assert_eq!(outcome.triangles.len(), 1 + 3 + 3, "one of them is flat");
}

/// A plank on one edge, at a corner of walls: it is open there, and could collapse to two triangles.
#[test]
fn plank_on_an_edge_does_not_collapse_flat() {
    let (x, y, z) = ([0.0, 140.0], [0.0, 8.0], [0.0, 1.0]);
    let corner = |i: usize, j: usize, k: usize| [x[i], y[j], z[k]];
    let mut points = vec![corner(0, 1, 0), corner(0, 0, 0), corner(1, 0, 0), corner(1, 1, 0)];
    points.extend([corner(1, 1, 1), corner(1, 0, 1), corner(0, 0, 1), corner(0, 1, 1)]);
    points.extend([[140.0, -6.0, 0.0], [0.0, 0.0, 105.0]]);
    let plank = [
        [3, 1, 0],
        [3, 2, 1],
        [7, 5, 4],
        [7, 6, 5],
        [7, 3, 0],
        [7, 4, 3],
        [6, 0, 1],
        [6, 7, 0],
        [5, 1, 2],
        [5, 6, 1],
        [4, 2, 3],
        [4, 5, 2],
    ];
    let walls = [[1, 2, 8], [9, 2, 1]];
    let outcome = run(flat(points, (0..10).collect(), [&plank[..], &walls[..]].concat()), KNOBS, 0);
    println!("{:?}", outcome.triangles);
    assert_eq!(count_duplicates(&outcome), 0);
    assert!(outcome.triangles.len() > 4, "the plank has an inside");
}

/// Number of triangles with the same corners as another one.
fn count_duplicates(outcome: &SimplifiedSurface<2>) -> usize {
    let mut sorted: Vec<[[u64; 3]; 3]> = outcome
        .triangles
        .iter()
        .map(|t| {
            let mut corners = t.map(|v| outcome.points[v as usize].map(f64::to_bits));
            corners.sort_unstable();
            corners
        })
        .collect();
    let count = sorted.len();
    sorted.sort_unstable();
    sorted.dedup();
    count - sorted.len()
}

/// Create a surface without texture.
fn flat(points: Vec<[f64; 3]>, sets: Vec<u32>, triangles: Vec<[u32; 3]>) -> SeamSurface<2> {
    let (vertices, count) = (points.len(), triangles.len());
    SeamSurface {
        points,
        coincident_sets: sets,
        triangles,
        corners: vec![[0.0; 2]; 3 * count],
        textured: vec![false; count],
        materials: vec![0; count],
        parts: vec![0; count],
        importance: vec![],
        locked: vec![false; vertices],
    }
}
