//! Welding of duplicated vertices.
//!
//! Two triangles are joined if exactly two of equal orientation meet at an edge between two sets. If more
//! triangles meet, those with the same file vertices at the edge are joined if there are exactly two; the
//! others stay open there. Sheets that still touch at an edge or a vertex without being joined must not move,
//! or the surface would come apart.

use crate::base::errors::KernelError;
use crate::base::ids::{HalfedgeId, VertexId};
use crate::mesh::connectivity::Connectivity;
use crate::mesh::connectivity_builder::check_indices;

/// Marks a vertex without a set, which may move.
pub const NO_SET: u32 = u32::MAX;

/// A surface after welding.
pub struct Welded {
    /// Vertex at the origin of each halfedge.
    pub corner_vertex: Vec<VertexId>,
    /// Opposite halfedge of each halfedge.
    twins: Vec<HalfedgeId>,
    /// Input triangle of each triangle; triangles with two corners in one set are dropped.
    pub triangle_source: Vec<u32>,
    /// By vertex: its set if it touches other vertices of that set without being joined.
    pub touching: Vec<u32>,
}

impl Welded {
    pub fn connectivity(&self) -> Connectivity {
        Connectivity::from_twins(self.touching.len(), &self.corner_vertex, &self.twins)
    }
}

/// Weld the vertices of each set.
///
/// # Errors
/// An index out of range, or more triangles than the maximum.
pub fn weld(sets: &[u32], triangles: &[[u32; 3]]) -> Result<Welded, KernelError> {
    check_indices(sets.len(), triangles)?;
    let has_area = |&t: &u32| {
        let [a, b, c] = triangles[t as usize].map(|v| sets[v as usize]);
        a != b && b != c && c != a
    };
    let triangle_source: Vec<u32> = (0..triangles.len() as u32).filter(has_area).collect();
    let corners: Vec<u32> = triangle_source.iter().flat_map(|&t| triangles[t as usize]).collect();
    let set_count = sets.iter().max().map_or(0, |&s| s as usize + 1);
    let corner_set: Vec<u32> = corners.iter().map(|&v| sets[v as usize]).collect();
    let (mut twins, mut torn) = find_twins(&corner_set, &corners, set_count);
    let set = |h: usize| corner_set[h] as usize;
    // Two triangles back to back are not a surface.
    let across = |h: HalfedgeId| set(Connectivity::prev(h).index());
    for h in (0..twins.len()).map(HalfedgeId::from_index) {
        let twin = twins[h.index()];
        if twin.is_some() && across(h) == across(twin) {
            [twins[h.index()], twins[twin.index()]] = [HalfedgeId::NONE; 2];
            [torn[h.index()], torn[twin.index()]] = [true; 2];
        }
    }

    let (mut corner_vertex, mut vertex_count) = assign_vertices(&twins);
    if make_edges_unique(&corner_vertex, &mut twins, &mut torn) {
        (corner_vertex, vertex_count) = assign_vertices(&twins);
    }
    let mut fan_of_set = vec![VertexId::NONE; set_count];
    let mut set_touches = vec![false; set_count];
    for (h, &v) in corner_vertex.iter().enumerate() {
        let set = set(h);
        if fan_of_set[set].is_none() {
            fan_of_set[set] = v;
        }
        let before = Connectivity::prev(HalfedgeId::from_index(h)).index();
        set_touches[set] |= fan_of_set[set] != v || torn[h] || torn[before];
    }
    let mut touching = vec![NO_SET; vertex_count];
    for (h, &v) in corner_vertex.iter().enumerate() {
        if set_touches[set(h)] {
            touching[v.index()] = set(h) as u32;
        }
    }
    Ok(Welded { corner_vertex, twins, triangle_source, touching })
}

/// Find the twin of each halfedge, and mark halfedges where more than two meet.
///
/// `sets` and `corners` are the set and the file vertex at the origin of each halfedge.
fn find_twins(sets: &[u32], corners: &[u32], set_count: usize) -> (Vec<HalfedgeId>, Vec<bool>) {
    let end = |h: u32| Connectivity::next(HalfedgeId(h)).index();
    let upwards = |h: u32| sets[h as usize] < sets[end(h)];
    let file_edge = |h: u32| {
        let (a, b) = (corners[h as usize], corners[end(h)]);
        if upwards(h) { (a, b) } else { (b, a) }
    };
    let (by_end, starts) = sort_halfedges(sets, set_count);
    let mut twins = vec![HalfedgeId::NONE; sets.len()];
    let mut torn = vec![false; sets.len()];
    // Twins if there are exactly two halfedges, in opposite directions.
    let mut join = |halfedges: &[u32]| match *halfedges {
        [g, h] if upwards(g) != upwards(h) => {
            (twins[g as usize], twins[h as usize]) = (HalfedgeId(h), HalfedgeId(g));
            true
        }
        _ => false,
    };
    let mut edge: Vec<u32> = vec![];
    for around in starts.windows(2).map(|range| &by_end[range[0] as usize..range[1] as usize]) {
        for same in around.chunk_by(|g, h| g >> 32 == h >> 32).filter(|same| same.len() > 1) {
            edge.clear();
            edge.extend(same.iter().map(|&key| key as u32));
            if !join(&edge) {
                edge.iter().for_each(|&h| torn[h as usize] = true);
                edge.sort_unstable_by_key(|&h| (file_edge(h), h));
                for own in edge.chunk_by(|&g, &h| file_edge(g) == file_edge(h)) {
                    join(own);
                }
            }
        }
    }
    (twins, torn)
}

/// Sort halfedges by the lower of their two sets, then by the higher and by index.
///
/// Returns higher set and index of each as one number, and the start of each lower set.
fn sort_halfedges(sets: &[u32], set_count: usize) -> (Vec<u64>, Vec<u32>) {
    let ends = |h: usize| (sets[h], sets[Connectivity::next(HalfedgeId::from_index(h)).index()]);
    // A counting sort takes linear time; a group is as small as the degree of a vertex.
    let mut starts = vec![0u32; set_count + 1];
    for h in 0..sets.len() {
        let (a, b) = ends(h);
        starts[a.min(b) as usize + 1] += 1;
    }
    for set in 0..set_count {
        starts[set + 1] += starts[set];
    }
    let mut next = starts.clone();
    let mut sorted = vec![0u64; sets.len()];
    for h in 0..sets.len() {
        let (a, b) = ends(h);
        let place = &mut next[a.min(b) as usize];
        sorted[*place as usize] = u64::from(a.max(b)) << 32 | h as u64;
        *place += 1;
    }
    for range in starts.windows(2) {
        sorted[range[0] as usize..range[1] as usize].sort_unstable();
    }
    (sorted, starts)
}

/// Make edges unique by their vertices. Returns true if anything changed.
///
/// Two open sides between the same vertices are joined, as at the common edge of two boxes. Where two edges
/// would still have the same vertices, fans are split into single triangles. More than two triangles meet
/// there, so no vertex around it moves.
fn make_edges_unique(corner_vertex: &[VertexId], twins: &mut [HalfedgeId], torn: &mut [bool]) -> bool {
    let ends = |h: usize| {
        let [a, b] = [h, Connectivity::next(HalfedgeId::from_index(h)).index()].map(|h| corner_vertex[h]);
        [a.min(b), a.max(b)]
    };
    // Only edges where more than two triangles meet, or with two open sides, can be ambiguous.
    let open = |h: &usize| torn[*h];
    let mut sides: Vec<([VertexId; 2], usize)> =
        (0..twins.len()).filter(open).map(|h| (ends(h), h)).collect();
    sides.sort_unstable();
    let (mut apart, mut joined): (Vec<VertexId>, Vec<[usize; 2]>) = (vec![], vec![]);
    for same in sides.chunk_by(|g, h| g.0 == h.0) {
        let apex = |h: usize| corner_vertex[Connectivity::prev(HalfedgeId::from_index(h)).index()];
        let is_one_edge = same.len() == 1 || (same.len() == 2 && twins[same[0].1].index() == same[1].1);
        if let [(_, g), (_, h)] = *same
            && [g, h].iter().all(|&h| twins[h].is_none())
            && corner_vertex[g] != corner_vertex[h]
            && apex(g) != apex(h)
        {
            joined.push([g, h]);
        } else if !is_one_edge {
            apart.push(same[0].0[0]);
        }
    }
    for [g, h] in &joined {
        (twins[*g], twins[*h]) = (HalfedgeId::from_index(*h), HalfedgeId::from_index(*g));
    }
    apart.sort_unstable();
    for h in 0..twins.len() {
        let next = Connectivity::next(HalfedgeId::from_index(h)).index();
        if !apart.is_empty() && [h, next].iter().any(|&h| apart.binary_search(&corner_vertex[h]).is_ok()) {
            (twins[h], torn[h]) = (HalfedgeId::NONE, true);
        }
    }
    !apart.is_empty() || !joined.is_empty()
}

/// Assign a vertex to every corner: corners connected through joined triangles share one. Also returns the
/// count.
fn assign_vertices(twins: &[HalfedgeId]) -> (Vec<VertexId>, usize) {
    let mut vertex = vec![VertexId::NONE; twins.len()];
    let mut count = 0;
    for start in 0..twins.len() {
        if vertex[start].is_some() {
            continue;
        }
        let v = VertexId::from_index(count);
        count += 1;
        // Counter-clockwise first, then clockwise if that ends at an open edge.
        let mut h = HalfedgeId::from_index(start);
        while h.is_some() && vertex[h.index()].is_none() {
            vertex[h.index()] = v;
            h = twins[Connectivity::prev(h).index()];
        }
        let mut across = twins[start];
        while across.is_some() && vertex[Connectivity::next(across).index()].is_none() {
            let h = Connectivity::next(across);
            vertex[h.index()] = v;
            across = twins[h.index()];
        }
    }
    (vertex, count)
}
