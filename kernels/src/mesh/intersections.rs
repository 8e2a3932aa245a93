//! Triangles that meet elsewhere than a mesh says.
//!
//! Triangles may share a vertex or an edge, and nothing else. Two triangles meet where a side of one meets the other; that
//! is decided by the exact signs of Shewchuk's predicates (1997), so that touching counts, and rounding does not.

use robust::{Coord, Coord3D, orient2d, orient3d};

use super::bvh::Bvh;
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, around};
use crate::base::parallel::fill;
use crate::base::progress::Progress;

/// No other triangle.
pub const NONE: u32 = u32::MAX;
/// Triangles between two looks whether to go on.
const PART: usize = 1 << 13;

/// For each triangle, one that it meets beyond what both share, or [`NONE`]. Triangles without area, and those of the same
/// three vertices, meet nothing.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn intersecting(
    points: &[Vec3],
    triangles: &[[u32; 3]],
    threads: usize,
    progress: &mut Progress,
) -> Result<Vec<u32>, KernelError> {
    let corners = |t: usize| triangles[t].map(|v| &points[v as usize]);
    let mut flat = vec![None; triangles.len()];
    fill(&mut flat, threads, |t| seen_from(corners(t)));
    let proper: Vec<u32> = (0..triangles.len() as u32).filter(|&t| flat[t as usize].is_some()).collect();
    let box_of = |t: usize| around(corners(t).into_iter().copied());
    let (tree, order) = Bvh::new(proper.len(), threads, |i| box_of(proper[i] as usize));
    let in_slots: Vec<u32> = order.iter().map(|&i| proper[i as usize]).collect();
    // Slot by slot: what lies together is searched together.
    let mut found = vec![NONE; in_slots.len()];
    for (number, part) in found.chunks_mut(PART).enumerate() {
        progress.tell((number * PART) as u64, in_slots.len() as u64)?;
        fill(part, threads, |i| {
            let t = in_slots[number * PART + i] as usize;
            let own = box_of(t);
            let mut met = NONE;
            let meets = |other: usize| {
                let (Some(axis), Some(other_axis)) = (flat[t], flat[other]) else { return false };
                other != t
                    && overlap(&own, &box_of(other))
                    && meet(points, [triangles[t], triangles[other]], [axis, other_axis])
            };
            let visit = |slot: u32| {
                let other = in_slots[slot as usize];
                if meets(other as usize) {
                    met = other;
                }
                met == NONE
            };
            tree.meeting(&own[0], &own[1], |_, _| false, visit);
            met
        });
    }
    let mut met = vec![NONE; triangles.len()];
    in_slots.iter().zip(&found).for_each(|(&t, &other)| met[t as usize] = other);
    Ok(met)
}

fn overlap(a: &[Vec3; 2], b: &[Vec3; 2]) -> bool {
    (0..3).all(|i| a[0][i] <= b[1][i] && b[0][i] <= a[1][i])
}

/// Whether two triangles meet beyond the vertices that they share; each has an area along its axis.
fn meet(points: &[Vec3], [a, b]: [[u32; 3]; 2], [axis_a, axis_b]: [usize; 2]) -> bool {
    let at = |v: u32| &points[v as usize];
    let shared = |v: &u32| b.contains(v);
    match a.iter().filter(|v| shared(v)).count() {
        0 => {
            let sides = |t: [u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
            sides(a).iter().any(|s| segment_meets(s.map(at), b.map(at), axis_b))
                || sides(b).iter().any(|s| segment_meets(s.map(at), a.map(at), axis_a))
        }
        1 => {
            // What begins at the shared vertex leaves the other triangle through the side that lies across.
            let across = |t: [u32; 3], other: [u32; 3]| {
                let mut others = t.into_iter().filter(move |v| !other.contains(v));
                others.next().zip(others.next())
            };
            let meets =
                |(p, q): (u32, u32), t: [u32; 3], axis| segment_meets([at(p), at(q)], t.map(at), axis);
            across(a, b).is_some_and(|side| meets(side, b, axis_b))
                || across(b, a).is_some_and(|side| meets(side, a, axis_a))
        }
        2 => {
            let one = |t: [u32; 3], other: [u32; 3]| t.into_iter().find(|v| !other.contains(v));
            let (Some(p), Some(q)) = (one(a, b), one(b, a)) else { return false };
            let mut edge = a.into_iter().filter(shared);
            let (Some(u), Some(v)) = (edge.next(), edge.next()) else { return false };
            let sides = [p, q].map(|w| plane(at(u), at(v), at(w), axis_a) > 0.0);
            // Folded onto each other: in one plane, on the same side of what they share.
            space(at(u), at(v), at(p), at(q)) == 0.0 && sides[0] == sides[1]
        }
        _ => false,
    }
}

/// Whether a segment and a triangle have a point in common; the triangle has an area seen along the axis.
fn segment_meets([p, q]: [&Vec3; 2], t: [&Vec3; 3], axis: usize) -> bool {
    let [a, b, c] = t;
    let (above, below) = (space(a, b, c, p), space(a, b, c, q));
    if above > 0.0 && below > 0.0 || above < 0.0 && below < 0.0 {
        return false;
    }
    if above == 0.0 && below == 0.0 {
        let sides = [[a, b], [b, c], [c, a]];
        return is_inside(p, t, axis)
            || is_inside(q, t, axis)
            || sides.iter().any(|s| cross([p, q], *s, axis));
    }
    let turns = [space(p, q, a, b), space(p, q, b, c), space(p, q, c, a)];
    turns.iter().all(|&x| x >= 0.0) || turns.iter().all(|&x| x <= 0.0)
}

/// Whether a point of its plane is in a triangle.
fn is_inside(p: &Vec3, [a, b, c]: [&Vec3; 3], axis: usize) -> bool {
    let turns = [plane(a, b, p, axis), plane(b, c, p, axis), plane(c, a, p, axis)];
    turns.iter().all(|&x| x >= 0.0) || turns.iter().all(|&x| x <= 0.0)
}

/// Whether two segments of a plane cross inside both. If one touches the other in another way, then an end of one of them
/// does, or both lie on a line.
fn cross([p, q]: [&Vec3; 2], [a, b]: [&Vec3; 2], axis: usize) -> bool {
    let opposite = |x: f64, y: f64| x > 0.0 && y < 0.0 || x < 0.0 && y > 0.0;
    let touches = |x: f64, y: f64| x == 0.0 || y == 0.0 || opposite(x, y);
    let (of_p, of_q) = (plane(a, b, p, axis), plane(a, b, q, axis));
    let (of_a, of_b) = (plane(p, q, a, axis), plane(p, q, b, axis));
    // On one line, an end of the segment is on the side, and so in the triangle, or the whole side is in the segment.
    let on_line = of_p == 0.0 && of_q == 0.0;
    if on_line {
        overlaps(p, q, a, axis) || overlaps(p, q, b, axis)
    } else {
        touches(of_p, of_q) && touches(of_a, of_b)
    }
}

/// Whether a point of the line through two others is between them.
fn overlaps(p: &Vec3, q: &Vec3, a: &Vec3, axis: usize) -> bool {
    (0..3).filter(|&i| i != axis).all(|i| p[i].min(q[i]) <= a[i] && a[i] <= p[i].max(q[i]))
}

/// The axis along which a triangle is seen largest, if it has an area.
fn seen_from(t: [&Vec3; 3]) -> Option<usize> {
    let areas = [0, 1, 2].map(|axis| plane(t[0], t[1], t[2], axis).abs());
    let axis = (0..3).fold(0, |best, axis| if areas[axis] > areas[best] { axis } else { best });
    (areas[axis] > 0.0).then_some(axis)
}

/// Twice the signed area of a triangle seen along an axis; its sign is exact.
fn plane(a: &Vec3, b: &Vec3, c: &Vec3, axis: usize) -> f64 {
    let flat = |p: &Vec3| Coord { x: p[(axis + 1) % 3], y: p[(axis + 2) % 3] };
    orient2d(flat(a), flat(b), flat(c))
}

/// Six times the signed volume of a tetrahedron; its sign is exact.
fn space(a: &Vec3, b: &Vec3, c: &Vec3, d: &Vec3) -> f64 {
    let [a, b, c, d] = [a, b, c, d].map(|p| Coord3D { x: p[0], y: p[1], z: p[2] });
    orient3d(a, b, c, d)
}
