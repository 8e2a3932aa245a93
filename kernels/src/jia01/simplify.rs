//! The complete JIA01 method.

use super::split::split_long_edges;
use crate::base::errors::KernelError;
use crate::base::geometry::distance2;
use crate::base::progress::Progress;
use crate::base::reserve::Reserve;
use crate::collapse::engine::{Refusal, Stop};
use crate::collapse::logs::Way;
use crate::collapse::rounds::{Goal, collapse};
use crate::collapse::whole::Whole;
use crate::mesh::legality::Illegal;
use crate::mesh::triangle_mesh::{Compact, Sources};

use super::measure::Bound;
use super::options::Options;
use super::records::JiaRecords;

/// Number of edges refused at the end, by the last rule that refused each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Refused {
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
pub struct Simplified<const D: usize> {
    pub mesh: Compact<D>,
    pub stop: Stop,
    pub refused: Refused,
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
    pub split: Option<Compact<D>>,
    /// Vertex indices refer to `split`, or to the input if that is `None`.
    pub way: Way<D>,
}

/// Simplify by JIA01: split long edges, then collapse.
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
    // After splitting, the mesh may be much larger than the input.
    let _reserve = Reserve::for_rows(if splits > 0 { mesh.points.len() + split_triangles } else { 0 })?;
    let split = origin.clone().filter(|_| goal.record).map(|origin| Compact {
        points: mesh.points.clone(),
        triangles: mesh.triangles.clone(),
        vertex_source: origin.vertices,
        triangle_source: origin.triangles,
    });
    let records = JiaRecords::new(&mesh, options);
    let outcome = collapse(mesh, records, goal, progress)?;
    let refused = outcome.mesh.refused_edges();
    let bound = |wanted: Bound| {
        refused.iter().filter(|r| matches!(r, Refusal::Barred(b) | Refusal::Bound(b) if *b == wanted)).count()
    };
    let illegal = |wanted: Illegal| refused.iter().filter(|r| **r == Refusal::Illegal(wanted)).count();
    Ok(Simplified {
        stop: outcome.stop,
        refused: Refused {
            length: bound(Bound::Length),
            shape: bound(Bound::Shape),
            texture: bound(Bound::Texture),
            topology: illegal(Illegal::Topology),
            bridge: illegal(Illegal::Bridge),
            locked: illegal(Illegal::Locked),
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

/// Split all edges longer than the length bound; most meshes have none.
///
/// Returns the mesh, the number of splits, and the sources of the new vertices and triangles (`None` without
/// splits).
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
