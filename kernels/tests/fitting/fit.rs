//! Fit to the input: an exact mesh does not change, an inexact one gets closer, locked vertices do not move.

use crate::promises::common::{coloured, sheet, torus};
use scanloom_kernels::base::geometry::{nearest_on_triangle, norm2, sub};
use scanloom_kernels::base::ids::VertexId;
use scanloom_kernels::base::progress::{Progress, RunControl};
use scanloom_kernels::fitting::least_squares::{FitInput, fit};
use scanloom_kernels::mesh::triangle_mesh::{Mesh, VertexLock};

fn fitted<const D: usize>(
    mut mesh: Mesh<D>,
    points: &[[f64; D]],
    triangles: &[[u32; 3]],
    threads: usize,
) -> Vec<[f64; D]> {
    // Start each search at the nearest vertex of the result.
    let near = |p: &[f64; D]| {
        let distance = |v: usize| (0..3).map(|i| (mesh.points[v][i] - p[i]).powi(2)).sum::<f64>();
        let nearest = (0..mesh.points.len()).min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        VertexId::from_index(nearest.unwrap())
    };
    let became: Vec<VertexId> = points.iter().map(near).collect();
    let input = FitInput { points, triangles, vertex_map: &became };
    fit(&mut mesh, &input, threads, &Progress::new(&RunControl::default())).unwrap();
    mesh.points
}

#[test]
fn exact_mesh_does_not_change() {
    let (points, triangles) = torus(20, 14);
    let points: Vec<[f64; 6]> = coloured(&points, 0.0, 1);
    let mesh = Mesh::new(points.clone(), &triangles).unwrap();
    let after = fitted(mesh, &points, &triangles, 1);
    for (a, b) in after.iter().flatten().zip(points.iter().flatten()) {
        // Barycentric coordinates are in single precision.
        assert!((a - b).abs() < 1e-6 * 255.0);
    }
}

#[test]
fn a_coarse_torus_comes_closer_to_a_fine_one() {
    let colour = |p: &[f64; 3]| [p[0], p[1], p[2], 128.0 + 60.0 * p[0].sin()];
    let (fine, fine_triangles) = torus(120, 80);
    let fine: Vec<[f64; 4]> = fine.iter().map(colour).collect();
    let (coarse, coarse_triangles) = torus(24, 16);
    let coarse: Vec<[f64; 4]> = coarse.iter().map(colour).collect();
    let mesh = Mesh::new(coarse.clone(), &coarse_triangles).unwrap();
    let after = fitted(mesh.clone(), &fine, &fine_triangles, 1);
    let errors = |points: &[[f64; 4]]| {
        let (mut shape, mut colour) = (0.0, 0.0);
        for p in &fine {
            let nearest = coarse_triangles.iter().map(|t| {
                let corners = t.map(|v| points[v as usize]);
                let [a, b, c] = corners.map(|q| [q[0], q[1], q[2]]);
                let (at, distance2) = nearest_on_triangle(&[p[0], p[1], p[2]], [&a, &b, &c]);
                (distance2, (0..3).map(|i| at[i] * corners[i][3]).sum::<f64>())
            });
            let (distance2, found) = nearest.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
            shape += distance2;
            colour += (found - p[3]).powi(2);
        }
        (shape.sqrt(), colour.sqrt())
    };
    let (before, now) = (errors(&coarse), errors(&after));
    assert!(now.0 < 0.7 * before.0 && now.1 < 0.9 * before.1, "{before:?} {now:?}");
    assert_eq!(after, fitted(mesh, &fine, &fine_triangles, 3));
}

#[test]
fn fixed_vertices_and_the_boundary_stay_where_they_are() {
    let (fine, fine_triangles) = sheet(40, 40);
    let lift = |p: &[f64; 3]| [p[0], p[1], 2.0, 50.0];
    let fine: Vec<[f64; 4]> = fine.iter().map(lift).collect();
    let (coarse, coarse_triangles) = sheet(5, 5);
    let coarse: Vec<[f64; 4]> = coarse.iter().map(|p| [8.0 * p[0], 8.0 * p[1], 0.0, 200.0]).collect();
    let mut mesh = Mesh::new(coarse.clone(), &coarse_triangles).unwrap();
    mesh.locks[14] = VertexLock::Locked;
    let after = fitted(mesh.clone(), &fine, &fine_triangles, 1);
    assert_eq!(after[14], coarse[14]);
    for v in mesh.connectivity.vertices() {
        let (old, new) = (coarse[v.index()], after[v.index()]);
        if mesh.connectivity.is_boundary_vertex(v) {
            assert_eq!(old[..3], new[..3]);
        } else if v.index() != 14 {
            assert!(new[2] > 1.0 && new[3] < 150.0, "{new:?}");
        }
    }
}

#[test]
fn the_nearest_point_of_a_triangle_is_the_nearest() {
    let corners = [[0.0, 0.0, 0.0], [2.0, 0.1, 0.3], [0.4, 1.5, -0.2]];
    let mut noise = crate::promises::common::Noise(5);
    for _ in 0..200 {
        let p: [f64; 3] = std::array::from_fn(|_| 4.0 * noise.next() - 2.0);
        let (at, distance2) = nearest_on_triangle(&p, corners.each_ref());
        assert!(at.iter().all(|&x| (0.0..=1.0).contains(&x)) && (at.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        let place = |at: [f64; 3]| std::array::from_fn(|i| (0..3).map(|c| at[c] * corners[c][i]).sum());
        assert!((norm2(&sub(&p, &place(at))) - distance2).abs() < 1e-12);
        for i in 0..=20 {
            for j in 0..=20 - i {
                let (b, c) = (f64::from(i) / 20.0, f64::from(j) / 20.0);
                assert!(norm2(&sub(&p, &place([1.0 - b - c, b, c]))) >= distance2 - 1e-12);
            }
        }
    }
}
