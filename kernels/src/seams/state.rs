//! What is known of a surface with seams while it is simplified.

use std::cell::RefCell;

use super::classes::Plan;
use super::record::Changes;
use super::texture::{Charts, Drifts};
use super::wedges::{NONE, Wedges};
use super::weld::TOUCHES_NONE;
use crate::base::geometry::Vec3;
use crate::base::ids::{HalfedgeId, VertexId};
use crate::quadrics::quadric::Quadric;

/// Weight of the input's triangles in the cost of a collapse, against the current triangles. Current triangles alone
/// forget that a surface has moved before; the input's alone are a quarter worse on meshes without seams.
const MEMORY: f64 = 0.4;

/// A penalty for valence counts from here.
pub(super) const HIGH_VALENCE: u32 = 8;

/// What a user can set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knobs {
    /// Share of itself by which the cost of a collapse grows that meets several materials.
    pub across_materials: f64,
    /// The same for several parts.
    pub across_parts: f64,
    /// The same for each edge a vertex would have beyond eight.
    pub valence: f64,
    /// The same for each wedge of the ends beyond two.
    pub wedges: f64,
    /// Weight of the quadric of shape against that of shape and attributes, near seams.
    pub shape: f64,
    /// Largest distance in the image between a seam and what it was, as a length.
    pub seam_drift: f64,
}

/// A refusal of this measure.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Rule {
    /// Both ends must stay where they are.
    Locked,
    /// A triangle would turn over, or lose its area.
    Fold,
    /// A seam would be cut, joined with another, or left.
    Seam,
    /// A triangle of the image would turn over, or a texture coordinate leave its chart.
    Chart,
    /// The image of a seam would be too far from what it was.
    Drift,
    /// The surface would be too far from what it was.
    Shape,
    /// A triangle would become too thin for a proof.
    Needle,
}

/// Materials, or parts, that differ.
pub(super) const SEVERAL: i32 = i32::MIN;

/// What is looked at together of a vertex, and kept together for it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    /// The wedge of all its corners, or none.
    pub only: u32,
    /// Its seam and boundary edges.
    pub seam_degree: u32,
    pub valence: u32,
    /// Of all triangles around it, or [`SEVERAL`].
    pub material: i32,
    pub part: i32,
}

/// What two have in common.
#[inline]
pub(super) fn common(a: i32, b: i32) -> i32 {
    if a == b { a } else { SEVERAL }
}

/// A region, while it is simplified.
pub struct Seams<'a, const D: usize, const K: usize> {
    pub(super) knobs: Knobs,
    pub(super) charts: &'a Charts,
    /// No vertex leaves this box.
    pub(super) bounds: [Vec3; 2],
    pub(super) wedges: Wedges<K>,
    /// Cache of the shape quadrics of vertices near seams; none after a change.
    pub(super) shape: RefCell<Vec<Option<Quadric<0>>>>,
    /// Quadrics of shape and attributes, by wedge.
    pub(super) quadrics: Vec<Quadric<K>>,
    /// Shape quadrics of the input's triangles that each vertex stands for.
    pub(super) history: Vec<Quadric<0>>,
    /// Factor of the error of each triangle; empty for 1.
    pub(super) importance: Vec<f64>,
    /// Corners that a collapse moves, as they were before it; used again for the next.
    pub(super) moved: Vec<Moved<D>>,
    pub(super) spots: Vec<Spot>,
    pub(super) is_seam: Vec<bool>,
    /// The set of each vertex that must stay with others; see [`super::weld`]. Empty if no vertex must.
    pub(super) touching: Vec<u32>,
    /// Tied vertices by their sets, in order.
    pub(super) sheets: Vec<(u32, VertexId)>,
    pub(super) drifts: Drifts,
    pub(super) plan: RefCell<Plan<K>>,
    pub(super) changes: Option<Changes<K>>,
    /// The numbers of the region's wedges on the whole surface.
    pub(super) numbers: Vec<u32>,
}

/// A corner that a collapse moves: its halfedge, and where it was before, attributes included.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moved<const D: usize> {
    pub corner: HalfedgeId,
    pub before: [f64; D],
}

impl<const D: usize, const K: usize> Seams<'_, D, K> {
    /// Whether a wedge has a texture coordinate.
    #[inline]
    pub(super) fn is_textured(&self, wedge: u32) -> bool {
        self.wedges.at(wedge).is_textured
    }

    /// Whether the ends have one wedge each and no seam: the most there is of a surface.
    #[inline]
    pub(super) fn is_plain(&self, ends: [VertexId; 2]) -> bool {
        ends.map(|v| &self.spots[v.index()]).iter().all(|spot| spot.only != NONE && spot.seam_degree == 0)
    }

    /// Error of a collapse to `place` by the input's triangles that both ends stand for, with its weight.
    #[inline]
    pub(super) fn input_error(&self, ends: [VertexId; 2], place: &Vec3) -> f64 {
        let [a, b] = ends.map(|v| self.history[v.index()].error(place));
        MEMORY * (a + b)
    }

    /// The set of a vertex that must stay with others.
    #[inline]
    pub(super) fn touching(&self, v: VertexId) -> u32 {
        self.touching.get(v.index()).copied().unwrap_or(TOUCHES_NONE)
    }
}
