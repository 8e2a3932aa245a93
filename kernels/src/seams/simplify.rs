//! Simplification of a surface with seams: weld, collapse, and extract the result.

use super::record::Log;
use super::records::{Given, SeamRecords, places};
use super::state::{Knobs, Rule};
use super::surface::Surface;
use super::texture::Charts;
use super::wedges::{NONE, input_corner, seams, wedges};
use super::weld::{TOUCHES_NONE, Welded, weld};
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, around, enlarged};
use crate::base::ids::{HalfedgeId, VertexId};
use crate::base::progress::Progress;
use crate::collapse::engine::{Refusal, Stop};
use crate::collapse::logs;
use crate::collapse::rounds::{self, collapse};
use crate::collapse::whole::Whole;
use crate::fitting::fit::{BOX_MARGIN, Input, fit};
use crate::mesh::legality::Illegal;
use crate::mesh::triangle_mesh::{Compact, Lock, Mesh, check_points};

/// Simplified surface.
#[derive(Clone, Debug)]
pub struct Outcome<const K: usize> {
    pub points: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    pub corners: Vec<[f64; K]>,
    /// Corner of the input (3 × triangle + corner) with exactly equal attributes, or `NONE`.
    pub corner_source: Vec<u32>,
    pub vertex_source: Vec<u32>,
    pub triangle_source: Vec<u32>,
    pub stop: Stop,
    /// Remaining edges by the last rule that refused each.
    pub refused: Refused,
    pub collapses: usize,
    pub attempts: u64,
    /// Largest distance in the texture between a seam and its original, as a length.
    pub seam_drift: f64,
    pub is_fitted: bool,
    pub log: Option<Log<K>>,
}

/// Number of edges by the last rule that refused each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Refused {
    pub topology: usize,
    pub bridge: usize,
    pub locked: usize,
    pub fold: usize,
    pub seam: usize,
    pub chart: usize,
    pub drift: usize,
    pub shape: usize,
    pub needle: usize,
}

impl Refused {
    fn count(&mut self, refusal: Refusal<Rule>) {
        let count = match refusal {
            Refusal::Illegal(Illegal::Topology) => &mut self.topology,
            Refusal::Illegal(Illegal::Bridge) => &mut self.bridge,
            Refusal::Illegal(Illegal::Locked) => &mut self.locked,
            Refusal::Illegal(Illegal::Fold) => &mut self.fold,
            Refusal::Barred(rule) | Refusal::Bound(rule) => match rule {
                Rule::Locked => &mut self.locked,
                Rule::Fold => &mut self.fold,
                Rule::Seam => &mut self.seam,
                Rule::Chart => &mut self.chart,
                Rule::Drift => &mut self.drift,
                Rule::Shape => &mut self.shape,
                Rule::Needle => &mut self.needle,
            },
            Refusal::Later | Refusal::Rim => return,
        };
        *count += 1;
    }
}

/// Target of a simplification, and optional fit.
#[derive(Clone, Copy, Debug)]
pub struct Goal {
    /// Target, regions and threads of the collapse loop.
    pub rounds: rounds::Goal,
    /// Finally move vertices along their normals to fit the input.
    pub fit: bool,
}

/// Simplify a surface up to the goal.
///
/// # Errors
/// [`KernelError`] for an index out of range, a value that is not finite, or when interrupted.
pub fn simplify<const D: usize, const K: usize>(
    surface: &Surface<K>,
    knobs: Knobs,
    goal: Goal,
    progress: &mut Progress,
) -> Result<Outcome<K>, KernelError> {
    simplify_by::<D, K>(surface, knobs, goal, progress, |whole, records, _, progress| {
        collapse(whole, records, &goal.rounds, progress)
    })
}

/// Result of the collapse loop on a surface with seams.
pub type Collapsed<'a, const D: usize, const K: usize> = rounds::Outcome<3, SeamRecords<'a, D, K>>;

/// As [`simplify`], with a custom collapse loop that may add constraints.
///
/// `collapse` receives the welded surface, the records, the input vertex of each vertex, and the progress.
///
/// # Errors
/// As [`simplify`].
pub fn simplify_by<const D: usize, const K: usize>(
    surface: &Surface<K>,
    knobs: Knobs,
    goal: Goal,
    progress: &mut Progress,
    collapse: impl for<'a> FnOnce(
        Whole<3, Rule>,
        SeamRecords<'a, D, K>,
        &[u32],
        &mut Progress,
    ) -> Result<Collapsed<'a, D, K>, KernelError>,
) -> Result<Outcome<K>, KernelError> {
    check_points(&surface.points)?;
    check_points(&surface.corners)?;
    let welded = weld(&surface.sets, &surface.triangles)?;
    progress.check()?;
    let touching = welded.touching.clone();
    let mesh = connected(surface, welded);
    let is_seam = seams(&mesh, surface);
    let (wedges, of_corner) = wedges(&mesh, surface, &is_seam);
    progress.check()?;
    let charts = Charts::new(&mesh, surface, &is_seam, goal.rounds.threads);
    let places = places(&mesh, surface, &touching);
    let corners = of_corner.chunks_exact(3).map(|w| [w[0], w[1], w[2]]).collect();
    let numbered = goal.rounds.record.then(|| numbered(&mesh, surface, &of_corner));
    let of_input = |&t: &u32| surface.importance.get(t as usize).copied();
    let importance = mesh.triangle_source.iter().filter_map(of_input).collect();
    let bounds = enlarged(&around(mesh.points.iter().copied()), BOX_MARGIN);
    let (whole, sources) = Whole::from_mesh(mesh);
    let given = Given { surface, charts: &charts, bounds };
    let is_recorded = goal.rounds.record;
    let records = SeamRecords::<D, K>::new(knobs, given, places, wedges, corners, importance, is_recorded);
    let before = goal.fit.then(|| Before::new(&whole));
    let done = collapse(whole, records, &sources.vertices, progress)?;

    let mut refused = Refused::default();
    done.mesh.refused_edges().into_iter().for_each(|refusal| refused.count(refusal));
    let (corners, corner_source) = corners_left(&done.mesh, &done.records);
    let mut compact = done.mesh.into_compact();
    let is_fitted = match before.filter(|_| done.collapses > 0 && done.stop != Stop::Enough) {
        Some(before) => before.fit(&mut compact, &done.logs, goal.rounds.threads, progress)?,
        None => false,
    };
    let seam_drift = done.records.largest_drift;
    let log = done.records.changes.zip(numbered);
    let log = log.map(|(changes, numbered)| Log::new(&done.logs, &changes, numbered));
    let compact = compact.traced_to(&Some(sources));
    Ok(Outcome {
        points: compact.points,
        triangles: compact.triangles,
        corners,
        corner_source,
        vertex_source: compact.vertex_source,
        triangle_source: compact.triangle_source,
        stop: done.stop,
        refused,
        collapses: done.collapses,
        attempts: done.attempts,
        seam_drift,
        is_fitted,
        log,
    })
}

/// Create the mesh of a welded surface, with touching vertices locked.
fn connected<const K: usize>(surface: &Surface<K>, welded: Welded) -> Mesh<3> {
    let slots = welded.connectivity.vertex_slots();
    let mut points = vec![[0.0; 3]; slots];
    let mut vertex_source = vec![0; slots];
    let mut locks = vec![Lock::Free; slots];
    for (h, &v) in welded.corner_vertex.iter().enumerate().rev() {
        let input = surface.triangles[welded.triangle_source[h / 3] as usize][h % 3];
        points[v.index()] = surface.points[input as usize];
        vertex_source[v.index()] = input;
        if welded.touching[v.index()] != TOUCHES_NONE || surface.locked[input as usize] {
            locks[v.index()] = Lock::Locked;
        }
    }
    let (connectivity, triangle_source) = (welded.connectivity, welded.triangle_source);
    Mesh { connectivity, points, vertex_source, triangle_source, locks }
}

/// Map each corner of the input to its wedge and vertex; `NONE` in dropped triangles.
fn numbered<const K: usize>(mesh: &Mesh<3>, surface: &Surface<K>, of_corner: &[u32]) -> [Vec<u32>; 2] {
    let mut numbered = [0, 1].map(|_| vec![NONE; 3 * surface.triangles.len()]);
    for (h, &wedge) in of_corner.iter().enumerate() {
        let h = HalfedgeId::from_index(h);
        let corner = input_corner(mesh, h);
        numbered[0][corner] = wedge;
        numbered[1][corner] = mesh.connectivity.origin(h).0;
    }
    numbered
}

/// Collect the attributes of the remaining corners, and the input corners with equal attributes.
///
/// Triangles are in the order of their sources.
fn corners_left<const D: usize, const K: usize>(
    mesh: &Whole<3, Rule>,
    records: &SeamRecords<'_, D, K>,
) -> (Vec<[f64; K]>, Vec<u32>) {
    let mut order: Vec<(u32, u32)> = mesh.triangle_source.iter().copied().zip(0..).collect();
    order.sort_unstable();
    let wedges =
        order.iter().flat_map(|&(_, t)| records.corners.at(t)).map(|&wedge| records.wedges.at(wedge));
    wedges.map(|wedge| (wedge.attributes, wedge.source)).unzip()
}

/// The surface before any collapse.
struct Before {
    points: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    locked: Vec<bool>,
}

impl Before {
    fn new(whole: &Whole<3, Rule>) -> Self {
        let Whole { points, triangles, locked, .. } = whole;
        Self { points: points.clone(), triangles: triangles.clone(), locked: locked.clone() }
    }

    /// Fit the simplified surface to this one by least squares.
    ///
    /// Returns false if the fit was skipped, because sheets touch in a way that makes the indexed mesh
    /// non-manifold.
    fn fit(
        &self,
        compact: &mut Compact<3>,
        logs: &[logs::Log<3>],
        threads: usize,
        progress: &Progress,
    ) -> Result<bool, KernelError> {
        let Ok(mut light) = Mesh::new(compact.points.clone(), &compact.triangles) else {
            return Ok(false);
        };
        let mut became = vec![VertexId::NONE; self.points.len()];
        for (number, &v) in compact.vertex_source.iter().enumerate() {
            became[v as usize] = VertexId::from_index(number);
            if self.locked[v as usize] {
                light.locks[number] = Lock::Locked;
            }
        }
        // Collapses in different regions of a round are independent, so any order of the logs works.
        for merge in logs.iter().flat_map(|log| &log.merges).rev() {
            became[merge.removed.index()] = became[merge.survivor.index()];
        }
        let input = Input { points: &self.points, triangles: &self.triangles, became: &became };
        fit(&mut light, &input, threads, progress)?;
        compact.points = light.points;
        Ok(true)
    }
}
