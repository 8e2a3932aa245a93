//! Triangle mesh with a point of R^D per vertex: three coordinates and D − 3 attributes.

use crate::base::errors::KernelError;
use crate::base::ids::{EdgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;

/// Maximum absolute value. Above it, products of four lengths in the area and fold tests could overflow
/// double precision.
const MAX_COORDINATE: f64 = 1e60;

/// Restriction on the movement of a vertex.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum VertexLock {
    #[default]
    Free,
    /// The vertex is fixed; others may collapse into it.
    Locked,
    /// The vertex is on the rim of a region and has more triangles outside it. None of its edges may
    /// collapse.
    Rim,
}

/// Triangle mesh that records the input element of every element.
#[derive(Clone, Debug)]
pub struct Mesh<const D: usize> {
    pub connectivity: Connectivity,
    pub points: Vec<[f64; D]>,
    /// Input vertex of each vertex. The vertex of a split inherits from one end of the edge.
    pub vertex_source: Vec<u32>,
    /// Input triangle of each triangle.
    pub triangle_source: Vec<u32>,
    pub locks: Vec<VertexLock>,
}

/// Remaining elements of a mesh, numbered without gaps in input order.
#[derive(Clone, Debug, PartialEq)]
pub struct CompactMesh<const D: usize> {
    pub points: Vec<[f64; D]>,
    pub triangles: Vec<[u32; 3]>,
    pub vertex_source: Vec<u32>,
    pub triangle_source: Vec<u32>,
}

/// Input vertices and triangles of a mesh's elements.
#[derive(Clone, Debug, PartialEq)]
pub struct ElementSources {
    pub vertices: Vec<u32>,
    pub triangles: Vec<u32>,
}

impl<const D: usize> CompactMesh<D> {
    /// Replace the sources by the sources of `origin`, if given.
    pub fn with_sources_of(mut self, origin: &Option<ElementSources>) -> Self {
        if let Some(origin) = origin {
            self.vertex_source.iter_mut().for_each(|v| *v = origin.vertices[*v as usize]);
            self.triangle_source.iter_mut().for_each(|t| *t = origin.triangles[*t as usize]);
        }
        self
    }
}

/// Check that all values are finite and within ±1e60.
///
/// # Errors
/// [`KernelError::NotFinite`].
pub fn check_points<const D: usize>(points: &[[f64; D]]) -> Result<(), KernelError> {
    // NaN fails the comparison, too. Testing all values without an early exit is faster, because the loop is
    // vectorised.
    if points.as_flattened().iter().fold(true, |sound, x| sound & (x.abs() <= MAX_COORDINATE)) {
        return Ok(());
    }
    match points.iter().position(|p| !p.iter().all(|x| x.abs() <= MAX_COORDINATE)) {
        Some(vertex) => Err(KernelError::NotFinite { vertex }),
        None => Ok(()),
    }
}

impl<const D: usize> Mesh<D> {
    /// Build a mesh. Triangles with repeated vertices are dropped.
    ///
    /// # Errors
    /// As [`Connectivity::from_triangles`] and [`check_points`].
    pub fn new(points: Vec<[f64; D]>, triangles: &[[u32; 3]]) -> Result<Self, KernelError> {
        Self::new_on(1, points, triangles)
    }

    /// Build a mesh on several threads.
    pub fn new_on(
        threads: usize,
        points: Vec<[f64; D]>,
        triangles: &[[u32; 3]],
    ) -> Result<Self, KernelError> {
        const { assert!(D >= 3, "a point has three coordinates") };
        check_points(&points)?;
        let proper = |t: &[u32; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
        let all = 0..triangles.len() as u32;
        let (connectivity, kept) = if triangles.iter().all(proper) {
            (Connectivity::from_triangles_on(threads, points.len(), triangles)?, all.collect())
        } else {
            let kept: Vec<u32> = all.filter(|&t| proper(&triangles[t as usize])).collect();
            let proper: Vec<[u32; 3]> = kept.iter().map(|&t| triangles[t as usize]).collect();
            (Connectivity::from_triangles_on(threads, points.len(), &proper)?, kept)
        };
        let vertex_source = (0..points.len() as u32).collect();
        let locks = vec![VertexLock::Free; points.len()];
        Ok(Self { connectivity, points, vertex_source, triangle_source: kept, locks })
    }

    /// Return the lock of a vertex.
    #[inline]
    pub fn lock(&self, v: VertexId) -> VertexLock {
        self.locks[v.index()]
    }

    /// Return for each end of an edge whether a collapse must keep it in place: locked vertices, and boundary
    /// vertices of an interior edge.
    #[inline]
    pub fn fixed_ends(&self, edge: EdgeId) -> [bool; 2] {
        let inside = !self.connectivity.is_boundary_edge(edge);
        self.connectivity.ends(edge).map(|v| {
            self.lock(v) == VertexLock::Locked || (inside && self.connectivity.is_boundary_vertex(v))
        })
    }

    /// Return the point of a vertex.
    #[inline]
    pub fn point(&self, v: VertexId) -> &[f64; D] {
        &self.points[v.index()]
    }

    /// Collapse `edge` into its end `survivor`, which moves to `point`.
    pub fn collapse(
        &mut self,
        edge: EdgeId,
        survivor: VertexId,
        point: [f64; D],
    ) -> crate::mesh::connectivity::CollapseChange {
        self.points[survivor.index()] = point;
        self.connectivity.collapse(edge, survivor)
    }

    /// Split `edge` at its midpoint; the attributes are the mean of the ends. Returns the new edges.
    ///
    /// The new vertex is locked if both ends are: where sheets touch along an edge, each has the same vertices.
    pub fn split(&mut self, edge: EdgeId) -> [EdgeId; 3] {
        let [a, b] = self.connectivity.ends(edge);
        let first = self.connectivity.halfedge(edge);
        let beside = [first, self.connectivity.twin(first)];
        let (pa, pb) = (*self.point(a), *self.point(b));
        self.points.push(std::array::from_fn(|i| 0.5 * (pa[i] + pb[i])));
        self.vertex_source.push(self.vertex_source[a.index()]);
        let is_locked = [a, b].iter().all(|&end| self.lock(end) == VertexLock::Locked);
        self.locks.push(if is_locked { VertexLock::Locked } else { VertexLock::Free });
        for h in beside.into_iter().filter(|h| h.is_some()) {
            self.triangle_source.push(self.triangle_source[Connectivity::triangle(h).index()]);
        }
        self.connectivity.split(edge).1
    }

    /// Extract the remaining elements, numbered without gaps; unused vertices are dropped.
    pub fn compact(&self) -> CompactMesh<D> {
        let mut number = vec![0u32; self.points.len()];
        let mut out =
            CompactMesh { points: vec![], triangles: vec![], vertex_source: vec![], triangle_source: vec![] };
        for v in self.connectivity.vertices() {
            number[v.index()] = out.points.len() as u32;
            out.points.push(*self.point(v));
            out.vertex_source.push(self.vertex_source[v.index()]);
        }
        for t in self.connectivity.triangles() {
            out.triangles.push(self.connectivity.corners(t).map(|v| number[v.index()]));
            out.triangle_source.push(self.triangle_source[t.index()]);
        }
        out
    }

    /// Return the corner points of a triangle.
    pub fn triangle_points(&self, t: TriangleId) -> [[f64; D]; 3] {
        self.connectivity.corners(t).map(|v| *self.point(v))
    }
}
