//! The complete JIA01 method.

use super::edge_splitting::split_long_edges;
use crate::base::errors::KernelError;
use crate::base::geometry::distance2;
use crate::base::memory_reserve::Reserve;
use crate::base::progress::Progress;
use crate::collapse::collapse_log::CollapseSequence;
use crate::collapse::engine::{Refusal, Stop};
use crate::collapse::rounds::{Goal, collapse};
use crate::collapse::whole_mesh::WholeMesh;
use crate::mesh::collapse_legality::IllegalCollapse;
use crate::mesh::triangle_mesh::{CompactMesh, ElementSources};

use super::accumulated_sums::JiaState;
use super::measure::StopRule;
use super::options::Options;

/// Number of edges refused at the end, by the last rule that refused each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct JiaRefusals {
    pub length: usize,
    pub shape: usize,
    pub texture: usize,
    pub topology: usize,
    pub bridge: usize,
    pub locked: usize,
    pub fold: usize,
}

/// Result of JIA01.
#[derive(Clone, Debug)]
pub struct JiaResult<const D: usize> {
    pub mesh: CompactMesh<D>,
    pub stop: Stop,
    pub refused: JiaRefusals,
    /// Number of triangles after splitting.
    pub split_triangles: usize,
    pub splits: u64,
    pub collapses: u64,
    pub attempts: u64,
    /// Largest sum of S on any edge at any time.
    pub largest_shape_change: f64,
    /// Largest sum of T on any edge at any time, without the initial contrast.
    pub largest_texture_change: f64,
    /// The mesh after splitting; `None` if no edge was split or no record was requested.
    pub split_mesh: Option<CompactMesh<D>>,
    /// Vertex indices refer to `split_mesh`, or to the input if that is `None`.
    pub collapse_sequence: CollapseSequence<D>,
}

/// Simplify by JIA01: split long edges, then collapse.
///
/// # Errors
/// [`KernelError::TooManyTriangles`] from the splits and [`KernelError::Interrupted`].
pub fn simplify<const D: usize>(
    mesh: WholeMesh<D, StopRule>,
    options: &Options,
    goal: &Goal,
    progress: &mut Progress,
) -> Result<JiaResult<D>, KernelError> {
    let (mesh, splits, origin) = split_mesh(mesh, options, progress)?;
    let split_triangles = mesh.triangles.len();
    // After splitting, the mesh may be much larger than the input.
    let _reserve = Reserve::for_rows(if splits > 0 { mesh.points.len() + split_triangles } else { 0 })?;
    let split = origin.clone().filter(|_| goal.record_positions).map(|origin| CompactMesh {
        points: mesh.points.clone(),
        triangles: mesh.triangles.clone(),
        vertex_source: origin.vertices,
        triangle_source: origin.triangles,
    });
    let records = JiaState::new(&mesh, options);
    let outcome = collapse(mesh, records, goal, progress)?;
    let refused = outcome.mesh.refused_edges();
    let bound = |wanted: StopRule| {
        refused
            .iter()
            .filter(
                |r| matches!(r, Refusal::PriorityRefused(b) | Refusal::ProposalRefused(b) if *b == wanted),
            )
            .count()
    };
    let illegal =
        |wanted: IllegalCollapse| refused.iter().filter(|r| **r == Refusal::Illegal(wanted)).count();
    Ok(JiaResult {
        stop: outcome.stop,
        refused: JiaRefusals {
            length: bound(StopRule::Length),
            shape: bound(StopRule::Shape),
            texture: bound(StopRule::Texture),
            topology: illegal(IllegalCollapse::Topology),
            bridge: illegal(IllegalCollapse::Bridge),
            locked: illegal(IllegalCollapse::Locked),
            fold: illegal(IllegalCollapse::Fold),
        },
        split_triangles,
        splits,
        collapses: outcome.collapses as u64,
        attempts: outcome.attempts,
        largest_shape_change: outcome.records.largest.shape,
        largest_texture_change: outcome.records.largest.texture,
        split_mesh: split,
        collapse_sequence: CollapseSequence::new(&outcome.logs),
        mesh: outcome.mesh.into_compact().with_sources_of(&origin),
    })
}

/// Split all edges longer than the length bound; most meshes have none.
///
/// Returns the mesh, the number of splits, and the sources of the new vertices and triangles (`None` without
/// splits).
fn split_mesh<const D: usize>(
    mesh: WholeMesh<D, StopRule>,
    options: &Options,
    progress: &mut Progress,
) -> Result<(WholeMesh<D, StopRule>, u64, Option<ElementSources>), KernelError> {
    let longest2 = options.bounds.length * options.bounds.length;
    let side2 = |a: u32, b: u32| distance2(&mesh.points[a as usize], &mesh.points[b as usize]);
    let is_long = |&[a, b, c]: &[u32; 3]| side2(a, b).max(side2(b, c)).max(side2(c, a)) > longest2;
    if !mesh.triangles.iter().any(is_long) {
        return Ok((mesh, 0, None));
    }
    let mut connected = mesh.into_connected()?;
    let splits = split_long_edges(&mut connected, options.bounds.length, options.triangle_limit, progress)?;
    let (whole, sources) = WholeMesh::from_mesh(connected);
    Ok((whole, splits, Some(sources)))
}
