//! Tests of construction, splits and collapses: every invariant must hold after every edit.

use crate::promises::common::{Noise, gallery, octahedron, sheet, tetrahedron, torus};
use scanloom_kernels::base::errors::KernelError;
use scanloom_kernels::base::ids::{EdgeId, VertexId};
use scanloom_kernels::mesh::collapse_legality::{IllegalCollapse, VertexMarks, can_collapse};
use scanloom_kernels::mesh::connectivity::Connectivity;
use scanloom_kernels::mesh::triangle_mesh::Mesh;
use scanloom_kernels::mesh::validation::Topology;

fn connect(vertices: usize, triangles: &[[u32; 3]]) -> Connectivity {
    Connectivity::from_triangles(vertices, triangles).unwrap()
}

fn edge_between(mesh: &Connectivity, a: u32, b: u32) -> EdgeId {
    let same = |e: &EdgeId| {
        let mut ends = mesh.ends(*e).map(|v| v.0);
        ends.sort_unstable();
        ends == [a.min(b), a.max(b)]
    };
    mesh.edges().find(same).unwrap()
}

fn verdict(mesh: &Connectivity, a: u32, b: u32) -> Result<(), IllegalCollapse> {
    can_collapse(mesh, edge_between(mesh, a, b), &mut VertexMarks::new(mesh.vertex_slots()))
}

#[test]
fn known_topology() {
    let topology = |(points, triangles): (Vec<[f64; 3]>, crate::promises::common::Triangles)| {
        connect(points.len(), &triangles).topology()
    };
    let expect = |euler, boundary_loops| Topology { euler, boundary_loops, components: 1 };
    assert_eq!(topology(octahedron()), expect(2, 0));
    assert_eq!(topology(torus(5, 4)), expect(0, 0));
    assert_eq!(topology(sheet(3, 2)), expect(1, 1));
    assert_eq!(topology(crate::promises::common::sheet_with_hole(2)), expect(0, 2));
}

#[test]
fn every_mesh_of_the_gallery_is_valid() {
    for (name, points, triangles) in gallery() {
        assert_eq!(connect(points.len(), &triangles).validate(), Ok(()), "{name}");
    }
}

#[test]
fn errors_name_the_elements() {
    let build = |triangles: &[[u32; 3]]| Connectivity::from_triangles(7, triangles).unwrap_err();
    assert_eq!(build(&[[0, 1, 2], [1, 0, 3], [0, 1, 4]]), KernelError::NonManifoldEdges(vec![[0, 1]]));
    assert_eq!(build(&[[0, 1, 2], [0, 1, 3]]), KernelError::InconsistentEdges(vec![[0, 1]]));
    assert_eq!(build(&[[0, 1, 2], [0, 3, 4]]), KernelError::PinchedVertices(vec![0]));
    assert_eq!(build(&[[4, 5, 6], [0, 1, 2], [1, 0, 2]]), KernelError::SameVertices(vec![[1, 2]]));
    let out = KernelError::IndexOutOfRange { triangle: 1, vertex: 9, vertices: 7 };
    assert_eq!(build(&[[0, 1, 2], [0, 1, 9]]), out);
    let message = build(&[[0, 1, 2], [1, 0, 3], [0, 1, 4]]).to_string();
    assert_eq!(message, "1 edge belongs to more than two triangles (0–1)");
}

/// Sheet with shuffled vertices and triangles, large enough to be connected on several threads.
fn shuffled_sheet() -> (usize, Vec<[u32; 3]>) {
    let (points, mut triangles) = sheet(150, 100);
    let mut noise = Noise(5);
    let mut name: Vec<u32> = (0..points.len() as u32).collect();
    for i in (1..name.len()).rev() {
        name.swap(i, noise.below(i + 1));
    }
    triangles.iter_mut().flatten().for_each(|v| *v = name[*v as usize]);
    for i in (1..triangles.len()).rev() {
        triangles.swap(i, noise.below(i + 1));
    }
    (points.len(), triangles)
}

#[test]
fn numbers_are_the_same_on_any_number_of_threads() {
    let (vertices, triangles) = shuffled_sheet();
    let alone = connect(vertices, &triangles);
    alone.validate().unwrap();
    // Edges are sorted by lower end, then by higher end.
    let ends = |e: EdgeId| {
        let [a, b] = alone.ends(e);
        [a.min(b), a.max(b)]
    };
    assert!(alone.edges().map(ends).is_sorted());
    for threads in [2, 3, 16] {
        let found = Connectivity::from_triangles_on(threads, vertices, &triangles).unwrap();
        assert_eq!(format!("{found:?}"), format!("{alone:?}"));
    }
}

#[test]
fn complaints_are_the_same_on_any_number_of_threads() {
    let (vertices, sound) = shuffled_sheet();
    let turned = |t: &[u32; 3]| [t[0], t[2], t[1]];
    let with = |spoil: &dyn Fn(&mut Vec<[u32; 3]>)| {
        let mut triangles = sound.clone();
        spoil(&mut triangles);
        triangles
    };
    let last = vertices as u32;
    for triangles in [
        with(&|t| (0..t.len()).step_by(1000).for_each(|i| t.push(t[i]))),
        with(&|t| (0..t.len()).step_by(1000).for_each(|i| t[i] = turned(&t[i]))),
        with(&|t| t.extend([[last, last + 1, last + 2], [last, last + 2, last + 1]])),
        with(&|t| t.extend([[t[0][0], last, last + 1], [t[9][0], last + 1, last + 2]])),
        with(&|t| t[7][1] = last + 3),
    ] {
        let alone = Connectivity::from_triangles(vertices + 3, &triangles).unwrap_err();
        for threads in [2, 3] {
            let found = Connectivity::from_triangles_on(threads, vertices + 3, &triangles).unwrap_err();
            assert_eq!(found, alone);
        }
    }
}

#[test]
fn a_closed_fan_and_an_open_one_at_a_vertex_are_a_pinch() {
    let (_, mut triangles) = octahedron();
    triangles.push([4, 6, 7]);
    let error = Connectivity::from_triangles(8, &triangles).unwrap_err();
    assert_eq!(error, KernelError::PinchedVertices(vec![4]));
}

#[test]
fn values_that_are_no_coordinates_are_refused() {
    for bad in [f64::NAN, f64::INFINITY, 1e80] {
        let (mut points, triangles) = tetrahedron();
        points[2][1] = bad;
        assert_eq!(Mesh::new(points, &triangles).unwrap_err(), KernelError::NotFinite { vertex: 2 });
    }
}

#[test]
fn a_triangle_that_names_a_vertex_twice_is_left_out() {
    let (points, mut triangles) = octahedron();
    triangles.insert(2, [3, 3, 1]);
    let compact = Mesh::new(points, &triangles).unwrap().compact();
    assert_eq!(compact.triangles, octahedron().1);
    assert_eq!(compact.triangle_source, [0, 1, 3, 4, 5, 6, 7, 8]);
}

#[test]
fn unused_vertices_are_left_out() {
    let (mut points, triangles) = tetrahedron();
    points.insert(0, [9.0; 3]);
    let triangles: Vec<_> = triangles.iter().map(|t| t.map(|v| v + 1)).collect();
    let compact = Mesh::new(points, &triangles).unwrap().compact();
    assert_eq!(compact.points, tetrahedron().0);
    assert_eq!(compact.vertex_source, [1, 2, 3, 4]);
}

#[test]
fn no_mesh_at_all() {
    let compact = Mesh::<3>::new(vec![], &[]).unwrap().compact();
    assert!(compact.points.is_empty() && compact.triangles.is_empty());
}

/// ```text
/// 6---7---8
/// | / | / |     A sheet of 2 × 2 squares: 4 is the only interior vertex.
/// 3---4---5
/// | / | / |
/// 0---1---2
/// ```
#[test]
fn what_may_collapse_on_a_sheet() {
    let (points, triangles) = sheet(2, 2);
    let mesh = connect(points.len(), &triangles);
    assert_eq!(verdict(&mesh, 0, 1), Ok(()), "along the boundary");
    assert_eq!(verdict(&mesh, 4, 1), Ok(()), "an interior vertex onto the boundary");
    assert_eq!(verdict(&mesh, 1, 5), Err(IllegalCollapse::Bridge), "across the interior");
}

#[test]
fn no_piece_or_hole_may_vanish() {
    let (points, triangles) = tetrahedron();
    let closed = connect(points.len(), &triangles);
    assert_eq!(verdict(&closed, 0, 1), Err(IllegalCollapse::Topology), "a tetrahedron");
    let open = connect(points.len(), &triangles[1..]);
    assert_eq!(verdict(&open, 0, 1), Err(IllegalCollapse::Topology), "a hole of three edges");
    assert_eq!(verdict(&open, 0, 3), Ok(()), "an interior vertex of three triangles");
    assert_eq!(verdict(&connect(3, &[[0, 1, 2]]), 0, 1), Err(IllegalCollapse::Topology), "a lone triangle");
    let (points, triangles) = torus(3, 3);
    let torus = connect(points.len(), &triangles);
    assert_eq!(verdict(&torus, 0, 1), Err(IllegalCollapse::Topology), "the neck of a torus");
}

#[test]
fn a_waist_of_three_edges_may_not_vanish() {
    // Two tetrahedra without their common face: 0, 1, 2 are the waist.
    let mesh = connect(5, &[[0, 1, 3], [1, 2, 3], [2, 0, 3], [1, 0, 4], [2, 1, 4], [0, 2, 4]]);
    assert_eq!(verdict(&mesh, 0, 1), Err(IllegalCollapse::Topology));
    assert_eq!(verdict(&mesh, 0, 3), Ok(()));
}

#[test]
fn a_collapse_tells_what_became_one() {
    let (points, triangles) = octahedron();
    let mut mesh = connect(points.len(), &triangles);
    let edge = edge_between(&mesh, 0, 4);
    let before: Vec<_> = mesh.edges().map(|e| (e, mesh.ends(e))).collect();
    let collapsed = mesh.collapse(edge, VertexId(0));
    assert_eq!((collapsed.survivor, collapsed.removed), (VertexId(0), VertexId(4)));
    for (kept, gone) in collapsed.merged.into_iter().flatten() {
        let ends = |e: EdgeId| before.iter().find(|(f, _)| *f == e).unwrap().1.map(|v| v.0);
        let far = |e: EdgeId| ends(e).into_iter().find(|&v| v == 1 || v == 3).unwrap();
        assert_eq!(far(kept), far(gone));
        assert!(mesh.is_edge(kept) && !mesh.is_edge(gone));
    }
    assert_eq!(mesh.validate(), Ok(()));
}

/// Random legal collapses of either end, and random splits.
#[test]
fn random_edits_keep_every_invariant() {
    for (name, points, triangles) in gallery() {
        for seed in 0..6 {
            let mut noise = Noise(seed);
            let mut mesh = connect(points.len(), &triangles);
            let topology = mesh.topology();
            for _ in 0..60 {
                let edges: Vec<EdgeId> = mesh.edges().collect();
                let edge = edges[noise.below(edges.len())];
                if noise.next() < 0.3 {
                    mesh.split(edge);
                } else if can_collapse(&mesh, edge, &mut VertexMarks::new(mesh.vertex_slots())).is_ok() {
                    let survivor = mesh.ends(edge)[noise.below(2)];
                    mesh.collapse(edge, survivor);
                }
                assert_eq!(mesh.validate(), Ok(()), "{name}, seed {seed}");
                assert_eq!(mesh.topology(), topology, "{name}, seed {seed}");
            }
        }
    }
}

/// Every collapse that the link condition refuses would break an invariant or change the topology.
#[test]
fn refusals_of_the_link_condition_are_needed() {
    for (name, points, triangles) in gallery() {
        let mesh = connect(points.len(), &triangles);
        for edge in mesh.edges() {
            let [survivor, removed] = mesh.ends(edge);
            let moved = |v: u32| if v == removed.0 { survivor.0 } else { v };
            let mut after: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(moved)).collect();
            after.retain(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]);
            let sound = Connectivity::from_triangles(points.len(), &after).is_ok_and(|collapsed| {
                // Cutting off an ear would also remove its tip.
                let one_less = collapsed.vertices().count() + 1 == mesh.vertices().count();
                one_less && collapsed.validate().is_ok() && collapsed.topology() == mesh.topology()
            });
            let allowed = can_collapse(&mesh, edge, &mut VertexMarks::new(mesh.vertex_slots())).is_ok();
            assert_eq!(allowed, sound, "{name}, edge {:?}", mesh.ends(edge));
        }
    }
}
