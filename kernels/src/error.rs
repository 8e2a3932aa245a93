//! What the kernels refuse to work on; every message names the elements.

use std::fmt;

/// How many offenders a message lists before it only counts them.
const NAMED: usize = 5;

#[derive(Clone, Debug, PartialEq)]
pub enum KernelError {
    /// A triangle refers to a vertex that is not there.
    IndexOutOfRange { triangle: usize, vertex: i64, vertices: usize },
    /// A coordinate or attribute is infinite, not a number, or so large that its square overflows.
    NotFinite { vertex: usize },
    /// Edges with more than two triangles.
    NonManifoldEdges(Vec<[u32; 2]>),
    /// Edges whose two triangles run through them in the same direction.
    InconsistentEdges(Vec<[u32; 2]>),
    /// Vertices where two fans of triangles touch.
    PinchedVertices(Vec<u32>),
    /// More elements than 32-bit indices or the stated limit allow.
    TooManyTriangles { wanted: f64, limit: usize },
    /// The caller asked to stop.
    Interrupted,
}

impl fmt::Display for KernelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::IndexOutOfRange { triangle, vertex, vertices } => {
                write!(f, "triangle {triangle} uses vertex {vertex}, but there are only {vertices} vertices")
            }
            Self::NotFinite { vertex } => {
                write!(f, "vertex {vertex} has a value that is not finite or is beyond ±1e60")
            }
            Self::NonManifoldEdges(edges) => named(
                f,
                edges.len(),
                "edge",
                "belongs",
                "belong",
                "to more than two triangles",
                edges.iter().map(ends),
            ),
            Self::InconsistentEdges(edges) => named(
                f,
                edges.len(),
                "edge",
                "lies",
                "lie",
                "between triangles of opposite orientation",
                edges.iter().map(ends),
            ),
            Self::PinchedVertices(vertices) => named(
                f,
                vertices.len(),
                "vertex",
                "joins",
                "join",
                "fans of triangles that share no edge",
                vertices.iter().map(u32::to_string),
            ),
            Self::TooManyTriangles { wanted, limit } => {
                write!(f, "it takes at least {wanted:.0} triangles; the limit is {limit}")
            }
            Self::Interrupted => write!(f, "interrupted"),
        }
    }
}

impl std::error::Error for KernelError {}

fn ends(edge: &[u32; 2]) -> String {
    format!("{}–{}", edge[0], edge[1])
}

fn named(
    f: &mut fmt::Formatter<'_>,
    count: usize,
    noun: &str,
    verb: &str,
    verb_plural: &str,
    what: &str,
    names: impl Iterator<Item = String>,
) -> fmt::Result {
    let shown: Vec<String> = names.take(NAMED).collect();
    let more = if count > NAMED { ", …" } else { "" };
    let plural = match (noun, count) {
        (_, 1) => noun,
        ("vertex", _) => "vertices",
        _ => "edges",
    };
    let verb = if count == 1 { verb } else { verb_plural };
    write!(f, "{count} {plural} {verb} {what} ({}{more})", shown.join(", "))
}
