//! Connectivity with a point of R^D at every vertex: three coordinates, then D − 3 attributes.

use crate::base::errors::KernelError;
use crate::base::ids::{EdgeId, TriangleId, VertexId};
use crate::mesh::connectivity::Connectivity;

/// Beyond this the products of four lengths in the area and fold tests come near the end of double precision.
const LARGEST: f64 = 1e60;

/// Whether a vertex may move.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Lock {
    #[default]
    Free,
    /// It stays where it is; others may collapse into it.
    Locked,
    /// It lies on the rim of a region, and more triangles touch it than this mesh knows: no edge of it collapses.
    Rim,
}

/// A triangle mesh whose elements know which element of the input they came from.
#[derive(Clone, Debug)]
pub struct Mesh<const D: usize> {
    pub connectivity: Connectivity,
    pub points: Vec<[f64; D]>,
    /// Input vertex of each vertex. The vertex of a split takes that of one end of the edge.
    pub vertex_source: Vec<u32>,
    /// Input triangle of each triangle.
    pub triangle_source: Vec<u32>,
    pub locks: Vec<Lock>,
}

/// What is left of a mesh, numbered without gaps, in the order of the input.
#[derive(Clone, Debug, PartialEq)]
pub struct Compact<const D: usize> {
    pub points: Vec<[f64; D]>,
    pub triangles: Vec<[u32; 3]>,
    pub vertex_source: Vec<u32>,
    pub triangle_source: Vec<u32>,
}

/// Where the vertices and triangles of a mesh came from.
#[derive(Clone, Debug, PartialEq)]
pub struct Sources {
    pub vertices: Vec<u32>,
    pub triangles: Vec<u32>,
}

impl<const D: usize> Compact<D> {
    /// The same with the sources of its sources, if they have any.
    pub fn traced_to(mut self, origin: &Option<Sources>) -> Self {
        if let Some(origin) = origin {
            self.vertex_source.iter_mut().for_each(|v| *v = origin.vertices[*v as usize]);
            self.triangle_source.iter_mut().for_each(|t| *t = origin.triangles[*t as usize]);
        }
        self
    }
}

/// # Errors
/// [`KernelError::NotFinite`] for a value that is not finite or is beyond ±1e60.
pub fn check_points<const D: usize>(points: &[[f64; D]]) -> Result<(), KernelError> {
    // NaN fails the comparison too. To look at all is faster than to stop at the first that fails.
    if points.as_flattened().iter().fold(true, |sound, x| sound & (x.abs() <= LARGEST)) {
        return Ok(());
    }
    match points.iter().position(|p| !p.iter().all(|x| x.abs() <= LARGEST)) {
        Some(vertex) => Err(KernelError::NotFinite { vertex }),
        None => Ok(()),
    }
}

impl<const D: usize> Mesh<D> {
    /// Connect triangles. One that names a vertex twice has no area and no side: it is left out.
    ///
    /// # Errors
    /// As [`Connectivity::from_triangles`], and for a value that is not finite or is beyond ±1e60.
    pub fn new(points: Vec<[f64; D]>, triangles: &[[u32; 3]]) -> Result<Self, KernelError> {
        Self::new_on(1, points, triangles)
    }

    /// The same on several threads.
    ///
    /// # Errors
    /// As [`Mesh::new`].
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
        let locks = vec![Lock::Free; points.len()];
        Ok(Self { connectivity, points, vertex_source, triangle_source: kept, locks })
    }

    #[inline]
    pub fn lock(&self, v: VertexId) -> Lock {
        self.locks[v.index()]
    }

    /// Which ends of an edge a collapse must leave where they are: locked ones, and on the boundary those of an
    /// edge that is not.
    #[inline]
    pub fn staying_ends(&self, edge: EdgeId) -> [bool; 2] {
        let inside = !self.connectivity.is_boundary_edge(edge);
        self.connectivity
            .ends(edge)
            .map(|v| self.lock(v) == Lock::Locked || (inside && self.connectivity.is_boundary_vertex(v)))
    }

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
    ) -> crate::mesh::connectivity::Collapsed {
        self.points[survivor.index()] = point;
        self.connectivity.collapse(edge, survivor)
    }

    /// Split `edge` at its midpoint; attributes take the mean of the ends. Returns the new edges.
    pub fn split(&mut self, edge: EdgeId) -> [EdgeId; 3] {
        let [a, b] = self.connectivity.ends(edge);
        let first = self.connectivity.halfedge(edge);
        let beside = [first, self.connectivity.twin(first)];
        let (pa, pb) = (*self.point(a), *self.point(b));
        self.points.push(std::array::from_fn(|i| 0.5 * (pa[i] + pb[i])));
        self.vertex_source.push(self.vertex_source[a.index()]);
        self.locks.push(Lock::Free);
        for h in beside.into_iter().filter(|h| h.is_some()) {
            self.triangle_source.push(self.triangle_source[Connectivity::triangle(h).index()]);
        }
        self.connectivity.split(edge).1
    }

    /// The result without gaps; vertices that no triangle uses are left out.
    pub fn compact(&self) -> Compact<D> {
        let mut number = vec![0u32; self.points.len()];
        let mut out =
            Compact { points: vec![], triangles: vec![], vertex_source: vec![], triangle_source: vec![] };
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

    /// Corner points of a triangle.
    pub fn triangle_points(&self, t: TriangleId) -> [[f64; D]; 3] {
        self.connectivity.corners(t).map(|v| *self.point(v))
    }
}
