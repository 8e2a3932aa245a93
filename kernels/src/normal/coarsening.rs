//! Simplification of a mesh to its base mesh.

use super::base_mesh::{Base, Chain, Collapse};
use super::base_parametrization::BasePoint;
use super::half_edge_measure::{HalfEdgeMeasure, ShapeRule};
use super::needle_removal;
use super::surface::Surface;
use crate::base::errors::KernelError;
use crate::base::geometry::{bounding_box, diagonal};
use crate::base::progress::Progress;
use crate::collapse::engine::{Engine, StopCriteria};
use crate::mesh::triangle_mesh::Mesh;
use crate::subdivision::topology::NONE;

/// Shape rules, from strict to lenient. A rule applies once the stricter ones allow no more collapses.
pub const RULES: [ShapeRule; 3] = [
    ShapeRule { min_quality: 0.1, max_valence: 10 },
    ShapeRule { min_quality: 0.05, max_valence: 12 },
    ShapeRule { min_quality: 0.01, max_valence: 20 },
];
/// Trial refinements start when at most this many times the target triangle count is left. Earlier they would
/// cost much time and change little.
const TRIAL_TRIANGLE_FACTOR: usize = 4;
/// Maximum cost of a collapse, relative to the fourth power of the bounding box diagonal: the target count
/// does not justify every collapse. `MAX_UNTESTED_COST` is the maximum without trial refinements.
pub const MAX_COLLAPSE_COST: f64 = 2e-5;
const MAX_UNTESTED_COST: f64 = 2e-8;

/// Stop criteria of the base; the first one reached applies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Maximum number of triangles.
    pub triangles: usize,
    /// Maximum RMS distance of a vertex from the planes that its quadric contains, in mesh units.
    pub error: f64,
    /// Continue above the cost limit, as long as all triangles of a collapse can be refined.
    pub ignore_cost_limit: bool,
}

/// Partly simplified mesh. From here on, collapses are checked by trial refinements.
#[derive(Clone)]
pub struct CoarseMesh<'a> {
    mesh: Mesh<3>,
    measure: HalfEdgeMeasure<'a>,
    /// Unit of costs: the fourth power of the bounding box diagonal.
    unit: f64,
    target: Target,
    /// True if the mesh already is the base and no levels follow. Its needles are then kept.
    is_base: bool,
    /// Collapses from the input to this mesh, in order.
    collapses: Vec<Collapse>,
}

/// Collapse edges without trial refinements. A mesh that gets no levels (not `refined`) and already meets the
/// triangle target is left unchanged.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn coarsen<'a>(
    mesh: Mesh<3>,
    surface: &'a Surface,
    target: Target,
    refined: bool,
    progress: &mut Progress,
) -> Result<CoarseMesh<'a>, KernelError> {
    let mut measure = HalfEdgeMeasure::new(&mesh, surface, target.error, RULES[0]);
    let size = diagonal(&bounding_box(mesh.connectivity.vertices().map(|v| *mesh.point(v))));
    let unit = size.powi(4);
    measure.limit = MAX_UNTESTED_COST * unit;
    let is_base = !refined && mesh.connectivity.triangle_count() <= target.triangles;
    let coarse = CoarseMesh { mesh, measure, unit, target, is_base, collapses: vec![] };
    if is_base {
        return Ok(coarse);
    }
    let wanted = target.triangles.saturating_mul(TRIAL_TRIANGLE_FACTOR);
    coarse.collapse_to(wanted, progress)?.remove_needles().collapse_to(wanted, progress)
}

impl CoarseMesh<'_> {
    /// Collapse edges down to the base, or as far as the rules allow. `importance` weights the error at each
    /// input vertex. `number` gives the number of each original triangle in the associated sets.
    ///
    /// # Errors
    /// [`KernelError::Interrupted`].
    pub fn build_base(
        mut self,
        importance: &[f64],
        number: &[u32],
        progress: &mut Progress,
    ) -> Result<Base, KernelError> {
        self.measure.apply_importance(importance);
        (self.measure.run_trials, self.measure.limit) = (true, MAX_COLLAPSE_COST * self.unit);
        let wanted = self.target.triangles;
        self = self.collapse_to(wanted, progress)?;
        (self.measure.strict, self.measure.limit) = (true, f64::INFINITY);
        for rule in RULES {
            if self.target.ignore_cost_limit && self.mesh.connectivity.triangle_count() > wanted {
                self.measure.rule = rule;
                self = self.collapse_to(wanted, progress)?;
            }
        }
        if !self.is_base {
            self = self.remove_needles();
        }
        Ok(extract_base(&self.mesh, &self.measure, number, self.collapses))
    }

    fn remove_needles(mut self) -> Self {
        let collapses =
            needle_removal::remove_needles(&mut self.mesh, &mut self.measure, MAX_UNTESTED_COST * self.unit);
        self.collapses.extend(collapses);
        self
    }

    fn collapse_to(self, triangles: usize, progress: &mut Progress) -> Result<Self, KernelError> {
        let mut engine = Engine::new(self.mesh, self.measure);
        engine.run(StopCriteria { triangles, ..StopCriteria::EXHAUSTED }, progress)?;
        let (mesh, measure, _, merges, _) = engine.into_parts();
        let mut collapses = self.collapses;
        collapses.extend(merges.iter().map(Collapse::from));
        Ok(Self { mesh, measure, collapses, ..self })
    }
}

/// Extract the base from a simplified mesh. `number` gives the number of each original triangle in the
/// associated sets.
pub fn extract_base(
    mesh: &Mesh<3>,
    measure: &HalfEdgeMeasure<'_>,
    number: &[u32],
    collapses: Vec<Collapse>,
) -> Base {
    let connectivity = &mesh.connectivity;
    let compact = mesh.compact();
    let mut place = vec![NONE; mesh.points.len()];
    connectivity.vertices().enumerate().for_each(|(i, v)| place[v.index()] = i as u32);
    let mut new_number = vec![NONE; connectivity.triangle_slots()];
    connectivity.triangles().enumerate().for_each(|(i, t)| new_number[t.index()] = i as u32);

    let chains = connectivity.edges().filter(|&e| connectivity.is_boundary_edge(e)).map(|edge| Chain {
        ends: connectivity.ends(edge).map(|v| place[v.index()]),
        halfedges: measure.chains.halfedges(edge),
    });
    let mut parameters = vec![BasePoint::UNDEFINED; mesh.points.len()];
    for (v, parameter) in parameters.iter_mut().enumerate() {
        if let Some((at, corners)) = measure.parametrization.of(v) {
            let triangle = new_number[at.triangle as usize];
            let of = |corner: u32| {
                let known = corners.iter().position(|&c| place[c as usize] == corner);
                known.map_or(0.0, |i| at.barycentric[i])
            };
            *parameter = BasePoint { triangle, barycentric: compact.triangles[triangle as usize].map(of) };
        }
    }
    for (t, corners) in compact.triangles.iter().enumerate() {
        for (i, &v) in corners.iter().enumerate() {
            let source = compact.vertex_source[v as usize] as usize;
            parameters[source] = BasePoint::from_corner(t as u32, i);
        }
    }
    Base {
        sets: measure.triangles.list_members(connectivity.triangles().map(|t| t.index()), number),
        chains: chains.collect(),
        base_points: parameters,
        collapses,
        vertex_source: compact.vertex_source,
        triangles: compact.triangles,
    }
}
