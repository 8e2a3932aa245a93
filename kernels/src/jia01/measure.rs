//! Measure of JIA01: new position, changes caused by a collapse, and stop rules.
//!
//! The paper computes the projection of (6) with a normal n3 in R^(3+k). That normal does not exist if the
//! midpoint is in the plane of the triangle. The foot of the perpendicular on the plane of e1, e2 is the same
//! point and always exists.

use super::attribute_contrast::{compute_vertex_contrast, texture_change};
use super::options::{Limits, Options};
use super::shape_change::{StarOverlay, boundary_change, shape_change};
use crate::base::geometry::{add_scaled, distance2, sub};
use crate::base::ids::EdgeId;
use crate::collapse::engine::{CollapseChange, Measure, Proposal};
use crate::mesh::edge_star::EdgeStar;
use crate::mesh::triangle_mesh::Mesh;

/// Minimum squared ratio of height to base; a flatter triangle has no plane to project on.
const MIN_HEIGHT_RATIO2: f64 = 1e-20;

/// Maximum ratio of an edge's length to a soft length bound that still increases its priority. Larger ones could
/// overflow.
const MAX_EXCESS: f64 = 1e6;

/// The three stop rules.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum StopRule {
    Length,
    Shape,
    Texture,
}

/// Changes caused by one collapse: S(e) and T(e).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Change {
    pub shape: f64,
    pub texture: f64,
    /// Minimum S_A for the spokes of the new star. Any point of an old triangle may now be in any new one,
    /// and brings its accumulated change. 0 under the paper's rule.
    pub min_spoke_sum: f64,
}

/// Sums of changes accumulated on an edge.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AccumulatedChange {
    /// S_A
    pub shape: f64,
    /// Part of T_A that collapses added.
    pub texture: f64,
    /// Initial part of T_A: T(e) on the mesh before any collapse.
    pub contrast: f64,
}

impl AccumulatedChange {
    /// Return T_A, the sum of both parts.
    #[inline]
    pub fn total_texture(&self) -> f64 {
        self.contrast + self.texture
    }

    /// Return the maximum of each sum.
    #[inline]
    pub(super) fn larger(&self, other: &Self) -> Self {
        Self {
            shape: self.shape.max(other.shape),
            texture: self.texture.max(other.texture),
            contrast: self.contrast.max(other.contrast),
        }
    }
}

/// Compute the factor on the priority of an edge, from the ratio of its length to a soft length bound.
///
/// The 16th power: at 1.5 times the bound, an edge comes after shorter ones with 600 times its priority.
#[inline]
fn excess_penalty(excess: f64) -> f64 {
    // `powi` may round differently on other machines.
    let square = |x: f64| x * x;
    square(square(square(square(excess.clamp(1.0, MAX_EXCESS)))))
}

/// Measure of JIA01 on points of R^D.
pub struct Jia01<const D: usize> {
    bounds: Limits,
    scales: Limits,
    soft_length: bool,
    /// Weight of the attributes in the inner product of R^D: the square of the attribute scale.
    attribute_weight: f64,
    paper_rule: bool,
    accumulated: Vec<AccumulatedChange>,
    overlay: StarOverlay,
    pub(super) largest_change: Change,
}

impl<const D: usize> Jia01<D> {
    pub fn new(mesh: &Mesh<D>, options: &Options) -> Self {
        let triangles = mesh.connectivity.triangles().map(|t| mesh.connectivity.corners(t).map(|v| v.0));
        let around = compute_vertex_contrast(&mesh.points, triangles);
        let contrast = |edge| {
            let [a, b] = mesh.connectivity.ends(edge);
            around[a.index()].max(around[b.index()])
        };
        let mut accumulated = vec![AccumulatedChange::default(); mesh.connectivity.edge_slots()];
        for edge in mesh.connectivity.edges() {
            accumulated[edge.index()].contrast = contrast(edge);
        }
        Self::from_accumulated(options, accumulated)
    }

    pub(super) fn from_accumulated(options: &Options, accumulated: Vec<AccumulatedChange>) -> Self {
        Self {
            bounds: options.bounds,
            scales: options.scales,
            soft_length: options.soft_length,
            attribute_weight: options.attribute_scale * options.attribute_scale,
            paper_rule: options.paper_rule,
            accumulated,
            overlay: StarOverlay::default(),
            largest_change: Change::default(),
        }
    }

    /// Return the sums of an edge.
    pub fn accumulated(&self, edge: EdgeId) -> &AccumulatedChange {
        &self.accumulated[edge.index()]
    }

    /// Compute the new vertex (4)–(6): the mean projection of the midpoint onto the planes of the star.
    fn mean_projection(&self, star: &EdgeStar<D>) -> [f64; D] {
        let mut sum = [0.0; D];
        let mut count = 0.0;
        let mut add = |p: &[f64; D], q: &[f64; D], r: &[f64; D]| {
            if let Some(offset) = self.offset_to_plane(&star.middle, p, q, r) {
                sum = add_scaled(&sum, 1.0, &offset);
                count += 1.0;
            }
        };
        for wing in &star.remaining {
            add(star.end_point(wing.end), &wing.from_point, &wing.to_point);
        }
        for (_, _, apex) in &star.vanishing {
            add(&star.end_points[0], &star.end_points[1], apex);
        }
        if count == 0.0 { star.middle } else { add_scaled(&star.middle, 1.0 / count, &sum) }
    }

    /// Compute the vector from `m` to its projection onto a plane.
    ///
    /// The plane passes through p, q, r in R^D. `None` if they have no area.
    #[inline]
    fn offset_to_plane(&self, m: &[f64; D], p: &[f64; D], q: &[f64; D], r: &[f64; D]) -> Option<[f64; D]> {
        let (h, k, l) = (sub(q, p), sub(r, p), sub(m, p));
        let hh = self.inner(&h, &h);
        // e1 = h / |h| and e2 = (k − (e1·k) e1) / |…|, both left unnormalised.
        let e2 = add_scaled(&k, -self.inner(&h, &k) / hh, &h);
        let ee = self.inner(&e2, &e2);
        // Two equal corners give NaN, for which the comparison is false.
        let has_area = ee > MIN_HEIGHT_RATIO2 * self.inner(&k, &k).max(hh);
        if !has_area {
            return None;
        }
        let in_plane = add_scaled(&h.map(|x| x * (self.inner(&l, &h) / hh)), self.inner(&l, &e2) / ee, &e2);
        Some(sub(&in_plane, &l))
    }

    /// As [`Self::mean_projection`] for a boundary edge, with the lines of three consecutive boundary edges.
    fn mean_projection_on_boundary(&self, star: &EdgeStar<D>, [before, after]: [&[f64; D]; 2]) -> [f64; D] {
        // The midpoint is its own projection onto its own edge.
        let mut sum = [0.0; D];
        let mut count = 1.0;
        for (a, b) in [(before, &star.end_points[0]), (&star.end_points[1], after)] {
            let (along, to_a) = (sub(b, a), sub(a, &star.middle));
            let length2 = self.inner(&along, &along);
            if length2 > 0.0 {
                let t = -self.inner(&to_a, &along) / length2;
                sum = add_scaled(&add_scaled(&sum, 1.0, &to_a), t, &along);
                count += 1.0;
            }
        }
        add_scaled(&star.middle, 1.0 / count, &sum)
    }

    #[inline]
    fn inner(&self, a: &[f64; D], b: &[f64; D]) -> f64 {
        let space = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let attributes: f64 = (3..D).map(|i| a[i] * b[i]).sum();
        space + self.attribute_weight * attributes
    }
}

impl<const D: usize> Measure<D> for Jia01<D> {
    type Reason = StopRule;
    type Change = Change;

    /// Order (7), or the stop rule that refuses the edge.
    #[inline]
    fn priority(&self, mesh: &Mesh<D>, edge: EdgeId) -> Result<f64, StopRule> {
        let [a, b] = mesh.connectivity.ends(edge);
        let length = distance2(mesh.point(a), mesh.point(b)).sqrt();
        let sums = &self.accumulated[edge.index()];
        let texture = sums.total_texture();
        if length > self.bounds.length && !self.soft_length {
            Err(StopRule::Length)
        } else if sums.shape > self.bounds.shape {
            Err(StopRule::Shape)
        } else if texture > self.bounds.texture {
            Err(StopRule::Texture)
        } else {
            Ok((sums.shape / self.scales.shape + 1.0)
                * (texture / self.scales.texture + 1.0)
                * (length / self.scales.length + 1.0)
                * excess_penalty(length / self.bounds.length))
        }
    }

    fn propose(&mut self, mesh: &Mesh<D>, star: &EdgeStar<D>) -> Result<Proposal<D, Change>, StopRule> {
        let texture = texture_change(star);
        if !self.paper_rule {
            let sum = |edge: &EdgeId| self.accumulated[edge.index()].texture;
            let largest = star.other_edges.iter().map(sum).fold(0.0, f64::max);
            let total = self.accumulated[star.edge.index()].total_texture();
            if largest.max(total) + texture > self.bounds.texture {
                return Err(StopRule::Texture);
            }
        }
        let point = match (star.end_is_fixed, star.boundary_neighbours) {
            ([true, false], _) => star.end_points[0],
            ([false, true], _) => star.end_points[1],
            (_, Some([before, after])) => {
                self.mean_projection_on_boundary(star, [mesh.point(before), mesh.point(after)])
            }
            _ => self.mean_projection(star),
        };
        let [first, second] = star.end_points.map(|end| distance2(&end, &point));
        let survivor = usize::from(second < first);
        Ok(Proposal { survivor, point, change: Change { shape: 0.0, texture, min_spoke_sum: 0.0 } })
    }

    fn judge(
        &mut self,
        mesh: &Mesh<D>,
        star: &EdgeStar<D>,
        proposal: &mut Proposal<D, Change>,
    ) -> Result<(), StopRule> {
        let mut shape = match star.boundary_neighbours {
            Some(neighbours) => boundary_change(star, neighbours.map(|v| mesh.point(v)), &proposal.point),
            None => shape_change(star, &proposal.point),
        };
        if !self.paper_rule {
            let sum = |edge: &EdgeId| self.accumulated[edge.index()].shape;
            let largest = star.other_edges.iter().map(sum).fold(sum(&star.edge), f64::max);
            if largest + shape > self.bounds.shape {
                return Err(StopRule::Shape);
            }
            shape = shape.max(self.overlay.crossing_gap(star, &proposal.point));
            if largest + shape > self.bounds.shape {
                return Err(StopRule::Shape);
            }
            proposal.change.min_spoke_sum = largest + shape;
        }
        proposal.change.shape = shape;
        Ok(())
    }

    fn commit(&mut self, mesh: &Mesh<D>, star: &EdgeStar<D>, collapsed: &CollapseChange, change: Change) {
        for edge in &star.other_edges {
            let sums = &mut self.accumulated[edge.index()];
            sums.shape += change.shape;
            sums.texture += change.texture;
            self.largest_change.shape = self.largest_change.shape.max(sums.shape);
            self.largest_change.texture = self.largest_change.texture.max(sums.texture);
        }
        for (kept, gone) in collapsed.merged.into_iter().flatten() {
            self.accumulated[kept.index()] =
                self.accumulated[kept.index()].larger(&self.accumulated[gone.index()]);
        }
        for (spoke, _) in mesh.connectivity.vertex_edges(collapsed.survivor) {
            let sums = &mut self.accumulated[spoke.index()];
            sums.shape = sums.shape.max(change.min_spoke_sum);
            self.largest_change.shape = self.largest_change.shape.max(sums.shape);
        }
    }
}
