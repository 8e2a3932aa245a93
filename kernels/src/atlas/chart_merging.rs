//! Dissolution of small charts: each triangle is rotated about an edge that it shares with a neighbouring
//! chart, into the plane of that chart, unless it would overlap other triangles there.
//!
//! Every chart needs padding around it, so fewer and larger charts use more of the image than many small
//! ones.

use super::charts::{ChartGrowth, Charts, MAX_DENSITY_RATIO, MIN_KEPT_COSINE};
use super::triangle_adjacency::NO_TRIANGLE;
use crate::base::errors::KernelError;
use crate::base::geometry::{dot, sub};
use crate::base::progress::Progress;

/// Relative tolerance for rounding when the area of a rotated triangle is compared with its original area.
const AREA_TOLERANCE: f64 = 1e-9;

/// Dissolve charts smaller than `small` texels into their neighbours. A chart stays unless all its triangles
/// fit elsewhere.
///
/// # Errors
/// As [`Progress::check`].
pub fn merge_small_charts(
    charts: &mut Charts,
    growth: &ChartGrowth<'_>,
    small: f64,
    progress: &mut Progress,
) -> Result<(), KernelError> {
    let mut members: Vec<Vec<u32>> = vec![vec![]; charts.scales.len()];
    let mut texels = vec![0.0; charts.scales.len()];
    for (t, &chart) in charts.chart_of_triangle.iter().enumerate() {
        if chart != NO_TRIANGLE {
            members[chart as usize].push(t as u32);
            texels[chart as usize] += growth.areas[t] * charts.scales[chart as usize].powi(2);
        }
    }
    let mut order: Vec<usize> =
        (0..members.len()).filter(|&c| texels[c] < small && !members[c].is_empty()).collect();
    order.sort_by(|&a, &b| texels[a].total_cmp(&texels[b]).then(a.cmp(&b)));
    let mut boxes = chart_boxes(charts);
    for chart in order {
        progress.check_periodically()?;
        let moved = std::mem::take(&mut members[chart]);
        if !charts.dissolve(&moved, growth, &mut boxes) {
            members[chart] = moved;
            continue;
        }
        for t in moved {
            members[charts.chart_of_triangle[t as usize] as usize].push(t);
        }
    }
    charts.renumber_charts();
    Ok(())
}

type TexelBox = [[f64; 2]; 2];

fn chart_boxes(charts: &Charts) -> Vec<TexelBox> {
    let mut boxes = vec![[[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]]; charts.scales.len()];
    for (t, &chart) in charts.chart_of_triangle.iter().enumerate() {
        if chart != NO_TRIANGLE {
            boxes[chart as usize] = grow_box(&boxes[chart as usize], &charts.corners[t]);
        }
    }
    boxes
}

fn grow_box(area: &TexelBox, corners: &[[f64; 2]; 3]) -> TexelBox {
    let [mut low, mut high] = *area;
    for p in corners {
        for k in 0..2 {
            (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
        }
    }
    [low, high]
}

impl Charts {
    /// Move all triangles of a chart into neighbouring charts; if one does not fit, restore all and return
    /// false.
    fn dissolve(&mut self, members: &[u32], growth: &ChartGrowth<'_>, boxes: &mut [TexelBox]) -> bool {
        let own = self.chart_of_triangle[members[0] as usize];
        let mut left = members.to_vec();
        let mut moved: Vec<(u32, [[f64; 2]; 3])> = vec![];
        loop {
            let before = left.len();
            left.retain(|&t| {
                let kept = self.corners[t as usize];
                let is_placed = self.move_to_neighbour(t, own, growth, boxes);
                if is_placed {
                    moved.push((t, kept));
                }
                !is_placed
            });
            if left.is_empty() {
                return true;
            }
            if left.len() == before {
                break;
            }
        }
        for (t, kept) in moved {
            let host = self.chart_of_triangle[t as usize] as usize;
            self.bitmaps[host].release(&self.corners[t as usize]);
            (self.chart_of_triangle[t as usize], self.corners[t as usize]) = (own, kept);
        }
        false
    }

    /// Rotate a triangle into the plane of a neighbouring chart; return false if it fits into none.
    fn move_to_neighbour(
        &mut self,
        t: u32,
        own: u32,
        growth: &ChartGrowth<'_>,
        boxes: &mut [TexelBox],
    ) -> bool {
        let across = growth.neighbours[t as usize];
        let hosts =
            across.map(|n| if n == NO_TRIANGLE { NO_TRIANGLE } else { self.chart_of_triangle[n as usize] });
        for side in 0..3 {
            let host = hosts[side];
            if host == NO_TRIANGLE || host == own {
                continue;
            }
            let Some([a, b]) = self.neighbour_edge(growth, t, side, across[side]) else { continue };
            let scale = self.scales[host as usize];
            let ratio = f64::from(growth.density[t as usize]) / scale;
            if !(1.0 / MAX_DENSITY_RATIO..=MAX_DENSITY_RATIO).contains(&ratio) {
                continue;
            }
            // If a second edge touches the same chart, the third corner is already laid out there.
            let next = (side + 1) % 3;
            let there = (hosts[next] == host)
                .then(|| self.neighbour_edge(growth, t, next, across[next]))
                .flatten()
                .filter(|other| other[0] == b)
                .map(|other| other[1]);
            let turned = growth.unfold_apex(t, side, &a, &b, scale);
            for apex in there.into_iter().chain([turned]) {
                let mut corners = [[0.0; 2]; 3];
                (corners[side], corners[next], corners[(side + 2) % 3]) = (a, b, apex);
                let share = doubled_area(&corners) / (2.0 * growth.areas[t as usize] * scale * scale);
                let area = grow_box(&boxes[host as usize], &corners);
                let fits = (0..2).all(|k| area[1][k] - area[0][k].floor() <= growth.side);
                if (MIN_KEPT_COSINE..=1.0 + AREA_TOLERANCE).contains(&share)
                    && fits
                    && self.bitmaps[host as usize].claim(&corners)
                {
                    boxes[host as usize] = area;
                    (self.chart_of_triangle[t as usize], self.corners[t as usize]) = (host, corners);
                    return true;
                }
            }
        }
        false
    }

    /// Get the chart coordinates of an edge in the chart of its neighbour; None if the neighbour traverses it
    /// in the same direction.
    fn neighbour_edge(
        &self,
        growth: &ChartGrowth<'_>,
        t: u32,
        side: usize,
        neighbour: u32,
    ) -> Option<[[f64; 2]; 2]> {
        let corners = growth.triangles[t as usize];
        let (from, to) = (corners[side], corners[(side + 1) % 3]);
        let other = growth.triangles[neighbour as usize];
        let k = (0..3).find(|&k| other[k] == to && other[(k + 1) % 3] == from)?;
        let places = self.corners[neighbour as usize];
        Some([places[(k + 1) % 3], places[k]])
    }

    /// Renumber charts without the empty ones, and shift each by whole texels so that its box starts at the
    /// origin.
    fn renumber_charts(&mut self) {
        let boxes = chart_boxes(self);
        let mut numbers = vec![NO_TRIANGLE; boxes.len()];
        self.count = 0;
        for (number, area) in numbers.iter_mut().zip(&boxes) {
            if area[0][0] <= area[1][0] {
                *number = self.count as u32;
                self.count += 1;
            }
        }
        for (chart, corners) in self.chart_of_triangle.iter_mut().zip(&mut self.corners) {
            if *chart != NO_TRIANGLE {
                let low = boxes[*chart as usize][0].map(f64::floor);
                *corners = corners.map(|p| [p[0] - low[0], p[1] - low[1]]);
                *chart = numbers[*chart as usize];
            }
        }
    }
}

impl ChartGrowth<'_> {
    /// Compute the third corner of a triangle in a chart plane, given one edge there, at the height that the
    /// triangle has in 3-D.
    fn unfold_apex(&self, t: u32, side: usize, a: &[f64; 2], b: &[f64; 2], scale: f64) -> [f64; 2] {
        let corners = self.triangles[t as usize];
        let [from, to, apex] = [0, 1, 2].map(|k| self.points[corners[(side + k) % 3] as usize]);
        let edge = sub(&to, &from);
        let length2 = dot(&edge, &edge);
        let along = dot(&sub(&apex, &from), &edge) / length2;
        let height = 2.0 * self.areas[t as usize] / length2.sqrt() * scale;
        let d = [b[0] - a[0], b[1] - a[1]];
        let length = d[0].hypot(d[1]).max(f64::MIN_POSITIVE);
        [a[0] + along * d[0] - height * d[1] / length, a[1] + along * d[1] + height * d[0] / length]
    }
}

fn doubled_area([a, b, c]: &[[f64; 2]; 3]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}
