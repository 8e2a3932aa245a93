//! Errors of the kernels. Messages list the affected vertices, edges or triangles.

use std::fmt;

/// Elements that a message lists before it only counts them.
const MAX_LISTED: usize = 5;

/// Error of a kernel: invalid input, exceeded limit, lack of memory, or interruption.
#[derive(Clone, Debug, PartialEq)]
pub enum KernelError {
    /// A triangle refers to a vertex that does not exist.
    IndexOutOfRange { triangle: usize, vertex: i64, vertices: usize },
    /// A coordinate or attribute is infinite, NaN, or so large that its square overflows.
    NotFinite { vertex: usize },
    /// Edges with more than two triangles.
    NonManifoldEdges(Vec<[u32; 2]>),
    /// Edges whose two triangles traverse them in the same direction.
    InconsistentEdges(Vec<[u32; 2]>),
    /// Two triangles with the same three vertices. Each edge is manifold, but a split of one edge would
    /// duplicate the others.
    SameVertices(Vec<[u32; 2]>),
    /// Vertices that join several fans of triangles which share no edge.
    PinchedVertices(Vec<u32>),
    /// More elements than 32-bit indices or the given limit allow.
    TooManyTriangles { wanted: f64, limit: usize },
    /// More voxel blocks than the memory limit allows.
    TooManyBlocks { wanted: usize, limit: usize },
    /// A voxel is more than this number of blocks from the origin of the volume.
    OutOfBlockRange { blocks: usize },
    /// The mesh is too small or too large, or the tolerance too fine, for the quantised coordinates of the
    /// file.
    UnrepresentableExtent { diagonal: f64 },
    /// A normal mesh cannot be written.
    NotEncodable(&'static str),
    /// The system is out of memory.
    OutOfMemory,
    /// The caller interrupted the run.
    Interrupted,
}

impl KernelError {
    /// Return true if the run was interrupted or ran out of memory; false if the input is invalid.
    pub fn is_aborted(&self) -> bool {
        matches!(self, Self::Interrupted | Self::OutOfMemory)
    }
}

impl fmt::Display for KernelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::IndexOutOfRange { triangle, vertex, vertices } => {
                write!(
                    f,
                    "triangle {triangle} has vertex index {vertex}, but the mesh has only {vertices} vertices"
                )
            }
            Self::NotFinite { vertex } => {
                write!(f, "vertex {vertex} has a value that is not finite, or is beyond ±1e60")
            }
            Self::NonManifoldEdges(edges) => {
                let phrases =
                    ["edge belongs to more than two triangles", "edges belong to more than two triangles"];
                write_listed(f, phrases, edges.iter().map(format_pair))
            }
            Self::InconsistentEdges(edges) => {
                let phrases = [
                    "edge joins triangles of opposite orientation",
                    "edges join triangles of opposite orientation",
                ];
                write_listed(f, phrases, edges.iter().map(format_pair))
            }
            Self::SameVertices(pairs) => {
                let phrases =
                    ["pair of triangles has the same vertices", "pairs of triangles have the same vertices"];
                write_listed(f, phrases, pairs.iter().map(format_pair))
            }
            Self::PinchedVertices(vertices) => {
                let phrases = [
                    "vertex joins fans of triangles that share no edge",
                    "vertices join fans of triangles that share no edge",
                ];
                write_listed(f, phrases, vertices.iter().map(u32::to_string))
            }
            Self::TooManyTriangles { wanted, limit } => {
                write!(f, "the result needs at least {wanted:.0} triangles; the limit is {limit}")
            }
            Self::TooManyBlocks { wanted, limit } => {
                write!(f, "the volume needs {wanted} voxel blocks; the limit is {limit}")
            }
            Self::OutOfBlockRange { blocks } => {
                write!(f, "a surface point is more than {blocks} voxel blocks from the origin")
            }
            Self::UnrepresentableExtent { diagonal } => write!(
                f,
                "the bounding-box diagonal of the mesh is {diagonal:e}; the file format cannot represent it at this tolerance"
            ),
            Self::NotEncodable(why) => write!(f, "the normal mesh cannot be written: {why}"),
            Self::OutOfMemory => write!(f, "not enough memory"),
            Self::Interrupted => write!(f, "interrupted"),
        }
    }
}

impl std::error::Error for KernelError {}

fn format_pair(pair: &[u32; 2]) -> String {
    format!("{}–{}", pair[0], pair[1])
}

fn write_listed(
    f: &mut fmt::Formatter<'_>,
    [one, many]: [&str; 2],
    names: impl ExactSizeIterator<Item = String>,
) -> fmt::Result {
    let count = names.len();
    let phrase = if count == 1 { one } else { many };
    let more = if count > MAX_LISTED { ", …" } else { "" };
    write!(f, "{count} {phrase} ({}{more})", names.take(MAX_LISTED).collect::<Vec<_>>().join(", "))
}
