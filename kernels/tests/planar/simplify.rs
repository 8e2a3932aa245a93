//! Near-planar patches: guarantees that hold on any mesh.

use crate::promises::common::{Noise, Triangles, octahedron, sheet, sheet_with_hole, tetrahedron, torus};
use scanloom_kernels::base::geometry::{Vec3, triangle_distance2};
use scanloom_kernels::base::progress::{Progress, RunControl};
use scanloom_kernels::mesh::connectivity::Connectivity;
use scanloom_kernels::mesh::triangle_mesh::{Mesh, VertexLock};
use scanloom_kernels::planar::{Options, PlanarMesh, simplify};

fn options(max_distance: f64) -> Options {
    let cosine = |degrees: f64| degrees.to_radians().cos();
    Options {
        labels: vec![],
        fidelity: cosine(35.0),
        detail: cosine(35.0),
        noise: cosine(75.0),
        max_distance,
        max_color: f64::INFINITY,
        threads: 1,
    }
}

fn planar<const D: usize, const K: usize>(mesh: &Mesh<D>, options: &Options) -> PlanarMesh {
    let control = RunControl::default();
    simplify::<D, K>(mesh, options, &mut Progress::new(&control)).expect("nobody interrupts")
}

/// Check that the result is a manifold of the same topology, with input vertices within the reported
/// distance.
fn check(points: &[Vec3], triangles: &Triangles, options: &Options) -> PlanarMesh {
    let mesh = Mesh::<3>::new(points.to_vec(), triangles).expect("a manifold");
    let result = planar::<3, 0>(&mesh, options);
    let connectivity = Connectivity::from_triangles(result.vertex_source.len(), &result.triangles)
        .expect("the result is a manifold");
    connectivity.validate().expect("sound");
    assert_eq!(connectivity.topology(), mesh.connectivity.topology());
    let place = |v: u32| points[result.vertex_source[v as usize] as usize];
    let bound = result.bounds.iter().map(|b| b[0]).fold(0.0, f64::max);
    assert!(bound <= options.max_distance * (1.0 + 1e-9), "{bound} > {}", options.max_distance);
    let stride = points.len() / 50 + 1;
    for v in mesh.connectivity.vertices().step_by(stride) {
        let nearest = result
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(place);
                triangle_distance2(&points[v.index()], [&a, &b, &c])
            })
            .fold(f64::MAX, f64::min);
        assert!(nearest.sqrt() <= bound * (1.0 + 1e-9) + 1e-12, "{v:?} is {} off", nearest.sqrt());
    }
    for (triangle, (&source, &patch)) in
        result.triangles.iter().zip(result.triangle_source.iter().zip(&result.triangle_patch))
    {
        assert_eq!(result.patches.patch_of_triangle[source as usize], patch);
        assert!(
            triangles[source as usize]
                .iter()
                .any(|&v| triangle.iter().any(|&w| result.vertex_source[w as usize] == v))
        );
    }
    result
}

fn subdivided((mut points, mut triangles): (Vec<Vec3>, Triangles), times: usize) -> (Vec<Vec3>, Triangles) {
    for _ in 0..times {
        let mut middles = std::collections::BTreeMap::new();
        let mut finer = vec![];
        for &[a, b, c] in &triangles {
            let [ab, bc, ca] = [[a, b], [b, c], [c, a]].map(|[p, q]| {
                *middles.entry([p.min(q), p.max(q)]).or_insert_with(|| {
                    let [p, q] = [points[p as usize], points[q as usize]];
                    points.push(std::array::from_fn(|i| 0.5 * (p[i] + q[i])));
                    points.len() as u32 - 1
                })
            });
            finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        triangles = finer;
    }
    (points, triangles)
}

fn ball(times: usize) -> (Vec<Vec3>, Triangles) {
    let (mut points, triangles) = subdivided(octahedron(), times);
    for p in &mut points {
        let length = p.iter().map(|x| x * x).sum::<f64>().sqrt();
        *p = p.map(|x| x / length);
    }
    (points, triangles)
}

#[test]
fn a_flat_sheet_is_two_triangles_and_a_hole_stays() {
    let (points, triangles) = sheet(30, 20);
    let result = check(&points, &triangles, &options(1e-6));
    assert_eq!(result.triangles.len(), 2);
    assert_eq!(result.patches.patches.len(), 1);
    let (points, triangles) = sheet_with_hole(7);
    assert_eq!(check(&points, &triangles, &options(1e-6)).triangles.len(), 8);
}

#[test]
fn flat_faces_of_a_solid_are_what_is_left_of_it() {
    let (points, triangles) = subdivided(tetrahedron(), 4);
    assert_eq!(check(&points, &triangles, &options(1e-6)).triangles.len(), 4);
    let (points, triangles) = subdivided(octahedron(), 4);
    assert_eq!(check(&points, &triangles, &options(1e-6)).triangles.len(), 8);
}

#[test]
fn closed_surfaces_stay_closed_at_any_tolerance() {
    for (points, triangles) in [ball(3), torus(30, 16), subdivided(tetrahedron(), 3)] {
        for distance in [1e-6, 0.003, 0.03, 0.3, 1.0, 100.0] {
            for angle in [35.0f64, 79.0] {
                let cosine = angle.to_radians().cos();
                let options = Options { fidelity: cosine, detail: cosine, ..options(distance) };
                check(&points, &triangles, &options);
                check(&points, &triangles, &Options { noise: 2.0, ..options });
            }
        }
    }
}

#[test]
fn noise_at_any_tolerance_gives_a_manifold_within_bounds() {
    let mut noise = Noise(7);
    for round in 0..12 {
        let (mut points, triangles) = match round % 4 {
            0 => sheet(24, 17),
            1 => sheet_with_hole(6),
            2 => torus(24, 12),
            _ => ball(3),
        };
        let much = [0.01, 0.1, 0.4][round % 3];
        for p in &mut points {
            *p = p.map(|x| x + much * (noise.next() - 0.5));
        }
        for distance in [0.01, 0.05, 0.2, 0.8, 3.0] {
            check(&points, &triangles, &options(distance));
            check(&points, &triangles, &Options { noise: 2.0, ..options(distance) });
        }
    }
}

/// Build a spiral ramp with several overlapping turns.
fn ramp(turns: u32, steps: u32, rise: f64) -> (Vec<Vec3>, Triangles) {
    let (across, along) = (6, turns * steps);
    let (mut points, triangles) = sheet(along, across);
    for p in &mut points {
        let angle = p[0] / f64::from(steps) * std::f64::consts::TAU;
        let radius = 1.0 + p[1] / f64::from(across);
        *p = [radius * angle.sin(), radius * angle.cos(), rise * angle];
    }
    (points, triangles)
}

#[test]
fn what_lies_over_itself_is_several_patches() {
    let (points, triangles) = ramp(4, 80, 1e-4);
    let result = check(&points, &triangles, &options(0.2));
    assert!(result.patches.patches.len() > 1);
    assert!(result.triangles.len() < triangles.len() / 10, "{}", result.triangles.len());
}

#[test]
fn locked_vertices_keep_their_triangles() {
    let (points, triangles) = sheet(20, 20);
    let mut mesh = Mesh::<3>::new(points, &triangles).expect("a manifold");
    let locked = [5 * 21 + 5, 13 * 21 + 8];
    locked.iter().for_each(|&v| mesh.locks[v] = VertexLock::Locked);
    let result = planar::<3, 0>(&mesh, &options(0.01));
    for triangle in triangles.iter().filter(|t| t.iter().any(|&v| locked.contains(&(v as usize)))) {
        let is_same =
            |t: &[u32; 3]| triangle.iter().all(|&v| t.iter().any(|&w| result.vertex_source[w as usize] == v));
        assert!(result.triangles.iter().any(is_same));
    }
}

#[test]
fn colours_stay_near_linear_within_a_patch() {
    let (points, triangles) = sheet(40, 10);
    // Colours rise linearly up to the middle and fall from there.
    let coloured: Vec<[f64; 6]> =
        points.iter().map(|p| [p[0], p[1], p[2], 100.0 - 5.0 * (p[0] - 20.0).abs(), 0.0, 0.0]).collect();
    let mesh = Mesh::<6>::new(coloured, &triangles).expect("a manifold");
    let free = planar::<6, 3>(&mesh, &options(0.01));
    let held = planar::<6, 3>(&mesh, &Options { max_color: 5.0, ..options(0.01) });
    assert_eq!((free.triangles.len(), free.patches.patches.len()), (2, 1));
    assert!(held.patches.patches.len() > 1 && held.triangles.len() < 80, "{}", held.triangles.len());
    assert!(held.bounds.iter().all(|b| b[1] <= 5.0 + 1e-9));
}

#[test]
fn the_work_is_linear() {
    let looks = |n: u32| {
        let (mut points, triangles) = sheet(n, n);
        let mut noise = Noise(3);
        points.iter_mut().for_each(|p| p[2] += 0.3 * noise.next());
        let mesh = Mesh::<3>::new(points, &triangles).expect("a manifold");
        planar::<3, 0>(&mesh, &options(0.25)).patches.visited_faces as f64 / triangles.len() as f64
    };
    let [small, large] = [looks(20), looks(80)];
    assert!(large < 1.5 * small + 1.0 && large < 20.0, "{small} {large}");
}

#[test]
fn triangles_of_different_labels_are_in_different_patches() {
    // A flat sheet with another label on its left half: each half becomes two triangles along an intact
    // border.
    let n = 10u32;
    let points: Vec<Vec3> =
        (0..(n + 1) * (n + 1)).map(|i| [f64::from(i % (n + 1)), f64::from(i / (n + 1)), 0.0]).collect();
    let quads = (0..n * n).map(|i| i / n * (n + 1) + i % n);
    let triangles: Vec<[u32; 3]> =
        quads.flat_map(|a| [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]).collect();
    let labels = (0..2 * n * n).map(|t| u32::from(t / 2 % n < n / 2)).collect();
    assert_eq!(check(&points, &triangles, &options(0.01)).triangles.len(), 2);
    let result = check(&points, &triangles, &Options { labels, ..options(0.01) });
    assert_eq!(result.patches.patches.len(), 2);
    assert_eq!(result.triangles.len(), 4);
    for (t, &source) in result.triangles.iter().zip(&result.triangle_source) {
        let is_left = t.iter().all(|&v| points[result.vertex_source[v as usize] as usize][0] <= 5.0);
        assert_eq!(is_left, source / 2 % n < n / 2);
    }
}

#[test]
fn the_number_of_threads_changes_nothing() {
    // A mesh with patches of all sizes, many repeatedly released triangles, and some folded patches.
    let (mut points, triangles) = ball(6);
    let mut noise = Noise(11);
    for p in &mut points {
        let waves = 1.0 + 0.05 * (7.0 * p[0]).sin() * (9.0 * p[1]).cos() + 0.004 * (noise.next() - 0.5);
        *p = p.map(|x| x * waves);
    }
    let colored: Vec<[f64; 6]> = points
        .iter()
        .map(|p| [p[0], p[1], p[2], 90.0 * p[0], 90.0 * p[1] * p[2], 50.0 * noise.next()])
        .collect();
    for distance in [0.002, 0.01, 0.05] {
        for (max_color, noise) in [(f64::INFINITY, 0.3), (40.0, 0.3), (40.0, 2.0)] {
            let on = |threads: usize| {
                let mesh = Mesh::<6>::new_on(threads, colored.clone(), &triangles).expect("a manifold");
                let options = Options { max_color, noise, threads, ..options(distance) };
                let mut result = planar::<6, 3>(&mesh, &options);
                let patches = std::mem::take(&mut result.patches.patches);
                let bits: Vec<[u64; 6]> = patches
                    .iter()
                    .map(|p| [p.area, p.heights[0], p.heights[1], p.residual, p.gradient, p.normal[0]])
                    .map(|values| values.map(f64::to_bits))
                    .collect();
                (format!("{result:?}"), bits)
            };
            let alone = on(1);
            for threads in [2, 3, 8] {
                assert!(on(threads) == alone, "{threads} threads, {distance}, {max_color}, {noise}");
            }
        }
    }
}
