//! Texture-preserving simplification: JIA01.
//!
//! Jia, Liu, Pei, Zhu and Li, "Mesh simplification with texture preservation", Journal of Image and
//! Graphics 6(7), 2001, 613–617, after Johnson and Hebert, "Control of polygonal mesh resolution for 3-D
//! computer vision", 1998. Equation numbers, here and in the parts, are the paper's.

mod contrast;
mod measure;
mod records;

pub use contrast::texture_change;
pub use measure::{Accumulated, Bound, Change, Jia01};

use crate::engine::{Refusal, Stop};
use crate::error::KernelError;
use crate::geometry::distance2;
use crate::legality::Illegal;
use crate::mesh::{Compact, Sources};
use crate::patch::Whole;
use crate::progress::Progress;
use crate::rounds::{Goal, Way, collapse};
use crate::split::split_long_edges;

use records::JiaRecords;

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
