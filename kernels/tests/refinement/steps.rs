//! The steps of a refinement on surfaces with known shape.

use crate::promises::common::Noise;
use scanloom_kernels::base::geometry::{Vec3, distance2, norm2, normalize, sub};
use scanloom_kernels::base::ids::{EdgeId, TriangleId};
use scanloom_kernels::fusion::frame_view::{DepthNoiseModel, FusionCamera};
use scanloom_kernels::mesh::connectivity::Connectivity;
use scanloom_kernels::mesh::triangle_mesh::Mesh;
use scanloom_kernels::refinement::boundary::smooth_boundaries;
use scanloom_kernels::refinement::creases::snap_to_planes;
use scanloom_kernels::refinement::depth_frame::DepthFrame;
use scanloom_kernels::refinement::normal_filter::{
    area_normals, filter_normals, fit_vertices, vertex_normals,
};
use scanloom_kernels::refinement::observations::{Observation, observe};
use scanloom_kernels::refinement::outlines::Outlines;
use scanloom_kernels::refinement::plane_growth::{
    FilteredSurface, Plane, PlaneLimits, grow_planes, label_vertices,
};
use scanloom_kernels::refinement::plane_merging::{MergeLimits, merge_planes};
use scanloom_kernels::refinement::refiner::Refiner;
use scanloom_kernels::refinement::short_edges::collapse_short_edges;
use scanloom_kernels::refinement::votes::Votes;

const SPACING: f64 = 0.005;
const NOISE: f64 = 0.0004;
const REACH: f64 = 0.01;
const MAX_MOVE: f64 = 0.004;

/// Pseudo-random number from −1 to 1.
fn signed(noise: &mut Noise) -> f64 {
    2.0 * noise.next() - 1.0
}

/// Triangles of a grid of `side` × `side` points.
fn grid(side: usize) -> Vec<[u32; 3]> {
    let mut triangles = vec![];
    for i in 0..side - 1 {
        for k in 0..side - 1 {
            let a = (i * side + k) as u32;
            let (b, c, d) = (a + 1, a + side as u32 + 1, a + side as u32);
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    triangles
}

/// Points of a grid, folded by 90° along a line between two rows, with noise along the normals.
fn folded_sheet(side: usize) -> Vec<Vec3> {
    let mut noise = Noise(7);
    (0..side * side)
        .map(|i| {
            let (s, t) = ((i / side) as f64 - 0.47 * side as f64, (i % side) as f64);
            let (s, t) = (s * SPACING, t * SPACING);
            let off = NOISE * signed(&mut noise);
            if s < 0.0 { [s, t, off] } else { [off, t, s] }
        })
        .collect()
}

fn limits(angle: f64, deviations: f64) -> PlaneLimits {
    PlaneLimits {
        min_cosine: angle.to_radians().cos(),
        max_deviations: deviations,
        min_triangles: 100,
        max_bend: 0.03,
    }
}

/// Filtered sheet.
struct FilteredSheet {
    points: Vec<Vec3>,
    normals: Vec<Vec3>,
    vertex_normals: Vec<Vec3>,
    areas: Vec<f64>,
    deviations: Vec<f64>,
}

impl FilteredSheet {
    fn new(connectivity: &Connectivity, points: &[Vec3]) -> Self {
        let chords = vec![0.5; connectivity.triangle_slots()];
        let normals = filter_normals(connectivity, points, chords, 15, 1);
        let moved = fit_vertices(connectivity, points, &normals, &vec![MAX_MOVE; points.len()], 15, 1);
        let weighted = area_normals(connectivity, &moved, 1);
        Self {
            points: moved,
            normals,
            vertex_normals: vertex_normals(connectivity, &weighted, 1),
            areas: weighted.iter().map(|n| 0.5 * norm2(n).sqrt()).collect(),
            deviations: vec![NOISE; points.len()],
        }
    }

    fn surface<'a>(&'a self, connectivity: &'a Connectivity) -> FilteredSurface<'a> {
        FilteredSurface {
            connectivity,
            points: &self.points,
            normals: &self.normals,
            areas: &self.areas,
            deviations: &self.deviations,
        }
    }
}

#[test]
fn a_noisy_fold_becomes_two_planes_with_a_straight_crease() {
    let side = 50;
    let points = folded_sheet(side);
    let mut connectivity = Connectivity::from_triangles(points.len(), &grid(side)).unwrap();
    let sheet = FilteredSheet::new(&connectivity, &points);
    let surface = sheet.surface(&connectivity);
    let (planes, of_triangles) = grow_planes(&surface, &limits(5.0, 4.0), 1);
    assert_eq!(planes.len(), 2);
    let labels =
        label_vertices(&surface, &planes, &of_triangles, &sheet.vertex_normals, &limits(60.0, 6.0), 4, 1);
    assert!(labels.iter().all(|&label| label < 2));
    let max_moves = vec![MAX_MOVE; points.len()];
    let result = snap_to_planes(&mut connectivity, &points, &sheet.points, &planes, &labels, &max_moves);
    for (p, q) in points.iter().zip(&result.points) {
        assert!(distance2(p, q).sqrt() <= MAX_MOVE + 1e-12);
    }
    assert!(connectivity.validate().is_ok());
    assert!(result.created.len() >= side);
    let height = |plane: &Plane, v: usize| plane.height(&result.points[v]).abs();
    for v in points.len()..result.points.len() {
        assert!(planes.iter().all(|plane| height(plane, v) < 1e-9), "a crease vertex is on both planes");
    }
    for t in connectivity.triangles() {
        let corners = connectivity.corners(t).map(|v| v.index());
        let is_on = |plane: &Plane| corners.iter().all(|&v| height(plane, v) < 1e-9);
        assert!(planes.iter().any(is_on), "no triangle cuts the crease");
    }
    // The crease is where it was made, to a fraction of the noise.
    for p in &result.points[points.len()..] {
        assert!(p[0].abs() < 0.5 * NOISE && p[2].abs() < 0.5 * NOISE, "{p:?}");
    }
}

#[test]
fn a_ball_has_no_planes() {
    let side = 50;
    let mut noise = Noise(3);
    let points: Vec<Vec3> = (0..side * side)
        .map(|i| {
            let at = [i / side, i % side].map(|x| (x as f64 - 0.5 * side as f64) * SPACING);
            let radius = 0.3 + NOISE * signed(&mut noise);
            normalize(&[at[0], at[1], 0.3]).map(|x| x * radius)
        })
        .collect();
    let connectivity = Connectivity::from_triangles(points.len(), &grid(side)).unwrap();
    let sheet = FilteredSheet::new(&connectivity, &points);
    assert!(grow_planes(&sheet.surface(&connectivity), &limits(5.0, 4.0), 1).0.is_empty());
}

/// Merge three strips of a sheet: a wall, a floor, and a floor tilted by an angle. Returns the planes, and the label
/// of a vertex of each strip.
fn merge_strips(tilt: f64) -> (Vec<Plane>, [u32; 3]) {
    let (side, step) = (48, 16);
    let points: Vec<Vec3> = (0..side * side)
        .map(|i| {
            let (s, t) = ((i / side) as f64 - step as f64, (i % side) as f64);
            let along = (s - step as f64).max(0.0);
            let up = (-s).max(0.0) + along * tilt.to_radians().tan();
            [s.max(0.0) * SPACING, t * SPACING, up * SPACING]
        })
        .collect();
    let connectivity = Connectivity::from_triangles(points.len(), &grid(side)).unwrap();
    let weighted = area_normals(&connectivity, &points, 1);
    let sheet = FilteredSheet {
        normals: weighted.iter().map(normalize).collect(),
        vertex_normals: vec![],
        areas: weighted.iter().map(|n| 0.5 * norm2(n).sqrt()).collect(),
        deviations: vec![NOISE; points.len()],
        points,
    };
    let strip_of = |v: usize| ((v / side) / step) as u32;
    let triangle_labels: Vec<u32> =
        connectivity.triangles().map(|t| strip_of(connectivity.corners(t)[0].index())).collect();
    let mut labels: Vec<u32> = (0..side * side).map(strip_of).collect();
    let mut planes = vec![
        Plane { normal: [1.0, 0.0, 0.0], origin: [0.0; 3] },
        Plane { normal: [0.0, 0.0, 1.0], origin: [0.0; 3] },
        Plane::default(),
    ];
    let limits = MergeLimits { min_cosine: 0.966, max_rms_deviations: 1.5, max_bend: 0.026 };
    merge_planes(&sheet.surface(&connectivity), &limits, &triangle_labels, &mut planes, &mut labels);
    (planes, [0, 1, 2].map(|strip| labels[(strip * step + step / 2) * side]))
}

#[test]
fn patches_within_the_noise_of_one_plane_merge_and_others_stay() {
    let (planes, labels) = merge_strips(1.0);
    assert_eq!(labels, [0, 1, 1]);
    assert_eq!(planes.len(), 2);
    let normal = planes[1].normal;
    assert!(normal[2].abs() > 0.9999 && normal[0].abs() > 0.005, "between both tilts: {normal:?}");
    // Too far from a common plane, and too bent.
    let (planes, labels) = merge_strips(6.0);
    assert_eq!(labels, [0, 1, 2]);
    assert_eq!(planes.len(), 3);
}

#[test]
fn filtering_keeps_the_fold_and_removes_the_noise() {
    let side = 40;
    let points = folded_sheet(side);
    let connectivity = Connectivity::from_triangles(points.len(), &grid(side)).unwrap();
    let FilteredSheet { points: moved, normals, .. } = FilteredSheet::new(&connectivity, &points);
    let off = |points: &[Vec3]| {
        let distances = points.iter().map(|p| p[0].abs().min(p[2].abs()).powi(2));
        (distances.sum::<f64>() / points.len() as f64).sqrt()
    };
    assert!(off(&moved) < 0.75 * off(&points), "{} {}", off(&moved), off(&points));
    // Away from the border of the sheet, every normal is within 3° of one of the two planes.
    let tilted = normals.iter().filter(|n| n[0].abs().max(n[2].abs()) < 3f64.to_radians().cos()).count();
    assert!(tilted < normals.len() / 20, "{tilted} of {}", normals.len());
    for (p, q) in points.iter().zip(&moved) {
        assert!(distance2(p, q).sqrt() <= MAX_MOVE + 1e-12);
    }
}

#[test]
fn short_edges_vanish_and_the_boundary_stays() {
    let side = 30;
    let mut noise = Noise(11);
    let points: Vec<Vec3> = (0..side * side)
        .map(|i| {
            let inside = ![i / side, i % side].iter().any(|&x| x == 0 || x == side - 1);
            let shift = if inside { 0.3 } else { 0.0 };
            [0, 1].map(|k| ([i / side, i % side][k] as f64 + shift * signed(&mut noise)) * SPACING)
        })
        .map(|[x, y]| [x, y, 0.0])
        .collect();
    let mut mesh = Mesh::<3>::new(points, &grid(side)).unwrap();
    let boundary = |mesh: &Mesh<3>| {
        let c = &mesh.connectivity;
        c.edges().filter(|&e: &EdgeId| c.is_boundary_edge(e)).count()
    };
    let before = boundary(&mesh);
    let least = 0.55 * SPACING;
    let is_short = |mesh: &Mesh<3>, e: EdgeId| {
        let [a, b] = mesh.connectivity.ends(e).map(|v| *mesh.point(v));
        distance2(&a, &b).sqrt() < least
    };
    let short = mesh.connectivity.edges().filter(|&e| is_short(&mesh, e)).count();
    assert!(short > 10);
    assert!(collapse_short_edges(&mut mesh, least) > 0);
    assert!(mesh.connectivity.validate().is_ok());
    assert_eq!(boundary(&mesh), before);
    let left = mesh.connectivity.edges().filter(|&e| is_short(&mesh, e)).count();
    assert!(left <= short / 4, "{left} of {short}");
    let up = |t: TriangleId| {
        let [a, b, c] = mesh.triangle_points(t);
        let (u, v) = (sub(&b, &a), sub(&c, &a));
        (u[0] * v[1] - u[1] * v[0]).signum()
    };
    let first = up(mesh.connectivity.triangles().next().unwrap());
    assert!(mesh.connectivity.triangles().all(|t| up(t) == first), "no triangle flips");
}

#[test]
fn a_jagged_boundary_becomes_straight_and_does_not_shrink() {
    let side = 30;
    let points: Vec<Vec3> = (0..side * side)
        .map(|i| {
            let at = [i / side, i % side].map(|x| x as f64 * SPACING);
            // Every second vertex of the first row stands out.
            let tooth = if i < side && i % 2 == 1 { 0.4 * SPACING } else { 0.0 };
            [at[0] - tooth, at[1], 0.0]
        })
        .collect();
    let connectivity = Connectivity::from_triangles(points.len(), &grid(side)).unwrap();
    let normals = vertex_normals(&connectivity, &area_normals(&connectivity, &points, 1), 1);
    let mut smooth = points.clone();
    smooth_boundaries(&connectivity, &mut smooth, &normals, SPACING, 1);
    let middle = &smooth[5..side - 5];
    let mean = middle.iter().map(|p| p[0]).sum::<f64>() / middle.len() as f64;
    assert!((mean + 0.2 * SPACING).abs() < 0.05 * SPACING, "{mean}");
    assert!(middle.iter().all(|p| (p[0] - mean).abs() < 0.05 * SPACING));
    for (v, (p, q)) in points.iter().zip(&smooth).enumerate() {
        let is_boundary = [v / side, v % side].iter().any(|&x| x == 0 || x == side - 1);
        assert!(q[2] == 0.0 && (is_boundary || p == q));
        assert!(distance2(p, q).sqrt() <= SPACING * (1.0 + 1e-12));
    }
}

/// Camera at the origin that looks along z, and a wall at 1 m.
fn camera() -> FusionCamera {
    let pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
    FusionCamera::new((80, 60), [70.0, 70.0], [39.5, 29.5], pose)
}

fn frame<'a>(camera: &'a FusionCamera, depth: &'a [f32]) -> DepthFrame<'a> {
    let noise = DepthNoiseModel { typical: 1.0, constant: 0.001, quadratic: 0.0 };
    DepthFrame { camera, depth, noise }
}

#[test]
fn observations_measure_the_distance_along_the_normal() {
    let (camera, depth) = (camera(), vec![1.0f32; 80 * 60]);
    let points = [[0.1, -0.05, 0.998], [0.0, 0.0, 1.003], [0.0, 0.0, 0.9], [0.0, 0.0, 1.1], [9.0, 0.0, 1.0]];
    let normals = [[0.0, 0.0, -1.0]; 5];
    let mut found = [Observation::default(); 5];
    observe(frame(&camera, &depth), REACH, &points, &normals, &mut found, 1);
    for (one, expected) in found.iter().zip([-0.002, 0.003]) {
        assert_eq!(one.frames, 1);
        assert!(one.best_cosine > 0.99);
        assert!((one.distance / one.weight - expected).abs() < 1e-6);
        assert!((one.weight - 1e6).abs() < 2e4);
    }
    assert!(
        found[2..].iter().all(|one| one.frames == 0 && one.best_cosine == 0.0),
        "in front of the wall, hidden, outside"
    );
    // The back of the surface is not measured.
    let mut back = [Observation::default()];
    observe(frame(&camera, &depth), REACH, &points[..1], &[[0.0, 0.0, 1.0]], &mut back, 1);
    assert_eq!(back[0].frames, 0);
    // Seen along the surface.
    let mut along = [Observation::default()];
    let steep = normalize(&[1.0, 0.0, -0.15]);
    observe(frame(&camera, &depth), REACH, &[[0.0, 0.0, 1.0]], &[steep], &mut along, 1);
    assert!(along[0].frames == 1 && along[0].best_cosine < 0.2);
}

#[test]
fn a_refinement_follows_the_measurements_whatever_the_number_of_threads() {
    let side = 40;
    let mut noise = Noise(5);
    let points: Vec<Vec3> = (0..side * side)
        .map(|i| {
            let at = [i % side, i / side].map(|x| (x as f64 - 0.5 * side as f64) * SPACING);
            [at[0], at[1], 0.997 + NOISE * signed(&mut noise)]
        })
        .collect();
    // Normals towards the camera.
    let triangles: Vec<[u32; 3]> = grid(side).into_iter().map(|[a, b, c]| [a, c, b]).collect();
    let (camera, depth) = (camera(), vec![1.0f32; 80 * 60]);
    let run = |threads: usize| {
        let mut refiner = Refiner::new(points.clone(), triangles.clone(), 1.0, threads).unwrap();
        (0..4).for_each(|_| refiner.observe(frame(&camera, &depth)));
        refiner.filter();
        for _ in 0..2 {
            (0..4).for_each(|_| refiner.observe(frame(&camera, &depth)));
            refiner.correct();
        }
        refiner.flatten();
        refiner.finish()
    };
    let (one, three) = (run(1), run(3));
    let bits = |points: &[Vec3]| points.as_flattened().iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&one.points), bits(&three.points));
    assert_eq!((&one.triangles, &one.labels), (&three.triangles, &three.labels));
    assert_eq!(one.plane_count, 1);
    for (p, &moved) in one.points.iter().zip(&one.moves) {
        assert!((p[2] - 1.0).abs() < 1e-4, "{p:?}");
        assert!(moved < 3.0 * (0.001 + SPACING));
    }
}

#[test]
fn frames_vote_for_what_they_measure_and_against_what_they_look_through() {
    let camera = camera();
    let vote = |depth: f32, point: Vec3, normal: Vec3| {
        let mut votes = Votes::default();
        votes.add(frame(&camera, &vec![depth; 80 * 60]), REACH, &point, &normal);
        (votes.surface > 0.0, votes.free_space > 0.0)
    };
    let (towards, away, aside) = ([0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]);
    assert_eq!(vote(1.0, [0.0, 0.0, 1.004], towards), (true, false));
    assert_eq!(vote(1.0, [0.0, 0.0, 0.9], towards), (false, true), "the surface is clearly behind");
    assert_eq!(vote(1.0, [0.0, 0.0, 1.1], towards), (false, false), "something is in front");
    assert_eq!(vote(1.0, [0.0, 0.0, 0.9], away), (false, true), "a ray from behind passes, too");
    assert_eq!(vote(1.0, [0.0, 0.0, 1.0], away), (false, false), "a back is not measured");
    assert_eq!(vote(1.0, [0.0, 0.0, 0.9], aside), (false, false), "a surface edge-on");
    assert_eq!(vote(0.0, [0.0, 0.0, 0.9], towards), (false, false), "no depth");
    assert_eq!(vote(1.0, [9.0, 0.0, 0.9], towards), (false, false), "outside of the image");
    assert_eq!(vote(1.0, [0.0, 0.0, -0.9], towards), (false, false), "behind the camera");
}

/// Align the right boundary of a wall at 1 m, near `x`, with an outline at 0. Return its mean, the largest distance
/// that vertices away from it moved, and all vertices.
fn align(x: f64, behind: f32, threads: usize) -> (f64, f64, Vec<Vec3>) {
    let side = 40;
    let points: Vec<Vec3> = (0..side * side)
        .map(|i| {
            let (row, column) = (i / side, i % side);
            [(column as f64 + 1.0 - side as f64) * SPACING + x, row as f64 * SPACING - 0.1, 1.0]
        })
        .collect();
    let triangles: Vec<[u32; 3]> = grid(side).iter().map(|&[a, b, c]| [a, c, b]).collect();
    let connectivity = Connectivity::from_triangles(points.len(), &triangles).unwrap();
    let camera = FusionCamera::new(
        (800, 600),
        [700.0, 700.0],
        [400.0, 300.0],
        [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
    );
    // Wall on the left half of the image, the background behind on the right.
    let depth: Vec<f32> = (0..800 * 600).map(|i| if i % 800 < 400 { 1.0 } else { behind }).collect();
    let mut outlines = Outlines::new(connectivity, points.clone(), threads);
    outlines.observe(frame(&camera, &depth));
    let moved = outlines.finish();
    let is_right = |v: usize| v % side == side - 1 && v / side > 4 && v / side < side - 5;
    let right: Vec<f64> = (0..side * side).filter(|&v| is_right(v)).map(|v| moved[v][0]).collect();
    // At the corners, the mean along the boundary moves a few vertices of the other sides.
    let others = (0..side * side)
        .filter(|&v| v % side < side - 12 || (v % side < side - 1 && (1..side - 1).contains(&(v / side))))
        .map(|v| distance2(&points[v], &moved[v]));
    (right.iter().sum::<f64>() / right.len() as f64, others.fold(0.0, f64::max).sqrt(), moved)
}

#[test]
fn a_boundary_moves_to_the_outline_from_both_sides() {
    let edge = SPACING * (2.0 + 2f64.sqrt()) / 3.0;
    for x in [-0.8 * SPACING, 0.5 * SPACING] {
        let (mean, others, moved) = align(x, 2.0, 1);
        // The outline is half a pixel to the left; points of the lines are a quarter of an edge apart.
        assert!((mean + 0.5 / 700.0).abs() < 0.15 * edge, "{mean}");
        assert_eq!(others, 0.0, "only the boundary at the outline moves");
        assert!(moved.iter().all(|p| p[2] == 1.0), "within the surface");
        assert_eq!(moved, align(x, 2.0, 2).2, "whatever the number of threads");
    }
    let (far, ..) = align(-1.9 * SPACING, 2.0, 1);
    assert!((far - (edge - 1.9 * SPACING)).abs() < 0.1 * edge, "at most one edge length: {far}");
}

#[test]
fn a_boundary_without_outline_stays() {
    for behind in [1.0, 0.0, 0.5] {
        let (mean, others, _) = align(-0.5 * SPACING, behind, 1);
        assert!((mean + 0.5 * SPACING).abs() < 1e-12 && others == 0.0, "depth {behind}: {mean}");
    }
}
