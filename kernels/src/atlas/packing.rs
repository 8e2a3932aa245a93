//! Packing of charts into images, largest chart first. Each is rotated by quarter turns to the orientation in
//! which its centre ends up highest, and may fill gaps between charts already placed.

use std::collections::BTreeMap;

use super::atlas_page::AtlasPage;
use super::chart_outline::{ChartOutline, QUARTER_TURNS, rotate_quarter_turns};
use super::charts::Charts;
use super::triangle_adjacency::NO_TRIANGLE;
use crate::base::errors::KernelError;
use crate::base::progress::Progress;

/// Shapes whose sides differ by less than this factor share a search start: the position of the last one
/// placed. With a smaller factor, and more steps in `Page::find`, images are a few rows lower after twice the
/// time.
const SIZE_CLASS_RATIO: f64 = 1.3;

/// Charts packed into images of one width.
#[derive(Debug)]
pub struct PackedCharts {
    /// Image of each triangle; `u16::MAX` for triangles without a chart.
    pub page_of_triangle: Vec<u16>,
    /// Corners of each triangle, in texels of its image.
    pub corners: Vec<[[f64; 2]; 3]>,
    /// Number of used rows of each image.
    pub heights: Vec<usize>,
}

/// Page index, and position on the page (column, row).
type PagePosition = (usize, [usize; 2]);

/// Pack charts into images of `side` × `side` texels, with `padding` texels around each.
///
/// # Errors
/// As [`Progress::check`]; [`KernelError::TooManyTriangles`] if more images are needed than 16-bit indices
/// allow.
pub fn pack_charts(
    charts: &Charts,
    side: usize,
    padding: usize,
    progress: &mut Progress,
) -> Result<PackedCharts, KernelError> {
    let mut members: Vec<Vec<u32>> = vec![vec![]; charts.count];
    let mut sizes = vec![[1usize; 2]; charts.count];
    for (t, &chart) in charts.chart_of_triangle.iter().enumerate() {
        if chart != NO_TRIANGLE {
            members[chart as usize].push(t as u32);
            for p in charts.corners[t] {
                for k in 0..2 {
                    let size = &mut sizes[chart as usize][k];
                    *size = (*size).max(p[k] as usize + 1);
                }
            }
        }
    }
    let mut order: Vec<usize> = (0..charts.count).collect();
    order.sort_by_key(|&chart| {
        let [width, height] = sizes[chart];
        (std::cmp::Reverse((width.max(height), width.min(height))), chart)
    });
    let mut packed = PackedCharts {
        page_of_triangle: vec![u16::MAX; charts.chart_of_triangle.len()],
        corners: vec![[[0.0; 2]; 3]; charts.chart_of_triangle.len()],
        heights: vec![],
    };
    let mut pages: Vec<AtlasPage> = vec![];
    let mut places = BTreeMap::new();
    for chart in order {
        progress.check()?;
        let flat: Vec<_> = members[chart].iter().map(|&t| charts.corners[t as usize]).collect();
        let mut best: Option<(PagePosition, ChartOutline, usize)> = None;
        for turns in 0..QUARTER_TURNS {
            let (corners, size) = rotate_quarter_turns(&flat, sizes[chart], turns);
            let shape = ChartOutline::new(&corners, size, padding);
            let kind = [shape.width, shape.height].map(|s| (s as f64).log(SIZE_CLASS_RATIO) as u32);
            let from = places.entry((turns, kind)).or_insert((0, [0, 0]));
            *from = find_position(&mut pages, &shape, *from, side);
            let lowest = |(page, [_, y]): PagePosition, shape: &ChartOutline| (page, 2 * y + shape.height);
            if best.as_ref().is_none_or(|(at, other, _)| lowest(*from, &shape) < lowest(*at, other)) {
                best = Some((*from, shape, turns));
            }
        }
        let Some(((page, at), shape, turns)) = best else { continue };
        if page >= usize::from(u16::MAX) {
            return Err(KernelError::TooManyTriangles { wanted: page as f64, limit: u16::MAX.into() });
        }
        pages[page].insert(&shape, at);
        let (corners, _) = rotate_quarter_turns(&flat, sizes[chart], turns);
        for (&t, corners) in members[chart].iter().zip(corners) {
            packed.page_of_triangle[t as usize] = page as u16;
            packed.corners[t as usize] =
                corners.map(|p| [p[0] + (at[0] + padding) as f64, p[1] + (at[1] + padding) as f64]);
        }
    }
    pages.retain(|page| page.height > 0);
    packed.heights = pages.iter().map(|page| page.height).collect();
    Ok(packed)
}

/// Find the first free position for a shape, starting at a previous one; append a page if no page has space.
fn find_position(
    pages: &mut Vec<AtlasPage>,
    shape: &ChartOutline,
    (first, at): PagePosition,
    side: usize,
) -> PagePosition {
    for (number, page) in pages.iter().enumerate().skip(first) {
        if let Some(found) = page.find_position(shape, if number == first { at } else { [0, 0] }) {
            return (number, found);
        }
    }
    pages.push(AtlasPage::new(side));
    (pages.len() - 1, [0, 0])
}
