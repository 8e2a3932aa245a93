//! Assembly of the mesh of a front of the tree, with each node partly refined by vertex splits.

/// Node of the front.
#[derive(Clone, Copy, Debug)]
pub struct FrontNode {
    /// Range of its triangles in the hierarchy: first index and count.
    pub start: usize,
    pub count: usize,
    /// Vertices with a smaller index exist after the node's splits.
    pub vertex_limit: u32,
}

/// Triangles of the front, and the vertices they use in ascending order.
pub struct FrontMesh {
    pub vertices: Vec<u32>,
    pub triangles: Vec<[u32; 3]>,
    /// Index of each triangle in the hierarchy.
    pub source: Vec<u32>,
}

/// Assemble the mesh of a front. `corners` holds three vertex indices per triangle of the hierarchy. Indices
/// must be in range, and `origin[v]` must be below `roots` + v.
pub fn build_front_mesh(corners: &[u32], origin: &[u32], roots: u32, front: &[FrontNode]) -> FrontMesh {
    let vertices = roots as usize + origin.len();
    let count = front.iter().map(|open| open.count).sum();
    let mut triangles = Vec::with_capacity(count);
    let mut source = Vec::with_capacity(count);
    let mut is_used = vec![false; vertices];
    for open in front {
        let mut up = |mut v: u32| {
            while v >= open.vertex_limit {
                v = origin[(v - roots) as usize];
            }
            is_used[v as usize] = true;
            v
        };
        let there = &corners[3 * open.start..3 * (open.start + open.count)];
        triangles.extend(there.chunks_exact(3).map(|t| [up(t[0]), up(t[1]), up(t[2])]));
        source.extend((open.start as u32..).take(open.count));
    }
    let mut number = vec![0; vertices];
    let mut used = vec![];
    for v in (0..vertices).filter(|&v| is_used[v]) {
        number[v] = used.len() as u32;
        used.push(v as u32);
    }
    triangles.iter_mut().flatten().for_each(|v| *v = number[*v as usize]);
    FrontMesh { vertices: used, triangles, source }
}
