//! Upper bounds on the deviation of one convex piece of a triangle: distance and colour difference.
//!
//! The bound on colour covers each target triangle that is at most the slack farther away than the nearest
//! one: its nearest point and all its points within the slack of that.

use super::facet::{Facet, distance2, nearest_point};
use super::polygon::{Corner, Polygon};
use super::surface::{NearestTriangle, Surface, difference, interpolate_colors, weighted_sum};
use crate::base::geometry::{Vec3, bounding_box, dot, norm2, sub};

/// Maximum number of target triangles around a piece for which its colour is bounded. A piece with more is
/// split first, unless it is small compared with the distance.
const MAX_NEAR_TRIANGLES: usize = 48;

/// Deviation in shape (metres) and colour (8-bit levels, Euclidean norm over the channels).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deviation {
    pub shape: f64,
    pub color: f64,
}

impl Deviation {
    /// Return the larger deviation of each component.
    pub fn max(self, other: Self) -> Self {
        Self { shape: self.shape.max(other.shape), color: self.color.max(other.color) }
    }

    /// Return the smaller deviation of each component.
    pub fn min(self, other: Self) -> Self {
        Self { shape: self.shape.min(other.shape), color: self.color.min(other.color) }
    }

    /// Apply a function to both components.
    pub fn map(self, each: impl Fn(f64) -> f64) -> Self {
        Self { shape: each(self.shape), color: each(self.color) }
    }

    /// Test if both components are at most those in `other`.
    pub fn is_within(self, other: Self) -> bool {
        self.shape <= other.shape && self.color <= other.color
    }
}

/// Deviation of the part of a piece whose nearest points may be in one slot of the target.
#[derive(Clone, Copy, Debug)]
pub struct SlotDeviation {
    pub slot: u32,
    pub deviation: Deviation,
}

/// A convex piece of a triangle, with proven bounds.
#[derive(Clone, Debug)]
pub struct Piece {
    pub polygon: Polygon,
    /// The slot nearest to the centre.
    pub slot: u32,
    pub radius: f64,
    pub bound: Deviation,
    /// The corners that determine the bound on shape and the bound on colour.
    pub worst: [Corner; 2],
    /// Range in the list of shares; `None` if there were too many target triangles.
    pub shares: Option<(usize, usize)>,
}

/// Pieces for which deviations are attributed to target slots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AttributionMode {
    None,
    All,
    /// Pieces that are not within this deviation.
    Beyond(Deviation),
}

/// The target surface and common settings of all bounds.
pub struct BoundContext<'a> {
    pub target: &'a Surface,
    pub slack: f64,
    /// Upper bound on the difference between any two colours of the surfaces.
    pub color_range: f64,
    pub with_color: bool,
    pub attribution: AttributionMode,
}

impl BoundContext<'_> {
    /// Bound a polygon that is part of a piece with bound `parent`.
    ///
    /// Returns the piece and the deviation at its centre. `goal` maps that deviation to the bound that is
    /// tight enough.
    pub fn bound_piece(
        &self,
        mut polygon: Polygon,
        hint: u32,
        parent: Deviation,
        goal: impl Fn(Deviation) -> Deviation,
        shares: &mut Vec<SlotDeviation>,
    ) -> (Piece, Deviation) {
        let (centre, radius) = polygon.centre();
        let NearestTriangle { slot, distance } = self.target.nearest(&centre.at, hint);
        let attained = self.measure_deviation(&centre, slot, distance);
        // Two convex upper bounds on the distance: the distance to one triangle, and a cone around the
        // centre.
        let reach = self.target.distance_bound(slot);
        polygon.set_reach(&reach);
        let at_centre = reach(&centre.at);
        if farthest_corner(&polygon).reach > at_centre + radius {
            polygon.set_reach(|p| at_centre + norm2(&sub(p, &centre.at)).sqrt());
        }
        let far = farthest_corner(&polygon);
        let shape = (far.reach + self.slack).min(parent.shape);
        let mut piece = Piece {
            polygon,
            slot,
            radius,
            bound: Deviation { shape, color: parent.color },
            worst: [far; 2],
            shares: None,
        };
        // Colour is bounded only for pieces that are near enough to the target.
        let level = goal(attained);
        if (self.with_color || self.attribution == AttributionMode::All) && shape <= level.shape {
            self.bound_color_around(&mut piece, parent, level.color, shares);
        }
        (piece, attained)
    }

    /// Measure the deviation at a point whose nearest triangle is known.
    pub fn measure_deviation(&self, corner: &Corner, slot: u32, distance: f64) -> Deviation {
        let color = if self.with_color {
            difference(&corner.color, &self.target.color_at(slot, &corner.at))
        } else {
            0.0
        };
        Deviation { shape: distance, color }
    }

    fn bound_color_around(
        &self,
        piece: &mut Piece,
        parent: Deviation,
        level: f64,
        shares: &mut Vec<SlotDeviation>,
    ) {
        let first = shares.len();
        let (mut met, mut color) = (0, 0.0);
        let crowd = if 2.0 * piece.radius < piece.bound.shape { usize::MAX } else { MAX_NEAR_TRIANGLES };
        // Skip branches whose colours are all close enough to all colours of the piece.
        let all = self.attribution == AttributionMode::All;
        let colors = (!all).then(|| bounding_box(piece.polygon.iter().map(|c| c.color)));
        let mut close = 0.0;
        let skip = |node: u32, branch: usize| {
            colors.is_some_and(|colors| {
                let range = self.target.bound_color_difference_below(node, branch, &colors);
                let skip = range <= level;
                if skip {
                    close = range.max(close);
                }
                skip
            })
        };
        self.visit_near(&piece.polygon, skip, |slot| {
            met += 1;
            if let Some((deviation, worst)) = self.bound_slot(&piece.polygon, slot) {
                let deviation = deviation.min(piece.bound);
                if deviation.color > color {
                    color = deviation.color;
                    piece.worst[1] = worst;
                }
                if all {
                    shares.push(SlotDeviation { slot, deviation });
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

    /// Attribute the deviation of a piece to target slots.
    pub fn attribute_deviations(&self, piece: &Piece, shares: &mut Vec<SlotDeviation>) {
        self.visit_near(
            &piece.polygon,
            |_, _| false,
            |slot| {
                if let Some((deviation, _)) = self.bound_slot(&piece.polygon, slot) {
                    shares.push(SlotDeviation { slot, deviation: deviation.min(piece.bound) });
                }
                true
            },
        );
    }

    /// Visit every slot whose triangle may be nearest to a point of `polygon`.
    ///
    /// Triangles within the slack of the nearest one are included, and some more. `skip` and `visit` are as
    /// in [`Bvh::meeting`].
    ///
    /// [`Bvh::meeting`]: crate::mesh::bvh::Bvh::meeting
    fn visit_near(
        &self,
        polygon: &Polygon,
        skip: impl FnMut(u32, usize) -> bool,
        visit: impl FnMut(u32) -> bool,
    ) {
        let reach = farthest_corner(polygon).reach + self.slack;
        let [low, high] = polygon.bounding_box();
        self.target.bvh.visit_overlapping(&low.map(|x| x - reach), &high.map(|x| x + reach), skip, visit);
    }

    /// Bound the deviation of the points of `polygon` that `slot` may be nearest to.
    ///
    /// Points within the slack of that count, too. Also returns the corner with the largest colour
    /// difference; `None` if there are no such points.
    pub fn bound_slot(&self, polygon: &Polygon, slot: u32) -> Option<(Deviation, Corner)> {
        let corners = &self.target.corners(slot);
        let facet = Facet::new(corners);
        let mut part = *polygon;
        let outside = self.clip_to_slot(&mut part, facet.as_ref())?;
        if self.is_beyond(&part, corners) {
            return None;
        }
        let shape = farthest_corner(&part).reach + self.slack;
        if !self.with_color {
            return Some((Deviation { shape, color: 0.0 }, part[0]));
        }
        let (color, worst) = self.bound_color(&part, corners, facet.as_ref(), outside, slot);
        Some((Deviation { shape, color }, worst))
    }

    /// Test if the colours of `polygon` and of a nearest slot differ by ≤ `level`.
    ///
    /// Only the part of `polygon` that `slot` may be nearest to counts. Makes up to `cuts` cuts: along a
    /// plane beyond which another triangle is nearer, or in two. On failure, returns a corner that may differ
    /// more.
    pub fn proves_slot_color(
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
            let Some(outside) = self.clip_to_slot(&mut part, facet) else { continue };
            let soon = facet.is_some_and(|facet| {
                let beside = facet.gradient_norm(colors) * (outside + self.slack);
                let differs = |c: &Corner| difference(&c.color, &weighted_sum(&facet.weights(&c.at), colors));
                part.iter().all(|c| differs(c) + beside <= level)
            });
            if soon || self.is_beyond(&part, corners) {
                continue;
            }
            let (most, worst) = self.bound_color(&part, corners, facet, outside, slot);
            if most <= level {
                continue;
            }
            if made == cuts {
                return Err(worst);
            }
            made += 1;
            let here = nearest_point(&worst.at, corners);
            let distance = here.distance2.sqrt();
            let away = sub(&worst.at, &weighted_sum(&here.weights, corners)).map(|x| x / distance);
            // The distance to a triangle is convex. Its tangent plane is a lower bound, and interpolation
            // between corners is an upper bound.
            let at_least = |p: &Vec3| distance + dot(&away, &sub(p, &worst.at)) - self.slack;
            if distance > worst.reach + self.slack {
                part.clip_convex(|c| c.reach - at_least(&c.at));
                parts.push(part);
                continue;
            }
            let nearer = self.target.nearest(&worst.at, slot);
            let reach = self.target.distance_bound(nearer.slot);
            if distance > reach(&worst.at) + self.slack {
                part.clip_convex(|c| reach(&c.at) - at_least(&c.at));
                parts.push(part);
            } else if self.measure_deviation(&worst, nearer.slot, nearer.distance).color > level {
                return Err(worst);
            } else {
                parts.extend(part.halves());
            }
        }
        Ok(())
    }

    /// Clip to the region whose nearest point may be on a triangle, as [`Facet::clip_to_slot`].
    fn clip_to_slot(&self, part: &mut Polygon, facet: Option<&Facet>) -> Option<f64> {
        match facet {
            Some(facet) => facet.clip_to_nearest(part, self.slack),
            None => (!part.is_empty()).then_some(f64::INFINITY),
        }
    }

    /// Test if a triangle is too far away, by a ball around the part. Next to a sharp corner, the offset
    /// outlines alone do not exclude it.
    fn is_beyond(&self, part: &Polygon, corners: &[Vec3; 3]) -> bool {
        let (centre, radius) = part.centre();
        distance2(&centre.at, corners).sqrt() - radius > farthest_corner(part).reach + self.slack
    }

    /// Bound the colour difference between `clip_to_slot` and the nearest points of one triangle.
    ///
    /// Points within the slack of the nearest points count, too. `outside` is the maximum distance of feet
    /// outside the triangle. Also returns the corner with the largest difference.
    fn bound_color(
        &self,
        part: &Polygon,
        corners: &[Vec3; 3],
        facet: Option<&Facet>,
        outside: f64,
        slot: u32,
    ) -> (f64, Corner) {
        let colors = self.target.corner_colors(slot);
        // On one face, side or corner, the nearest point is a linear function of the position, and each such
        // region is convex. The colour difference is linear there, too, and its norm is largest at a corner.
        let mut features = 0;
        let mut exact = (0.0, part[0]);
        // Otherwise: the colour continued over the plane, and the distance of the foot from the triangle.
        let (mut continued, mut beyond) = (0.0f64, 0.0f64);
        // No colour of the triangle differs more than one of its corner colours does: the norm is convex in
        // both.
        let mut range = 0.0f64;
        for corner in part.iter() {
            let here = nearest_point(&corner.at, corners);
            features |= 1u8 << here.feature;
            keep_greater(&mut exact, difference(&corner.color, &interpolate_colors(&here, &colors)), corner);
            range = colors.iter().map(|color| difference(&corner.color, color)).fold(range, f64::max);
            if let Some(facet) = facet {
                let height = facet.height(&corner.at);
                beyond = beyond.max((here.distance2 - height * height).max(0.0).sqrt());
                let color = weighted_sum(&facet.weights(&corner.at), &colors);
                continued = continued.max(difference(&corner.color, &color));
            }
        }
        // A flat triangle may have several colours at one position.
        let Some(facet) = facet else { return (range, exact.1) };
        let slope = facet.gradient_norm(&colors);
        let most = if features.count_ones() == 1 {
            exact.0
        } else {
            // Or assume linear colour and bound the error. Nearest points are no farther apart than their
            // query points. The mean distance of a point to corners whose mean it is does not exceed the
            // radius.
            let missed = part.centre().1;
            (continued + slope * beyond.min(outside)).min(exact.0 + slope * missed)
        };
        ((most + slope * self.slack).min(range), exact.1)
    }
}

/// Find the corner with the largest reach.
fn farthest_corner(polygon: &Polygon) -> Corner {
    let mut far = polygon[0];
    for corner in polygon.iter() {
        if corner.reach > far.reach {
            far = *corner;
        }
    }
    far
}

fn keep_greater(most: &mut (f64, Corner), value: f64, corner: &Corner) {
    if value > most.0 {
        *most = (value, *corner);
    }
}
