//! Simplification of a mesh to its base mesh.

use super::base_mesh::{Base, Chain, Collapse};
use super::half_edge::{HalfEdge, Rule};
use super::needles;
use super::parameters::Parameter;
use super::surface::Surface;
use crate::base::errors::KernelError;
use crate::base::geometry::{around, diagonal};
use crate::base::progress::Progress;
use crate::collapse::engine::{Engine, Until};
use crate::mesh::triangle_mesh::Mesh;
use crate::subdivision::topology::NONE;

/// Shape rules, from strict to lenient. A rule applies once the stricter ones allow no more collapses.
pub const RULES: [Rule; 3] = [
    Rule { quality: 0.1, neighbours: 10 },
    Rule { quality: 0.05, neighbours: 12 },
    Rule { quality: 0.01, neighbours: 20 },
];
/// Trial refinements start when at most this many times the target triangle count is left. Earlier they would
/// cost much time and change little.
const CAREFUL: usize = 4;
/// Maximum cost of a collapse, relative to the fourth power of the bounding box diagonal: the target count
/// does not justify every collapse. `CHEAP` is the maximum without trial refinements.
pub const DEAR: f64 = 2e-5;
const CHEAP: f64 = 2e-8;

/// Stop criteria of the base; the first one reached applies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Maximum number of triangles.
    pub triangles: usize,
    /// Maximum RMS distance of a vertex from the planes that its quadric contains, in mesh units.
    pub error: f64,
    /// Continue above the cost limit, as long as all triangles of a collapse can be refined.
    pub at_any_price: bool,
}

/// Partly simplified mesh. From here on, collapses are checked by trial refinements.
#[derive(Clone)]
pub struct Coarse<'a> {
    mesh: Mesh<3>,
    measure: HalfEdge<'a>,
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
pub fn coarse<'a>(
    mesh: Mesh<3>,
    surface: &'a Surface,
    target: Target,
    refined: bool,
    progress: &mut Progress,
) -> Result<Coarse<'a>, KernelError> {
    let mut measure = HalfEdge::new(&mesh, surface, target.error, RULES[0]);
    let size = diagonal(&around(mesh.connectivity.vertices().map(|v| *mesh.point(v))));
    let unit = size.powi(4);
    measure.limit = CHEAP * unit;
    let is_base = !refined && mesh.connectivity.triangle_count() <= target.triangles;
    let coarse = Coarse { mesh, measure, unit, target, is_base, collapses: vec![] };
    if is_base {
        return Ok(coarse);
    }
    let wanted = target.triangles.saturating_mul(CAREFUL);
    coarse.collapsed(wanted, progress)?.without_needles().collapsed(wanted, progress)
}

impl Coarse<'_> {
    /// Collapse edges down to the base, or as far as the rules allow. `importance` weights the error at each
    /// input vertex. `number` gives the number of each original triangle in the associated sets.
    ///
    /// # Errors
    /// [`KernelError::Interrupted`].
    pub fn base(
        mut self,
        importance: &[f64],
        number: &[u32],
        progress: &mut Progress,
    ) -> Result<Base, KernelError> {
        self.measure.weigh(importance);
        (self.measure.careful, self.measure.limit) = (true, DEAR * self.unit);
        let wanted = self.target.triangles;
        self = self.collapsed(wanted, progress)?;
        (self.measure.strict, self.measure.limit) = (true, f64::INFINITY);
        for rule in RULES {
            if self.target.at_any_price && self.mesh.connectivity.triangle_count() > wanted {
                self.measure.rule = rule;
                self = self.collapsed(wanted, progress)?;
            }
        }
        if !self.is_base {
            self = self.without_needles();
        }
        Ok(described(&self.mesh, &self.measure, number, self.collapses))
    }

    fn without_needles(mut self) -> Self {
        let collapses = needles::remove(&mut self.mesh, &mut self.measure, CHEAP * self.unit);
        self.collapses.extend(collapses);
        self
    }

    fn collapsed(self, triangles: usize, progress: &mut Progress) -> Result<Self, KernelError> {
        let mut engine = Engine::new(self.mesh, self.measure);
        engine.run(Until { triangles, ..Until::EXHAUSTED }, progress)?;
        let (mesh, measure, _, merges, _) = engine.into_parts();
        let mut collapses = self.collapses;
        collapses.extend(merges.iter().map(Collapse::from));
        Ok(Self { mesh, measure, collapses, ..self })
    }
}

/// Extract the base from a simplified mesh. `number` gives the number of each original triangle in the
/// associated sets.
pub fn described(mesh: &Mesh<3>, measure: &HalfEdge<'_>, number: &[u32], collapses: Vec<Collapse>) -> Base {
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
    let mut parameters = vec![Parameter::NOWHERE; mesh.points.len()];
    for (v, parameter) in parameters.iter_mut().enumerate() {
        if let Some((at, corners)) = measure.parameters.of(v) {
            let triangle = new_number[at.triangle as usize];
            let of = |corner: u32| {
                let known = corners.iter().position(|&c| place[c as usize] == corner);
                known.map_or(0.0, |i| at.barycentric[i])
            };
            *parameter = Parameter { triangle, barycentric: compact.triangles[triangle as usize].map(of) };
        }
    }
    for (t, corners) in compact.triangles.iter().enumerate() {
        for (i, &v) in corners.iter().enumerate() {
            let source = compact.vertex_source[v as usize] as usize;
            parameters[source] = Parameter::corner(t as u32, i);
        }
    }
    Base {
        sets: measure.triangles.listed(connectivity.triangles().map(|t| t.index()), number),
        chains: chains.collect(),
        parameters,
        collapses,
        vertex_source: compact.vertex_source,
        triangles: compact.triangles,
    }
}
