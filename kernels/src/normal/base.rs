//! The base mesh, and what every triangle and boundary edge of it stands for.

use super::associated::Sets;
use super::half_edge::{HalfEdge, Rule};
use super::parameters::Parameter;
use super::surface::Surface;
use super::topology::NONE;
use crate::engine::{Engine, Until};
use crate::error::KernelError;
use crate::geometry::{around, diagonal};
use crate::ids::HalfedgeId;
use crate::mesh::Mesh;
use crate::progress::Progress;

/// What shapes are usable: the next row counts where the one before leads no further at any cost.
const RULES: [Rule; 3] = [
    Rule { quality: 0.1, neighbours: 10 },
    Rule { quality: 0.05, neighbours: 12 },
    Rule { quality: 0.01, neighbours: 20 },
];
/// Triangles are tried out once there are at most so many times those wanted.
const CAREFUL: usize = 8;
/// The dearest collapse rises from turn to turn by this.
const RISE: f64 = 3.0;
/// It starts from this part of the diagonal's fourth power, below what single precision tells apart, and ends here.
/// What is dearer goes only if all its triangles can be refined: a base of a given size is not worth any price.
const START: f64 = 1e-18;
const DEAR: f64 = 2e-5;

/// How far the base goes: whatever comes first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// At most so many triangles.
    pub triangles: usize,
    /// Root of the mean squared distance from the planes a vertex stands for.
    pub error: f64,
}

/// A base mesh and what it stands for.
#[derive(Clone, Debug)]
pub struct Base {
    /// The input's vertex that each base vertex is.
    pub vertex_source: Vec<u32>,
    pub triangles: Vec<[u32; 3]>,
    /// Of each triangle: original triangles, in the numbering asked for.
    pub sets: Sets,
    pub chains: Vec<Chain>,
    /// Where each vertex of the input lies. No triangle for those that none uses.
    pub parameters: Vec<Parameter>,
}

/// What a boundary edge of the base stands for.
#[derive(Clone, Debug)]
pub struct Chain {
    /// The base vertices it joins.
    pub ends: [u32; 2],
    /// Boundary halfedges of the input from the first to the second.
    pub halfedges: Vec<HalfedgeId>,
}

impl Base {
    /// The same with other numbers: `vertices` and `triangles` give the old number of each new one, `corners` the new
    /// triangles, which may start from another corner.
    pub fn reordered(self, vertices: &[u32], triangles: &[u32], corners: &[[u32; 3]]) -> Self {
        let mut new_vertex = vec![NONE; self.vertex_source.len()];
        vertices.iter().enumerate().for_each(|(new, &old)| new_vertex[old as usize] = new as u32);
        let mut new_triangle = vec![NONE; self.triangles.len()];
        triangles.iter().enumerate().for_each(|(new, &old)| new_triangle[old as usize] = new as u32);
        let moved = |parameter: &Parameter| {
            if parameter.triangle == NONE {
                return Parameter::NOWHERE;
            }
            let was = self.triangles[parameter.triangle as usize].map(|v| new_vertex[v as usize]);
            let triangle = new_triangle[parameter.triangle as usize];
            let first = corners[triangle as usize].map(|v| was.iter().position(|&w| w == v).unwrap_or(0));
            Parameter { triangle, barycentric: first.map(|i| parameter.barycentric[i]) }
        };
        Self {
            parameters: self.parameters.iter().map(moved).collect(),
            vertex_source: vertices.iter().map(|&v| self.vertex_source[v as usize]).collect(),
            triangles: corners.to_vec(),
            sets: self.sets.reordered(triangles),
            chains: self
                .chains
                .into_iter()
                .map(|chain| Chain { ends: chain.ends.map(|v| new_vertex[v as usize]), ..chain })
                .collect(),
        }
    }
}

/// Collapse as far as asked, or as can be. The cost of a collapse depends on more than its edge, so the order is kept
/// by a limit that rises: what is dearer than that waits. `importance` is by how much each triangle's error counts;
/// `number` gives the number of each original triangle in the sets.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn base(
    mut mesh: Mesh<3>,
    surface: &Surface,
    importance: &[f64],
    target: Target,
    number: &[u32],
    progress: &mut Progress,
) -> Result<Base, KernelError> {
    let mut measure = HalfEdge::new(&mesh, surface, importance, target.error, RULES[0]);
    let size = diagonal(&around(mesh.connectivity.vertices().map(|v| *mesh.point(v))));
    let unit = size.powi(4);
    let many = target.triangles.saturating_mul(CAREFUL);
    measure.limit = START * unit;
    let mut rules = RULES.iter();
    while mesh.connectivity.triangle_count() > target.triangles {
        measure.careful = mesh.connectivity.triangle_count() <= many;
        let triangles = if measure.careful || measure.strict { target.triangles } else { many };
        let mut engine = Engine::new(mesh, measure);
        let until = Until { triangles, priority: engine.measure().limit, ..Until::EXHAUSTED };
        engine.run(until, progress)?;
        (mesh, measure, ..) = engine.into_parts();
        if mesh.connectivity.triangle_count() <= triangles {
            continue;
        }
        if measure.strict {
            let Some(&rule) = rules.next() else { break };
            measure.rule = rule;
        } else if measure.limit > DEAR * unit {
            (measure.strict, measure.limit) = (true, f64::INFINITY);
        } else {
            measure.limit *= RISE;
        }
    }
    Ok(described(&mesh, &measure, number))
}

fn described(mesh: &Mesh<3>, measure: &HalfEdge<'_>, number: &[u32]) -> Base {
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
        vertex_source: compact.vertex_source,
        triangles: compact.triangles,
    }
}
