//! Base mesh as a parametrisation domain; points can be expressed in the coordinates of any nearby triangle.
//!
//! Across an edge, coordinates are extended affinely. For a triangle a, b, c with the neighbour's far corner
//! d across edge a–b, d is mapped to a + b − c.

use super::base_mesh::Base;
use super::base_parametrization::{BasePoint, compute_barycentric};
use super::surface::{Surface, SurfacePoint};
use crate::subdivision::topology::{NONE, Topology};

/// Maximum number of edges to cross when looking for the triangle of a point.
const MAX_CROSSED_EDGES: usize = 3;
/// Maximum number of triangle-to-triangle steps towards the triangle that contains a point.
const MAX_LOCATE_STEPS: usize = 8;

/// Base mesh as a parametrisation domain, with the input triangles on each base triangle.
pub struct Domain<'a> {
    corners: Vec<[u32; 3]>,
    /// Neighbour across each side, and the index of the shared side in that neighbour.
    neighbours: Vec<[(u32, usize); 3]>,
    /// Position of each input vertex on the base.
    base_points: &'a [BasePoint],
    surface: &'a Surface,
    /// Candidate input triangles (slots) of each base triangle, in compressed form.
    starts: Vec<u32>,
    slots: Vec<u32>,
}

impl<'a> Domain<'a> {
    /// Build the domain from a base, the topology of its level 0, and the input surface.
    pub fn new(base: &'a Base, topology: &Topology, surface: &'a Surface) -> Self {
        let mut beyond = vec![[(NONE, 0); 3]; topology.triangles.len()];
        for (t, edges) in topology.triangle_edges.iter().enumerate() {
            for (side, &edge) in edges.iter().enumerate() {
                let [first, second] = topology.edge_triangles[edge as usize];
                let other = if first as usize == t { second } else { first };
                if other != NONE {
                    let back = topology.triangle_edges[other as usize].iter().position(|&e| e == edge);
                    beyond[t][side] = (other, back.unwrap_or(0));
                }
            }
        }
        let mut domain = Self {
            corners: topology.triangles.clone(),
            neighbours: beyond,
            base_points: &base.base_points,
            surface,
            starts: vec![],
            slots: vec![],
        };
        domain.assign_triangles();
        domain
    }

    /// Assign input triangles to the base triangles that may contain parts of them. These are the base
    /// triangles of its corners. If the corners are in different base triangles, the neighbours are included.
    fn assign_triangles(&mut self) {
        let mut pairs: Vec<(u32, u32)> = vec![];
        for slot in 0..self.surface.len() as u32 {
            let at = self.surface.vertices(slot).map(|v| self.base_points[v as usize].triangle);
            if at.contains(&NONE) {
                continue;
            }
            let first = pairs.len();
            pairs.extend(at.map(|t| (t, slot)));
            if at[1] != at[0] || at[2] != at[0] {
                for t in at {
                    pairs.extend(
                        self.neighbours[t as usize]
                            .iter()
                            .filter(|(g, _)| *g != NONE)
                            .map(|(g, _)| (*g, slot)),
                    );
                }
            }
            pairs[first..].sort_unstable();
            let mut kept = first;
            for i in first..pairs.len() {
                if i == first || pairs[i] != pairs[kept - 1] {
                    pairs[kept] = pairs[i];
                    kept += 1;
                }
            }
            pairs.truncate(kept);
        }
        // Counting sort keeps the slots of each base triangle in order.
        self.starts = vec![0; self.corners.len() + 1];
        pairs.iter().for_each(|(t, _)| self.starts[*t as usize + 1] += 1);
        for t in 0..self.corners.len() {
            self.starts[t + 1] += self.starts[t];
        }
        let mut at = self.starts.clone();
        self.slots = vec![0; pairs.len()];
        for (t, slot) in pairs {
            self.slots[at[t as usize] as usize] = slot;
            at[t as usize] += 1;
        }
    }

    /// Express a point in the barycentric coordinates of a nearby base triangle. None if the triangle is too
    /// far away.
    pub fn coordinates_in(&self, point: &BasePoint, triangle: u32) -> Option<[f64; 3]> {
        if point.triangle == triangle {
            return Some(point.barycentric);
        }
        if point.triangle == NONE {
            return None;
        }
        // Shortcut for a corner shared by both triangles: its coordinates are exact.
        if let Some(corner) = point.barycentric.iter().position(|&x| x == 1.0) {
            let v = self.corners[point.triangle as usize][corner];
            if let Some(i) = self.corners[triangle as usize].iter().position(|&w| w == v) {
                let mut barycentric = [0.0; 3];
                barycentric[i] = 1.0;
                return Some(barycentric);
            }
        }
        (1..=MAX_CROSSED_EDGES).find_map(|depth| self.search_across_edges(point, triangle, 3, depth))
    }

    fn search_across_edges(
        &self,
        point: &BasePoint,
        triangle: u32,
        came: usize,
        depth: usize,
    ) -> Option<[f64; 3]> {
        for side in (0..3).filter(|&side| side != came) {
            let (other, back) = self.neighbours[triangle as usize][side];
            let found = if other == NONE {
                None
            } else if other == point.triangle {
                Some(point.barycentric)
            } else if depth > 1 {
                self.search_across_edges(point, other, back, depth - 1)
            } else {
                None
            };
            if let Some(there) = found {
                return Some(convert_across_edge(&there, back, side));
            }
        }
        None
    }

    /// Convert a point with coordinates outside its triangle to the triangle that contains it, as far as the
    /// base extends.
    pub fn to_containing_triangle(&self, triangle: u32, barycentric: [f64; 3]) -> BasePoint {
        let mut at = BasePoint { triangle, barycentric };
        for _ in 0..MAX_LOCATE_STEPS {
            let lowest = (0..3).fold(0, |l, i| if at.barycentric[i] < at.barycentric[l] { i } else { l });
            if at.barycentric[lowest] >= 0.0 {
                break;
            }
            let side = (lowest + 1) % 3;
            let (other, back) = self.neighbours[at.triangle as usize][side];
            if other == NONE {
                break;
            }
            at = BasePoint { triangle: other, barycentric: convert_across_edge(&at.barycentric, side, back) };
        }
        at
    }

    /// Map a surface point to the base, in the coordinates of a nearby base triangle.
    pub fn map_to_base(&self, slot: u32, barycentric: &[f64; 3], triangle: u32) -> Option<[f64; 3]> {
        let mut sum = [0.0; 3];
        for (v, weight) in self.surface.vertices(slot).into_iter().zip(barycentric) {
            let corner = self.coordinates_in(&self.base_points[v as usize], triangle)?;
            (0..3).for_each(|i| sum[i] += weight * corner[i]);
        }
        Some(sum)
    }

    /// Find the surface point that maps to a point of the base.
    pub fn find_surface_point(&self, point: &BasePoint) -> Option<SurfacePoint> {
        let t = point.triangle;
        if t == NONE {
            return None;
        }
        let at = [point.barycentric[1], point.barycentric[2]];
        let mut best: Option<(f64, u32, [f64; 3])> = None;
        let range = self.starts[t as usize] as usize..self.starts[t as usize + 1] as usize;
        for &slot in &self.slots[range] {
            let corners =
                self.surface.vertices(slot).map(|v| self.coordinates_in(&self.base_points[v as usize], t));
            let [Some(a), Some(b), Some(c)] = corners else { continue };
            let [a, b, c] = [a, b, c].map(|x| [x[1], x[2]]);
            let Some(barycentric) = compute_barycentric(&at, [&a, &b, &c]) else { continue };
            let least = barycentric.iter().fold(f64::INFINITY, |least, &x| least.min(x));
            if best.is_none_or(|(most, ..)| least > most) {
                best = Some((least, slot, barycentric));
            }
            if least >= 0.0 {
                break;
            }
        }
        let (_, slot, barycentric) = best?;
        let inside = barycentric.map(|x| x.max(0.0));
        let sum: f64 = inside.iter().sum();
        Some(self.surface.point_at(slot, inside.map(|x| x / sum)))
    }
}

/// Convert barycentric coordinates across an edge. The edge is side `back` of the triangle that `there`
/// refers to, and side `side` of the triangle of the result.
fn convert_across_edge(there: &[f64; 3], back: usize, side: usize) -> [f64; 3] {
    let far = there[(back + 2) % 3];
    let mut here = [0.0; 3];
    here[side] = there[(back + 1) % 3] + far;
    here[(side + 1) % 3] = there[back] + far;
    here[(side + 2) % 3] = -far;
    here
}
