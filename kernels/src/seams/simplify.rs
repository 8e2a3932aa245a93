//! Simplification of a surface with seams: weld, collapse, and extract the result.

use super::progressive_record::ProgressiveRecord;
use super::region_state::{CostParameters, RefusalReason};
use super::surface::SeamSurface;
use super::surface_state::{InitialSurface, SurfaceState, create_vertex_states};
use super::texture_space::Charts;
use super::wedges::{ABSENT, create_wedges, find_seams, input_corner};
use super::welding::{NO_SET, Welded, weld};
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, bounding_box, enlarge_box};
use crate::base::ids::{HalfedgeId, VertexId};
use crate::base::progress::Progress;
use crate::collapse::collapse_log;
use crate::collapse::engine::{Refusal, Stop};
use crate::collapse::rounds::{self, collapse};
use crate::collapse::whole_mesh::WholeMesh;
use crate::fitting::least_squares::{BOX_MARGIN_RATIO, FitInput, fit};
use crate::mesh::collapse_legality::IllegalCollapse;
use crate::mesh::triangle_mesh::{CompactMesh, Mesh, VertexLock, check_points};

/// Simplified surface.
#[derive(Clone, Debug)]
pub struct SimplifiedSurface<const K: usize> {
    pub points: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    pub corners: Vec<[f64; K]>,
    /// Corner of the input (3 × triangle + corner) with exactly equal attributes, or `NONE`.
    pub corner_source: Vec<u32>,
    pub vertex_source: Vec<u32>,
    pub triangle_source: Vec<u32>,
    pub stop: Stop,
    /// Remaining edges by the last rule that refused each.
    pub refused: SeamRefusals,
    pub collapses: usize,
    pub attempts: u64,
    /// Largest distance in the texture between a seam and its original, as a length.
    pub seam_drift: f64,
    pub is_fitted: bool,
    pub log: Option<ProgressiveRecord<K>>,
}

/// Number of edges by the last rule that refused each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SeamRefusals {
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

impl SeamRefusals {
    fn count(&mut self, refusal: Refusal<RefusalReason>) {
        let count = match refusal {
            Refusal::Illegal(IllegalCollapse::Topology) => &mut self.topology,
            Refusal::Illegal(IllegalCollapse::Bridge) => &mut self.bridge,
            Refusal::Illegal(IllegalCollapse::Locked) => &mut self.locked,
            Refusal::Illegal(IllegalCollapse::Fold) => &mut self.fold,
            Refusal::PriorityRefused(rule) | Refusal::ProposalRefused(rule) => match rule {
                RefusalReason::Locked => &mut self.locked,
                RefusalReason::Fold => &mut self.fold,
                RefusalReason::Seam => &mut self.seam,
                RefusalReason::Chart => &mut self.chart,
                RefusalReason::Drift => &mut self.drift,
                RefusalReason::Shape => &mut self.shape,
                RefusalReason::Needle => &mut self.needle,
            },
            Refusal::Postponed | Refusal::Rim => return,
        };
        *count += 1;
    }
}

/// Target of a simplification, and optional fit.
#[derive(Clone, Copy, Debug)]
pub struct SeamGoal {
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
    surface: &SeamSurface<K>,
    knobs: CostParameters,
    goal: SeamGoal,
    progress: &mut Progress,
) -> Result<SimplifiedSurface<K>, KernelError> {
    simplify_with::<D, K>(surface, knobs, goal, progress, |whole, records, _, progress| {
        collapse(whole, records, &goal.rounds, progress)
    })
}

/// Result of the collapse loop on a surface with seams.
pub type CollapseOutcome<'a, const D: usize, const K: usize> = rounds::Outcome<3, SurfaceState<'a, D, K>>;

/// As [`simplify`], with a custom collapse loop that may add constraints.
///
/// `collapse` receives the welded surface, the records, the input vertex of each vertex, and the progress.
///
/// # Errors
/// As [`simplify`].
pub fn simplify_with<const D: usize, const K: usize>(
    surface: &SeamSurface<K>,
    knobs: CostParameters,
    goal: SeamGoal,
    progress: &mut Progress,
    collapse: impl for<'a> FnOnce(
        WholeMesh<3, RefusalReason>,
        SurfaceState<'a, D, K>,
        &[u32],
        &mut Progress,
    ) -> Result<CollapseOutcome<'a, D, K>, KernelError>,
) -> Result<SimplifiedSurface<K>, KernelError> {
    check_points(&surface.points)?;
    check_points(&surface.corners)?;
    let welded = weld(&surface.coincident_sets, &surface.triangles)?;
    progress.check()?;
    let touching = welded.touching.clone();
    let mesh = create_mesh(surface, welded);
    let is_seam = find_seams(&mesh, surface);
    let (wedges, of_corner) = create_wedges(&mesh, surface, &is_seam);
    progress.check()?;
    let charts = Charts::new(&mesh, surface, &is_seam, goal.rounds.threads);
    let places = create_vertex_states(&mesh, surface, &touching);
    let corners = of_corner.chunks_exact(3).map(|w| [w[0], w[1], w[2]]).collect();
    let numbered = goal.rounds.record_positions.then(|| map_input_corners(&mesh, surface, &of_corner));
    let of_input = |&t: &u32| surface.importance.get(t as usize).copied();
    let importance = mesh.triangle_source.iter().filter_map(of_input).collect();
    let bounds = enlarge_box(&bounding_box(mesh.points.iter().copied()), BOX_MARGIN_RATIO);
    let (whole, sources) = WholeMesh::from_mesh(mesh);
    let given = InitialSurface { surface, charts: &charts, bounds };
    let is_recorded = goal.rounds.record_positions;
    let records = SurfaceState::<D, K>::new(knobs, given, places, wedges, corners, importance, is_recorded);
    let before = goal.fit.then(|| FitReference::new(&whole));
    let done = collapse(whole, records, &sources.vertices, progress)?;

    let mut refused = SeamRefusals::default();
    done.mesh.refused_edges().into_iter().for_each(|refusal| refused.count(refusal));
    let (corners, corner_source) = collect_corners(&done.mesh, &done.records);
    let mut compact = done.mesh.into_compact();
    let is_fitted = match before.filter(|_| done.collapses > 0 && done.stop != Stop::StoppedByCaller) {
        Some(before) => before.fit(&mut compact, &done.logs, goal.rounds.threads, progress)?,
        None => false,
    };
    let seam_drift = done.records.largest_drift;
    let log = done.records.changes.zip(numbered);
    let log = log.map(|(changes, numbered)| ProgressiveRecord::new(&done.logs, &changes, numbered));
    let compact = compact.with_sources_of(&Some(sources));
    Ok(SimplifiedSurface {
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
fn create_mesh<const K: usize>(surface: &SeamSurface<K>, welded: Welded) -> Mesh<3> {
    let connectivity = welded.connectivity();
    let slots = connectivity.vertex_slots();
    let mut points = vec![[0.0; 3]; slots];
    let mut vertex_source = vec![0; slots];
    let mut locks = vec![VertexLock::Free; slots];
    for (h, &v) in welded.corner_vertex.iter().enumerate().rev() {
        let input = surface.triangles[welded.triangle_source[h / 3] as usize][h % 3];
        points[v.index()] = surface.points[input as usize];
        vertex_source[v.index()] = input;
        if welded.touching[v.index()] != NO_SET || surface.locked[input as usize] {
            locks[v.index()] = VertexLock::Locked;
        }
    }
    Mesh { connectivity, points, vertex_source, triangle_source: welded.triangle_source, locks }
}

/// Map each corner of the input to its wedge and vertex; `NONE` in dropped triangles.
fn map_input_corners<const K: usize>(
    mesh: &Mesh<3>,
    surface: &SeamSurface<K>,
    of_corner: &[u32],
) -> [Vec<u32>; 2] {
    let mut numbered = [0, 1].map(|_| vec![ABSENT; 3 * surface.triangles.len()]);
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
fn collect_corners<const D: usize, const K: usize>(
    mesh: &WholeMesh<3, RefusalReason>,
    records: &SurfaceState<'_, D, K>,
) -> (Vec<[f64; K]>, Vec<u32>) {
    let mut order: Vec<(u32, u32)> = mesh.triangle_source.iter().copied().zip(0..).collect();
    order.sort_unstable();
    let wedges =
        order.iter().flat_map(|&(_, t)| records.corners.get(t)).map(|&wedge| records.wedges.get(wedge));
    wedges.map(|wedge| (wedge.attributes, wedge.source)).unzip()
}

/// The surface before any collapse.
struct FitReference {
    points: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    locked: Vec<bool>,
}

impl FitReference {
    fn new(whole: &WholeMesh<3, RefusalReason>) -> Self {
        let WholeMesh { points, triangles, locked, .. } = whole;
        Self { points: points.clone(), triangles: triangles.clone(), locked: locked.clone() }
    }

    /// Fit the simplified surface to this one by least squares.
    ///
    /// Returns false if the fit was skipped, because sheets touch in a way that makes the indexed mesh
    /// non-manifold.
    fn fit(
        &self,
        compact: &mut CompactMesh<3>,
        logs: &[collapse_log::RegionLog<3>],
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
                light.locks[number] = VertexLock::Locked;
            }
        }
        // Collapses in different regions of a round are independent, so any order of the logs works.
        for merge in logs.iter().flat_map(|log| &log.merges).rev() {
            became[merge.removed.index()] = became[merge.survivor.index()];
        }
        let input = FitInput { points: &self.points, triangles: &self.triangles, vertex_map: &became };
        fit(&mut light, &input, threads, progress)?;
        compact.points = light.points;
        Ok(true)
    }
}
