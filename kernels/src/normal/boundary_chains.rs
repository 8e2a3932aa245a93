//! Boundary curves: chains of original boundary edges on which new boundary vertices are placed.

use super::base_mesh::Chain;
use super::surface::SurfacePoint;
use crate::base::geometry::{Vec3, dot, norm2, sub};

/// Minimum distance of a new vertex from both ends of its span, as a fraction of the span. It prevents
/// zero-length boundary edges.
const MIN_END_MARGIN: f64 = 0.15;

/// A chain as a polyline.
#[derive(Clone, Debug)]
struct Polyline {
    points: Vec<Vec3>,
    /// Arc length at each point.
    lengths: Vec<f64>,
    /// Slot of the triangle at each segment, and the corner where the segment starts.
    sides: Vec<(u32, usize)>,
}

/// Arc length interval of a chain that one boundary edge represents.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChainSpan {
    pub chain: u32,
    pub from: f64,
    pub to: f64,
}

/// Boundary chains of the base as polylines.
#[derive(Clone, Debug)]
pub struct BoundaryChains {
    chains: Vec<Polyline>,
}

impl BoundaryChains {
    /// Build the polylines. `corners` returns the points of an original triangle, `slots` holds its slot.
    pub fn new(chains: &[Chain], corners: impl Fn(usize) -> [Vec3; 3], slots: &[u32]) -> Self {
        let of = |chain: &Chain| {
            let mut line = Polyline { points: vec![], lengths: vec![], sides: vec![] };
            let mut length = 0.0;
            for h in &chain.halfedges {
                let (triangle, corner) = (h.index() / 3, h.index() % 3);
                let points = corners(triangle);
                let (from, to) = (points[corner], points[(corner + 1) % 3]);
                if line.points.is_empty() {
                    line.points.push(from);
                    line.lengths.push(0.0);
                }
                length += norm2(&sub(&to, &from)).sqrt();
                line.points.push(to);
                line.lengths.push(length);
                line.sides.push((slots[triangle], corner));
            }
            line
        };
        Self { chains: chains.iter().map(of).collect() }
    }

    /// Return the span of an entire chain.
    pub fn full_span(&self, chain: u32) -> ChainSpan {
        let to = self.chains[chain as usize].lengths.last().copied().unwrap_or(0.0);
        ChainSpan { chain, from: 0.0, to }
    }

    /// Find the point of a span nearest to `p`, at a margin from both ends. Returns its arc length and
    /// surface point.
    pub fn find_nearest(&self, span: &ChainSpan, p: &Vec3) -> (f64, SurfacePoint) {
        let line = &self.chains[span.chain as usize];
        let margin = MIN_END_MARGIN * (span.to - span.from);
        let (low, high) = (span.from + margin, span.to - margin);
        let first = line.lengths.partition_point(|&l| l <= low).clamp(1, line.sides.len()) - 1;
        let mut best = (f64::INFINITY, low, first, 0.0);
        for piece in first..line.sides.len() {
            let [start, end] = [line.lengths[piece], line.lengths[piece + 1]];
            if start > high {
                break;
            }
            let (a, b) = (&line.points[piece], &line.points[piece + 1]);
            let (along, to_p) = (sub(b, a), sub(p, a));
            let length2 = norm2(&along);
            let free = if length2 > 0.0 { dot(&to_p, &along) / length2 } else { 0.0 };
            let length = end - start;
            let share = |l: f64| if length > 0.0 { ((l - start) / length).clamp(0.0, 1.0) } else { 0.0 };
            let t = free.clamp(share(low), share(high).max(share(low)));
            let off = sub(&to_p, &along.map(|x| t * x));
            if norm2(&off) < best.0 {
                best = (norm2(&off), start + t * length, piece, t);
            }
        }
        let (_, at, piece, t) = best;
        (at, line.place(piece, t))
    }

    /// Return the surface point at an arc length of a chain.
    pub fn point_at(&self, chain: u32, along: f64) -> SurfacePoint {
        let line = &self.chains[chain as usize];
        let piece = line.lengths.partition_point(|&l| l <= along).clamp(1, line.sides.len()) - 1;
        let [start, end] = [line.lengths[piece], line.lengths[piece + 1]];
        let share = if end > start { ((along - start) / (end - start)).clamp(0.0, 1.0) } else { 0.0 };
        line.place(piece, share)
    }
}

impl Polyline {
    fn place(&self, piece: usize, t: f64) -> SurfacePoint {
        let (a, b) = (&self.points[piece], &self.points[piece + 1]);
        let (slot, corner) = self.sides[piece];
        let mut barycentric = [0.0; 3];
        barycentric[corner] = 1.0 - t;
        barycentric[(corner + 1) % 3] = t;
        SurfacePoint { slot, barycentric, point: [0, 1, 2].map(|i| a[i] + t * (b[i] - a[i])) }
    }
}
