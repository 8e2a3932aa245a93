//! Z-order of vertices and triangles, for meshes stored in random order.

use crate::base::geometry::{Vec3, bounding_box};

/// Bits per coordinate. With 2¹⁰ cells along the longest side, a cell contains few vertices of a surface.
const COORDINATE_BITS: u32 = 10;

/// Sort vertices along the Z-order curve (Morton, "A computer oriented geodetic data base", 1966) of a grid
/// over their bounding box, and triangles by their first vertex in that order. Returns the input indices of
/// both; ties keep the input order. Indices must be in range.
pub fn compute_spatial_order(points: &[Vec3], triangles: &[[u32; 3]]) -> (Vec<u32>, Vec<u32>) {
    let [low, high] = bounding_box(points.iter().copied());
    let longest = (0..3).map(|i| high[i] - low[i]).fold(0.0, f64::max);
    let cells = f64::from(1u32 << COORDINATE_BITS);
    // The maximum coordinate belongs to the last cell; a mesh without extent has a single cell.
    let cell = |x: f64| (x / longest * cells).min(cells - 1.0) as u64;
    let place = |p: &Vec3| (0..3).map(|i| spread_bits(cell(p[i] - low[i])) << i).sum::<u64>();
    let mut keys: Vec<u64> = points.iter().zip(0..).map(|(p, v): (_, u64)| place(p) << 32 | v).collect();
    keys.sort_unstable();
    let vertices: Vec<u32> = keys.iter().map(|&key| key as u32).collect();
    let mut number = vec![0u32; points.len()];
    for (new, &v) in (0..).zip(&vertices) {
        number[v as usize] = new;
    }
    (vertices, sort_by_first_vertex(triangles, &number))
}

/// Insert two zeros after each of the low ten bits.
fn spread_bits(x: u64) -> u64 {
    let x = (x | x << 16) & 0x0300_00ff;
    let x = (x | x << 8) & 0x0300_f00f;
    let x = (x | x << 4) & 0x030c_30c3;
    (x | x << 2) & 0x0924_9249
}

/// Sort triangles by the minimum new index of their vertices, by counting sort.
fn sort_by_first_vertex(triangles: &[[u32; 3]], number: &[u32]) -> Vec<u32> {
    let first = |t: &[u32; 3]| t.map(|v| number[v as usize]).into_iter().fold(u32::MAX, u32::min) as usize;
    let mut next = vec![0u32; number.len() + 1];
    let firsts: Vec<u32> = triangles.iter().map(|t| first(t) as u32).collect();
    firsts.iter().for_each(|&v| next[v as usize + 1] += 1);
    (0..number.len()).for_each(|v| next[v + 1] += next[v]);
    let mut order = vec![0u32; triangles.len()];
    for (t, &v) in (0..).zip(&firsts) {
        let place = &mut next[v as usize];
        order[*place as usize] = t;
        *place += 1;
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_spread() {
        for bit in 0..10 {
            assert_eq!(spread_bits(1 << bit), 1 << (3 * bit));
        }
        assert_eq!(spread_bits(1023).count_ones(), 10);
    }

    #[test]
    fn neighbours_in_space_become_neighbours_in_memory() {
        // A row of points in scrambled order, with a triangle on each three consecutive points.
        let n = 97;
        let scrambled: Vec<u32> = (0..n).map(|i| i * 31 % n).collect();
        let points: Vec<Vec3> = scrambled.iter().map(|&x| [f64::from(x), 0.0, 0.0]).collect();
        let mut at = vec![0; n as usize];
        (0..n).for_each(|v| at[scrambled[v as usize] as usize] = v);
        let triangles: Vec<[u32; 3]> =
            (0..n - 2).map(|i| i * 17 % (n - 2)).map(|i| [0, 1, 2].map(|k| at[(i + k) as usize])).collect();
        let (vertices, order) = compute_spatial_order(&points, &triangles);
        assert_eq!(vertices, at);
        let firsts: Vec<u32> = order.iter().map(|&t| scrambled[triangles[t as usize][0] as usize]).collect();
        assert_eq!(firsts, (0..n - 2).collect::<Vec<_>>());
    }

    #[test]
    fn a_mesh_without_extent_keeps_its_order() {
        let (vertices, triangles) = compute_spatial_order(&[[1.0; 3]; 4], &[[1, 2, 3], [0, 1, 2]]);
        assert_eq!((vertices, triangles), (vec![0, 1, 2, 3], vec![1, 0]));
        assert_eq!(compute_spatial_order(&[], &[]), (vec![], vec![]));
    }
}
