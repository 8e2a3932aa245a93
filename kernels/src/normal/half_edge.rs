//! Cost measure for base simplification: half-edge collapses by quadric error, penalised by trial
//! refinements.
//!
//! A collapse moves one end of the edge onto the other (Li, Li, Xu and Li 2002, section 2). Base vertices are
//! therefore input vertices. The first cost is the quadric error at the survivor (Garland and Heckbert 1997).
//! The second is the error left after a trial refinement of the new triangles. The larger one counts. Factors
//! penalise needles, high valence and triangles that turn away from the surface.

use super::associated::{Chains, TriangleSets};
use super::parameters::Parameters;
use super::surface::Surface;
use super::unfold::{against_surface, soundness};
use crate::base::geometry::{Vec3, add_scaled, area, cross, distance2, dot, midpoint, norm2, sub, unit};
use crate::base::ids::{EdgeId, HalfedgeId, VertexId};
use crate::collapse::engine::{Collapsed, Measure, Proposal};
use crate::mesh::legality::keeps_triangles;
use crate::mesh::star::Star;
use crate::mesh::triangle_mesh::Mesh;
use crate::quadrics::quadric::Quadric;

/// Weight of the squared edge length, relative to the squared quadric distance. Among nearly free collapses,
/// short edges go first, which keeps triangle sizes even.
const EVENNESS: f64 = 1e-6;
/// Weight of the constraint planes on boundary edges, relative to the square of the edge length.
const BOUNDARY: f64 = 1.0;
/// A triangle turns away from the surface if its cosine with a corner normal is below this.
const LEAST_COSINE: f64 = 0.2;
/// With at least this cosine at all corners, the triangle cannot be flipped and the exact test is skipped.
const SURE: f64 = 0.7;
/// Minimum agreement with the surface if `upright` is set. A nearly flipped triangle may flip on the next
/// level.
const LEAST_UPRIGHT: f64 = 0.1;
/// Cost factors: for each triangle that turns away, and for each triangle that cannot be refined.
const TURNED: f64 = 4.0;
const UNFIT: f64 = 4.0;
/// Increase of the cost with the squared number of neighbours above six, the regular valence.
const CROWD: f64 = 0.1;
/// Search distance of trial refinements in edge lengths, and the minimum agreement of their triangles with
/// the surface.
const REACH: f64 = 0.6;
const LEAST_SOUNDNESS: f64 = 0.3;
/// Factor that makes trial errors comparable to quadric errors. On a smooth surface one refinement leaves
/// about 1/16 of the squared error.
const LEFT: f64 = 16.0;
/// Slots of the trial cache, a power of two. A collapse leaves most triangles of later trials unchanged.
const REMEMBERED: usize = 1 << 16;

/// Limits for usable shapes: minimum triangle quality (1 equilateral, 0 degenerate) and maximum vertex
/// valence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    pub quality: f64,
    pub neighbours: usize,
}

/// Reason to refuse a collapse.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Refused {
    /// The shape is unusable, or the cost exceeds the limit.
    Shape,
    /// The squared error exceeds its limit.
    Error,
}

/// Cache entry of a trial: the triangle, starting at its smallest vertex, and the squared error left by the
/// trial.
#[derive(Clone, Copy, Debug)]
struct Tried {
    corners: [u32; 3],
    left: Option<f64>,
}

/// Cost measure of half-edge collapses, with the correspondence between mesh and input.
#[derive(Clone, Debug)]
pub struct HalfEdge<'a> {
    surface: &'a Surface,
    quadrics: Vec<Quadric<0>>,
    /// Weight of the error at each vertex.
    importance: Vec<f64>,
    /// Trial cache, addressed by a hash of the corners.
    tried: Vec<Tried>,
    /// Maximum squared error of a vertex.
    error2: f64,
    pub triangles: TriangleSets,
    pub chains: Chains,
    pub parameters: Parameters,
    pub rule: Rule,
    /// Run trial refinements.
    pub careful: bool,
    /// Refuse triangles that turn away or cannot be refined, instead of penalising them.
    pub strict: bool,
    /// Refuse flipped or nearly flipped triangles, even if they were flipped before the collapse.
    pub upright: bool,
    /// Maximum cost of a collapse.
    pub limit: f64,
}

impl<'a> HalfEdge<'a> {
    /// Create the measure for a mesh that equals the input. `error` is the maximum RMS distance of a vertex.
    pub fn new(mesh: &Mesh<3>, surface: &'a Surface, error: f64, rule: Rule) -> Self {
        let corners: Vec<[u32; 3]> =
            mesh.connectivity.triangles().map(|t| mesh.connectivity.corners(t).map(|v| v.0)).collect();
        Self {
            surface,
            quadrics: quadrics(mesh),
            importance: vec![1.0; mesh.points.len()],
            tried: vec![Tried { corners: [u32::MAX; 3], left: None }; REMEMBERED],
            error2: error * error,
            triangles: TriangleSets::new(corners.len()),
            chains: Chains::new(&mesh.connectivity),
            parameters: Parameters::new(mesh.points.len(), &corners),
            rule,
            careful: false,
            strict: false,
            upright: false,
            limit: f64::INFINITY,
        }
    }

    /// Scale the error of each vertex by its importance.
    pub fn weigh(&mut self, importance: &[f64]) {
        self.quadrics.iter_mut().zip(importance).for_each(|(quadric, factor)| quadric.scale(*factor));
        self.importance.copy_from_slice(importance);
    }

    /// Look up the unit normals of the input at three vertices.
    pub fn normals(&self, vertices: [VertexId; 3]) -> [&Vec3; 3] {
        vertices.map(|v| &self.surface.normals()[v.index()])
    }

    /// Check whether an edge may collapse into one of its ends for at most `limit`, before triangle
    /// penalties.
    pub fn allows(&self, mesh: &Mesh<3>, star: &Star<3>, survivor: usize, limit: f64) -> bool {
        let together = self.together(star.ends);
        together.error(&star.end_points[survivor]) <= self.error2 * together.area
            && self.cost(mesh, star.edge, star.ends, survivor) <= limit
    }

    /// Check whether an edge may collapse into one of its ends as far as its triangles are concerned, at any
    /// cost.
    pub fn fits(&mut self, mesh: &Mesh<3>, star: &Star<3>, survivor: usize) -> bool {
        keeps_triangles(star, &star.end_points[survivor]).is_ok()
            && self.full_cost(mesh, star, survivor, 0.0, f64::INFINITY).is_some()
    }

    fn together(&self, ends: [VertexId; 2]) -> Quadric<0> {
        self.quadrics[ends[0].index()].sum(&self.quadrics[ends[1].index()])
    }

    /// Compute the error of the merged quadrics at one end. Infinite if the other end must stay.
    fn cost(&self, mesh: &Mesh<3>, edge: EdgeId, ends: [VertexId; 2], survivor: usize) -> f64 {
        if mesh.staying_ends(edge)[1 - survivor] {
            return f64::INFINITY;
        }
        let together = self.together(ends);
        let [a, b] = ends.map(|v| mesh.point(v));
        together.error(mesh.point(ends[survivor])) + EVENNESS * together.area * distance2(a, b)
    }

    /// Compute the cost including triangle penalties. None if a triangle is unusable or the cost exceeds
    /// `limit`.
    fn full_cost(
        &mut self,
        mesh: &Mesh<3>,
        star: &Star<3>,
        survivor: usize,
        cost: f64,
        limit: f64,
    ) -> Option<f64> {
        let normals = self.surface.normals();
        let (end, point) = (star.ends[survivor], &star.end_points[survivor]);
        // A corner opposite the edge neighbours both ends and must not count twice.
        let neighbours = star.spokes.len() - star.vanishing.len();
        if neighbours > self.rule.neighbours {
            let most = star.ends.map(|v| mesh.connectivity.spokes(v).count()).into_iter().max();
            if most.is_none_or(|most| neighbours > most) {
                return None;
            }
        }
        let moved = || star.wings.iter().filter(|wing| wing.end != survivor);
        let (mut worst, mut factor) = (1.0f64, 1.0);
        for wing in moved() {
            let (from, to) = (&wing.from_point, &wing.to_point);
            let new = quality(point, from, to);
            if new < self.rule.quality && new < quality(&star.end_points[wing.end], from, to) {
                return None;
            }
            worst = worst.min(new);
            let normal = cross(&sub(from, point), &sub(to, point));
            let bound = LEAST_COSINE * norm2(&normal).sqrt();
            let corners = [end, wing.from, wing.to].map(|v| &normals[v.index()]);
            let least = corners.iter().map(|n| dot(n, &normal)).fold(f64::INFINITY, f64::min);
            if least < SURE / LEAST_COSINE * bound
                && self.turns_over([point, from, to], corners)
                && (self.upright || !self.turns_over([&star.end_points[wing.end], from, to], corners))
            {
                return None;
            }
            if least < bound {
                if self.strict {
                    return None;
                }
                factor *= TURNED;
            }
        }
        let crowd = neighbours.saturating_sub(6) as f64;
        factor *= (1.0 + CROWD * crowd * crowd) / (worst * worst * worst);
        let (mut left, careful) = (0.0, self.careful);
        for wing in moved().filter(|_| careful) {
            // Trials take most of the time, so stop before them where possible.
            if factor * cost.max(LEFT * left) > limit {
                return None;
            }
            match self.tried([end, wing.from, wing.to], [point, &wing.from_point, &wing.to_point]) {
                Some(error) => left += error,
                None if self.strict => return None,
                None => factor *= UNFIT,
            }
        }
        Some(factor * cost.max(LEFT * left)).filter(|full| *full <= limit)
    }

    /// Check whether a triangle is flipped against the surface at its corners or next to its centroid.
    fn turns_over(&self, points: [&Vec3; 3], normals: [&Vec3; 3]) -> bool {
        let least = if self.upright { LEAST_UPRIGHT } else { 0.0 };
        against_surface(self.surface, points, normals, [], None, least) <= least
    }

    /// Return the cached result of [`left_by_refinement`], weighted by importance.
    fn tried(&mut self, vertices: [VertexId; 3], points: [&Vec3; 3]) -> Option<f64> {
        let first = if vertices[0] < vertices[1].min(vertices[2]) {
            0
        } else if vertices[1] < vertices[2] {
            1
        } else {
            2
        };
        let turned = [0, 1, 2].map(|i| (first + i) % 3);
        let corners = turned.map(|i| vertices[i].0);
        let hash = corners.iter().fold(0u32, |hash, v| (hash ^ v).wrapping_mul(0x9E37_79B1).rotate_left(15));
        let place = hash as usize % REMEMBERED;
        if self.tried[place].corners != corners {
            let normals = self.surface.normals();
            let normals = corners.map(|v| &normals[v as usize]);
            let left = left_by_refinement(self.surface, turned.map(|i| points[i]), normals);
            self.tried[place] = Tried { corners, left };
        }
        let importance = corners.iter().map(|&v| self.importance[v as usize]).sum::<f64>() / 3.0;
        self.tried[place].left.map(|left| importance * left)
    }
}

impl Measure<3> for HalfEdge<'_> {
    type Bound = Refused;
    /// Cost of the collapse.
    type Change = f64;

    fn priority(&self, mesh: &Mesh<3>, edge: EdgeId) -> Result<f64, Refused> {
        let ends = mesh.connectivity.ends(edge);
        let least = self.cost(mesh, edge, ends, 0).min(self.cost(mesh, edge, ends, 1));
        if least.is_finite() { Ok(least) } else { Err(Refused::Shape) }
    }

    fn propose(&mut self, mesh: &Mesh<3>, star: &Star<3>) -> Result<Proposal<3, f64>, Refused> {
        let costs = [0, 1].map(|end| self.cost(mesh, star.edge, star.ends, end));
        let together = self.together(star.ends);
        let better = usize::from(costs[1] < costs[0]);
        let mut best: Result<Proposal<3, f64>, Refused> = Err(Refused::Shape);
        for survivor in [better, 1 - better] {
            let (cost, point) = (costs[survivor], star.end_points[survivor]);
            if together.error(&point) > self.error2 * together.area {
                best = best.or(Err(Refused::Error));
                continue;
            }
            // The cost is infinite if the removed end must stay.
            let limit = best.as_ref().map_or(self.limit, |best| best.change);
            if !cost.is_finite() || cost > limit || keeps_triangles(star, &point).is_err() {
                continue;
            }
            if let Some(full) = self.full_cost(mesh, star, survivor, cost, limit) {
                best = Ok(Proposal { survivor, point, change: full });
            }
        }
        best
    }

    fn cost(&self, proposal: &Proposal<3, f64>) -> f64 {
        proposal.change
    }

    fn judge(&mut self, _: &Mesh<3>, _: &Star<3>, _: &mut Proposal<3, f64>) -> Result<(), Refused> {
        Ok(())
    }

    fn commit(&mut self, mesh: &Mesh<3>, star: &Star<3>, collapsed: &Collapsed, _: f64) {
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

/// Compute the squared error that one refinement of a triangle leaves. None if a line through an edge
/// midpoint misses the nearby surface, or if one of the four children disagrees with it.
fn left_by_refinement(surface: &Surface, corners: [&Vec3; 3], at: [&Vec3; 3]) -> Option<f64> {
    let (mut points, mut normals, mut slots) = ([[0.0; 3]; 6], [[0.0; 3]; 6], [0; 3]);
    for i in 0..3 {
        let j = (i + 1) % 3;
        (points[i], normals[i]) = (*corners[i], *at[i]);
        let normal = unit(&add_scaled(at[i], 1.0, at[j]));
        let reach = REACH * distance2(corners[i], corners[j]).sqrt();
        let middle = midpoint(corners[i], corners[j]);
        let (_, place) = surface.pierced(&middle, &normal, reach, LEAST_COSINE, |_, _| true)?;
        slots[i] = place.slot;
        points[3 + i] = place.point;
        normals[3 + i] = unit(&surface.normal_at(&place));
    }
    let mut left = 0.0;
    for child in [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]] {
        let [a, b, c] = child.map(|i| &points[i]);
        if soundness([a, b, c], child.map(|i| &normals[i])) < LEAST_SOUNDNESS {
            return None;
        }
        let middle: Vec3 = std::array::from_fn(|i| (a[i] + b[i] + c[i]) / 3.0);
        left += area([a, b, c]) * surface.nearest_slot(&middle, slots).1;
    }
    Some(left)
}

/// Compute the shape quality, 4√3 · area / sum of squared sides: 1 for equilateral triangles, 0 for
/// degenerate ones.
pub fn quality(a: &Vec3, b: &Vec3, c: &Vec3) -> f64 {
    let sides2 = distance2(a, b) + distance2(b, c) + distance2(c, a);
    if sides2 > 0.0 { 4.0 * 3f64.sqrt() * area([a, b, c]) / sides2 } else { 0.0 }
}

/// Compute the quadric of each vertex: the planes of its triangles and constraint planes on the boundary.
fn quadrics(mesh: &Mesh<3>) -> Vec<Quadric<0>> {
    let mut quadrics = vec![Quadric::default(); mesh.points.len()];
    for t in mesh.connectivity.triangles() {
        let corners = mesh.connectivity.corners(t);
        let quadric = Quadric::of_triangle(corners.map(|v| mesh.point(v)), 0.0);
        corners.iter().for_each(|v| quadrics[v.index()].add(&quadric));
        for i in 0..3 {
            if mesh.connectivity.twin(HalfedgeId::from_index(3 * t.index() + i)).is_some() {
                continue;
            }
            let [a, b, c] = [0, 1, 2].map(|k| corners[(i + k) % 3]);
            for v in [a, b] {
                let points = [a, b, c].map(|v| mesh.point(v));
                quadrics[v.index()].add_wall(BOUNDARY, points);
            }
        }
    }
    quadrics
}
