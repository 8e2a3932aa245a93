//! Collapsing a mesh to its base.

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

/// What shapes are usable: the next row counts where the one before leads no further.
pub const RULES: [Rule; 3] = [
    Rule { quality: 0.1, neighbours: 10 },
    Rule { quality: 0.05, neighbours: 12 },
    Rule { quality: 0.01, neighbours: 20 },
];
/// Triangles are tried out once there are at most so many times those wanted.
const CAREFUL: usize = 4;
/// The dearest collapse, as a part of the diagonal's fourth power: a base of some size is not worth any price. And the
/// dearest without trying its triangles out.
pub const DEAR: f64 = 2e-5;
const CHEAP: f64 = 2e-8;

/// How far the base goes: whatever comes first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// At most so many triangles.
    pub triangles: usize,
    /// Root of the mean squared distance from the planes a vertex stands for.
    pub error: f64,
    /// Go on beyond what is dear, as long as all triangles of a collapse can be refined.
    pub at_any_price: bool,
}

/// A mesh on its way to the base, coarse enough that from here on it pays to try triangles out.
#[derive(Clone)]
pub struct Coarse<'a> {
    mesh: Mesh<3>,
    measure: HalfEdge<'a>,
    /// Of costs.
    unit: f64,
    target: Target,
    /// Whether it is the base already, and no levels will come: then needles stay, too.
    is_base: bool,
    /// What has made it of the input.
    collapses: Vec<Collapse>,
}

/// Collapse as far as no care is needed. A mesh that is not `refined` afterwards stays as it is if no triangle has to go.
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
    /// Collapse to the base, or as far as can be. `importance` is by how much the error at each vertex of the input
    /// counts; `number` gives the number of each original triangle in the sets.
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

/// The base that a mesh has become. `number` gives the number of each original triangle in the sets.
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
