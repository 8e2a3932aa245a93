//! The whole mesh between two rounds.

use crate::base::errors::KernelError;
use crate::collapse::engine::Refusal;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::connectivity_builder::check_indices;
use crate::mesh::triangle_mesh::{CompactMesh, ElementSources, Mesh, VertexLock, check_points};

/// By corner of a triangle: the reason why the edge that starts there cannot collapse.
pub type CornerRefusals<B> = [Option<Refusal<B>>; 3];

/// The whole mesh between two rounds.
pub struct WholeMesh<const D: usize, B> {
    pub points: Vec<[f64; D]>,
    pub triangles: Vec<[u32; 3]>,
    /// Indices of the vertices and triangles in the initial mesh.
    pub vertex_source: Vec<u32>,
    pub triangle_source: Vec<u32>,
    /// Vertices that must not move; empty for none.
    pub locked: Vec<bool>,
    /// By triangle; empty before the first round.
    pub refused: Vec<CornerRefusals<B>>,
}

impl<const D: usize, B: Copy> WholeMesh<D, B> {
    /// Create from points and triangles.
    ///
    /// A triangle that uses a vertex twice has no area and is dropped. The rest must be an oriented manifold,
    /// which is checked when the mesh is cut into regions.
    ///
    /// # Errors
    /// An index out of range, or a value that is not finite or beyond ±1e60.
    pub fn new(
        points: Vec<[f64; D]>,
        mut triangles: Vec<[u32; 3]>,
        locked: Vec<bool>,
    ) -> Result<Self, KernelError> {
        check_points(&points)?;
        check_indices(points.len(), &triangles)?;
        let proper = |t: &[u32; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
        let triangle_source: Vec<u32> =
            (0..triangles.len() as u32).filter(|&t| proper(&triangles[t as usize])).collect();
        if triangle_source.len() < triangles.len() {
            triangles.retain(proper);
        }
        let vertex_source = (0..points.len() as u32).collect();
        Ok(Self { points, triangles, vertex_source, triangle_source, locked, refused: vec![] })
    }

    /// Convert to a mesh with halfedges, in one region.
    ///
    /// # Errors
    /// As [`Connectivity::from_triangles`].
    pub fn into_connected(self) -> Result<Mesh<D>, KernelError> {
        let locks = (0..self.points.len())
            .map(|v| if self.locked.get(v) == Some(&true) { VertexLock::Locked } else { VertexLock::Free })
            .collect();
        Ok(Mesh {
            connectivity: Connectivity::from_triangles(self.points.len(), &self.triangles)?,
            points: self.points,
            vertex_source: self.vertex_source,
            triangle_source: self.triangle_source,
            locks,
        })
    }

    /// Convert a halfedge mesh; also returns the sources of its vertices and triangles.
    pub fn from_mesh(mesh: Mesh<D>) -> (Self, ElementSources) {
        let corners = |t| mesh.connectivity.corners(t).map(|v| v.0);
        let triangles: Vec<[u32; 3]> = mesh.connectivity.triangles().map(corners).collect();
        let whole = Self {
            vertex_source: (0..mesh.points.len() as u32).collect(),
            triangle_source: (0..triangles.len() as u32).collect(),
            points: mesh.points,
            triangles,
            locked: mesh.locks.iter().map(|&lock| lock == VertexLock::Locked).collect(),
            refused: vec![],
        };
        (whole, ElementSources { vertices: mesh.vertex_source, triangles: mesh.triangle_source })
    }

    /// List the refusal of each edge that cannot collapse.
    pub fn refused_edges(&self) -> Vec<Refusal<B>> {
        let mut refused: Vec<(u32, u32, Refusal<B>)> = vec![];
        for (corners, refusals) in self.triangles.iter().zip(&self.refused) {
            for (corner, refusal) in refusals.iter().enumerate() {
                let (a, b) = (corners[corner], corners[(corner + 1) % 3]);
                refused.extend(refusal.map(|refusal| (a.min(b), a.max(b), refusal)));
            }
        }
        refused.sort_unstable_by_key(|edge| (edge.0, edge.1));
        refused.dedup_by_key(|edge| (edge.0, edge.1));
        refused.into_iter().map(|edge| edge.2).collect()
    }

    /// Convert to a compact mesh, sorted by source, without unused vertices.
    pub fn into_compact(self) -> CompactMesh<D> {
        let used = {
            let mut used = vec![false; self.points.len()];
            self.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
            used
        };
        let mut vertices: Vec<(u32, u32)> = (0..self.points.len() as u32)
            .filter(|&v| used[v as usize])
            .map(|v| (self.vertex_source[v as usize], v))
            .collect();
        vertices.sort_unstable();
        let mut number = vec![0u32; self.points.len()];
        for (new, &(_, v)) in vertices.iter().enumerate() {
            number[v as usize] = new as u32;
        }
        let mut triangles: Vec<(u32, u32)> =
            self.triangle_source.iter().zip(0..).map(|(&source, t)| (source, t)).collect();
        triangles.sort_unstable();
        CompactMesh {
            points: vertices.iter().map(|&(_, v)| self.points[v as usize]).collect(),
            triangles: triangles
                .iter()
                .map(|&(_, t)| self.triangles[t as usize].map(|v| number[v as usize]))
                .collect(),
            vertex_source: vertices.iter().map(|&(source, _)| source).collect(),
            triangle_source: triangles.iter().map(|&(source, _)| source).collect(),
        }
    }
}
