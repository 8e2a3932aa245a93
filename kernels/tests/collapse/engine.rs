//! The engine with another measure than JIA01: shortest edge first, half-edge collapses, locked vertices.

use crate::promises::common::{Noise, coloured, gallery, sheet};
use scanloom_kernels::base::geometry::{cross, distance2, sub};
use scanloom_kernels::base::ids::{EdgeId, TriangleId, VertexId};
use scanloom_kernels::collapse::engine::{CollapseChange, Engine, Measure, Proposal, Refusal, Step};
use scanloom_kernels::mesh::edge_star::EdgeStar;
use scanloom_kernels::mesh::triangle_mesh::Mesh;

/// Test measure with the features that simplifiers need: a choice of the survivor, locked vertices, and a set
/// of input triangles per triangle, as the normal-mesh remesher keeps it.
struct ShortestHalfEdge {
    locked: Vec<bool>,
    associated: Vec<Vec<TriangleId>>,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct Locked;

impl<const D: usize> Measure<D> for ShortestHalfEdge {
    type Reason = Locked;
    type Change = ();

    fn priority(&self, mesh: &Mesh<D>, edge: EdgeId) -> Result<f64, Locked> {
        let [a, b] = mesh.connectivity.ends(edge);
        let locked = self.locked[a.index()] && self.locked[b.index()];
        if locked { Err(Locked) } else { Ok(distance2(mesh.point(a), mesh.point(b))) }
    }

    fn propose(&mut self, _: &Mesh<D>, star: &EdgeStar<D>) -> Result<Proposal<D, ()>, Locked> {
        let survivor = usize::from(self.locked[star.ends[1].index()]);
        Ok(Proposal { survivor, point: star.end_points[survivor], change: () })
    }

    fn judge(&mut self, _: &Mesh<D>, _: &EdgeStar<D>, _: &mut Proposal<D, ()>) -> Result<(), Locked> {
        Ok(())
    }

    fn commit(&mut self, _: &Mesh<D>, star: &EdgeStar<D>, collapsed: &CollapseChange, (): ()) {
        let moved = |end: usize| star.ends[end] == collapsed.removed;
        let around: Vec<TriangleId> = star
            .remaining
            .iter()
            .filter(|w| moved(w.end))
            .map(|w| w.triangle)
            .chain(star.vanishing.iter().map(|v| v.0))
            .collect();
        let mut union: Vec<TriangleId> =
            around.iter().flat_map(|t| std::mem::take(&mut self.associated[t.index()])).collect();
        union.sort_unstable();
        union.dedup();
        // Removing the tip of an ear moves no triangle: its set goes to the triangles of the survivor.
        let none_moves = !star.remaining.iter().any(|w| moved(w.end));
        for wing in star.remaining.iter().filter(|w| moved(w.end) || none_moves) {
            self.associated[wing.triangle.index()].extend(&union);
        }
    }
}

fn engine(points: &[[f64; 3]], triangles: &[[u32; 3]], locked: &[u32]) -> Engine<3, ShortestHalfEdge> {
    let mesh = Mesh::new(points.to_vec(), triangles).unwrap();
    let is_locked = |v| locked.contains(&v);
    let measure = ShortestHalfEdge {
        locked: (0..points.len() as u32).map(is_locked).collect(),
        associated: (0..triangles.len() as u32).map(|t| vec![TriangleId(t)]).collect(),
    };
    Engine::new(mesh, measure)
}

#[test]
fn every_step_keeps_every_invariant() {
    for (name, points, triangles) in gallery() {
        let points = coloured::<3>(&points, 0.2, 1);
        let mut engine = engine(&points, &triangles, &[]);
        let topology = engine.mesh().connectivity.topology();
        loop {
            match engine.step() {
                Step::Finished => break,
                Step::Refused(..) => {}
                Step::Collapsed(_) => {
                    assert_eq!(engine.mesh().connectivity.validate(), Ok(()), "{name}");
                    assert_eq!(engine.mesh().connectivity.topology(), topology, "{name}");
                }
            }
        }
    }
}

#[test]
fn a_half_edge_collapse_leaves_input_vertices() {
    let (points, triangles) = sheet(8, 8);
    let points = coloured::<3>(&points, 0.3, 2);
    let mut engine = engine(&points, &triangles, &[]);
    while engine.step() != Step::Finished {}
    let result = engine.mesh().compact();
    assert!(result.points.len() < points.len() / 2);
    for (point, &source) in result.points.iter().zip(&result.vertex_source) {
        assert_eq!(*point, points[source as usize]);
    }
}

#[test]
fn locked_vertices_stay_and_their_edges_are_counted() {
    let (points, triangles) = sheet(6, 6);
    let border: Vec<u32> =
        (0..49).filter(|v| [0, 6].contains(&(v % 7)) || [0, 6].contains(&(v / 7))).collect();
    let mut engine = engine(&points, &triangles, &border);
    while engine.step() != Step::Finished {}
    for &v in &border {
        let v = VertexId(v);
        assert!(engine.mesh().connectivity.vertices().any(|w| w == v));
        assert_eq!(engine.mesh().point(v), &points[v.index()]);
    }
    // Only the border of the sheet is left: each of its 24 edges is locked.
    let is_locked = |edge: &EdgeId| engine.refusal(*edge) == Some(Refusal::PriorityRefused(Locked));
    assert!(engine.mesh().connectivity.edges().filter(is_locked).count() >= 24);
}

#[test]
fn commit_sees_which_triangles_vanished_and_moved() {
    let (points, triangles) = sheet(6, 6);
    let points = coloured::<3>(&points, 0.3, 3);
    let mut engine = engine(&points, &triangles, &[]);
    while engine.step() != Step::Finished {}
    let connectivity = &engine.mesh().connectivity;
    let mut covered: Vec<u32> = connectivity
        .triangles()
        .flat_map(|t| engine.measure().associated[t.index()].iter().map(|t| t.0))
        .collect();
    covered.sort_unstable();
    covered.dedup();
    assert_eq!(covered, (0..triangles.len() as u32).collect::<Vec<_>>());
}

/// Iterate over the z components of the normals (of length twice the area) of a flat mesh.
fn turned_up(mesh: &Mesh<3>) -> impl Iterator<Item = f64> + '_ {
    mesh.connectivity.triangles().map(|t| {
        let [a, b, c] = mesh.connectivity.corners(t).map(|v| mesh.point(v));
        cross(&sub(b, a), &sub(c, a))[2]
    })
}

/// Collapse a flat sheet completely; no triangle may turn over in any step.
fn require_upper_sides(points: &[[f64; 3]], triangles: &[[u32; 3]]) {
    let mut engine = engine(points, triangles, &[]);
    assert!(turned_up(engine.mesh()).all(|up| up > 0.0));
    loop {
        match engine.step() {
            Step::Finished => break,
            Step::Refused(..) => {}
            Step::Collapsed(_) => assert!(turned_up(engine.mesh()).all(|up| up > 0.0)),
        }
    }
    assert!(engine.merges().len() > triangles.len() / 4);
}

#[test]
fn no_triangle_turns_over() {
    let (mut points, triangles) = sheet(14, 14);
    let mut noise = Noise(21);
    for p in &mut points {
        *p = [p[0] + 0.4 * (noise.next() - 0.5), p[1] + 0.4 * (noise.next() - 0.5), 0.0];
    }
    require_upper_sides(&points, &triangles);
}

/// The corners of this sheet are on lines: without a check, collapses would make three of them collinear.
#[test]
fn no_triangle_becomes_a_line() {
    let (points, triangles) = sheet(14, 14);
    require_upper_sides(&points, &triangles);
}

#[test]
fn priorities_of_merges_never_fall() {
    let (points, triangles) = sheet(14, 14);
    let points = coloured::<3>(&points, 0.4, 5);
    let mut engine = engine(&points, &triangles, &[]);
    while engine.step() != Step::Finished {}
    assert!(engine.merges().len() > 100);
    assert!(engine.merges().windows(2).all(|pair| pair[0].priority <= pair[1].priority));
}
