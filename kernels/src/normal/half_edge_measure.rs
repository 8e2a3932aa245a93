//! Cost measure for base simplification: half-edge collapses by quadric error, penalised by trial
//! refinements.
//!
//! A collapse moves one end of the edge onto the other (Li, Li, Xu and Li 2002, section 2). Base vertices are
//! therefore input vertices. The first cost is the quadric error at the survivor (Garland and Heckbert 1997).
//! The second is the error left after a trial refinement of the new triangles. The larger one counts. Factors
//! penalise needles, high valence and triangles that turn away from the surface.

use super::associated_sets::{Chains, TriangleSets};
use super::base_parametrization::BaseParametrization;
use super::fold_repair::{compute_normal_cosine, compute_surface_cosine};
use super::surface::Surface;
use crate::base::geometry::{Vec3, add_scaled, area, cross, distance2, dot, midpoint, norm2, normalize, sub};
use crate::base::ids::{EdgeId, HalfedgeId, VertexId};
use crate::collapse::engine::{CollapseChange, Measure, Proposal};
use crate::mesh::collapse_legality::check_triangles;
use crate::mesh::edge_star::EdgeStar;
use crate::mesh::triangle_mesh::Mesh;
use crate::quadrics::quadric::Quadric;

/// Weight of the squared edge length, relative to the squared quadric distance. Among nearly free collapses,
/// short edges go first, which keeps triangle sizes even.
const EDGE_LENGTH_WEIGHT: f64 = 1e-6;
/// Weight of the constraint planes on boundary edges, relative to the square of the edge length.
const BOUNDARY_WEIGHT: f64 = 1.0;
/// A triangle turns away from the surface if its cosine with a corner normal is below this.
const MIN_COSINE: f64 = 0.2;
/// With at least this cosine at all corners, the triangle cannot be flipped and the exact test is skipped.
const SAFE_COSINE: f64 = 0.7;
/// Minimum agreement with the surface if `refuse_flipped` is set. A nearly flipped triangle may flip on the next
/// level.
const MIN_UPRIGHT_COSINE: f64 = 0.1;
/// Cost factors: for each triangle that turns away, and for each triangle that cannot be refined.
const TURNED_AWAY_FACTOR: f64 = 4.0;
const UNREFINABLE_FACTOR: f64 = 4.0;
/// Increase of the cost with the squared number of neighbours above six, the regular valence.
const VALENCE_PENALTY: f64 = 0.1;
/// Search distance of trial refinements in edge lengths, and the minimum agreement of their triangles with
/// the surface.
const TRIAL_REACH: f64 = 0.6;
const MIN_TRIAL_COSINE: f64 = 0.3;
/// Factor that makes trial errors comparable to quadric errors. On a smooth surface one refinement leaves
/// about 1/16 of the squared error.
const TRIAL_ERROR_FACTOR: f64 = 16.0;
/// Slots of the trial cache, a power of two. A collapse leaves most triangles of later trials unchanged.
const TRIAL_CACHE_SLOTS: usize = 1 << 16;

/// Limits for usable shapes: minimum triangle quality (1 equilateral, 0 degenerate) and maximum vertex
/// valence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapeRule {
    pub min_quality: f64,
    pub max_valence: usize,
}

/// Reason to refuse a collapse.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum CollapseRefusal {
    /// The shape is unusable, or the cost exceeds the limit.
    Shape,
    /// The squared error exceeds its limit.
    Error,
}

/// Cache entry of a trial: the triangle, starting at its smallest vertex, and the squared error left by the
/// trial.
#[derive(Clone, Copy, Debug)]
struct TrialEntry {
    corners: [u32; 3],
    remaining_error2: Option<f64>,
}

/// Cost measure of half-edge collapses, with the correspondence between mesh and input.
#[derive(Clone, Debug)]
pub struct HalfEdgeMeasure<'a> {
    surface: &'a Surface,
    quadrics: Vec<Quadric<0>>,
    /// Weight of the error at each vertex.
    importance: Vec<f64>,
    /// Trial cache, addressed by a hash of the corners.
    tried: Vec<TrialEntry>,
    /// Maximum squared error of a vertex.
    max_error2: f64,
    pub triangles: TriangleSets,
    pub chains: Chains,
    pub parametrization: BaseParametrization,
    pub rule: ShapeRule,
    /// Run trial refinements.
    pub run_trials: bool,
    /// Refuse triangles that turn away or cannot be refined, instead of penalising them.
    pub strict: bool,
    /// Refuse flipped or nearly flipped triangles, even if they were flipped before the collapse.
    pub refuse_flipped: bool,
    /// Maximum cost of a collapse.
    pub limit: f64,
}

impl<'a> HalfEdgeMeasure<'a> {
    /// Create the measure for a mesh that equals the input. `error` is the maximum RMS distance of a vertex.
    pub fn new(mesh: &Mesh<3>, surface: &'a Surface, error: f64, rule: ShapeRule) -> Self {
        let corners: Vec<[u32; 3]> =
            mesh.connectivity.triangles().map(|t| mesh.connectivity.corners(t).map(|v| v.0)).collect();
        Self {
            surface,
            quadrics: compute_quadrics(mesh),
            importance: vec![1.0; mesh.points.len()],
            tried: vec![TrialEntry { corners: [u32::MAX; 3], remaining_error2: None }; TRIAL_CACHE_SLOTS],
            max_error2: error * error,
            triangles: TriangleSets::new(corners.len()),
            chains: Chains::new(&mesh.connectivity),
            parametrization: BaseParametrization::new(mesh.points.len(), &corners),
            rule,
            run_trials: false,
            strict: false,
            refuse_flipped: false,
            limit: f64::INFINITY,
        }
    }

    /// Scale the error of each vertex by its importance.
    pub fn apply_importance(&mut self, importance: &[f64]) {
        self.quadrics.iter_mut().zip(importance).for_each(|(quadric, factor)| quadric.scale(*factor));
        self.importance.copy_from_slice(importance);
    }

    /// Look up the unit normals of the input at three vertices.
    pub fn normals(&self, vertices: [VertexId; 3]) -> [&Vec3; 3] {
        vertices.map(|v| &self.surface.normals()[v.index()])
    }

    /// Check whether an edge may collapse into one of its ends for at most `limit`, before triangle
    /// penalties.
    pub fn is_affordable(&self, mesh: &Mesh<3>, star: &EdgeStar<3>, survivor: usize, limit: f64) -> bool {
        let together = self.merge_quadrics(star.ends);
        together.error(&star.end_points[survivor]) <= self.max_error2 * together.area
            && self.cost(mesh, star.edge, star.ends, survivor) <= limit
    }

    /// Check whether an edge may collapse into one of its ends as far as its triangles are concerned, at any
    /// cost.
    pub fn is_feasible(&mut self, mesh: &Mesh<3>, star: &EdgeStar<3>, survivor: usize) -> bool {
        check_triangles(star, &star.end_points[survivor]).is_ok()
            && self.compute_full_cost(mesh, star, survivor, 0.0, f64::INFINITY).is_some()
    }

    fn merge_quadrics(&self, ends: [VertexId; 2]) -> Quadric<0> {
        self.quadrics[ends[0].index()].sum(&self.quadrics[ends[1].index()])
    }

    /// Compute the error of the merged quadrics at one end. Infinite if the other end must stay.
    fn cost(&self, mesh: &Mesh<3>, edge: EdgeId, ends: [VertexId; 2], survivor: usize) -> f64 {
        if mesh.fixed_ends(edge)[1 - survivor] {
            return f64::INFINITY;
        }
        let together = self.merge_quadrics(ends);
        let [a, b] = ends.map(|v| mesh.point(v));
        together.error(mesh.point(ends[survivor])) + EDGE_LENGTH_WEIGHT * together.area * distance2(a, b)
    }

    /// Compute the cost including triangle penalties. None if a triangle is unusable or the cost exceeds
    /// `limit`.
    fn compute_full_cost(
        &mut self,
        mesh: &Mesh<3>,
        star: &EdgeStar<3>,
        survivor: usize,
        cost: f64,
        limit: f64,
    ) -> Option<f64> {
        let normals = self.surface.normals();
        let (end, point) = (star.ends[survivor], &star.end_points[survivor]);
        // A corner opposite the edge neighbours both ends and must not count twice.
        let neighbours = star.spokes.len() - star.vanishing.len();
        if neighbours > self.rule.max_valence {
            let most = star.ends.map(|v| mesh.connectivity.vertex_edges(v).count()).into_iter().max();
            if most.is_none_or(|most| neighbours > most) {
                return None;
            }
        }
        let moved = || star.remaining.iter().filter(|wing| wing.end != survivor);
        let (mut worst, mut factor) = (1.0f64, 1.0);
        for wing in moved() {
            let (from, to) = (&wing.from_point, &wing.to_point);
            let new = compute_quality(point, from, to);
            if new < self.rule.min_quality && new < compute_quality(&star.end_points[wing.end], from, to) {
                return None;
            }
            worst = worst.min(new);
            let normal = cross(&sub(from, point), &sub(to, point));
            let bound = MIN_COSINE * norm2(&normal).sqrt();
            let corners = [end, wing.side_start, wing.side_end].map(|v| &normals[v.index()]);
            let least = corners.iter().map(|n| dot(n, &normal)).fold(f64::INFINITY, f64::min);
            if least < SAFE_COSINE / MIN_COSINE * bound
                && self.is_flipped([point, from, to], corners)
                && (self.refuse_flipped || !self.is_flipped([&star.end_points[wing.end], from, to], corners))
            {
                return None;
            }
            if least < bound {
                if self.strict {
                    return None;
                }
                factor *= TURNED_AWAY_FACTOR;
            }
        }
        let crowd = neighbours.saturating_sub(6) as f64;
        factor *= (1.0 + VALENCE_PENALTY * crowd * crowd) / (worst * worst * worst);
        let (mut left, careful) = (0.0, self.run_trials);
        for wing in moved().filter(|_| careful) {
            // Trials take most of the time, so stop before them where possible.
            if factor * cost.max(TRIAL_ERROR_FACTOR * left) > limit {
                return None;
            }
            match self.tried([end, wing.side_start, wing.side_end], [point, &wing.from_point, &wing.to_point])
            {
                Some(error) => left += error,
                None if self.strict => return None,
                None => factor *= UNREFINABLE_FACTOR,
            }
        }
        Some(factor * cost.max(TRIAL_ERROR_FACTOR * left)).filter(|full| *full <= limit)
    }

    /// Check whether a triangle is flipped against the surface at its corners or next to its centroid.
    fn is_flipped(&self, points: [&Vec3; 3], normals: [&Vec3; 3]) -> bool {
        let least = if self.refuse_flipped { MIN_UPRIGHT_COSINE } else { 0.0 };
        compute_surface_cosine(self.surface, points, normals, [], None, least) <= least
    }

    /// Return the cached result of [`compute_trial_error2`], weighted by importance.
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
        let place = hash as usize % TRIAL_CACHE_SLOTS;
        if self.tried[place].corners != corners {
            let normals = self.surface.normals();
            let normals = corners.map(|v| &normals[v as usize]);
            let left = compute_trial_error2(self.surface, turned.map(|i| points[i]), normals);
            self.tried[place] = TrialEntry { corners, remaining_error2: left };
        }
        let importance = corners.iter().map(|&v| self.importance[v as usize]).sum::<f64>() / 3.0;
        self.tried[place].remaining_error2.map(|left| importance * left)
    }
}

impl Measure<3> for HalfEdgeMeasure<'_> {
    type Reason = CollapseRefusal;
    /// Cost of the collapse.
    type Change = f64;

    fn priority(&self, mesh: &Mesh<3>, edge: EdgeId) -> Result<f64, CollapseRefusal> {
        let ends = mesh.connectivity.ends(edge);
        let least = self.cost(mesh, edge, ends, 0).min(self.cost(mesh, edge, ends, 1));
        if least.is_finite() { Ok(least) } else { Err(CollapseRefusal::Shape) }
    }

    fn propose(&mut self, mesh: &Mesh<3>, star: &EdgeStar<3>) -> Result<Proposal<3, f64>, CollapseRefusal> {
        let costs = [0, 1].map(|end| self.cost(mesh, star.edge, star.ends, end));
        let together = self.merge_quadrics(star.ends);
        let better = usize::from(costs[1] < costs[0]);
        let mut best: Result<Proposal<3, f64>, CollapseRefusal> = Err(CollapseRefusal::Shape);
        for survivor in [better, 1 - better] {
            let (cost, point) = (costs[survivor], star.end_points[survivor]);
            if together.error(&point) > self.max_error2 * together.area {
                best = best.or(Err(CollapseRefusal::Error));
                continue;
            }
            // The cost is infinite if the removed end must stay.
            let limit = best.as_ref().map_or(self.limit, |best| best.change);
            if !cost.is_finite() || cost > limit || check_triangles(star, &point).is_err() {
                continue;
            }
            if let Some(full) = self.compute_full_cost(mesh, star, survivor, cost, limit) {
                best = Ok(Proposal { survivor, point, change: full });
            }
        }
        best
    }

    fn cost(&self, proposal: &Proposal<3, f64>) -> f64 {
        proposal.change
    }

    fn judge(
        &mut self,
        _: &Mesh<3>,
        _: &EdgeStar<3>,
        _: &mut Proposal<3, f64>,
    ) -> Result<(), CollapseRefusal> {
        Ok(())
    }

    fn commit(&mut self, mesh: &Mesh<3>, star: &EdgeStar<3>, collapsed: &CollapseChange, _: f64) {
        let removed = usize::from(star.ends[1] == collapsed.removed);
        let moved = || star.remaining.iter().filter(|w| w.end == removed).map(|w| w.triangle.index());
        let around = moved().chain(star.vanishing.iter().map(|(t, _, _)| t.index()));
        self.triangles.unite(around, moved());
        self.parametrization.collapse(star, removed);
        let gone = self.quadrics[collapsed.removed.index()];
        self.quadrics[collapsed.survivor.index()].add(&gone);

        for (kept, gone) in collapsed.merged.into_iter().flatten() {
            self.chains.merge_chains(kept, gone);
        }
        if star.boundary_neighbours.is_some() {
            let connectivity = &mesh.connectivity;
            if removed == 0 {
                let arriving = connectivity.vertex_edges(collapsed.survivor).last().map(|(edge, _)| edge);
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
fn compute_trial_error2(surface: &Surface, corners: [&Vec3; 3], at: [&Vec3; 3]) -> Option<f64> {
    let (mut points, mut normals, mut slots) = ([[0.0; 3]; 6], [[0.0; 3]; 6], [0; 3]);
    for i in 0..3 {
        let j = (i + 1) % 3;
        (points[i], normals[i]) = (*corners[i], *at[i]);
        let normal = normalize(&add_scaled(at[i], 1.0, at[j]));
        let reach = TRIAL_REACH * distance2(corners[i], corners[j]).sqrt();
        let middle = midpoint(corners[i], corners[j]);
        let (_, place) = surface.intersect_line(&middle, &normal, reach, MIN_COSINE, |_, _| true)?;
        slots[i] = place.slot;
        points[3 + i] = place.point;
        normals[3 + i] = normalize(&surface.normal_at(&place));
    }
    let mut left = 0.0;
    for child in [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]] {
        let [a, b, c] = child.map(|i| &points[i]);
        if compute_normal_cosine([a, b, c], child.map(|i| &normals[i])) < MIN_TRIAL_COSINE {
            return None;
        }
        let middle: Vec3 = std::array::from_fn(|i| (a[i] + b[i] + c[i]) / 3.0);
        left += area([a, b, c]) * surface.find_nearest_slot(&middle, slots).1;
    }
    Some(left)
}

/// Compute the shape quality, 4√3 · area / sum of squared sides: 1 for equilateral triangles, 0 for
/// degenerate ones.
pub fn compute_quality(a: &Vec3, b: &Vec3, c: &Vec3) -> f64 {
    let sides2 = distance2(a, b) + distance2(b, c) + distance2(c, a);
    if sides2 > 0.0 { 4.0 * 3f64.sqrt() * area([a, b, c]) / sides2 } else { 0.0 }
}

/// Compute the quadric of each vertex: the planes of its triangles and constraint planes on the boundary.
fn compute_quadrics(mesh: &Mesh<3>) -> Vec<Quadric<0>> {
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
                quadrics[v.index()].add_wall(BOUNDARY_WEIGHT, points);
            }
        }
    }
    quadrics
}
