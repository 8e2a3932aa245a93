//! Weld, collapse, and give out what is left.

use super::record::Log;
use super::state::{Knobs, Rule, Seams};
use super::surface::Surface;
use super::weld;
use crate::base::errors::KernelError;
use crate::base::geometry::Vec3;
use crate::base::ids::VertexId;
use crate::base::progress::Progress;
use crate::collapse::engine::{Engine, Merge, Refusal, Stop};
use crate::fitting::fit::{Input, fit};
use crate::mesh::legality::Illegal;
use crate::mesh::triangle_mesh::{Compact, Lock, Mesh, check_points};

/// What is left of a surface.
#[derive(Clone, Debug)]
pub struct Outcome<const K: usize> {
    pub points: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    pub corners: Vec<[f64; K]>,
    /// The corner of the input (3 × triangle + corner) that has this corner's attributes to the bit, if one has.
    pub corner_source: Vec<u32>,
    pub vertex_source: Vec<u32>,
    pub triangle_source: Vec<u32>,
    pub stop: Stop,
    pub refused: Vec<(&'static str, usize)>,
    pub collapses: usize,
    pub attempts: u64,
    /// Largest distance in the image between a seam and what it was, as a length.
    pub seam_drift: f64,
    pub is_fitted: bool,
    pub log: Option<Log<K>>,
}

/// Edges worked on at a time: what is known of them and around them fits into the caches.
const WINDOW: usize = 6144;

/// How far to go, and what to do besides.
#[derive(Clone, Copy, Debug)]
pub struct Goal {
    /// Collapse until at most this many triangles are left.
    pub triangles: usize,
    /// Move vertices along their normals to fit the input at the end.
    pub fit: bool,
    pub record: bool,
    /// For the fit.
    pub threads: usize,
}

/// Collapse as far as the goal says.
///
/// # Errors
/// [`KernelError`] for an index out of range, a value that is not finite, or when interrupted.
pub fn simplify<const D: usize, const K: usize>(
    surface: Surface<K>,
    knobs: Knobs,
    goal: Goal,
    progress: &mut Progress,
) -> Result<Outcome<K>, KernelError> {
    let target = goal.triangles;
    check_points(&surface.points)?;
    check_points(&surface.corners)?;
    let welded = weld::weld(&surface.sets, &surface.triangles)?;
    progress.check()?;
    let triangles = welded.connectivity.triangle_count();
    let slots = welded.connectivity.vertex_slots();
    let mut points = vec![[0.0; 3]; slots];
    let mut vertex_source = vec![0; slots];
    let mut locks = vec![Lock::Free; slots];
    for (h, &v) in welded.corner_vertex.iter().enumerate().rev() {
        let input = surface.triangles[welded.triangle_source[h / 3] as usize][h % 3];
        points[v.index()] = surface.points[input as usize];
        vertex_source[v.index()] = input;
        if welded.tie[v.index()] != weld::UNTIED || surface.locked[input as usize] {
            locks[v.index()] = Lock::Locked;
        }
    }
    let mesh = Mesh {
        connectivity: welded.connectivity,
        points,
        vertex_source,
        triangle_source: welded.triangle_source,
        locks,
    };
    let measure = Seams::<D, K>::new(&mesh, &surface, welded.tie, knobs, goal.record);
    let given = goal.fit.then(|| Given::new(&mesh));
    let mut engine = Engine::new(mesh, measure);
    progress.tell(0, triangles.saturating_sub(target) as u64)?;
    let stop = engine.run_by_windows(target, WINDOW, progress)?;
    gathered(engine, stop, given, goal.threads, progress)
}

/// The surface before any collapse.
struct Given {
    points: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

impl Given {
    fn new(mesh: &Mesh<3>) -> Self {
        let corners = |t| mesh.connectivity.corners(t).map(|v| v.0);
        Self { points: mesh.points.clone(), triangles: mesh.connectivity.triangles().map(corners).collect() }
    }

    /// Move what became of it along its normals, to fit it by least squares. Whether that was done: not where sheets
    /// touch in a way that their vertices alone do not tell.
    fn fit(
        &self,
        mesh: &Mesh<3>,
        compact: &mut Compact<3>,
        merges: &[Merge],
        threads: usize,
        progress: &Progress,
    ) -> Result<bool, KernelError> {
        let Ok(mut light) = Mesh::new(compact.points.clone(), &compact.triangles) else {
            return Ok(false);
        };
        let mut became = vec![VertexId::NONE; self.points.len()];
        for (number, v) in mesh.connectivity.vertices().enumerate() {
            became[v.index()] = VertexId::from_index(number);
            light.locks[number] = mesh.lock(v);
        }
        for merge in merges.iter().rev() {
            became[merge.removed.index()] = became[merge.survivor.index()];
        }
        let input = Input { points: &self.points, triangles: &self.triangles, became: &became };
        fit(&mut light, &input, threads, progress)?;
        compact.points = light.points;
        Ok(true)
    }
}

fn gathered<const D: usize, const K: usize>(
    engine: Engine<3, Seams<D, K>>,
    stop: Stop,
    given: Option<Given>,
    threads: usize,
    progress: &Progress,
) -> Result<Outcome<K>, KernelError> {
    let attempts = engine.attempts();
    let (mesh, measure, refusals, merges, _) = engine.into_parts();
    let mut compact = mesh.compact();
    let is_fitted = match given.filter(|_| !merges.is_empty() && stop != Stop::Enough) {
        Some(given) => given.fit(&mesh, &mut compact, &merges, threads, progress)?,
        None => false,
    };
    let mut corners = Vec::with_capacity(3 * compact.triangles.len());
    let mut corner_source = Vec::with_capacity(3 * compact.triangles.len());
    for t in mesh.connectivity.triangles() {
        for corner in 0..3 {
            let (attributes, source) = measure.corner(t, corner);
            corners.push(attributes);
            corner_source.push(source);
        }
    }
    let mut refused: Vec<(&'static str, usize)> =
        ["topology", "bridge", "locked", "fold", "seam", "chart", "drift"].map(|name| (name, 0)).into();
    for edge in mesh.connectivity.edges() {
        let rule = match refusals[edge.index()] {
            Some(Refusal::Illegal(Illegal::Topology)) => 0,
            Some(Refusal::Illegal(Illegal::Bridge)) => 1,
            Some(Refusal::Illegal(Illegal::Locked)) => 2,
            Some(Refusal::Illegal(Illegal::Fold)) => 3,
            Some(Refusal::Barred(bound) | Refusal::Bound(bound)) => match bound {
                Rule::Locked => 2,
                Rule::Fold => 3,
                Rule::Seam => 4,
                Rule::Chart => 5,
                Rule::Drift => 6,
            },
            _ => continue,
        };
        refused[rule].1 += 1;
    }
    Ok(Outcome {
        is_fitted,
        points: compact.points,
        triangles: compact.triangles,
        corners,
        corner_source,
        vertex_source: compact.vertex_source,
        triangle_source: compact.triangle_source,
        stop,
        refused,
        collapses: merges.len(),
        attempts,
        seam_drift: measure.largest_drift(),
        log: measure.into_log(),
    })
}
