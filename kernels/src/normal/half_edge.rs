//! The measure of the base: half-edge collapse by quadrics, dearer where it makes a patch that refines badly.
//!
//! A collapse takes one end of its edge into the other, so that base vertices are vertices of the input (Li, Li, Xu and
//! Li 2002, section 2). Its cost is the quadric error there (Garland and Heckbert 1997), or what a trial refinement of
//! the new triangles leaves, whichever is more; times factors for needles, for vertices of many triangles and for
//! triangles that turn away from the surface.

use super::associated::{Chains, TriangleSets};
use super::parameters::Parameters;
use super::surface::Surface;
use super::unfold::soundness;
use crate::engine::{Collapsed, Measure, Proposal};
use crate::geometry::{Vec3, add_scaled, area, cross, distance2, dot, midpoint, norm2, sub, unit};
use crate::ids::{EdgeId, HalfedgeId, VertexId};
use crate::legality::keeps_triangles;
use crate::mesh::Mesh;
use crate::quadric::Quadric;
use crate::star::Star;

/// Weight of the squared length of an edge beside the squared distances: among collapses that do little harm, short
/// edges go first, and the triangles stay even.
const EVENNESS: f64 = 1e-6;
/// Weight of the walls on boundary edges, against the area of the square over the edge.
const BOUNDARY: f64 = 1.0;
/// A triangle turns away where the cosine between it and the surface at a corner is below this.
const LEAST_COSINE: f64 = 0.2;
/// How much dearer that makes a collapse, and how much one triangle that cannot be refined does.
const TURNED: f64 = 4.0;
const UNFIT: f64 = 4.0;
/// Growth of the cost with the square of the neighbours beyond six.
const CROWD: f64 = 0.1;
/// Reach of the trial's lines in lengths of their edge, and the least soundness of the triangles it makes.
const REACH: f64 = 0.6;
const LEAST_SOUNDNESS: f64 = 0.3;
/// Where a surface is smooth, one refinement leaves about this part of the squared error: what is left counts so much more.
const LEFT: f64 = 16.0;

/// What shapes are usable at all: least quality of a triangle (1 for equal sides, 0 for none) and most neighbours of
/// a vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    pub quality: f64,
    pub neighbours: usize,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Refused {
    /// No usable shape, or too dear for now.
    Shape,
    /// Beyond the error.
    Error,
}

pub struct HalfEdge<'a> {
    surface: &'a Surface,
    quadrics: Vec<Quadric<0>>,
    /// Squared error that no vertex may pass.
    error2: f64,
    pub triangles: TriangleSets,
    pub chains: Chains,
    pub parameters: Parameters,
    pub rule: Rule,
    /// Whether triangles are tried out.
    pub careful: bool,
    /// Whether triangles that turn away or cannot be refined are refused, not only dear.
    pub strict: bool,
    /// The dearest collapse allowed for now.
    pub limit: f64,
}

impl<'a> HalfEdge<'a> {
    pub fn new(mesh: &Mesh<3>, surface: &'a Surface, importance: &[f64], error: f64, rule: Rule) -> Self {
        let corners: Vec<[u32; 3]> =
            mesh.connectivity.triangles().map(|t| mesh.connectivity.corners(t).map(|v| v.0)).collect();
        Self {
            surface,
            quadrics: quadrics(mesh, importance),
            error2: error * error,
            triangles: TriangleSets::new(corners.len()),
            chains: Chains::new(&mesh.connectivity),
            parameters: Parameters::new(mesh.points.len(), &corners),
            rule,
            careful: false,
            strict: false,
            limit: f64::INFINITY,
        }
    }

    fn together(&self, ends: [VertexId; 2]) -> Quadric<0> {
        self.quadrics[ends[0].index()].sum(&self.quadrics[ends[1].index()])
    }

    /// Error at an end for what both ends stand for; infinite for one that must not survive.
    fn cost(&self, mesh: &Mesh<3>, edge: EdgeId, ends: [VertexId; 2], survivor: usize) -> f64 {
        if mesh.staying_ends(edge)[1 - survivor] {
            return f64::INFINITY;
        }
        let together = self.together(ends);
        let [a, b] = ends.map(|v| mesh.point(v));
        together.error(mesh.point(ends[survivor])) + EVENNESS * together.area * distance2(a, b)
    }

    /// The cost with all that its triangles add; none if they are not usable.
    fn full_cost(&self, mesh: &Mesh<3>, star: &Star<3>, survivor: usize, cost: f64) -> Option<f64> {
        let normals = self.surface.normals();
        let point = &star.end_points[survivor];
        // A corner across from the edge is a neighbour of both ends.
        let neighbours = star.spokes.len() - star.vanishing.len();
        if neighbours > self.rule.neighbours {
            let most = star.ends.map(|v| mesh.connectivity.spokes(v).count()).into_iter().max();
            if most.is_none_or(|most| neighbours > most) {
                return None;
            }
        }
        let (mut worst, mut factor, mut left) = (1.0f64, 1.0, 0.0);
        for wing in star.wings.iter().filter(|wing| wing.end != survivor) {
            let (from, to) = (&wing.from_point, &wing.to_point);
            let new = quality(point, from, to);
            if new < self.rule.quality && new < quality(&star.end_points[wing.end], from, to) {
                return None;
            }
            worst = worst.min(new);
            let at = [star.ends[survivor], wing.from, wing.to].map(|v| &normals[v.index()]);
            let normal = cross(&sub(from, point), &sub(to, point));
            let bound = LEAST_COSINE * norm2(&normal).sqrt();
            if at.iter().any(|n| dot(n, &normal) < bound) {
                if self.strict {
                    return None;
                }
                factor *= TURNED;
            }
            if self.careful || self.strict {
                match self.left_by_refinement([point, from, to], at) {
                    Some(error) => left += error,
                    None if self.strict => return None,
                    None => factor *= UNFIT,
                }
            }
        }
        let crowd = neighbours.saturating_sub(6) as f64;
        Some((1.0 + CROWD * crowd * crowd) * factor / (worst * worst * worst) * cost.max(LEFT * left))
    }

    /// What is left of the squared error of a triangle once it is refined; none if it cannot be: if the lines through the
    /// middles of its sides do not pierce the surface near by, or the four triangles that makes do not look along it.
    fn left_by_refinement(&self, corners: [&Vec3; 3], at: [&Vec3; 3]) -> Option<f64> {
        let (mut points, mut normals) = ([[0.0; 3]; 6], [[0.0; 3]; 6]);
        for i in 0..3 {
            let j = (i + 1) % 3;
            (points[i], normals[i]) = (*corners[i], *at[i]);
            let normal = unit(&add_scaled(at[i], 1.0, at[j]));
            let reach = REACH * distance2(corners[i], corners[j]).sqrt();
            let middle = midpoint(corners[i], corners[j]);
            let (_, place) = self.surface.pierced(&middle, &normal, reach, LEAST_COSINE, |_, _| true)?;
            points[3 + i] = place.point;
            normals[3 + i] = unit(&self.surface.normal_at(&place));
        }
        let mut left = 0.0;
        for child in [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]] {
            let [a, b, c] = child.map(|i| &points[i]);
            if soundness([a, b, c], child.map(|i| &normals[i])) < LEAST_SOUNDNESS {
                return None;
            }
            let middle: Vec3 = std::array::from_fn(|i| (a[i] + b[i] + c[i]) / 3.0);
            left += area([a, b, c]) * self.surface.distance2(&middle);
        }
        Some(left)
    }
}

impl Measure<3> for HalfEdge<'_> {
    type Bound = Refused;
    type Change = ();

    fn priority(&self, mesh: &Mesh<3>, edge: EdgeId) -> Result<f64, Refused> {
        let ends = mesh.connectivity.ends(edge);
        let least = self.cost(mesh, edge, ends, 0).min(self.cost(mesh, edge, ends, 1));
        if least.is_finite() { Ok(least) } else { Err(Refused::Shape) }
    }

    fn propose(&mut self, mesh: &Mesh<3>, star: &Star<3>) -> Result<Proposal<3, ()>, Refused> {
        let costs = [0, 1].map(|end| self.cost(mesh, star.edge, star.ends, end));
        let together = self.together(star.ends);
        let better = usize::from(costs[1] < costs[0]);
        let mut refused = Refused::Shape;
        for survivor in [better, 1 - better] {
            let point = star.end_points[survivor];
            if together.error(&point) > self.error2 * together.area {
                refused = Refused::Error;
                continue;
            }
            // The limit may be infinite; an end that stays never goes.
            if costs[survivor] > self.limit.min(f64::MAX) || keeps_triangles(star, &point).is_err() {
                continue;
            }
            let full = self.full_cost(mesh, star, survivor, costs[survivor]);
            if full.is_some_and(|full| full <= self.limit) {
                return Ok(Proposal { survivor, point, change: () });
            }
        }
        Err(refused)
    }

    fn judge(&mut self, _: &Mesh<3>, _: &Star<3>, _: &mut Proposal<3, ()>) -> Result<(), Refused> {
        Ok(())
    }

    fn commit(&mut self, mesh: &Mesh<3>, star: &Star<3>, collapsed: &Collapsed, (): ()) {
        let removed = usize::from(star.ends[1] == collapsed.removed);
        let moved = || star.wings.iter().filter(|w| w.end == removed).map(|w| w.triangle.index());
        let around = moved().chain(star.vanishing.iter().map(|(t, _, _)| t.index()));
        self.triangles.unite(around, moved());
        self.parameters.collapse(star, removed);
        let gone = self.quadrics[collapsed.removed.index()];
        self.quadrics[collapsed.survivor.index()].add(&gone);

        for (kept, gone) in collapsed.merged.into_iter().flatten() {
            self.chains.merge_sides(kept, gone);
        }
        if star.boundary_neighbours.is_some() {
            let connectivity = &mesh.connectivity;
            if removed == 0 {
                let arriving = connectivity.spokes(collapsed.survivor).last().map(|(edge, _)| edge);
                self.chains.append(star.edge, arriving, None);
            } else {
                let leaving = connectivity.outgoing[collapsed.survivor.index()];
                self.chains.append(star.edge, None, Some(connectivity.edge(leaving)));
            }
        }
    }
}

/// 4√3 · area over the sum of the squared sides: 1 for equal sides, 0 for a needle.
fn quality(a: &Vec3, b: &Vec3, c: &Vec3) -> f64 {
    let sides2 = distance2(a, b) + distance2(b, c) + distance2(c, a);
    if sides2 > 0.0 { 4.0 * 3f64.sqrt() * area([a, b, c]) / sides2 } else { 0.0 }
}

/// Quadrics of the triangles around each vertex, and of walls on the boundary.
fn quadrics(mesh: &Mesh<3>, importance: &[f64]) -> Vec<Quadric<0>> {
    let mut quadrics = vec![Quadric::default(); mesh.points.len()];
    for t in mesh.connectivity.triangles() {
        let corners = mesh.connectivity.corners(t);
        let importance = importance[mesh.triangle_source[t.index()] as usize];
        let mut quadric = Quadric::of_triangle(corners.map(|v| mesh.point(v)), 0.0);
        quadric.scale(importance);
        corners.iter().for_each(|v| quadrics[v.index()].add(&quadric));
        for i in 0..3 {
            if mesh.connectivity.twin(HalfedgeId::from_index(3 * t.index() + i)).is_some() {
                continue;
            }
            let [a, b, c] = [0, 1, 2].map(|k| corners[(i + k) % 3]);
            for v in [a, b] {
                let points = [a, b, c].map(|v| mesh.point(v));
                quadrics[v.index()].add_wall(BOUNDARY * importance, points);
            }
        }
    }
    quadrics
}
