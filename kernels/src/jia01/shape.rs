//! How far a collapse takes the surface: S(e) of JIA01, and what S(e) does not see.

use crate::base::geometry::{Vec3, cross, dot, norm2, position, segment_distance2, sub, triangle_distance2};
use crate::mesh::star::Star;

/// S(e) (1)–(2). The ring is common to both stars, so only the ends against the new star and the new vertex
/// against the old one count.
pub fn shape_change<const D: usize>(star: &Star<D>, point: &[f64; D]) -> f64 {
    let to = position(point);
    let ends = star.end_points.map(|p| position(&p));
    let mut largest2 = 0f64;
    for from in &ends {
        let wings = star
            .wings
            .iter()
            .map(|w| triangle_distance2(from, [&to, &position(&w.from_point), &position(&w.to_point)]));
        largest2 = largest2.max(least(wings, largest2));
    }
    let apexes = star
        .vanishing
        .iter()
        .map(|(_, _, apex)| triangle_distance2(&to, [&ends[0], &ends[1], &position(apex)]));
    let wings = star
        .wings
        .iter()
        .map(|w| triangle_distance2(&to, [&ends[w.end], &position(&w.from_point), &position(&w.to_point)]));
    largest2.max(least(apexes.chain(wings), largest2)).sqrt()
}

/// S(e) on a boundary edge: the distances between the boundary polylines before and after. They are part
/// of the stars, so the distances to the stars are never larger.
pub fn boundary_change<const D: usize>(star: &Star<D>, neighbours: [&[f64; D]; 2], point: &[f64; D]) -> f64 {
    let to = position(point);
    let [first, second] = star.end_points.map(|p| position(&p));
    let [before, after] = neighbours.map(position);
    let nearest = |p: &Vec3, line: &[[&Vec3; 2]]| {
        line.iter().map(|[a, b]| segment_distance2(p, a, b)).fold(f64::INFINITY, f64::min)
    };
    let new = [[&before, &to], [&to, &after]];
    let old = [[&before, &first], [&first, &second], [&second, &after]];
    nearest(&first, &new).max(nearest(&second, &new)).max(nearest(&to, &old)).sqrt()
}

/// The least of some distances, or anything up to `enough` if one is that small: what then follows cannot
/// change the maximum.
#[inline]
fn least(distances: impl Iterator<Item = f64>, enough: f64) -> f64 {
    let mut least = f64::INFINITY;
    for distance in distances {
        least = least.min(distance);
        if least <= enough {
            break;
        }
    }
    least
}

/// The old and the new star drawn on one sheet.
#[derive(Clone, Debug, Default)]
pub struct Overlay {
    /// From the new vertex to the end of every spoke: two coordinates on the sheet, then the height.
    spokes: Vec<Vec3>,
}

impl Overlay {
    /// How far the two stars are apart between their vertices.
    ///
    /// Seen along the mean normal they cover the same ground, and the height of one above the other is linear
    /// between the points where old and new edges cross. It is largest at a vertex, which S(e) sees, or at such a
    /// crossing, which it does not: a long triangle can swing away from a crease while every vertex stays
    /// close. On a machined part that took the surface twenty times as far as S_max.
    pub fn crossing_gap<const D: usize>(&mut self, star: &Star<D>, point: &[f64; D]) -> f64 {
        let to = position(point);
        let up = star.mean_normal();
        let Some(sheet) = Frame::across(up).filter(|_| is_height_field(star, &to, &up)) else {
            return farthest_end(star, &to);
        };
        let flat = |p: &[f64; D]| sheet.coordinates(&sub(&position(p), &to));
        self.spokes.clear();
        self.spokes.extend(star.spokes.iter().map(|(_, p)| flat(p)));
        let ends = star.end_points.map(|p| flat(&p));

        let mut largest = gap_along(&ends[0], &ends[1], &self.spokes);
        for ((end, _), target) in star.spokes.iter().zip(&self.spokes) {
            largest = largest.max(gap_along(&ends[*end], target, &self.spokes));
        }
        largest
    }
}

/// Whether no triangle of the old or the new star turns its back when seen along `up`.
fn is_height_field<const D: usize>(star: &Star<D>, to: &Vec3, up: &Vec3) -> bool {
    let ends = star.end_points.map(|p| position(&p));
    let faces = |p: &Vec3, a: &Vec3, b: &Vec3| dot(&cross(&sub(a, p), &sub(b, p)), up) >= 0.0;
    let wings = star.wings.iter().all(|w| {
        let (a, b) = (position(&w.from_point), position(&w.to_point));
        faces(&ends[w.end], &a, &b) && faces(to, &a, &b)
    });
    wings
        && star
            .vanishing
            .iter()
            .enumerate()
            .all(|(side, (_, _, apex))| faces(&ends[side], &ends[1 - side], &position(apex)))
}

/// A bound that always holds: no point moves farther when both ends are dragged to the new vertex, and the
/// triangles with them.
fn farthest_end<const D: usize>(star: &Star<D>, to: &Vec3) -> f64 {
    star.end_points.iter().map(|end| norm2(&sub(to, &position(end)))).fold(0.0, f64::max).sqrt()
}

/// Largest difference of height where the old edge `from`–`to` crosses new edges, which go from the origin to `spokes`.
#[inline]
fn gap_along(from: &Vec3, to: &Vec3, spokes: &[Vec3]) -> f64 {
    let old = sub(to, from);
    let mut largest = 0f64;
    for new in spokes {
        // from + t·old = u·new on the sheet, with t = at_old / area and u = at_new / area.
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

/// An orthonormal frame whose third axis is a given direction.
struct Frame([Vec3; 3]);

impl Frame {
    fn across(direction: Vec3) -> Option<Self> {
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
