//! State of a region of a surface with seams during simplification.

use std::cell::RefCell;

use super::merge_plan::MergePlan;
use super::progressive_record::WedgeChanges;
use super::texture_space::{Charts, SeamDrifts};
use super::wedges::{ABSENT, Wedges};
use super::welding::NO_SET;
use crate::base::geometry::Vec3;
use crate::base::ids::{HalfedgeId, VertexId};
use crate::quadrics::quadric::Quadric;

/// Weight of the input triangles in the cost of a collapse, relative to the current triangles. With current
/// triangles alone, earlier displacements are forgotten. With input triangles alone, results are a quarter
/// worse on meshes without seams.
const INPUT_QUADRIC_WEIGHT: f64 = 0.4;

/// Valence above which the penalty applies.
pub(super) const PENALTY_VALENCE: u32 = 8;

/// Cost parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CostParameters {
    /// Relative cost increase for a collapse across materials.
    pub material_border_penalty: f64,
    /// Relative cost increase for a collapse across parts.
    pub part_border_penalty: f64,
    /// Relative cost increase for each edge of the new vertex above eight.
    pub valence: f64,
    /// Relative cost increase for each wedge of both ends above two.
    pub wedges: f64,
    /// Weight of the shape quadric, relative to the quadric of shape and attributes, near seams.
    pub shape: f64,
    /// Maximum distance in the texture between a seam and its original, as a length.
    pub seam_drift: f64,
}

/// Reason for a refusal by this measure.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum RefusalReason {
    /// Neither end may move.
    Locked,
    /// A triangle would turn over, or lose its area.
    Fold,
    /// A seam would be cut, merged with another one, or left.
    Seam,
    /// A triangle would fold in the texture, or a texture coordinate would leave its chart.
    Chart,
    /// The drift of a seam would exceed its bound.
    Drift,
    /// The surface would exceed the bound on shape.
    Shape,
    /// A triangle would become too thin for a proof.
    Needle,
}

/// Marks vertices with several materials or parts.
pub(super) const SEVERAL: i32 = i32::MIN;

/// Summary of a vertex, stored together for cache locality.
#[derive(Clone, Copy, Debug)]
pub(super) struct VertexSummary {
    /// The wedge of all its corners, or `NONE` if there are several.
    pub only_wedge: u32,
    /// Number of its seam and boundary edges.
    pub seam_degree: u32,
    pub valence: u32,
    /// Common value of all triangles around the vertex, or [`SEVERAL`].
    pub material: i32,
    pub part: i32,
}

/// Return the common value of two, or [`SEVERAL`].
#[inline]
pub(super) fn common_value(a: i32, b: i32) -> i32 {
    if a == b { a } else { SEVERAL }
}

/// Measure of a region with seams.
pub struct SeamMeasure<'a, const D: usize, const K: usize> {
    pub(super) knobs: CostParameters,
    pub(super) charts: &'a Charts,
    /// Bounding box that no vertex may leave.
    pub(super) bounds: [Vec3; 2],
    pub(super) wedges: Wedges<K>,
    /// Cached shape quadrics of vertices near seams; `None` after a change.
    pub(super) shape: RefCell<Vec<Option<Quadric<0>>>>,
    /// Quadrics of shape and attributes, by wedge.
    pub(super) quadrics: Vec<Quadric<K>>,
    /// By vertex: shape quadric of the input triangles that it represents.
    pub(super) history: Vec<Quadric<0>>,
    /// Factor on the error, by triangle; empty for 1.
    pub(super) importance: Vec<f64>,
    /// Corners moved by the current collapse, as they were before it; the buffer is reused.
    pub(super) moved: Vec<MovedCorner<D>>,
    pub(super) summaries: Vec<VertexSummary>,
    pub(super) is_seam: Vec<bool>,
    /// By vertex: set of touching vertices that must stay together; see [`super::welding`]. Empty without
    /// touching vertices.
    pub(super) touching: Vec<u32>,
    /// Touching vertices, sorted by set.
    pub(super) touching_vertices: Vec<(u32, VertexId)>,
    pub(super) drifts: SeamDrifts,
    pub(super) plan: RefCell<MergePlan<K>>,
    pub(super) changes: Option<WedgeChanges<K>>,
    /// Indices of the wedges on the whole surface.
    pub(super) surface_wedge_indices: Vec<u32>,
}

/// A corner that a collapse moves: its halfedge, and its old position and attributes.
#[derive(Clone, Copy, Debug)]
pub(super) struct MovedCorner<const D: usize> {
    pub corner: HalfedgeId,
    pub before: [f64; D],
}

impl<const D: usize, const K: usize> SeamMeasure<'_, D, K> {
    /// Test if a wedge has a texture coordinate.
    #[inline]
    pub(super) fn is_textured(&self, wedge: u32) -> bool {
        self.wedges.get(wedge).is_textured
    }

    /// Test if both ends have one wedge and no seam (the usual case).
    #[inline]
    pub(super) fn has_single_wedges(&self, ends: [VertexId; 2]) -> bool {
        ends.map(|v| &self.summaries[v.index()])
            .iter()
            .all(|spot| spot.only_wedge != ABSENT && spot.seam_degree == 0)
    }

    /// Compute the weighted error of a collapse against the input triangles of both ends.
    #[inline]
    pub(super) fn input_error(&self, ends: [VertexId; 2], place: &Vec3) -> f64 {
        let [a, b] = ends.map(|v| self.history[v.index()].error(place));
        INPUT_QUADRIC_WEIGHT * (a + b)
    }

    /// Return the set of touching vertices that contains a vertex, or [`NO_SET`].
    #[inline]
    pub(super) fn touching_set(&self, v: VertexId) -> u32 {
        self.touching.get(v.index()).copied().unwrap_or(NO_SET)
    }
}
