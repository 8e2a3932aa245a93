//! One triangle against everything near it at once: the quick proof that it stays within a limit.
//!
//! Look at triangle T along its normal. The other surface's triangles over it are within some height of it. Where they
//! hide all of T, every point of T has one of them as near as that. They do if a single point of T is hidden and no
//! border of theirs crosses T: the number of layers over a point, those turned up less those turned down, changes
//! nowhere but at a border, and at a side of two triangles that follow each other there is none.
//!
//! Colour: a point x of T and the nearest point y of another triangle are no farther apart than that. Continued over
//! the plane, the colour of T at the foot of y is linear on the other triangle, and so is the difference there;
//! between foot and x it changes by no more than its gradient. Where the other triangle is the larger one,
//! it is the other way round. Either way the slack comes to what the gradient is multiplied by.

use super::facet::Facet;
use super::piece::{Against, Deviation};
use super::polygon::{Corner, Polygon};
use super::surface::{NEEDLE, combine, difference};
use crate::base::geometry::{Vec3, add_scaled, around, cross, dot, norm2, sub};

/// Share of the lengths in it that the position in a view may be wrong by: far more than rounding makes it.
const ROUNDING: f64 = 1e-12;

/// What of T is looked at to count the layers over it: a point where few meshes have a side or a corner.
const PLACE: Vec3 = [0.381_966_011_250_105, 0.351_407_320_124_931, 0.266_626_668_624_964];

/// The plane of a triangle: coordinates in it, and height.
struct View {
    origin: Vec3,
    axes: [Vec3; 3],
    /// Corners of the triangle.
    corners: [[f64; 2]; 3],
    /// Inward normal of each side, and its distance from the origin.
    sides: [[f64; 3]; 3],
    size: f64,
    /// Colour at the origin, and what it changes along both axes.
    color: [Vec3; 3],
    slope: f64,
}

/// A triangle of the other surface, as seen.
#[derive(Clone, Copy)]
struct Seen {
    slot: u32,
    /// Two coordinates and the height of each corner.
    at: [Vec3; 3],
}

/// Memory that the next triangle can use again.
#[derive(Default)]
pub struct Cover {
    seen: Vec<Seen>,
    /// Sides that may cross the triangle: their vertices in order, and in which direction they are run through.
    sides: Vec<([u32; 2], bool)>,
    /// Where a colour differs too much, as far as the proof can tell.
    pub doubt: Option<Corner>,
}

impl Cover {
    /// Whether all of `triangle` is proven to be within `limit`. `near` are slots nearest to its corners, and
    /// their `reach` is the distance there.
    pub fn proves(
        &mut self,
        against: &Against<'_>,
        triangle: &[Corner; 3],
        near: [u32; 3],
        limit: Deviation,
    ) -> bool {
        let most = limit.shape - against.slack;
        let by_one = one_triangle(against, triangle, near, most);
        if by_one.is_some() && !against.with_color {
            return true;
        }
        self.seen.clear();
        self.doubt = None;
        let Some(view) = View::new(triangle) else { return false };
        let color_within =
            |cover: &mut Self, reach| cover.color_within(against, triangle, &view, reach, limit.color);
        if let Some(reach) = by_one {
            let colors = around(triangle.iter().map(|c| c.color));
            let close = |node, branch| against.target.colors_apart(node, branch, &colors) <= limit.color;
            self.look(against, triangle, &view, reach + against.slack, close);
            if color_within(self, reach) {
                return true;
            }
        }
        // Several triangles may be nearer than one is: fewer then have a colour that matters.
        let most = by_one.unwrap_or(most);
        self.look(against, triangle, &view, most + against.slack, |_, _| false);
        let reach = self.hidden(against, &view, most);
        reach.is_some_and(|reach| !against.with_color || color_within(self, reach))
    }

    /// How many triangles were near the one looked at last.
    pub fn crowd(&self) -> usize {
        self.seen.len()
    }

    /// Find every triangle that may be within `reach` of the one viewed, but for those in branches to `skip`.
    fn look(
        &mut self,
        against: &Against<'_>,
        triangle: &[Corner; 3],
        view: &View,
        reach: f64,
        skip: impl Fn(u32, usize) -> bool,
    ) {
        let [low, high] = around(triangle.iter().map(|c| c.at));
        let (low, high) = (low.map(|x| x - reach), high.map(|x| x + reach));
        let seen = &mut self.seen;
        seen.clear();
        against.target.bvh.meeting(&low, &high, skip, |slot| {
            let corners = against.target.corners(slot);
            let heights = corners.map(|p| view.height(&p));
            // Most are out of reach by their height alone.
            if heights.iter().all(|&h| h > reach) || heights.iter().all(|&h| h < -reach) {
                return true;
            }
            let at = corners.map(|p| view.at(&p));
            if !view.apart(&at, reach) {
                seen.push(Seen { slot, at });
            }
            true
        });
    }

    /// The greatest height of what hides all of the triangle, if that is at most `most`.
    fn hidden(&mut self, against: &Against<'_>, view: &View, most: f64) -> Option<f64> {
        self.sides.clear();
        let place = [0, 1].map(|i| (0..3).map(|k| PLACE[k] * view.corners[k][i]).sum());
        let (mut layers, mut highest) = (0, 0.0f64);
        for seen in &self.seen {
            let outside = seen.at.map(|p| view.outside(&p));
            if outside[0] & outside[1] & outside[2] != 0 {
                continue;
            }
            // Not part of the cover: where others end at it there is a border then.
            let mut height = seen.at.iter().map(|p| p[2].abs()).fold(0.0, f64::max);
            // Beside the triangle it may be as high as it likes.
            if height > highest && outside != [0; 3] {
                height = view.height_over(&seen.at);
            }
            height += needle_height(&seen.at);
            if height > most {
                continue;
            }
            highest = highest.max(height);
            layers += turns(&seen.at, &place)?;
            let vertices = against.target.vertices[seen.slot as usize];
            for (i, j) in [(0, 1), (1, 2), (2, 0)] {
                if outside[i] & outside[j] == 0 {
                    let (a, b) = (vertices[i], vertices[j]);
                    self.sides.push(([a.min(b), a.max(b)], a < b));
                }
            }
        }
        if layers == 0 {
            return None;
        }
        self.sides.sort_unstable();
        let all_closed = self.sides.chunk_by(|a, b| a.0 == b.0).all(|same| {
            let forward = same.iter().filter(|side| side.1).count();
            2 * forward == same.len() || {
                let ends = same[0].0.map(|v| view.at(&against.target.points[v as usize]));
                view.beside(&ends)
            }
        });
        all_closed.then_some(highest)
    }

    /// Whether no point of the triangle differs in colour by more than `level` from any point that may be nearest to it,
    /// where those are not farther than `reach`.
    fn color_within(
        &mut self,
        against: &Against<'_>,
        triangle: &[Corner; 3],
        view: &View,
        reach: f64,
        level: f64,
    ) -> bool {
        let polygon = Polygon::new(triangle.map(|c| Corner { reach, ..c }));
        let around = reach + against.slack;
        for seen in self.seen.iter().filter(|seen| !view.apart(&seen.at, around)) {
            let quick = if extent(&seen.at) < view.size {
                Some(view.smaller_differs(against, seen, around))
            } else {
                larger_differs(against, triangle, seen.slot, around)
            };
            if quick.is_none_or(|most| most > level)
                && let Some((most, worst)) = against.share(&polygon, seen.slot)
                && most.color > level
            {
                self.doubt = Some(worst);
                return false;
            }
        }
        true
    }
}

/// The greatest distance of the corners from one triangle, which no point between them passes.
fn one_triangle(against: &Against<'_>, triangle: &[Corner; 3], near: [u32; 3], most: f64) -> Option<f64> {
    (0..3).filter(|&i| !near[..i].contains(&near[i])).find_map(|i| {
        if near == [near[0]; 3] && !is_needle(area_and_length(&against.target.corners(near[0]))) {
            return Some(triangle.iter().map(|c| c.reach).fold(0.0, f64::max)).filter(|&far| far <= most);
        }
        let reach = against.target.reach(near[i]);
        // The corner this triangle is nearest to is the last one to be too far from it.
        [(i + 1) % 3, (i + 2) % 3, i].into_iter().try_fold(0.0f64, |far, k| {
            let far = far.max(reach(&triangle[k].at));
            (far <= most).then_some(far)
        })
    })
}

/// The greatest difference between the colours of a triangle and of the nearest points on a larger one, if that
/// has a plane. The colour of the larger one is continued to the feet of points beside it.
fn larger_differs(against: &Against<'_>, triangle: &[Corner; 3], slot: u32, around: f64) -> Option<f64> {
    let facet = Facet::new(&against.target.corners(slot))?;
    let colors = against.target.corner_colors(slot);
    let (mut most, mut beside) = (0.0f64, false);
    for corner in triangle {
        let weights = facet.weights(&corner.at);
        beside |= weights.iter().any(|&w| w < 0.0);
        most = most.max(difference(&corner.color, &combine(&weights, &colors)));
    }
    let moved = if beside { around } else { 0.0 };
    Some(most + facet.slope(&colors) * (moved + against.slack))
}

impl View {
    /// None for a needle, whose normal has too few digits.
    fn new(triangle: &[Corner; 3]) -> Option<Self> {
        let [a, b, c] = triangle.map(|c| c.at);
        if is_needle(area_and_length(&[a, b, c])) {
            return None;
        }
        let unit = |v: Vec3| {
            let length = norm2(&v).sqrt();
            v.map(|x| x / length)
        };
        let (ab, ac) = (sub(&b, &a), sub(&c, &a));
        let x = unit(ab);
        let normal = unit(cross(&ab, &ac));
        let axes = [x, cross(&normal, &x), normal];
        let flat = |v: &Vec3| [dot(&axes[0], v), dot(&axes[1], v)];
        let corners = [[0.0; 2], flat(&ab), flat(&ac)];
        let sides = [0, 1, 2].map(|opposite| {
            let (from, to) = (corners[(opposite + 1) % 3], corners[(opposite + 2) % 3]);
            let (along, across) = (to[0] - from[0], to[1] - from[1]);
            let length = (along * along + across * across).sqrt();
            let inward = [-across / length, along / length];
            [inward[0], inward[1], -(inward[0] * from[0] + inward[1] * from[1])]
        });
        let [base, to_b, to_c] = [0, 1, 2]
            .map(|i| if i == 0 { triangle[0].color } else { sub(&triangle[i].color, &triangle[0].color) });
        // Corner b is on the first axis.
        let along = to_b.map(|x| x / corners[1][0]);
        let across = add_scaled(&to_c, -corners[2][0], &along).map(|x| x / corners[2][1]);
        let slope = (norm2(&along) + norm2(&across)).sqrt();
        let size = [ab, ac, sub(&c, &b)].iter().map(norm2).fold(0.0, f64::max).sqrt();
        Some(Self { origin: a, axes, corners, sides, size, color: [base, along, across], slope })
    }

    #[inline]
    fn at(&self, p: &Vec3) -> Vec3 {
        let to_p = sub(p, &self.origin);
        [0, 1, 2].map(|i| dot(&self.axes[i], &to_p))
    }

    /// How far inside a side; negative outside.
    #[inline]
    fn depth(&self, side: usize, p: &Vec3) -> f64 {
        let [x, y, offset] = self.sides[side];
        x * p[0] + y * p[1] + offset
    }

    #[inline]
    fn height(&self, p: &Vec3) -> f64 {
        dot(&self.axes[2], &sub(p, &self.origin))
    }

    /// Whether no point of this triangle is within `reach`, which contains the slack, of the other one.
    #[inline]
    fn apart(&self, other: &[Vec3; 3], reach: f64) -> bool {
        other.iter().all(|p| p[2] > reach)
            || other.iter().all(|p| p[2] < -reach)
            || (0..3).any(|side| other.iter().all(|p| self.depth(side, p) < -reach))
    }

    #[inline]
    fn rounding(&self, p: &Vec3) -> f64 {
        ROUNDING * (self.size + p[0].abs() + p[1].abs())
    }

    /// Bit i is set where the point is outside of side i, and not by rounding.
    #[inline]
    fn outside(&self, p: &Vec3) -> u8 {
        let margin = self.rounding(p);
        (0..3).map(|side| u8::from(self.depth(side, p) < -margin) << side).sum()
    }

    /// The greatest height that another triangle has over this one.
    fn height_over(&self, other: &[Vec3; 3]) -> f64 {
        let margin = other.iter().map(|p| self.rounding(p)).fold(0.0, f64::max);
        let corner = |at: Vec3| Corner { at, color: [0.0; 3], reach: 0.0 };
        let part = (0..3).fold(Polygon::new(other.map(corner)), |part, side| {
            part.clipped(|p| self.depth(side, p) + margin)
        });
        part.iter().map(|c| c.at[2].abs()).fold(0.0, f64::max)
    }

    /// Whether a side passes beside this triangle.
    fn beside(&self, [a, b]: &[Vec3; 2]) -> bool {
        let along = [b[0] - a[0], b[1] - a[1]];
        let length = along[0].abs() + along[1].abs();
        let margin = length * (self.rounding(a) + self.rounding(b));
        let turn = self.corners.map(|c| along[0] * (c[1] - a[1]) - along[1] * (c[0] - a[0]));
        turn.iter().all(|&t| t > margin) || turn.iter().all(|&t| t < -margin)
    }

    /// As `larger_differs`, with the colour of this triangle continued to the feet of the points of the other one:
    /// those nearest to a point here, and those within the slack of them.
    fn smaller_differs(&self, against: &Against<'_>, seen: &Seen, around: f64) -> f64 {
        let colors = against.target.corner_colors(seen.slot);
        let most2 = [0, 1, 2].map(|k| {
            let [x, y, _] = seen.at[k];
            let here = add_scaled(&add_scaled(&self.color[0], x, &self.color[1]), y, &self.color[2]);
            norm2(&sub(&here, &colors[k]))
        });
        // Where heights are above zero all over the triangle, less is left for the way along the plane.
        let [low, high] =
            [f64::min, f64::max].map(|pick| seen.at[1..].iter().fold(seen.at[0][2], |m, p| pick(m, p[2])));
        let nearest = low.max(-high).max(0.0).min(around);
        let moved = (around * around - nearest * nearest).sqrt();
        let most = most2.iter().fold(0.0f64, |m, &d| m.max(d)).sqrt();
        most + self.slope * (moved + against.slack)
    }
}

/// Four times the squared area, and the squared length of the longest side.
#[inline]
fn area_and_length([a, b, c]: &[Vec3; 3]) -> (f64, f64) {
    let (ab, ac) = (sub(b, a), sub(c, a));
    let longest = norm2(&ab).max(norm2(&ac)).max(norm2(&sub(c, b)));
    (norm2(&cross(&ab, &ac)), longest)
}

/// Of a needle only the longest side counts, which is no farther from any of its points than this.
#[inline]
fn needle_height(corners: &[Vec3; 3]) -> f64 {
    let (area2, longest2) = area_and_length(corners);
    if is_needle((area2, longest2)) && longest2 > 0.0 { (area2 / longest2).sqrt() } else { 0.0 }
}

#[inline]
fn is_needle((area2, longest2): (f64, f64)) -> bool {
    area2 <= (NEEDLE * longest2).powi(2)
}

/// How many times a triangle goes around a place, as seen: 1, 0 or −1. None where that is too close to call.
#[inline]
fn turns(corners: &[Vec3; 3], place: &[f64; 2]) -> Option<i32> {
    let to = corners.map(|p| [p[0] - place[0], p[1] - place[1]]);
    let mut side = [0; 3];
    for (i, j) in [(0, 1), (1, 2), (2, 0)] {
        let (a, b) = (to[i], to[j]);
        let turn = a[0] * b[1] - a[1] * b[0];
        let margin = ROUNDING * (a[0].abs() + a[1].abs()) * (b[0].abs() + b[1].abs());
        side[i] = if turn > margin {
            1
        } else if turn < -margin {
            -1
        } else {
            0
        };
    }
    if side.contains(&1) && side.contains(&-1) {
        return Some(0);
    }
    let beyond = (0..2).any(|i| to.iter().all(|p| p[i] > 0.0) || to.iter().all(|p| p[i] < 0.0));
    match side {
        _ if beyond => Some(0),
        [1, 1, 1] => Some(1),
        [-1, -1, -1] => Some(-1),
        _ => None,
    }
}

/// A length that no side of the triangle is much longer than.
#[inline]
fn extent(corners: &[Vec3; 3]) -> f64 {
    let [low, high] = around(corners.iter().copied());
    (0..3).map(|i| high[i] - low[i]).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests;
