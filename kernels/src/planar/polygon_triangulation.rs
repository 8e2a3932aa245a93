//! Constrained Delaunay triangulation of a polygon with holes.
//!
//! The polygon is valid if its chords neither cross nor touch, and the area to their left is connected. The
//! number of triangles must be the one that its loops imply. Only then may the triangulation replace a patch.

use robust::{Coord, incircle, orient2d};
use spade::handles::FixedVertexHandle;
use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation};

use super::polygon::Polygon;

/// Triangles as indices of the polygon's corners.
pub type Triangles = Vec<[u32; 3]>;

/// Triangulation failure with the conflicting chords, given by their first corner; empty if unknown.
#[derive(Debug, PartialEq)]
pub struct InvalidPolygon(pub Vec<usize>);

/// Triangulate a polygon.
///
/// # Errors
/// [`InvalidPolygon`] if chords cross, or if the area to the left of the loops is not connected.
pub fn triangulate(polygon: &Polygon<'_>) -> Result<Triangles, InvalidPolygon> {
    let short: Vec<usize> = polygon.loops.iter().filter(|l| l.len() < 3).flat_map(Clone::clone).collect();
    if !short.is_empty() || polygon.loops.iter().any(|l| l.is_empty()) {
        return Err(InvalidPolygon(short));
    }
    match (polygon.loops.len(), polygon.corners.len()) {
        (1, 3) => triangulate_triangle(polygon),
        (1, 4) => triangulate_quad(polygon),
        _ => triangulate_delaunay(polygon),
    }
}

/// Check whether three corners are counter-clockwise.
pub fn is_counterclockwise(polygon: &Polygon<'_>, corners: [u32; 3]) -> bool {
    let [a, b, c] = corners.map(|i| to_coord(polygon, i));
    orient2d(a, b, c) > 0.0
}

fn to_coord(polygon: &Polygon<'_>, corner: u32) -> Coord<f64> {
    let [x, y] = polygon.corners[corner as usize].position;
    Coord { x, y }
}

fn triangulate_triangle(polygon: &Polygon<'_>) -> Result<Triangles, InvalidPolygon> {
    if is_counterclockwise(polygon, [0, 1, 2]) { Ok(vec![[0, 1, 2]]) } else { Err(InvalidPolygon(vec![])) }
}

fn triangulate_quad(polygon: &Polygon<'_>) -> Result<Triangles, InvalidPolygon> {
    let ways: [[[u32; 3]; 2]; 2] = [[[0, 1, 2], [0, 2, 3]], [[1, 2, 3], [1, 3, 0]]];
    let is_sound = ways.map(|way| way.into_iter().all(|t| is_counterclockwise(polygon, t)));
    let [a, b, c, d] = [0, 1, 2, 3].map(|i| to_coord(polygon, i));
    match is_sound {
        [true, true] => Ok(ways[usize::from(incircle(a, b, c, d) > 0.0)].to_vec()),
        [true, false] => Ok(ways[0].to_vec()),
        [false, true] => Ok(ways[1].to_vec()),
        [false, false] => Err(InvalidPolygon(vec![])),
    }
}

/// Displacement of coincident corners along their chord, relative to its length.
const COINCIDENT_SHIFT: f64 = 1e-6;

type Cdt = ConstrainedDelaunayTriangulation<Point2<f64>>;

fn triangulate_delaunay(polygon: &Polygon<'_>) -> Result<Triangles, InvalidPolygon> {
    let (own, first) = number_corners(polygon);
    let points = separate_positions(polygon, &first);
    let edges: Vec<[usize; 2]> =
        polygon.corners.iter().zip(&own).map(|(c, &from)| [from as usize, own[c.next] as usize]).collect();
    let mut conflicts = vec![];
    let cdt = Cdt::try_bulk_load_cdt(points, edges.clone(), |edge| conflicts.push(edge))
        .map_err(|_| InvalidPolygon(vec![]))?;
    if cdt.num_vertices() < first.len() {
        return Err(InvalidPolygon(vec![]));
    }
    if !conflicts.is_empty() {
        return Err(InvalidPolygon(find_crossed_chords(&cdt, &edges, &conflicts)));
    }
    let inside = find_inside(&cdt, &edges).map_err(InvalidPolygon)?;
    // V − E + F = 2 − loops, with all vertices on the border.
    let wanted = polygon.corners.len() + 2 * polygon.loops.len() - 4;
    if inside.len() != wanted {
        return Err(InvalidPolygon(vec![]));
    }
    Ok(inside.into_iter().map(|t| t.map(|v| first[v])).collect())
}

/// Number the corners so that loops touching at a vertex share a number. Also returns the first corner of
/// each number.
fn number_corners(polygon: &Polygon<'_>) -> (Vec<u32>, Vec<u32>) {
    let mut sorted: Vec<u32> = (0..polygon.corners.len() as u32).collect();
    sorted.sort_unstable_by_key(|&c| (polygon.corners[c as usize].vertex, c));
    let mut leader = vec![0u32; sorted.len()];
    for same in
        sorted.chunk_by(|&a, &b| polygon.corners[a as usize].vertex == polygon.corners[b as usize].vertex)
    {
        same.iter().for_each(|&c| leader[c as usize] = same[0]);
    }
    let (mut own, mut first) = (vec![0u32; leader.len()], vec![]);
    for (corner, &lead) in leader.iter().enumerate() {
        if lead as usize == corner {
            own[corner] = first.len() as u32;
            first.push(lead);
        } else {
            own[corner] = own[lead as usize];
        }
    }
    (own, first)
}

/// Compute the positions of the corners. Coincident corners (scans contain zero-length edges) are moved
/// slightly along their chords, because the triangulator needs distinct points. The triangles between them
/// have no area anyway.
fn separate_positions(polygon: &Polygon<'_>, corners: &[u32]) -> Vec<Point2<f64>> {
    let at = |c: u32| polygon.corners[c as usize].position;
    let order = |a: [f64; 2], b: [f64; 2]| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1]));
    let mut places: Vec<[f64; 2]> = corners.iter().map(|&c| at(c)).collect();
    let mut sorted: Vec<usize> = (0..corners.len()).collect();
    sorted.sort_unstable_by(|&i, &j| order(places[i], places[j]).then(i.cmp(&j)));
    let doubled: Vec<usize> =
        sorted.windows(2).filter(|pair| places[pair[0]] == places[pair[1]]).map(|pair| pair[1]).collect();
    for i in doubled {
        let here = places[i];
        let mut corner = corners[i] as usize;
        for _ in 0..polygon.corners.len() {
            corner = polygon.corners[corner].next;
            let to = polygon.corners[corner].position;
            if to != here {
                places[i] = [0, 1].map(|k| here[k] + COINCIDENT_SHIFT * (to[k] - here[k]));
                break;
            }
        }
    }
    places.into_iter().map(|[x, y]| Point2::new(x, y)).collect()
}

/// List the chords that could not be inserted, and the chords they cross.
fn find_crossed_chords(cdt: &Cdt, edges: &[[usize; 2]], conflicts: &[[usize; 2]]) -> Vec<usize> {
    let mut by_ends: Vec<([usize; 2], usize)> =
        edges.iter().enumerate().map(|(chord, &[a, b])| ([a.min(b), a.max(b)], chord)).collect();
    by_ends.sort_unstable();
    let mut crossed = vec![];
    let mut note = |a: usize, b: usize| {
        let ends = [a.min(b), a.max(b)];
        let from = by_ends.partition_point(|entry| entry.0 < ends);
        crossed.extend(by_ends[from..].iter().take_while(|entry| entry.0 == ends).map(|entry| entry.1));
    };
    for &[a, b] in conflicts {
        note(a, b);
        let handles = [a, b].map(FixedVertexHandle::from_index);
        for edge in cdt.get_conflicting_edges_between_vertices(handles[0], handles[1]) {
            note(edge.from().index(), edge.to().index());
        }
    }
    crossed.sort_unstable();
    crossed.dedup();
    crossed
}

/// Collect the triangles left of the chords and those reachable without crossing a chord. On a contradiction,
/// returns a chord where inside and outside meet.
fn find_inside(cdt: &Cdt, edges: &[[usize; 2]]) -> Result<Vec<[usize; 3]>, Vec<usize>> {
    // A chord to the left of each face, if any, and one to the right. Faces reached from inside inherit the
    // left chord.
    const NONE: u32 = u32::MAX;
    let mut left_of = vec![NONE; cdt.num_all_faces()];
    let mut right_of = vec![NONE; cdt.num_all_faces()];
    let mut reached = vec![];
    for (chord, &[a, b]) in edges.iter().enumerate() {
        let [a, b] = [a, b].map(FixedVertexHandle::from_index);
        // A chord through another corner is split into two edges.
        let edge = cdt.get_edge_from_neighbors(a, b).filter(|e| e.is_constraint_edge()).ok_or(vec![chord])?;
        let left = edge.face().as_inner().ok_or(vec![chord])?.fix();
        let right = edge.rev().face().fix().index();
        if left_of[left.index()] == NONE {
            reached.push(left);
        }
        left_of[left.index()] = chord as u32;
        right_of[right] = chord as u32;
    }
    let mut triangles = vec![];
    while let Some(face) = reached.pop() {
        let here = left_of[face.index()];
        if right_of[face.index()] != NONE {
            return Err(vec![here as usize, right_of[face.index()] as usize]);
        }
        let face = cdt.face(face);
        triangles.push(face.vertices().map(|v| v.index()));
        for edge in face.adjacent_edges().into_iter().filter(|e| !e.is_constraint_edge()) {
            let next = edge.rev().face().as_inner().ok_or(vec![here as usize])?.fix();
            if left_of[next.index()] == NONE {
                left_of[next.index()] = here;
                reached.push(next);
            }
        }
    }
    Ok(triangles)
}
