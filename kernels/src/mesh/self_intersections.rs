//! Self-intersections of a mesh.
//!
//! Triangles may share a vertex or an edge, and must not touch otherwise. Two triangles intersect if a side
//! of one intersects the other. The test uses the exact signs of Shewchuk's predicates (1997): touching
//! counts as intersection, and rounding has no effect.

use robust::{Coord, Coord3D, orient2d, orient3d};

use super::bvh::Bvh;
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, bounding_box};
use crate::base::parallel::{fill, update};
use crate::base::progress::Progress;

/// Marker for no triangle.
pub const NO_TRIANGLE: u32 = u32::MAX;
/// Triangles per cancellation check.
const TRIANGLES_PER_CHECK: usize = 1 << 13;

/// Find for each triangle one that it intersects beyond their shared vertices, or [`NO_TRIANGLE`]. Triangles without
/// area, and triangles with the same three vertices, do not count.
pub fn find_intersecting(
    points: &[Vec3],
    triangles: &[[u32; 3]],
    threads: usize,
    progress: &mut Progress,
) -> Result<Vec<u32>, KernelError> {
    let corners = |t: usize| triangles[t].map(|v| &points[v as usize]);
    let mut flat = vec![None; triangles.len()];
    fill(&mut flat, threads, |t| largest_projection_axis(corners(t)));
    let proper: Vec<u32> = (0..triangles.len() as u32).filter(|&t| flat[t as usize].is_some()).collect();
    let box_of = |t: usize| bounding_box(corners(t).into_iter().copied());
    let (tree, order) = Bvh::new(proper.len(), threads, |i| box_of(proper[i] as usize));
    let in_slots: Vec<u32> = order.iter().map(|&i| proper[i as usize]).collect();
    // Processed in slot order, because triangles close in space are searched together.
    let count = in_slots.len();
    let mut search = |tree: &Bvh, slots: &[u32], found: &mut [u32], pass: usize| -> Result<(), KernelError> {
        for (number, part) in found.chunks_mut(TRIANGLES_PER_CHECK).enumerate() {
            let first = number * TRIANGLES_PER_CHECK;
            progress.report((pass * count + first) as u64, 2 * count as u64)?;
            update(part, threads, |i, met| {
                if *met != NO_TRIANGLE {
                    return;
                }
                let t = in_slots[first + i] as usize;
                let own = box_of(t);
                let meets = |other: usize| {
                    let (Some(axis), Some(other_axis)) = (flat[t], flat[other]) else { return false };
                    boxes_overlap(&own, &box_of(other))
                        && triangles_intersect(points, [triangles[t], triangles[other]], [axis, other_axis])
                };
                let visit = |slot: u32| {
                    let other = slots[slot as usize];
                    let is_wanted = if pass == 0 { slot as usize > first + i } else { other as usize != t };
                    if is_wanted && meets(other as usize) {
                        *met = other;
                    }
                    *met == NO_TRIANGLE
                };
                tree.visit_overlapping(&own[0], &own[1], |_, _| false, visit);
            });
        }
        Ok(())
    };
    // The first pass tests each pair once. A triangle that only intersects triangles of lower slots is found by
    // the second pass, among the triangles that the first one found: usually few.
    let mut found = vec![NO_TRIANGLE; count];
    search(&tree, &in_slots, &mut found, 0)?;
    drop(tree);
    let hit: Vec<u32> =
        in_slots.iter().zip(&found).filter(|&(_, &other)| other != NO_TRIANGLE).map(|(&t, _)| t).collect();
    if !hit.is_empty() {
        let (tree, order) = Bvh::new(hit.len(), threads, |i| box_of(hit[i] as usize));
        let slots: Vec<u32> = order.iter().map(|&i| hit[i as usize]).collect();
        search(&tree, &slots, &mut found, 1)?;
    }
    let mut met = vec![NO_TRIANGLE; triangles.len()];
    in_slots.iter().zip(&found).for_each(|(&t, &other)| met[t as usize] = other);
    Ok(met)
}

fn boxes_overlap(a: &[Vec3; 2], b: &[Vec3; 2]) -> bool {
    (0..3).all(|i| a[0][i] <= b[1][i] && b[0][i] <= a[1][i])
}

/// Check whether two triangles intersect beyond their shared vertices. Each has a nonzero area seen along its
/// axis.
fn triangles_intersect(points: &[Vec3], [a, b]: [[u32; 3]; 2], [axis_a, axis_b]: [usize; 2]) -> bool {
    let at = |v: u32| &points[v as usize];
    let shared = |v: &u32| b.contains(v);
    let shared_count = a.iter().filter(|v| shared(v)).count();
    if shared_count < 2 && (is_beside(points, a, b) || is_beside(points, b, a)) {
        return false;
    }
    match shared_count {
        0 => {
            let sides = |t: [u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
            sides(a).iter().any(|s| segment_intersects(s.map(at), b.map(at), axis_b))
                || sides(b).iter().any(|s| segment_intersects(s.map(at), a.map(at), axis_a))
        }
        1 => {
            // A triangle that enters the other at the shared vertex leaves it through the opposite side.
            let across = |t: [u32; 3], other: [u32; 3]| {
                let mut others = t.into_iter().filter(move |v| !other.contains(v));
                others.next().zip(others.next())
            };
            let meets =
                |(p, q): (u32, u32), t: [u32; 3], axis| segment_intersects([at(p), at(q)], t.map(at), axis);
            across(a, b).is_some_and(|side| meets(side, b, axis_b))
                || across(b, a).is_some_and(|side| meets(side, a, axis_a))
        }
        2 => {
            let one = |t: [u32; 3], other: [u32; 3]| t.into_iter().find(|v| !other.contains(v));
            let (Some(p), Some(q)) = (one(a, b), one(b, a)) else { return false };
            let mut edge = a.into_iter().filter(shared);
            let (Some(u), Some(v)) = (edge.next(), edge.next()) else { return false };
            let side = |w| doubled_projected_area(at(u), at(v), at(w), axis_a) > 0.0;
            // Folded onto each other: coplanar, on the same side of the shared edge.
            orientation(at(u), at(v), at(p), at(q)) == 0.0 && side(p) == side(q)
        }
        _ => false,
    }
}

/// Check whether all vertices of a triangle that another one does not have are strictly on one side of the other
/// triangle's plane. The two then touch at a shared vertex at most.
fn is_beside(points: &[Vec3], t: [u32; 3], other: [u32; 3]) -> bool {
    let [a, b, c] = other.map(|v| &points[v as usize]);
    let sides = || {
        let others = t.iter().filter(|v| !other.contains(v));
        others.map(|&v| orientation(a, b, c, &points[v as usize]))
    };
    sides().all(|side| side > 0.0) || sides().all(|side| side < 0.0)
}

/// Check whether a segment and a triangle intersect. The triangle has a nonzero area seen along the axis.
fn segment_intersects([p, q]: [&Vec3; 2], t: [&Vec3; 3], axis: usize) -> bool {
    let [a, b, c] = t;
    let (above, below) = (orientation(a, b, c, p), orientation(a, b, c, q));
    if above > 0.0 && below > 0.0 || above < 0.0 && below < 0.0 {
        return false;
    }
    if above == 0.0 && below == 0.0 {
        let sides = [[a, b], [b, c], [c, a]];
        return is_in_triangle(p, t, axis)
            || is_in_triangle(q, t, axis)
            || sides.iter().any(|s| segments_cross([p, q], *s, axis));
    }
    let turns = [orientation(p, q, a, b), orientation(p, q, b, c), orientation(p, q, c, a)];
    turns.iter().all(|&x| x >= 0.0) || turns.iter().all(|&x| x <= 0.0)
}

/// Check whether a point in the plane of a triangle is inside it.
fn is_in_triangle(p: &Vec3, [a, b, c]: [&Vec3; 3], axis: usize) -> bool {
    let turns = [
        doubled_projected_area(a, b, p, axis),
        doubled_projected_area(b, c, p, axis),
        doubled_projected_area(c, a, p, axis),
    ];
    turns.iter().all(|&x| x >= 0.0) || turns.iter().all(|&x| x <= 0.0)
}

/// Check whether two coplanar segments cross, or overlap on one line. Other contacts are found by the tests
/// of end points against the triangle.
fn segments_cross([p, q]: [&Vec3; 2], [a, b]: [&Vec3; 2], axis: usize) -> bool {
    let opposite = |x: f64, y: f64| x > 0.0 && y < 0.0 || x < 0.0 && y > 0.0;
    let touches = |x: f64, y: f64| x == 0.0 || y == 0.0 || opposite(x, y);
    let (of_p, of_q) = (doubled_projected_area(a, b, p, axis), doubled_projected_area(a, b, q, axis));
    let (of_a, of_b) = (doubled_projected_area(p, q, a, axis), doubled_projected_area(p, q, b, axis));
    // Collinear: an end of the segment is on the side, and therefore in the triangle, or the segment contains
    // the whole side.
    let on_line = of_p == 0.0 && of_q == 0.0;
    if on_line {
        is_between(p, q, a, axis) || is_between(p, q, b, axis)
    } else {
        touches(of_p, of_q) && touches(of_a, of_b)
    }
}

/// Check whether a point on the line through two others is between them.
fn is_between(p: &Vec3, q: &Vec3, a: &Vec3, axis: usize) -> bool {
    (0..3).filter(|&i| i != axis).all(|i| p[i].min(q[i]) <= a[i] && a[i] <= p[i].max(q[i]))
}

/// Return the axis along which a triangle appears largest; None if it has no area.
fn largest_projection_axis(t: [&Vec3; 3]) -> Option<usize> {
    let areas = [0, 1, 2].map(|axis| doubled_projected_area(t[0], t[1], t[2], axis).abs());
    let axis = (0..3).fold(0, |best, axis| if areas[axis] > areas[best] { axis } else { best });
    (areas[axis] > 0.0).then_some(axis)
}

/// Compute twice the signed area of a triangle seen along an axis; the sign is exact.
fn doubled_projected_area(a: &Vec3, b: &Vec3, c: &Vec3, axis: usize) -> f64 {
    let flat = |p: &Vec3| Coord { x: p[(axis + 1) % 3], y: p[(axis + 2) % 3] };
    orient2d(flat(a), flat(b), flat(c))
}

/// Compute six times the signed volume of a tetrahedron; the sign is exact.
fn orientation(a: &Vec3, b: &Vec3, c: &Vec3, d: &Vec3) -> f64 {
    let [a, b, c, d] = [a, b, c, d].map(|p| Coord3D { x: p[0], y: p[1], z: p[2] });
    orient3d(a, b, c, d)
}
