//! Modified butterfly subdivision (Zorin, Schröder and Sweldens, "Interpolating subdivision for meshes with
//! arbitrary topology", 1996).

use super::topology::{NONE, Topology};
use crate::base::geometry::{Vec3, add_scaled, midpoint};

/// Compute the new vertex of every edge.
pub fn compute_edge_points(topology: &Topology, points: &[Vec3]) -> Vec<Vec3> {
    let rings = VertexRings::new(topology);
    let mut ring = [vec![], vec![]];
    (0..topology.edges.len())
        .map(|edge| {
            let [a, b] = topology.edges[edge];
            if topology.is_boundary_edge(edge) {
                return rings.apply_boundary_stencil(edge, points);
            }
            let closed =
                [rings.collect_ring(a, edge, &mut ring[0]), rings.collect_ring(b, edge, &mut ring[1])];
            let regular = [closed[0] && ring[0].len() == 6, closed[1] && ring[1].len() == 6];
            let at = |v: u32| points[v as usize];
            match (closed, regular) {
                // Eight-point stencil: 1/2 for the ends, 1/8 for the opposite corners, −1/16 for the four
                // outer ones.
                (_, [true, true]) => {
                    let mut sum = midpoint(&at(a), &at(b));
                    for ring in &ring {
                        // Both rings contain the opposite corners, so each contributes half of 1/8.
                        for (place, weight) in [(1, 0.0625), (5, 0.0625), (2, -0.0625), (4, -0.0625)] {
                            sum = add_scaled(&sum, weight, &at(ring[place]));
                        }
                    }
                    sum
                }
                ([true, true], [true, false]) => apply_vertex_stencil(&at(b), &ring[1], points),
                ([true, true], [false, true]) => apply_vertex_stencil(&at(a), &ring[0], points),
                ([true, true], _) => midpoint(
                    &apply_vertex_stencil(&at(a), &ring[0], points),
                    &apply_vertex_stencil(&at(b), &ring[1], points),
                ),
                ([true, false], _) => apply_vertex_stencil(&at(a), &ring[0], points),
                ([false, true], _) => apply_vertex_stencil(&at(b), &ring[1], points),
                _ => midpoint(&at(a), &at(b)),
            }
        })
        .collect()
}

/// Apply the stencil of an extraordinary vertex: weight 3/4, and its neighbours, starting at the other end of
/// the edge.
fn apply_vertex_stencil(end: &Vec3, ring: &[u32], points: &[Vec3]) -> Vec3 {
    let mut sum = end.map(|x| 0.75 * x);
    let mut add = |weight: f64, v: u32| sum = add_scaled(&sum, weight, &points[v as usize]);
    match ring.len() {
        3 => {
            add(5.0 / 12.0, ring[0]);
            add(-1.0 / 12.0, ring[1]);
            add(-1.0 / 12.0, ring[2]);
        }
        4 => {
            add(0.375, ring[0]);
            add(-0.125, ring[2]);
        }
        count => {
            let k = count as f64;
            let first = cosine_of_fraction(count);
            // cos(jα) by recurrence.
            let (mut last, mut now) = (first, 1.0);
            for &v in ring {
                add((0.25 + now + 0.5 * (2.0 * now * now - 1.0)) / k, v);
                (last, now) = (now, 2.0 * first * now - last);
            }
        }
    }
    sum
}

/// Compute cos(2π / k) for k ≥ 4 from its series. The bits are the same on all platforms, unlike the maths
/// library's.
fn cosine_of_fraction(k: usize) -> f64 {
    let x = 2.0 * std::f64::consts::PI / k as f64;
    let (mut term, mut sum) = (1.0, 1.0);
    for i in 1..=12 {
        let i = f64::from(i);
        term *= -x * x / ((2.0 * i - 1.0) * (2.0 * i));
        sum += term;
    }
    sum
}

/// Ordered neighbours of vertices.
struct VertexRings<'a> {
    topology: &'a Topology,
    /// Outgoing and incoming boundary edge of each boundary vertex.
    leaving: Vec<u32>,
    arriving: Vec<u32>,
}

impl<'a> VertexRings<'a> {
    fn new(topology: &'a Topology) -> Self {
        let (mut leaving, mut arriving) = (vec![NONE; topology.vertices], vec![NONE; topology.vertices]);
        for edge in (0..topology.edges.len()).filter(|&e| topology.is_boundary_edge(e)) {
            let [from, to] = topology.edges[edge];
            leaving[from as usize] = edge as u32;
            arriving[to as usize] = edge as u32;
        }
        Self { topology, leaving, arriving }
    }

    /// Collect the neighbours of one end of an interior edge, starting at the other end. Returns false at a
    /// boundary vertex.
    fn collect_ring(&self, end: u32, edge: usize, ring: &mut Vec<u32>) -> bool {
        ring.clear();
        let topology = self.topology;
        if self.leaving[end as usize] != NONE {
            return false;
        }
        let mut edge = edge as u32;
        let start = edge;
        // Triangle in which the edge starts at `end`.
        let mut t =
            topology.edge_triangles[edge as usize][usize::from(topology.edges[edge as usize][0] != end)];
        loop {
            let [a, b] = topology.edges[edge as usize];
            ring.push(if a == end { b } else { a });
            // In triangle t the edge leaves `end`; the triangle's edge back to `end` is next.
            let corners = &topology.triangles[t as usize];
            let Some(corner) = corners.iter().position(|&v| v == end) else { return false };
            edge = topology.triangle_edges[t as usize][(corner + 2) % 3];
            if edge == start {
                return true;
            }
            let [first, second] = topology.edge_triangles[edge as usize];
            t = if first == t { second } else { first };
        }
    }

    /// Apply the four-point stencil along the boundary.
    fn apply_boundary_stencil(&self, edge: usize, points: &[Vec3]) -> Vec3 {
        let at = |v: u32| points[v as usize];
        let [a, b] = self.topology.edges[edge];
        let before = self.topology.edges[self.arriving[a as usize] as usize][0];
        let after = self.topology.edges[self.leaving[b as usize] as usize][1];
        let middle = midpoint(&at(a), &at(b));
        add_scaled(&middle.map(|x| 1.125 * x), -0.125, &midpoint(&at(before), &at(after)))
    }
}
