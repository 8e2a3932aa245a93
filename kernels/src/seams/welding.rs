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

/// Connectivity of a surface after welding.
pub struct Welded {
    pub connectivity: Connectivity,
    /// Vertex at the origin of each halfedge.
    pub corner_vertex: Vec<VertexId>,
    /// Input triangle of each triangle; triangles with two corners in one set are dropped.
    pub triangle_source: Vec<u32>,
    /// By vertex: its set if it touches other vertices of that set without being joined.
    pub touching: Vec<u32>,
}

/// A halfedge between two sets: (higher set and file vertices), index, and true if it runs from the lower set
/// to the higher.
type HalfedgeKey = ((u32, u32, u32), u32, bool);

/// Weld the vertices of each set, and build the connectivity.
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
    let kept: Vec<[u32; 3]> = triangle_source.iter().map(|&t| triangles[t as usize]).collect();
    let set_count = sets.iter().max().map_or(0, |&s| s as usize + 1);
    let corner = |h: u32| kept[h as usize / 3][h as usize % 3];
    let set = |h: usize| sets[corner(h as u32) as usize] as usize;
    let (mut twins, mut torn) =
        find_twins(3 * kept.len(), set_count, |h| (set(h as usize) as u32, corner(h)));
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
    let connectivity = Connectivity::from_twins(vertex_count, &corner_vertex, &twins);
    Ok(Welded { connectivity, corner_vertex, triangle_source, touching })
}

/// Find the twin of each halfedge, and mark halfedges where more than two meet. `origin` returns set and
/// vertex.
fn find_twins(count: usize, sets: usize, origin: impl Fn(u32) -> (u32, u32)) -> (Vec<HalfedgeId>, Vec<bool>) {
    let ends = |h: u32| {
        let (a, b) = (origin(h), origin(Connectivity::next(HalfedgeId(h)).0));
        if a.0 < b.0 { (a, b, true) } else { (b, a, false) }
    };
    // Group by the lower set in linear time; a group is as small as the degree of a vertex.
    let mut group = vec![0u32; sets + 1];
    for h in 0..count as u32 {
        group[ends(h).0.0 as usize + 1] += 1;
    }
    for set in 0..sets {
        group[set + 1] += group[set];
    }
    let mut fill = group.clone();
    let mut sorted: Vec<HalfedgeKey> = vec![((0, 0, 0), 0, false); count];
    for h in 0..count as u32 {
        let (low, high, upwards) = ends(h);
        let place = &mut fill[low.0 as usize];
        sorted[*place as usize] = ((high.0, low.1, high.1), h, upwards);
        *place += 1;
    }
    let mut twins = vec![HalfedgeId::NONE; count];
    let mut torn = vec![false; count];
    for low in 0..sets {
        let around = &mut sorted[group[low] as usize..group[low + 1] as usize];
        around.sort_unstable();
        for same in around.chunk_by(|g, h| g.0.0 == h.0.0) {
            if same.len() > 1 && !join_twins(same, &mut twins) {
                for own in same.chunk_by(|g, h| g.0 == h.0) {
                    join_twins(own, &mut twins);
                }
                same.iter().for_each(|&(_, h, _)| torn[h as usize] = true);
            }
        }
    }
    (twins, torn)
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

/// Make two sides twins if there are exactly two, in opposite directions.
fn join_twins(sides: &[HalfedgeKey], twins: &mut [HalfedgeId]) -> bool {
    match *sides {
        [(_, g, up), (_, h, also_up)] if up != also_up => {
            twins[g as usize] = HalfedgeId(h);
            twins[h as usize] = HalfedgeId(g);
            true
        }
        _ => false,
    }
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
