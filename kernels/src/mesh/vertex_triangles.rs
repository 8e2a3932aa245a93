//! Triangles around each vertex, for meshes without halfedges.

/// Triangles around each vertex, ascending, one vertex after another.
pub struct VertexTriangles {
    starts: Vec<u32>,
    triangles: Vec<u32>,
}

impl VertexTriangles {
    /// Sort the triangles of a mesh by their vertices (counting sort).
    pub fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let mut starts = vec![0; vertices + 1];
        triangles.as_flattened().iter().for_each(|&v| starts[v as usize + 1] += 1);
        (0..vertices).for_each(|v| starts[v + 1] += starts[v]);
        let mut free = starts.clone();
        let mut around = vec![0; 3 * triangles.len()];
        for (t, corners) in triangles.iter().enumerate() {
            for &v in corners {
                around[free[v as usize] as usize] = t as u32;
                free[v as usize] += 1;
            }
        }
        Self { starts, triangles: around }
    }

    /// Return the triangles around a vertex.
    #[inline]
    pub fn around(&self, v: u32) -> &[u32] {
        &self.triangles[self.starts[v as usize] as usize..self.starts[v as usize + 1] as usize]
    }
}
