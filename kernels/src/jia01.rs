//! Texture-preserving simplification: the measure of JIA01.
//!
//! Jia, Liu, Pei, Zhu and Li, "Mesh simplification with texture preservation", Journal of Image and
//! Graphics 6(7), 2001, 613–617, after Johnson and Hebert, "Control of polygonal mesh resolution for 3-D
//! computer vision", 1998. Equation numbers are the paper's.
//!
//! The paper reaches the projection of (6) through a normal n3 in R^(3+k), which does not exist when the midpoint
//! lies in the triangle's plane. The foot of the perpendicular on the plane of e1, e2 is the same point and
//! always exists.

use crate::engine::{Collapsed, Measure, Proposal, Refusal, Stop};
use crate::error::KernelError;
use crate::geometry::{add_scaled, distance2, sub};
use crate::ids::{EdgeId, HalfedgeId};
use crate::legality::Illegal;
use crate::mesh::{Compact, Mesh, Sources};
use crate::patch::{Records, Whole};
use crate::progress::Progress;
use crate::rounds::{Goal, Way, collapse};
use crate::shape::{Overlay, boundary_change, shape_change};
use crate::split::split_long_edges;
use crate::star::Star;

/// A height below this share of the base is rounding error; such a triangle has no plane to project on.
const LEAST_HEIGHT2: f64 = 1e-20;

/// One value each for edge length (in the unit of the mesh), shape change (same) and texture change (levels).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    pub length: f64,
    pub shape: f64,
    pub texture: f64,
}

impl Limits {
    pub const NONE: Self = Self { length: f64::INFINITY, shape: f64::INFINITY, texture: f64::INFINITY };
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// L, S_max and T_max as bounds; infinite for none. Edges are split only for a finite length.
    pub bounds: Limits,
    /// L, S_max and T_max in the order (7): finite and positive, also where there is no bound.
    pub scales: Limits,
    /// Length that counts as much as one level of an attribute in the placement (4)–(6).
    pub attribute_scale: f64,
    /// As in the paper: check the sums after a collapse instead of before, and look at vertices only.
    pub paper_rule: bool,
    /// Refuse to split beyond this.
    pub triangle_limit: usize,
}

/// Edges that stand at the end, each under the rule that refused it last.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Standing {
    pub length: usize,
    pub shape: usize,
    pub texture: usize,
    pub topology: usize,
    pub bridge: usize,
    pub pinned: usize,
    pub fold: usize,
}

#[derive(Clone, Debug)]
pub struct Simplified<const D: usize> {
    pub mesh: Compact<D>,
    pub stop: Stop,
    pub standing: Standing,
    /// Triangles after splitting.
    pub split_triangles: usize,
    pub splits: u64,
    pub collapses: u64,
    pub attempts: u64,
    /// Largest sum of S on any edge at any time.
    pub largest_shape_change: f64,
    /// Largest sum of T on any edge at any time, without the contrast it starts with.
    pub largest_texture_change: f64,
    /// What the collapses began with, where a record was asked for and that is not the input: after splitting.
    pub split: Option<Compact<D>>,
    /// In numbers of that mesh.
    pub way: Way<D>,
}

/// Split and collapse: the whole of JIA01.
///
/// # Errors
/// [`KernelError::TooManyTriangles`] from the splits and [`KernelError::Interrupted`].
pub fn simplify<const D: usize>(
    mesh: Whole<D, Bound>,
    options: &Options,
    goal: &Goal,
    progress: &mut Progress,
) -> Result<Simplified<D>, KernelError> {
    let (mesh, splits, origin) = split_whole(mesh, options, progress)?;
    let split_triangles = mesh.triangles.len();
    let split = origin.clone().filter(|_| goal.record).map(|origin| Compact {
        points: mesh.points.clone(),
        triangles: mesh.triangles.clone(),
        vertex_source: origin.vertices,
        triangle_source: origin.triangles,
    });
    let records = JiaRecords::new(&mesh, options);
    let outcome = collapse(mesh, records, goal, progress)?;
    let held = outcome.mesh.held_edges();
    let bound = |wanted: Bound| {
        held.iter().filter(|r| matches!(r, Refusal::Barred(b) | Refusal::Bound(b) if *b == wanted)).count()
    };
    let illegal = |wanted: Illegal| held.iter().filter(|r| **r == Refusal::Illegal(wanted)).count();
    Ok(Simplified {
        stop: outcome.stop,
        standing: Standing {
            length: bound(Bound::Length),
            shape: bound(Bound::Shape),
            texture: bound(Bound::Texture),
            topology: illegal(Illegal::Topology),
            bridge: illegal(Illegal::Bridge),
            pinned: illegal(Illegal::Pinned),
            fold: illegal(Illegal::Fold),
        },
        split_triangles,
        splits,
        collapses: outcome.collapses as u64,
        attempts: outcome.attempts,
        largest_shape_change: outcome.records.largest.shape,
        largest_texture_change: outcome.records.largest.texture,
        split,
        way: Way::new(&outcome.logs),
        mesh: outcome.mesh.into_compact().traced_to(&origin),
    })
}

/// Split what is longer than the bound of length; most meshes have no such edge. What comes out is a mesh of its own,
/// whose parts the last value takes back to the input.
fn split_whole<const D: usize>(
    mesh: Whole<D, Bound>,
    options: &Options,
    progress: &mut Progress,
) -> Result<(Whole<D, Bound>, u64, Option<Sources>), KernelError> {
    let longest2 = options.bounds.length * options.bounds.length;
    let side2 = |a: u32, b: u32| distance2(&mesh.points[a as usize], &mesh.points[b as usize]);
    let is_long = |&[a, b, c]: &[u32; 3]| side2(a, b).max(side2(b, c)).max(side2(c, a)) > longest2;
    if !mesh.triangles.iter().any(is_long) {
        return Ok((mesh, 0, None));
    }
    let mut connected = mesh.connected()?;
    let splits = split_long_edges(&mut connected, options.bounds.length, options.triangle_limit, progress)?;
    let (whole, sources) = Whole::from_mesh(connected);
    Ok((whole, splits, Some(sources)))
}

/// The three stop rules.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Bound {
    Length,
    Shape,
    Texture,
}

/// What one collapse changes: S(e) and T(e).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Change {
    pub shape: f64,
    pub texture: f64,
    /// The least S_A of the new star's spokes afterwards: a point of any old triangle may have come to lie in
    /// any new one, with the changes of the old one behind it. 0 under the paper's rule.
    pub least_sum: f64,
}

/// What has been summed up on an edge.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Accumulated {
    /// S_A
    pub shape: f64,
    /// The part of T_A that collapses added.
    pub texture: f64,
    /// The part of T_A that was there at the start: T(e) on the mesh before any collapse.
    pub contrast: f64,
}

impl Accumulated {
    /// T_A
    #[inline]
    pub fn total_texture(&self) -> f64 {
        self.contrast + self.texture
    }

    #[inline]
    fn larger(&self, other: &Self) -> Self {
        Self {
            shape: self.shape.max(other.shape),
            texture: self.texture.max(other.texture),
            contrast: self.contrast.max(other.contrast),
        }
    }
}

/// The measure of JIA01 on points of R^D.
pub struct Jia01<const D: usize> {
    bounds: Limits,
    scales: Limits,
    /// Weight of the attributes in the inner product of R^D: the square of the attribute scale.
    attribute_weight: f64,
    paper_rule: bool,
    accumulated: Vec<Accumulated>,
    overlay: Overlay,
    largest: Change,
}

impl<const D: usize> Jia01<D> {
    pub fn new(mesh: &Mesh<D>, options: &Options) -> Self {
        let triangles = mesh.connectivity.triangles().map(|t| mesh.connectivity.corners(t).map(|v| v.0));
        let around = contrast_around(&mesh.points, triangles);
        let contrast = |edge| {
            let [a, b] = mesh.connectivity.ends(edge);
            around[a.index()].max(around[b.index()])
        };
        let mut accumulated = vec![Accumulated::default(); mesh.connectivity.edge_slots()];
        for edge in mesh.connectivity.edges() {
            accumulated[edge.index()].contrast = contrast(edge);
        }
        Self::with(options, accumulated)
    }

    fn with(options: &Options, accumulated: Vec<Accumulated>) -> Self {
        Self {
            bounds: options.bounds,
            scales: options.scales,
            attribute_weight: options.attribute_scale * options.attribute_scale,
            paper_rule: options.paper_rule,
            accumulated,
            overlay: Overlay::default(),
            largest: Change::default(),
        }
    }

    pub fn accumulated(&self, edge: EdgeId) -> &Accumulated {
        &self.accumulated[edge.index()]
    }

    /// The new vertex (4)–(6): the mean of the midpoint's projections on the planes of the star's triangles.
    fn mean_projection(&self, star: &Star<D>) -> [f64; D] {
        let mut sum = [0.0; D];
        let mut count = 0.0;
        let mut add = |p: &[f64; D], q: &[f64; D], r: &[f64; D]| {
            if let Some(offset) = self.offset_to_plane(&star.middle, p, q, r) {
                sum = add_scaled(&sum, 1.0, &offset);
                count += 1.0;
            }
        };
        for wing in &star.wings {
            add(star.end_point(wing.end), &wing.from_point, &wing.to_point);
        }
        for (_, _, apex) in &star.vanishing {
            add(&star.end_points[0], &star.end_points[1], apex);
        }
        if count == 0.0 { star.middle } else { add_scaled(&star.middle, 1.0 / count, &sum) }
    }

    /// From `m` to its orthogonal projection on the affine 2-plane through p, q, r in R^D.
    #[inline]
    fn offset_to_plane(&self, m: &[f64; D], p: &[f64; D], q: &[f64; D], r: &[f64; D]) -> Option<[f64; D]> {
        let (h, k, l) = (sub(q, p), sub(r, p), sub(m, p));
        let hh = self.inner(&h, &h);
        // e1 = h / |h| and e2 = (k − (e1·k) e1) / |…|, both left unnormalised.
        let e2 = add_scaled(&k, -self.inner(&h, &k) / hh, &h);
        let ee = self.inner(&e2, &e2);
        // Two equal corners give NaN, which is not larger either.
        let has_area = ee > LEAST_HEIGHT2 * self.inner(&k, &k).max(hh);
        if !has_area {
            return None;
        }
        let in_plane = add_scaled(&h.map(|x| x * (self.inner(&l, &h) / hh)), self.inner(&l, &e2) / ee, &e2);
        Some(sub(&in_plane, &l))
    }

    /// The same on a boundary, with lines for planes: those of the boundary edges before, at and after.
    fn mean_projection_on_boundary(&self, star: &Star<D>, [before, after]: [&[f64; D]; 2]) -> [f64; D] {
        // The midpoint is its own projection on its own line.
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
    type Bound = Bound;
    type Change = Change;

    /// The order (7), or the stop rule that holds the edge.
    #[inline]
    fn priority(&self, mesh: &Mesh<D>, edge: EdgeId) -> Result<f64, Bound> {
        let [a, b] = mesh.connectivity.ends(edge);
        let length = distance2(mesh.point(a), mesh.point(b)).sqrt();
        let sums = &self.accumulated[edge.index()];
        let texture = sums.total_texture();
        if length > self.bounds.length {
            Err(Bound::Length)
        } else if sums.shape > self.bounds.shape {
            Err(Bound::Shape)
        } else if texture > self.bounds.texture {
            Err(Bound::Texture)
        } else {
            Ok((sums.shape / self.scales.shape + 1.0)
                * (texture / self.scales.texture + 1.0)
                * (length / self.scales.length + 1.0))
        }
    }

    fn propose(&mut self, mesh: &Mesh<D>, star: &Star<D>) -> Result<Proposal<D, Change>, Bound> {
        let texture = texture_change(star);
        if !self.paper_rule {
            let sum = |edge: &EdgeId| self.accumulated[edge.index()].texture;
            let largest = star.others.iter().map(sum).fold(0.0, f64::max);
            let total = self.accumulated[star.edge.index()].total_texture();
            if largest.max(total) + texture > self.bounds.texture {
                return Err(Bound::Texture);
            }
        }
        let point = match (star.end_stays, star.boundary_neighbours) {
            ([true, false], _) => star.end_points[0],
            ([false, true], _) => star.end_points[1],
            (_, Some([before, after])) => {
                self.mean_projection_on_boundary(star, [mesh.point(before), mesh.point(after)])
            }
            _ => self.mean_projection(star),
        };
        let [first, second] = star.end_points.map(|end| distance2(&end, &point));
        let survivor = usize::from(second < first);
        Ok(Proposal { survivor, point, change: Change { shape: 0.0, texture, least_sum: 0.0 } })
    }

    fn judge(
        &mut self,
        mesh: &Mesh<D>,
        star: &Star<D>,
        proposal: &mut Proposal<D, Change>,
    ) -> Result<(), Bound> {
        let mut shape = match star.boundary_neighbours {
            Some(neighbours) => boundary_change(star, neighbours.map(|v| mesh.point(v)), &proposal.point),
            None => shape_change(star, &proposal.point),
        };
        if !self.paper_rule {
            let sum = |edge: &EdgeId| self.accumulated[edge.index()].shape;
            let largest = star.others.iter().map(sum).fold(sum(&star.edge), f64::max);
            if largest + shape > self.bounds.shape {
                return Err(Bound::Shape);
            }
            shape = shape.max(self.overlay.crossing_gap(star, &proposal.point));
            if largest + shape > self.bounds.shape {
                return Err(Bound::Shape);
            }
            proposal.change.least_sum = largest + shape;
        }
        proposal.change.shape = shape;
        Ok(())
    }

    fn commit(&mut self, mesh: &Mesh<D>, star: &Star<D>, collapsed: &Collapsed, change: Change) {
        for edge in &star.others {
            let sums = &mut self.accumulated[edge.index()];
            sums.shape += change.shape;
            sums.texture += change.texture;
            self.largest.shape = self.largest.shape.max(sums.shape);
            self.largest.texture = self.largest.texture.max(sums.texture);
        }
        for (kept, gone) in collapsed.merged.into_iter().flatten() {
            self.accumulated[kept.index()] =
                self.accumulated[kept.index()].larger(&self.accumulated[gone.index()]);
        }
        for (spoke, _) in mesh.connectivity.spokes(collapsed.survivor) {
            let sums = &mut self.accumulated[spoke.index()];
            sums.shape = sums.shape.max(change.least_sum);
            self.largest.shape = self.largest.shape.max(sums.shape);
        }
    }
}

/// Squared difference of the attributes of two vertices.
#[inline]
fn contrast2<const D: usize>(a: &[f64; D], b: &[f64; D]) -> f64 {
    (3..D).map(|i| (a[i] - b[i]) * (a[i] - b[i])).sum()
}

/// T(e) (3): the largest attribute difference along any edge of the star.
#[inline]
pub fn texture_change<const D: usize>(star: &Star<D>) -> f64 {
    let [first, second] = &star.end_points;
    let mut largest2 = contrast2(first, second);
    for wing in &star.wings {
        let end = star.end_point(wing.end);
        largest2 = largest2
            .max(contrast2(end, &wing.from_point))
            .max(contrast2(end, &wing.to_point))
            .max(contrast2(&wing.from_point, &wing.to_point));
    }
    // At the far corners one end may have no wing.
    for (_, _, apex) in &star.vanishing {
        largest2 = largest2.max(contrast2(first, apex)).max(contrast2(second, apex));
    }
    largest2.sqrt()
}

/// The largest attribute difference along any edge of each vertex's star. T(e) of an edge on the mesh as it is
/// given is the larger one of its ends, whose stars together are that of the edge.
fn contrast_around<const D: usize>(
    points: &[[f64; D]],
    triangles: impl Iterator<Item = [u32; 3]>,
) -> Vec<f64> {
    let mut around = vec![0f64; points.len()];
    for corners in triangles {
        let [a, b, c] = corners.map(|v| &points[v as usize]);
        let largest2 = contrast2(a, b).max(contrast2(b, c)).max(contrast2(c, a));
        for v in corners {
            around[v as usize] = around[v as usize].max(largest2);
        }
    }
    around.iter_mut().for_each(|contrast| *contrast = contrast.sqrt());
    around
}

/// What JIA01 has summed up on the whole mesh.
struct JiaRecords {
    options: Options,
    /// Contrast around each vertex, before the first round.
    around: Vec<f64>,
    /// From then on, what the pieces of the last round have summed up, and the number of the first triangle of each.
    pieces: Vec<(u32, Sums)>,
    largest: Change,
}

/// Sums on the edges of a piece. An edge has them at one corner of a triangle, on the rim at one in each piece.
struct Sums {
    /// Which corners of a triangle have sums, a bit each.
    corners: Vec<u8>,
    /// Where the sums of each triangle start.
    starts: Vec<u32>,
    accumulated: Vec<Accumulated>,
    largest: Change,
}

impl Sums {
    /// Corners of a triangle that have sums, and these.
    fn of(&self, triangle: usize) -> impl Iterator<Item = (usize, &Accumulated)> {
        let corners = (0..3).filter(move |corner| self.corners[triangle] >> corner & 1 == 1);
        corners.zip(&self.accumulated[self.starts[triangle] as usize..])
    }
}

impl JiaRecords {
    fn new<const D: usize>(mesh: &Whole<D, Bound>, options: &Options) -> Self {
        let around = contrast_around(&mesh.points, mesh.triangles.iter().copied());
        Self { options: *options, around, pieces: vec![], largest: Change::default() }
    }
}

impl<const D: usize> Records<D> for JiaRecords {
    type Measure = Jia01<D>;
    type Piece = Sums;

    const KEEPS_MERGES: bool = false;

    fn load(&self, patch: &Mesh<D>) -> Jia01<D> {
        let connectivity = &patch.connectivity;
        let mut accumulated = vec![Accumulated::default(); connectivity.edge_slots()];
        if !self.around.is_empty() {
            for edge in connectivity.edges() {
                let [a, b] = connectivity.ends(edge).map(|v| patch.vertex_source[v.index()] as usize);
                accumulated[edge.index()].contrast = self.around[a].max(self.around[b]);
            }
        }
        // Triangles come in the order of the whole mesh, and so piece after piece.
        let mut pieces = self.pieces.iter().peekable();
        let mut piece = pieces.next();
        for (local, &t) in patch.triangle_source.iter().enumerate() {
            while pieces.peek().is_some_and(|(first, _)| *first <= t) {
                piece = pieces.next();
            }
            for (corner, sums) in piece.iter().flat_map(|(first, sums)| sums.of((t - first) as usize)) {
                let edge = connectivity.edge(HalfedgeId((3 * local + corner) as u32));
                // An edge on the rim, where nothing changes, may have lost its sums in one of its pieces.
                accumulated[edge.index()] = accumulated[edge.index()].larger(sums);
            }
        }
        Jia01::with(&self.options, accumulated)
    }

    fn unload(measure: Jia01<D>, patch: &Mesh<D>) -> Sums {
        let connectivity = &patch.connectivity;
        let (triangles, edges) = (connectivity.triangle_count(), connectivity.edges().count());
        let mut sums = Sums {
            corners: Vec::with_capacity(triangles),
            starts: Vec::with_capacity(triangles),
            accumulated: Vec::with_capacity(edges),
            largest: measure.largest,
        };
        for t in connectivity.triangles() {
            sums.starts.push(sums.accumulated.len() as u32);
            let mut corners = 0;
            for corner in 0..3 {
                let h = HalfedgeId(3 * t.0 + corner);
                let edge = connectivity.edge(h);
                if connectivity.halfedge(edge) == h {
                    corners |= 1 << corner;
                    sums.accumulated.push(*measure.accumulated(edge));
                }
            }
            sums.corners.push(corners);
        }
        sums
    }

    fn join(mut self, _: &[u32], pieces: Vec<Sums>) -> Self {
        self.around = vec![];
        self.pieces.clear();
        let mut first = 0;
        for piece in pieces {
            self.largest.shape = self.largest.shape.max(piece.largest.shape);
            self.largest.texture = self.largest.texture.max(piece.largest.texture);
            let count = piece.corners.len() as u32;
            self.pieces.push((first, piece));
            first += count;
        }
        self
    }
}
