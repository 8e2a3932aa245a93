//! Marching-cubes triangle table: triangles of a cube, by the signs of its eight voxels.
//!
//! On a face whose two diagonal voxels are behind the surface, these two are kept separate. Each face is cut
//! by its own four signs only, so both adjacent cubes cut it identically. The cuts on the faces of a cube
//! form loops. Loops are triangulated without diagonals inside a face: the adjacent cube could choose the
//! same diagonal, and the edge would have four triangles. The result is therefore manifold by construction.
//! The table of Lorensen and Cline (1987) has holes at ambiguous faces, and repaired tables have such
//! diagonals.

use std::sync::LazyLock;

/// Corners of a cube. The bits of a corner index are x, y, z.
pub const CORNER_COUNT: usize = 8;
/// Edges of a cube: four along each axis.
pub const EDGE_COUNT: usize = 12;

/// Axis and lower corner of each edge.
pub const EDGE_CORNERS: [(usize, usize); EDGE_COUNT] = {
    let mut edges = [(0, 0); EDGE_COUNT];
    let (mut axis, mut count) = (0, 0);
    while axis < 3 {
        let mut corner = 0;
        while corner < CORNER_COUNT {
            if corner >> axis & 1 == 0 {
                edges[count] = (axis, corner);
                count += 1;
            }
            corner += 1;
        }
        axis += 1;
    }
    edges
};

/// Triangles of all 256 sign patterns, as edge indices, counterclockwise seen from in front of the surface.
pub struct CubeTable {
    starts: [u16; 257],
    triangles: Vec<[u8; 3]>,
}

/// The triangle table, computed on first use.
pub static CUBE_TABLE: LazyLock<CubeTable> = LazyLock::new(CubeTable::new);

impl CubeTable {
    fn new() -> Self {
        let (mut starts, mut triangles) = ([0; 257], vec![]);
        for behind in 0..256 {
            for around in find_cut_loops(behind) {
                let is_filled = triangulate_loop(&around, 0, around.len() - 1, &mut triangles);
                debug_assert!(is_filled, "cube {behind} has a loop that cannot be filled");
            }
            starts[behind + 1] = triangles.len() as u16;
        }
        Self { starts, triangles }
    }

    /// Return the triangles of a cube. Bit `c` of `behind` is set if corner `c` is behind the surface.
    #[inline]
    pub fn triangles(&self, behind: u8) -> &[[u8; 3]] {
        let behind = usize::from(behind);
        &self.triangles[usize::from(self.starts[behind])..usize::from(self.starts[behind + 1])]
    }
}

/// List the corners of a face, counterclockwise seen from outside.
fn face_corners(number: usize) -> [usize; 4] {
    let (axis, is_upper) = (number / 2, number % 2);
    let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
    let base = is_upper << axis;
    if is_upper == 1 {
        [base, base | u, base | u | v, base | v]
    } else {
        [base, base | v, base | u | v, base | u]
    }
}

fn edge_between(a: usize, b: usize) -> u8 {
    let axis = (a ^ b).trailing_zeros() as usize;
    (0..EDGE_COUNT).find(|&e| EDGE_CORNERS[e] == (axis, a & b)).unwrap_or(0) as u8
}

/// Find the loops of cut edges, in the orientation of the triangles.
fn find_cut_loops(behind: usize) -> Vec<Vec<u8>> {
    const NONE: u8 = u8::MAX;
    let mut next = [NONE; EDGE_COUNT];
    for number in 0..6 {
        let corners = face_corners(number);
        let is_behind = |i: usize| behind >> corners[i % 4] & 1 == 1;
        // Each run of corners behind the surface is cut off by one segment, from the edge before the run to
        // the edge after it.
        for last in (0..4).filter(|&i| is_behind(i) && !is_behind(i + 1)) {
            let mut first = last;
            while is_behind(first + 3) {
                first = (first + 3) % 4;
            }
            let ends = edge_between(corners[last], corners[(last + 1) % 4]);
            let begins = edge_between(corners[(first + 3) % 4], corners[first]);
            next[usize::from(begins)] = ends;
        }
    }
    let mut found = vec![];
    for start in 0..EDGE_COUNT {
        let (mut around, mut at) = (vec![], start);
        while next[at] != NONE {
            around.push(at as u8);
            at = usize::from(std::mem::replace(&mut next[at], NONE));
        }
        if !around.is_empty() {
            found.push(around);
        }
    }
    found
}

/// Triangulate the part of a loop from position `i` to `j`; return false if that requires a diagonal inside a
/// face.
fn triangulate_loop(around: &[u8], i: usize, j: usize, triangles: &mut Vec<[u8; 3]>) -> bool {
    if j - i < 2 {
        return true;
    }
    let is_allowed = |a: usize, b: usize| b - a < 2 || !share_face(around[a], around[b]);
    let before = triangles.len();
    for middle in i + 1..j {
        if is_allowed(i, middle)
            && is_allowed(middle, j)
            && triangulate_loop(around, i, middle, triangles)
            && triangulate_loop(around, middle, j, triangles)
        {
            triangles.push([around[i], around[middle], around[j]]);
            return true;
        }
        triangles.truncate(before);
    }
    false
}

/// Check whether two edges belong to a common face.
fn share_face(a: u8, b: u8) -> bool {
    let has = |corners: &[usize; 4], e: u8| {
        let (axis, lower) = EDGE_CORNERS[usize::from(e)];
        corners.contains(&lower) && corners.contains(&(lower | 1 << axis))
    };
    (0..6).map(face_corners).any(|corners| has(&corners, a) && has(&corners, b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cube_is_filled_with_its_loops_as_the_only_border() {
        for behind in 0..=255_u8 {
            let mut sides: Vec<(u8, u8)> = vec![];
            for t in CUBE_TABLE.triangles(behind) {
                for k in 0..3 {
                    let side = (t[k], t[(k + 1) % 3]);
                    if let Some(other) = sides.iter().position(|&s| s == (side.1, side.0)) {
                        sides.swap_remove(other);
                        assert!(!share_face(side.0, side.1), "cube {behind:08b}, diagonal {side:?}");
                    } else {
                        sides.push(side);
                    }
                }
            }
            let mut border: Vec<(u8, u8)> = find_cut_loops(usize::from(behind))
                .iter()
                .flat_map(|l| (0..l.len()).map(|k| (l[k], l[(k + 1) % l.len()])))
                .collect();
            sides.sort_unstable();
            border.sort_unstable();
            assert_eq!(sides, border, "cube {behind:08b}");
        }
    }

    #[test]
    fn every_edge_between_a_corner_before_and_one_behind_is_cut_and_no_other() {
        for behind in 0..=255_u8 {
            let cut = CUBE_TABLE.triangles(behind).iter().flatten().fold(0_u16, |cut, e| cut | 1 << e);
            for (e, (axis, lower)) in EDGE_CORNERS.into_iter().enumerate() {
                let differs = (behind >> lower ^ behind >> (lower | 1 << axis)) & 1;
                assert_eq!(cut >> e & 1, u16::from(differs), "cube {behind:08b}, edge {e}");
            }
        }
    }

    #[test]
    fn triangles_look_to_the_side_before_the_surface() {
        // Corner 0 is behind the surface; seen from corner 7, its triangle is counterclockwise.
        let [[a, b, c]] = CUBE_TABLE.triangles(1) else { panic!("one triangle") };
        let place = |e: &u8| {
            let (axis, lower) = EDGE_CORNERS[usize::from(*e)];
            std::array::from_fn::<f64, 3, _>(|k| (lower >> k & 1) as f64 + if k == axis { 0.5 } else { 0.0 })
        };
        let [a, b, c] = [a, b, c].map(place);
        let [u, v]: [[f64; 3]; 2] = [b, c].map(|p| std::array::from_fn(|k| p[k] - a[k]));
        let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        assert!(normal.iter().all(|&n| n > 0.0), "{normal:?}");
    }
}
