//! Adjacent triangles of any mesh. Edges of more than two non-degenerate triangles have no neighbours.

/// Marker for no triangle.
pub const NO_TRIANGLE: u32 = u32::MAX;

/// Find the triangle across the edge that begins at each corner. `sizes` are areas; triangles with area 0 are
/// ignored.
pub fn find_neighbours(triangles: &[[u32; 3]], sizes: &[f64]) -> Vec<[u32; 3]> {
    let mut sides: Vec<(u64, u32)> = (0..3 * triangles.len())
        .filter(|side| sizes[side / 3] > 0.0)
        .map(|side| {
            let (a, b) = (triangles[side / 3][side % 3], triangles[side / 3][(side + 1) % 3]);
            (u64::from(a.min(b)) << 32 | u64::from(a.max(b)), side as u32)
        })
        .collect();
    sides.sort_unstable();
    let mut across = vec![[NO_TRIANGLE; 3]; triangles.len()];
    for sides in sides.chunk_by(|a, b| a.0 == b.0) {
        if let [(_, a), (_, b)] = *sides {
            across[a as usize / 3][a as usize % 3] = b / 3;
            across[b as usize / 3][b as usize % 3] = a / 3;
        }
    }
    across
}
