//! Where each vertex of the input lies on the base mesh, kept up while edges collapse.
//!
//! As in MAPS (Lee, Sweldens, Schröder, Cowsar and Dobkin, 1998): before a vertex goes, the triangles around it are
//! laid out flat, angles in proportion; it, and all that lay in them, then lie in the triangles that take their place.
//! Li, Li, Xu and Li do without. What it gains: where a line pierces the associated set in several places, the right
//! one is known, and a place is known where it pierces none.

use std::f64::consts::PI;

use crate::geometry::{Vec3, dot, norm2, sub};
use crate::ids::VertexId;
use crate::star::Star;

const NONE: u32 = u32::MAX;

type Point = [f64; 2];

/// A triangle and barycentric coordinates, in the order of its corners.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    pub triangle: u32,
    pub barycentric: [f64; 3],
}

impl Parameter {
    pub const NOWHERE: Self = Self { triangle: NONE, barycentric: [0.0; 3] };

    /// A corner of a triangle.
    pub fn corner(triangle: u32, corner: usize) -> Self {
        let mut barycentric = [0.0; 3];
        barycentric[corner] = 1.0;
        Self { triangle, barycentric }
    }
}

#[derive(Clone, Debug)]
pub struct Parameters {
    /// Of each vertex of the input; no triangle for one that is still there.
    of: Vec<Parameter>,
    /// Corners of each triangle, as they are or were last.
    corners: Vec<[u32; 3]>,
    /// The first vertex in each triangle, and the next one in the same.
    first: Vec<u32>,
    next: Vec<u32>,
    scratch: Scratch,
}

#[derive(Clone, Debug, Default)]
struct Scratch {
    /// Neighbours of the vertex that goes, the survivor first, and where they lie; it is at the origin.
    ring: Vec<(u32, Vec3)>,
    flat: Vec<Point>,
    moved: Vec<(u32, Point)>,
}

impl Parameters {
    pub fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        Self {
            of: vec![Parameter::NOWHERE; vertices],
            corners: triangles.to_vec(),
            first: vec![NONE; triangles.len()],
            next: vec![NONE; vertices],
            scratch: Scratch::default(),
        }
    }

    /// Of a vertex of the input that is gone, with the corners its coordinates stand for.
    pub fn of(&self, v: usize) -> Option<(Parameter, [u32; 3])> {
        let parameter = self.of[v];
        (parameter.triangle != NONE).then(|| (parameter, self.corners[parameter.triangle as usize]))
    }

    /// An end of the edge of `star`, 0 or 1, has collapsed into the other.
    pub fn collapse(&mut self, star: &Star<3>, removed: usize) {
        let mut scratch = std::mem::take(&mut self.scratch);
        let gone = star.ends[removed].0;
        let survivor = star.ends[1 - removed].0;
        scratch.lay_out(star, removed);
        let place = |v: u32, ring: &[(u32, Vec3)], flat: &[Point]| {
            ring.iter().position(|(w, _)| *w == v).map_or([0.0; 2], |i| flat[i])
        };
        let wings = || star.wings.iter().filter(|w| w.end == removed).map(|w| w.triangle.index());
        if wings().next().is_none() {
            self.scratch = scratch;
            self.fold_ear(star, removed);
            return;
        }

        // Everything in the triangles around, in the plane.
        scratch.moved.clear();
        scratch.moved.push((gone, [0.0; 2]));
        for triangle in wings().chain(star.vanishing.iter().map(|(t, ..)| t.index())) {
            let at = self.corners[triangle].map(|v| place(v, &scratch.ring, &scratch.flat));
            let mut v = std::mem::replace(&mut self.first[triangle], NONE);
            while v != NONE {
                let [a, b, c] = self.of[v as usize].barycentric;
                scratch.moved.push((v, [0, 1].map(|i| a * at[0][i] + b * at[1][i] + c * at[2][i])));
                v = self.next[v as usize];
            }
        }
        for triangle in wings() {
            self.corners[triangle] = self.corners[triangle].map(|v| if v == gone { survivor } else { v });
        }

        for &(v, at) in &scratch.moved {
            let mut best = (f64::NEG_INFINITY, NONE, [0.0; 3]);
            for triangle in wings() {
                let corners = self.corners[triangle].map(|v| place(v, &scratch.ring, &scratch.flat));
                let barycentric = barycentric(&at, &corners);
                let least = barycentric.iter().fold(f64::INFINITY, |least, &x| least.min(x));
                if least > best.0 {
                    best = (least, triangle as u32, barycentric);
                }
                if least >= 0.0 {
                    break;
                }
            }
            let (_, triangle, barycentric) = best;
            let inside = barycentric.map(|x| x.max(0.0));
            let sum: f64 = inside.iter().sum();
            self.of[v as usize] = Parameter { triangle, barycentric: inside.map(|x| x / sum) };
            if triangle != NONE {
                self.next[v as usize] = std::mem::replace(&mut self.first[triangle as usize], v);
            }
        }
        self.scratch = scratch;
    }

    /// The vertex that goes has one triangle only: what lay there comes to lie on the side that stays.
    fn fold_ear(&mut self, star: &Star<3>, removed: usize) {
        let (ear, apex, _) = star.vanishing[0];
        let (gone, survivor) = (star.ends[removed].0, star.ends[1 - removed].0);
        let beside = star.wings.iter().find(|w| w.from == apex || w.to == apex);
        let Some(triangle) = beside.map(|w| w.triangle.index()) else { return };
        let corners = self.corners[triangle];
        let put = |v: u32, at_survivor: f64, at_apex: f64, this: &mut Self| {
            let barycentric = corners.map(|c| {
                if c == survivor { at_survivor } else { f64::from(u8::from(c == apex.0)) * at_apex }
            });
            this.of[v as usize] = Parameter { triangle: triangle as u32, barycentric };
            this.next[v as usize] = std::mem::replace(&mut this.first[triangle], v);
        };
        let was = self.corners[ear.index()];
        let mut v = std::mem::replace(&mut self.first[ear.index()], NONE);
        while v != NONE {
            let next = self.next[v as usize];
            let of = |corner: u32| {
                was.iter().position(|c| *c == corner).map_or(0.0, |i| self.of[v as usize].barycentric[i])
            };
            let half = 0.5 * of(gone);
            let (at_survivor, at_apex) = (of(survivor) + half, of(apex.0) + half);
            put(v, at_survivor, at_apex, self);
            v = next;
        }
        put(gone, 0.5, 0.5, self);
    }
}

impl Scratch {
    /// Lay the neighbours of an end of an edge out in the plane, counter-clockwise: at their distances, or, where the
    /// survivor would not see all of them then, on a circle.
    fn lay_out(&mut self, star: &Star<3>, removed: usize) {
        let origin = &star.end_points[removed];
        let other = 1 - removed;
        let survivor = (star.ends[other], star.end_points[other]);
        self.ring.clear();
        // The triangle on the left of the edge, seen from the end that goes, starts the turn.
        let left = removed;
        let on_left = star.vanishing.len() == 2 || removed == 0;
        let wings = || star.wings.iter().filter(|w| w.end == removed);
        let mut at: VertexId;
        if on_left {
            let (_, apex, point) = star.vanishing[if star.vanishing.len() == 2 { left } else { 0 }];
            self.ring.extend([(survivor.0.0, survivor.1), (apex.0, point)]);
            at = apex;
        } else {
            // On a boundary, with the only triangle on the right: from the far end to the survivor.
            let starts = |v: VertexId| wings().all(|w| w.to != v);
            let first = wings().find(|w| starts(w.from));
            let Some(first) = first else {
                let (_, apex, point) = star.vanishing[0];
                self.ring.extend([(apex.0, point), (survivor.0.0, survivor.1)]);
                self.flatten(origin, false, 1);
                return;
            };
            self.ring.push((first.from.0, first.from_point));
            at = first.from;
        }
        while let Some(wing) = wings().find(|w| w.from == at) {
            if self.ring.iter().any(|(v, _)| *v == wing.to.0) {
                break;
            }
            self.ring.push((wing.to.0, wing.to_point));
            at = wing.to;
        }
        let closed = star.vanishing.len() == 2;
        let mut survivor_at = 0;
        if !on_left {
            survivor_at = self.ring.len();
            self.ring.push((survivor.0.0, survivor.1));
        }
        self.flatten(origin, closed, survivor_at);
    }

    fn flatten(&mut self, origin: &Vec3, closed: bool, survivor: usize) {
        let count = self.ring.len();
        let spokes: Vec<Vec3> = self.ring.iter().map(|(_, p)| sub(p, origin)).collect();
        let gaps = if closed { count } else { count - 1 };
        let angle = |i: usize| {
            let (a, b) = (&spokes[i], &spokes[(i + 1) % count]);
            let lengths = (norm2(a) * norm2(b)).sqrt();
            // Never nothing: every triangle keeps a part of the turn.
            if lengths > 0.0 { (dot(a, b) / lengths).clamp(-1.0, 1.0).acos().max(1e-3) } else { 1e-3 }
        };
        let angles: Vec<f64> = (0..gaps).map(angle).collect();
        let total: f64 = angles.iter().sum();
        let turn = if closed { 2.0 * PI } else { PI };
        let mut directions = Vec::with_capacity(count);
        let mut at: f64 = 0.0;
        for i in 0..count {
            directions.push([at.cos(), at.sin()]);
            at += angles.get(i).map_or(0.0, |a| a * turn / total);
        }
        self.flat.clear();
        self.flat.extend((0..count).map(|i| directions[i].map(|x| x * norm2(&spokes[i]).sqrt())));
        let s = self.flat[survivor];
        let seen = (0..gaps).all(|i| {
            let j = (i + 1) % count;
            i == survivor
                || j == survivor
                || area(&s, &self.flat[i], &self.flat[j])
                    > 1e-3 * area_scale(&s, &self.flat[i], &self.flat[j])
        });
        if !seen {
            self.flat = directions;
        }
    }
}

fn area_scale(a: &Point, b: &Point, c: &Point) -> f64 {
    let d = |p: &Point, q: &Point| (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2);
    d(a, b).max(d(b, c)).max(d(c, a))
}

/// Twice the area of a triangle, positive if it turns to the left.
pub fn area(a: &Point, b: &Point, c: &Point) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Barycentric coordinates in a triangle of the plane; far outside of one without area.
pub fn barycentric(p: &Point, [a, b, c]: &[Point; 3]) -> [f64; 3] {
    let whole = area(a, b, c);
    if whole <= 0.0 {
        return [-1e30; 3];
    }
    let (u, v) = (area(p, b, c) / whole, area(a, p, c) / whole);
    [u, v, 1.0 - u - v]
}
