//! Normal meshes: correspondence of base and input, and the step from level to level.

use scanloom_kernels::base::geometry::Vec3;
use scanloom_kernels::base::progress::{Progress, RunControl};
use scanloom_kernels::mesh::triangle_mesh::Mesh;
use scanloom_kernels::normal::base_mesh::Base;
use scanloom_kernels::normal::coarsening::{Target, coarsen};
use scanloom_kernels::normal::decode::decode;
use scanloom_kernels::normal::prediction::predict;
use scanloom_kernels::normal::remesh::remesh;
use scanloom_kernels::normal::settings::Settings;
use scanloom_kernels::normal::surface::Surface;
use scanloom_kernels::normal::vertex_attributes::VertexAttributes;
use scanloom_kernels::subdivision::butterfly::compute_edge_points;
use scanloom_kernels::subdivision::snm_contents::{Offset, Scheme};
use scanloom_kernels::subdivision::topology::{NONE, Topology};

/// Build a wavy height field of n × n squares with a square hole.
pub fn sheet(n: u32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let at = |i: u32, j: u32| i * (n + 1) + j;
    let point = |k: u32| {
        let (x, y) = (f64::from(k / (n + 1)) / f64::from(n), f64::from(k % (n + 1)) / f64::from(n));
        [x, y, 0.1 * (6.0 * x).sin() * (5.0 * y).cos()]
    };
    let points = (0..(n + 1) * (n + 1)).map(point).collect();
    let mut triangles = vec![];
    for i in 0..n {
        for j in 0..n {
            let inside = |k: u32| k > n / 3 && k < n / 2;
            if !(inside(i) && inside(j)) {
                triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
    }
    (points, triangles)
}

fn base_of(points: &[Vec3], triangles: &[[u32; 3]], wanted: usize) -> (Base, Surface) {
    let mesh = Mesh::new(points.to_vec(), triangles).unwrap();
    let surface = Surface::new(points, triangles, 1);
    let numbers: Vec<u32> = (0..triangles.len() as u32).collect();
    let target = Target { triangles: wanted, error: f64::INFINITY, ignore_cost_limit: true };
    let control = RunControl::default();
    let importance = vec![1.0; points.len()];
    let progress = &mut Progress::new(&control);
    let coarse = coarsen(mesh, &surface, target, true, progress).unwrap();
    let made = coarse.build_base(&importance, &numbers, progress).unwrap();
    (made, surface)
}

pub fn settings(levels: u8, scheme: Scheme) -> Settings {
    Settings {
        levels: Some(levels),
        target: Target { triangles: 60, error: f64::INFINITY, ignore_cost_limit: true },
        max_error: 0.0,
        scheme,
        relaxations: 1,
        tolerance: Some(1e-4),
        color_tolerance: 2.0,
        up: None,
        threads: 1,
    }
}

#[test]
fn the_associated_set_of_a_base_triangle_covers_what_lies_on_it() {
    let (points, triangles) = sheet(24);
    let (base, _) = base_of(&points, &triangles, 60);
    assert!(base.triangles.len() <= 60);
    for (number, corners) in triangles.iter().enumerate() {
        for &v in corners {
            let at = base.base_points[v as usize];
            assert_ne!(at.triangle, NONE, "vertex {v} lies nowhere");
            assert!(at.barycentric.iter().all(|&x| (0.0..=1.0).contains(&x)));
            assert!((at.barycentric.iter().sum::<f64>() - 1.0).abs() < 1e-9);
            // Triangles that only touch the base triangle at a corner or side need not be in its set.
            if at.barycentric.iter().all(|&x| x > 1e-6) {
                assert!(base.sets.contains(at.triangle as usize, number as u32));
            }
        }
    }
}

#[test]
fn chains_cover_the_boundary_once_and_join_their_ends() {
    let (points, triangles) = sheet(24);
    let (base, _) = base_of(&points, &triangles, 60);
    let topology = Topology::new(points.len(), triangles.clone()).unwrap();
    let boundary = (0..topology.edges.len()).filter(|&e| topology.is_boundary_edge(e)).count();
    let origin = |h: usize| triangles[h / 3][h % 3];
    let target = |h: usize| triangles[h / 3][(h % 3 + 1) % 3];
    let mut seen = vec![];
    for chain in &base.chains {
        let [from, to] = chain.ends.map(|v| base.vertex_source[v as usize]);
        assert_eq!(origin(chain.halfedges[0].index()), from);
        assert_eq!(target(chain.halfedges[chain.halfedges.len() - 1].index()), to);
        assert!(chain.halfedges.windows(2).all(|w| target(w[0].index()) == origin(w[1].index())));
        seen.extend(chain.halfedges.iter().map(|h| h.index()));
    }
    seen.sort_unstable();
    seen.dedup();
    assert_eq!(seen.len(), boundary);
}

#[test]
fn butterfly_and_relaxation_leave_a_plane_flat_and_a_regular_grid_even() {
    let (mut points, triangles) = sheet(9);
    points.iter_mut().for_each(|p| p[2] = 0.5 * p[0] - p[1]);
    let topology = Topology::new(points.len(), triangles).unwrap();
    for scheme in [Scheme::Linear, Scheme::Butterfly] {
        let predicted = predict(&topology, &points, scheme, 3);
        for p in &predicted.points {
            assert!((p[2] - (0.5 * p[0] - p[1])).abs() < 1e-12);
        }
    }
    // All stencils have weights that sum to 1, so translated points give translated predictions.
    let shifted: Vec<Vec3> = points.iter().map(|p| p.map(|x| x + 7.0)).collect();
    for (a, b) in compute_edge_points(&topology, &points).iter().zip(compute_edge_points(&topology, &shifted))
    {
        (0..3).for_each(|i| assert!((b[i] - a[i] - 7.0).abs() < 1e-12));
    }
}

#[test]
fn butterfly_reproduces_cubics_inside_a_regular_grid() {
    // The stencil interpolates four points per direction, so it is exact for cubics where it is complete.
    let n = 8;
    let (mut points, triangles) = sheet(n);
    let cubic = |x: f64, y: f64| x * x * x - 2.0 * x * y * y + y * y - x;
    points.iter_mut().for_each(|p| p[2] = cubic(p[0], p[1]));
    let kept: Vec<[u32; 3]> = triangles.into_iter().filter(|t| t.iter().all(|v| v % (n + 1) >= 5)).collect();
    let topology = Topology::new(points.len(), kept).unwrap();
    let mut checked = 0;
    for (edge, p) in compute_edge_points(&topology, &points).iter().enumerate() {
        let ends = topology.edges[edge].map(|v| (v / (n + 1), v % (n + 1)));
        // Only edges whose ends, and their neighbours, are interior have a complete stencil.
        if ends.iter().all(|(i, j)| (2..=n - 2).contains(i) && (6..=n - 1).contains(j)) {
            assert!((p[2] - cubic(p[0], p[1])).abs() < 1e-12, "{p:?}");
            checked += 1;
        }
    }
    assert!(checked > 10);
}

#[test]
fn what_is_decoded_is_what_was_made_and_every_beginning_is_a_level() {
    let (points, triangles) = sheet(12);
    let colors = points.iter().map(|p| p.map(|x| (255.0 * x.abs().min(1.0)) as u8)).collect();
    let carried = VertexAttributes { colors, confidence: points.iter().map(|p| p[0]).collect() };
    let control = RunControl::default();
    for scheme in [Scheme::Linear, Scheme::Butterfly] {
        let settings = settings(2, scheme);
        let made =
            remesh(&points, &triangles, &carried, None, &settings, &mut Progress::new(&control)).unwrap();
        let (back, damage) = decode(&made.file, usize::MAX).unwrap();
        assert_eq!(damage, None);
        assert_eq!(back.levels.len(), 3);
        for (level, decoded) in made.levels.iter().zip(&back.levels) {
            assert_eq!(level.points, decoded.points);
            assert_eq!(level.topology, decoded.topology);
            assert_eq!(level.channels, decoded.channels);
        }
        // Cut the file at all bytes near its start and near level ends, where the cases differ, and at a
        // sample of others.
        let near = |end: &usize| {
            *end < 40 || made.ends.iter().any(|e| e.abs_diff(*end) < 12) || end.is_multiple_of(37)
        };
        for end in (0..made.file.len()).filter(near) {
            let whole = made.ends.iter().filter(|&&e| e <= end).count();
            match decode(&made.file[..end], usize::MAX) {
                Ok((part, damage)) => {
                    assert_eq!(part.levels.len(), whole);
                    assert_eq!(damage.is_none(), made.ends.contains(&end));
                    assert_eq!(part.levels[whole - 1].points, made.levels[whole - 1].points);
                }
                Err(_) => assert_eq!(whole, 0),
            }
        }
    }
}

#[test]
fn any_number_of_threads_makes_the_same_file() {
    let (points, triangles) = sheet(20);
    let control = RunControl::default();
    let file = |threads| {
        let settings = Settings { threads, ..settings(2, Scheme::Linear) };
        let progress = &mut Progress::new(&control);
        remesh(&points, &triangles, &VertexAttributes::default(), None, &settings, progress).unwrap().file
    };
    let one = file(1);
    assert_eq!(one, file(2));
    assert_eq!(one, file(5));
}

#[test]
fn on_a_smooth_surface_scalars_do() {
    let (points, triangles) = sheet(30);
    let control = RunControl::default();
    let progress = &mut Progress::new(&control);
    let made = remesh(
        &points,
        &triangles,
        &VertexAttributes::default(),
        None,
        &settings(3, Scheme::Linear),
        progress,
    )
    .unwrap();
    let mut vectors = 0;
    for (level, step) in made.levels.iter().zip(&made.steps) {
        for (edge, offset) in step.refinement.offsets.iter().enumerate() {
            let is_vector = matches!(offset, Offset::Vector(_));
            assert!(is_vector || !level.topology.is_boundary_edge(edge));
            vectors += usize::from(is_vector && !level.topology.is_boundary_edge(edge));
        }
    }
    assert!(vectors < 10, "{vectors}");
    assert_eq!(made.fold_count(), 0);
}
