//! Upper bounds over one convex piece of a triangle: how far the other surface is, and its colour there.
//!
//! Its colour: on each triangle no more than the slack farther away than the nearest one, at the nearest point and
//! within the slack of that.

use super::facet::{Facet, distance2, nearest};
use super::polygon::{Corner, Polygon};
use super::surface::{Found, Surface, blend, combine, difference};
use crate::base::geometry::{Vec3, around, dot, norm2, sub};

/// Triangles that may be met around a piece before it has to be made smaller for its colour to be looked at,
/// unless it is small already, beside the distance.
const CROWD: usize = 48;

/// Shape in metres, colour in 8-bit levels (Euclidean norm over the channels).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deviation {
    pub shape: f64,
    pub color: f64,
}

impl Deviation {
    pub fn max(self, other: Self) -> Self {
        Self { shape: self.shape.max(other.shape), color: self.color.max(other.color) }
    }

    pub fn min(self, other: Self) -> Self {
        Self { shape: self.shape.min(other.shape), color: self.color.min(other.color) }
    }

    pub fn map(self, each: impl Fn(f64) -> f64) -> Self {
        Self { shape: each(self.shape), color: each(self.color) }
    }

    pub fn within(self, other: Self) -> bool {
        self.shape <= other.shape && self.color <= other.color
    }
}

/// What part of a piece's deviation falls on which slot of the other surface.
#[derive(Clone, Copy, Debug)]
pub struct Share {
    pub slot: u32,
    pub deviation: Deviation,
}

#[derive(Clone, Debug)]
pub struct Piece {
    pub polygon: Polygon,
    /// The slot nearest to the centre.
    pub slot: u32,
    pub radius: f64,
    pub bound: Deviation,
    /// Where the bound on colour, and where that on shape, comes from.
    pub worst: [Corner; 2],
    /// Range in the list of shares; none if there were too many to look at.
    pub shares: Option<(usize, usize)>,
}

/// Of which pieces it is wanted what falls on which slot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Wanted {
    None,
    All,
    /// Of those that are not within this.
    Beyond(Deviation),
}

/// What every piece is bounded against.
pub struct Against<'a> {
    pub target: &'a Surface,
    pub slack: f64,
    /// No colours of the two surfaces differ more.
    pub color_range: f64,
    pub with_color: bool,
    pub wanted: Wanted,
}

impl Against<'_> {
    /// Bound `polygon`, part of something bounded by `parent`. Returns it with the deviation at its centre.
    /// `goal` says, given that, which bound is good enough.
    pub fn piece(
        &self,
        mut polygon: Polygon,
        hint: u32,
        parent: Deviation,
        goal: impl Fn(Deviation) -> Deviation,
        shares: &mut Vec<Share>,
    ) -> (Piece, Deviation) {
        let (centre, radius) = polygon.centre();
        let Found { slot, distance } = self.target.nearest(&centre.at, hint);
        let attained = self.deviation(&centre, slot, distance);
        // Two functions are nowhere less than the distance, and convex: that to one triangle, and a cone.
        let reach = self.target.reach(slot);
        polygon.set_reach(&reach);
        let at_centre = reach(&centre.at);
        if farthest(&polygon).reach > at_centre + radius {
            polygon.set_reach(|p| at_centre + norm2(&sub(p, &centre.at)).sqrt());
        }
        let far = farthest(&polygon);
        let shape = (far.reach + self.slack).min(parent.shape);
        let mut piece = Piece {
            polygon,
            slot,
            radius,
            bound: Deviation { shape, color: parent.color },
            worst: [far; 2],
            shares: None,
        };
        // Colour is looked at where the nearest triangles are not all over the place.
        let level = goal(attained);
        if (self.with_color || self.wanted == Wanted::All) && shape <= level.shape {
            self.look_around(&mut piece, parent, level.color, shares);
        }
        (piece, attained)
    }

    /// Deviation at a point whose nearest triangle is known.
    pub fn deviation(&self, corner: &Corner, slot: u32, distance: f64) -> Deviation {
        let color = if self.with_color {
            difference(&corner.color, &self.target.color(slot, &corner.at))
        } else {
            0.0
        };
        Deviation { shape: distance, color }
    }

    fn look_around(&self, piece: &mut Piece, parent: Deviation, level: f64, shares: &mut Vec<Share>) {
        let first = shares.len();
        let (mut met, mut color) = (0, 0.0);
        let crowd = if 2.0 * piece.radius < piece.bound.shape { usize::MAX } else { CROWD };
        // Where all colours are close enough to all of the piece, nothing else matters.
        let all = self.wanted == Wanted::All;
        let colors = (!all).then(|| around(piece.polygon.iter().map(|c| c.color)));
        let mut close = 0.0;
        let skip = |node: u32, branch: usize| {
            colors.is_some_and(|colors| {
                let range = self.target.colors_apart(node, branch, &colors);
                let skip = range <= level;
                if skip {
                    close = range.max(close);
                }
                skip
            })
        };
        self.around(&piece.polygon, skip, |slot| {
            met += 1;
            if let Some((deviation, worst)) = self.share(&piece.polygon, slot) {
                let deviation = deviation.min(piece.bound);
                if deviation.color > color {
                    color = deviation.color;
                    piece.worst[1] = worst;
                }
                if all {
                    shares.push(Share { slot, deviation });
                }
            }
            met <= crowd
        });
        if met > crowd {
            shares.truncate(first);
        } else {
            piece.shares = all.then_some((first, shares.len()));
            piece.bound.color = close.max(color).min(parent.color);
        }
    }

    /// What of a piece falls on which slot.
    pub fn shares(&self, piece: &Piece, shares: &mut Vec<Share>) {
        self.around(
            &piece.polygon,
            |_, _| false,
            |slot| {
                if let Some((deviation, _)) = self.share(&piece.polygon, slot) {
                    shares.push(Share { slot, deviation: deviation.min(piece.bound) });
                }
                true
            },
        );
    }

    /// Every slot whose triangle may be nearest to some point of `polygon`, or no more than the slack farther away, and
    /// a few more; as [`Bvh::meeting`].
    ///
    /// [`Bvh::meeting`]: crate::mesh::bvh::Bvh::meeting
    fn around(
        &self,
        polygon: &Polygon,
        skip: impl FnMut(u32, usize) -> bool,
        visit: impl FnMut(u32) -> bool,
    ) {
        let reach = farthest(polygon).reach + self.slack;
        let [low, high] = polygon.bounding_box();
        self.target.bvh.meeting(&low.map(|x| x - reach), &high.map(|x| x + reach), skip, visit);
    }

    /// The greatest deviation of those points of `polygon` whose nearest point may be on the triangle in `slot`, or is
    /// no more than the slack nearer.
    pub fn share(&self, polygon: &Polygon, slot: u32) -> Option<(Deviation, Corner)> {
        let corners = &self.target.corners(slot);
        let facet = Facet::new(corners);
        let mut part = *polygon;
        let outside = self.part(&mut part, facet.as_ref())?;
        if self.is_beyond(&part, corners) {
            return None;
        }
        let shape = farthest(&part).reach + self.slack;
        if !self.with_color {
            return Some((Deviation { shape, color: 0.0 }, part[0]));
        }
        let (color, worst) = self.color(&part, corners, facet.as_ref(), outside, slot);
        Some((Deviation { shape, color }, worst))
    }

    /// Whether the share of `polygon` differs in colour by no more than `level`; if not, a corner where it may. Up to so many
    /// `cuts` are made: where another triangle is nearer, and in two where none is.
    pub fn share_within(
        &self,
        polygon: &Polygon,
        slot: u32,
        facet: Option<&Facet>,
        level: f64,
        cuts: usize,
        parts: &mut Vec<Polygon>,
    ) -> Result<(), Corner> {
        let corners = &self.target.corners(slot);
        let colors = &self.target.corner_colors(slot);
        parts.clear();
        parts.push(*polygon);
        let mut made = 0;
        while let Some(mut part) = parts.pop() {
            let Some(outside) = self.part(&mut part, facet) else { continue };
            let soon = facet.is_some_and(|facet| {
                let beside = facet.slope(colors) * (outside + self.slack);
                let differs = |c: &Corner| difference(&c.color, &combine(&facet.weights(&c.at), colors));
                part.iter().all(|c| differs(c) + beside <= level)
            });
            if soon || self.is_beyond(&part, corners) {
                continue;
            }
            let (most, worst) = self.color(&part, corners, facet, outside, slot);
            if most <= level {
                continue;
            }
            if made == cuts {
                return Err(worst);
            }
            made += 1;
            let here = nearest(&worst.at, corners);
            let distance = here.distance2.sqrt();
            let away = sub(&worst.at, &combine(&here.weights, corners)).map(|x| x / distance);
            // The distance to a triangle is convex: nowhere less than it is by its gradient, and nowhere more than it is by
            // corners around.
            let at_least = |p: &Vec3| distance + dot(&away, &sub(p, &worst.at)) - self.slack;
            if distance > worst.reach + self.slack {
                part.keep(|c| c.reach - at_least(&c.at));
                parts.push(part);
                continue;
            }
            let nearer = self.target.nearest(&worst.at, slot);
            let reach = self.target.reach(nearer.slot);
            if distance > reach(&worst.at) + self.slack {
                part.keep(|c| reach(&c.at) - at_least(&c.at));
                parts.push(part);
            } else if self.deviation(&worst, nearer.slot, nearer.distance).color > level {
                return Err(worst);
            } else {
                parts.extend(part.halves());
            }
        }
        Ok(())
    }

    /// Leave the part where the nearest point may be on a triangle. Returns how far outside of that its foot can be there; None
    /// if there is no such part.
    fn part(&self, part: &mut Polygon, facet: Option<&Facet>) -> Option<f64> {
        match facet {
            Some(facet) => facet.part(part, self.slack),
            None => (!part.is_empty()).then_some(f64::INFINITY),
        }
    }

    /// Beside a sharp corner, inside of both outlines moved out, a triangle can still be too far.
    fn is_beyond(&self, part: &Polygon, corners: &[Vec3; 3]) -> bool {
        let (centre, radius) = part.centre();
        distance2(&centre.at, corners).sqrt() - radius > farthest(part).reach + self.slack
    }

    /// The greatest colour difference between `part` and the nearest points of one triangle, or points of it within
    /// the slack of those; and the corner it is from. `outside` is the most a foot may be outside the triangle.
    fn color(
        &self,
        part: &Polygon,
        corners: &[Vec3; 3],
        facet: Option<&Facet>,
        outside: f64,
        slot: u32,
    ) -> (f64, Corner) {
        let colors = self.target.corner_colors(slot);
        // The nearest point of a triangle is linear in space where it stays on one face, side or corner; such a region
        // is convex. So is the difference then, and its norm is greatest at a corner.
        let mut features = 0;
        let mut exact = (0.0, part[0]);
        // Elsewhere: the colour continued over the plane, and how far from the foot the triangle is.
        let (mut continued, mut beyond) = (0.0f64, 0.0f64);
        // No colour of the triangle is farther than one of its corners is: convex in both.
        let mut range = 0.0f64;
        for corner in part.iter() {
            let here = nearest(&corner.at, corners);
            features |= 1u8 << here.feature;
            greater(&mut exact, difference(&corner.color, &blend(&here, &colors)), corner);
            range = colors.iter().map(|color| difference(&corner.color, color)).fold(range, f64::max);
            if let Some(facet) = facet {
                let height = facet.height(&corner.at);
                beyond = beyond.max((here.distance2 - height * height).max(0.0).sqrt());
                let color = combine(&facet.weights(&corner.at), &colors);
                continued = continued.max(difference(&corner.color, &color));
            }
        }
        // A triangle that is no more than its sides has several colours at one place.
        let Some(facet) = facet else { return (range, exact.1) };
        let slope = facet.slope(&colors);
        let most = if features.count_ones() == 1 {
            exact.0
        } else {
            // Or the colour as if linear, and what it misses: nearest points are no farther apart than the points they
            // are nearest to, and the mean distance of a point from corners that it is the mean of is at most the radius.
            let missed = part.centre().1;
            (continued + slope * beyond.min(outside)).min(exact.0 + slope * missed)
        };
        ((most + slope * self.slack).min(range), exact.1)
    }
}

fn farthest(polygon: &Polygon) -> Corner {
    let mut far = polygon[0];
    for corner in polygon.iter() {
        if corner.reach > far.reach {
            far = *corner;
        }
    }
    far
}

fn greater(most: &mut (f64, Corner), value: f64, corner: &Corner) {
    if value > most.0 {
        *most = (value, *corner);
    }
}
