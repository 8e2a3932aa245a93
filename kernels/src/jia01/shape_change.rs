//! Change of the surface by a collapse: S(e) of JIA01, and the gap that S(e) misses.

use crate::base::geometry::{
    Vec3, cross, dot, norm2, position_of, segment_distance2, sub, triangle_distance2,
};
use crate::mesh::edge_star::EdgeStar;

/// Compute S(e) (1)–(2).
///
/// Both stars have the same ring, so only the old ends and the new vertex count.
pub fn shape_change<const D: usize>(star: &EdgeStar<D>, point: &[f64; D]) -> f64 {
    let to = position_of(point);
    let ends = star.end_points.map(|p| position_of(&p));
    let mut largest2 = 0f64;
    for from in &ends {
        let wings = star
            .remaining
            .iter()
            .map(|w| triangle_distance2(from, [&to, &position_of(&w.from_point), &position_of(&w.to_point)]));
        largest2 = largest2.max(early_minimum(wings, largest2));
    }
    let apexes = star
        .vanishing
        .iter()
        .map(|(_, _, apex)| triangle_distance2(&to, [&ends[0], &ends[1], &position_of(apex)]));
    let wings = star.remaining.iter().map(|w| {
        triangle_distance2(&to, [&ends[w.end], &position_of(&w.from_point), &position_of(&w.to_point)])
    });
    largest2.max(early_minimum(apexes.chain(wings), largest2)).sqrt()
}

/// Compute S(e) of a boundary edge: the distance between the boundary polylines before and after.
///
/// The polylines are parts of the stars, so the distances to the stars are never larger.
pub fn boundary_change<const D: usize>(
    star: &EdgeStar<D>,
    neighbours: [&[f64; D]; 2],
    point: &[f64; D],
) -> f64 {
    let to = position_of(point);
    let [first, second] = star.end_points.map(|p| position_of(&p));
    let [before, after] = neighbours.map(position_of);
    let nearest = |p: &Vec3, line: &[[&Vec3; 2]]| {
        line.iter().map(|[a, b]| segment_distance2(p, a, b)).fold(f64::INFINITY, f64::min)
    };
    let new = [[&before, &to], [&to, &after]];
    let old = [[&before, &first], [&first, &second], [&second, &after]];
    nearest(&first, &new).max(nearest(&second, &new)).max(nearest(&to, &old)).sqrt()
}

/// Compute the minimum of some distances, stopping at the first one ≤ `enough`.
///
/// Smaller ones cannot change the maximum.
#[inline]
fn early_minimum(distances: impl Iterator<Item = f64>, enough: f64) -> f64 {
    let mut least = f64::INFINITY;
    for distance in distances {
        least = least.min(distance);
        if least <= enough {
            break;
        }
    }
    least
}

/// Overlay of the old and the new star, projected onto one plane.
#[derive(Clone, Debug, Default)]
pub struct StarOverlay {
    /// Vector from the new vertex to the end of each spoke: two coordinates in the plane, then the height.
    spokes: Vec<Vec3>,
}

impl StarOverlay {
    /// Compute the largest gap between the two stars at crossings of their edges.
    ///
    /// Projected along the mean normal, both stars cover the same area. The height of one over the other is
    /// linear between the crossings of old and new edges. Its maximum is at a vertex, which S(e) measures, or
    /// at a crossing, which S(e) misses: a long triangle can move away from a crease while every vertex stays
    /// close. On a machined part, this moved the surface by twenty times S_max.
    pub fn crossing_gap<const D: usize>(&mut self, star: &EdgeStar<D>, point: &[f64; D]) -> f64 {
        let to = position_of(point);
        let up = star.mean_normal();
        let Some(sheet) = OrthonormalFrame::from_direction(up).filter(|_| is_height_field(star, &to, &up))
        else {
            return max_end_distance(star, &to);
        };
        let flat = |p: &[f64; D]| sheet.coordinates(&sub(&position_of(p), &to));
        self.spokes.clear();
        self.spokes.extend(star.spokes.iter().map(|(_, p)| flat(p)));
        let ends = star.end_points.map(|p| flat(&p));

        let mut largest = max_gap_along(&ends[0], &ends[1], &self.spokes);
        for ((end, _), target) in star.spokes.iter().zip(&self.spokes) {
            largest = largest.max(max_gap_along(&ends[*end], target, &self.spokes));
        }
        largest
    }
}

/// Test if every triangle of both stars faces `up`.
fn is_height_field<const D: usize>(star: &EdgeStar<D>, to: &Vec3, up: &Vec3) -> bool {
    let ends = star.end_points.map(|p| position_of(&p));
    let faces = |p: &Vec3, a: &Vec3, b: &Vec3| dot(&cross(&sub(a, p), &sub(b, p)), up) >= 0.0;
    let wings = star.remaining.iter().all(|w| {
        let (a, b) = (position_of(&w.from_point), position_of(&w.to_point));
        faces(&ends[w.end], &a, &b) && faces(to, &a, &b)
    });
    wings
        && star
            .vanishing
            .iter()
            .enumerate()
            .all(|(side, (_, _, apex))| faces(&ends[side], &ends[1 - side], &position_of(apex)))
}

/// Compute a fallback bound: the maximum distance from an end to the new vertex.
///
/// No point moves farther if both ends are dragged there.
fn max_end_distance<const D: usize>(star: &EdgeStar<D>, to: &Vec3) -> f64 {
    star.end_points.iter().map(|end| norm2(&sub(to, &position_of(end)))).fold(0.0, f64::max).sqrt()
}

/// Find the largest height difference where an old edge crosses new edges.
///
/// The old edge is `from`–`to`; new edges run from the origin to `spokes`.
#[inline]
fn max_gap_along(from: &Vec3, to: &Vec3, spokes: &[Vec3]) -> f64 {
    let old = sub(to, from);
    let mut largest = 0f64;
    for new in spokes {
        // Solve from + t·old = u·new in the plane, with t = at_old / area and u = at_new / area.
        let area = old[0] * new[1] - old[1] * new[0];
        let at_old = (new[0] * from[1] - new[1] * from[0]) * area.signum();
        let at_new = (old[0] * from[1] - old[1] * from[0]) * area.signum();
        let area = area.abs();
        if at_old >= 0.0 && at_new >= 0.0 && at_old <= area && at_new <= area && area > 0.0 {
            largest = largest.max((from[2] + (at_old * old[2] - at_new * new[2]) / area).abs());
        }
    }
    largest
}

/// Orthonormal frame whose third axis is a given direction.
struct OrthonormalFrame([Vec3; 3]);

impl OrthonormalFrame {
    fn from_direction(direction: Vec3) -> Option<Self> {
        let unit = |v: Vec3| {
            let length = norm2(&v).sqrt();
            (length > 0.0).then(|| v.map(|x| x / length))
        };
        let up = unit(direction)?;
        // The coordinate axis that is farthest from parallel.
        let [x, y, z] = up.map(f64::abs);
        let axis = if x <= y && x <= z {
            [1.0, 0.0, 0.0]
        } else if y <= z {
            [0.0, 1.0, 0.0]
        } else {
            [0.0, 0.0, 1.0]
        };
        let first = unit(cross(&up, &axis))?;
        Some(Self([first, cross(&up, &first), up]))
    }

    #[inline]
    fn coordinates(&self, v: &Vec3) -> Vec3 {
        self.0.map(|axis| dot(&axis, v))
    }
}
