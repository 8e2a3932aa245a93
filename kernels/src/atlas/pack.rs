//! Charts in images: each falls as far as it can onto those below it, where least room is lost (Lévy, Petitjean, Ray and
//! Maillot 2002, "Least squares conformal maps for automatic texture atlas generation", section 4).

use super::charts::Charts;
use super::neighbours::NONE;
use super::texels::spans;
use crate::base::errors::KernelError;
use crate::base::progress::Progress;

/// Of the side, steps at which places for large charts are tried.
const STEP: usize = 512;

/// Charts in images of one width.
#[derive(Debug)]
pub struct Packed {
    /// The image of each triangle, `u16::MAX` for those without a chart.
    pub pages: Vec<u16>,
    /// In texels of the image.
    pub corners: Vec<[[f64; 2]; 3]>,
    /// Rows that are used of each image.
    pub heights: Vec<usize>,
}

/// A chart with the room around it, column by column.
struct Outline {
    chart: u32,
    height: usize,
    /// First row that is taken, and the one after the last; of columns between two that are taken, too.
    columns: Vec<[u32; 2]>,
}

/// Put charts into images of `side` × `side`, each with `padding` texels around it.
///
/// # Errors
/// As [`Progress::check`]; [`KernelError::TooManyTriangles`] where more images were needed than can be numbered.
pub fn pack(
    charts: &Charts,
    side: usize,
    padding: usize,
    progress: &mut Progress,
) -> Result<Packed, KernelError> {
    let mut outlines = outlines(charts, padding);
    outlines.sort_by(|a, b| {
        b.height.cmp(&a.height).then(b.columns.len().cmp(&a.columns.len())).then(a.chart.cmp(&b.chart))
    });
    let mut horizons: Vec<Vec<u32>> = vec![];
    let mut placed = vec![(u16::MAX, [0.0; 2]); charts.count];
    for outline in &outlines {
        progress.check_now_and_then()?;
        let found = horizons
            .iter()
            .enumerate()
            .find_map(|(page, horizon)| Some((page, fallen(outline, horizon, side)?)));
        let (page, (x, y)) = match found {
            Some(found) => found,
            None => {
                horizons.push(vec![0; side]);
                (horizons.len() - 1, (0, 0))
            }
        };
        if page >= usize::from(u16::MAX) {
            return Err(KernelError::TooManyTriangles { wanted: page as f64, limit: u16::MAX.into() });
        }
        for (column, [_, end]) in outline.columns.iter().enumerate() {
            horizons[page][x + column] = y as u32 + end;
        }
        placed[outline.chart as usize] = (page as u16, [(x + padding) as f64, (y + padding) as f64]);
    }
    let mut packed = Packed {
        pages: vec![u16::MAX; charts.of.len()],
        corners: charts.corners.clone(),
        heights: horizons.iter().map(|horizon| horizon.iter().copied().max().unwrap_or(0) as usize).collect(),
    };
    for (t, &chart) in charts.of.iter().enumerate() {
        if chart != NONE {
            let (page, [x, y]) = placed[chart as usize];
            packed.pages[t] = page;
            packed.corners[t] = charts.corners[t].map(|p| [p[0] + x, p[1] + y]);
        }
    }
    Ok(packed)
}

/// Where a chart comes to lie on a horizon with least room lost, if it fits.
fn fallen(outline: &Outline, horizon: &[u32], side: usize) -> Option<(usize, usize)> {
    let width = outline.columns.len();
    if width > side {
        return None;
    }
    // The places of a large chart need not be tried one by one.
    let step = (width / 16).clamp(1, side / STEP.min(side));
    let mut best = None;
    let mut least = u64::MAX;
    for x in (0..=side - width).step_by(step) {
        let below = &horizon[x..x + width];
        let rest =
            below.iter().zip(&outline.columns).map(|(&h, &[first, _])| i64::from(h) - i64::from(first));
        let y = rest.max().unwrap_or(0).max(0);
        if y as usize + outline.height > side {
            continue;
        }
        let lost: i64 = below
            .iter()
            .zip(&outline.columns)
            .map(|(&h, &[first, _])| y + i64::from(first) - i64::from(h))
            .sum();
        // Lower is better, too, or a few towers grow.
        let cost = lost as u64 + (y as u64 + outline.height as u64) * width as u64 / 2;
        if cost < least {
            (best, least) = (Some((x, y as usize)), cost);
        }
    }
    best
}

fn outlines(charts: &Charts, padding: usize) -> Vec<Outline> {
    let mut sizes = vec![[0usize; 2]; charts.count];
    for (t, &chart) in charts.of.iter().enumerate() {
        if chart != NONE {
            for p in charts.corners[t] {
                for k in 0..2 {
                    let size = &mut sizes[chart as usize][k];
                    *size = (*size).max(p[k] as usize + 1);
                }
            }
        }
    }
    let mut bare: Vec<Vec<[u32; 2]>> = sizes.iter().map(|[width, _]| vec![[u32::MAX, 0]; *width]).collect();
    for (t, &chart) in charts.of.iter().enumerate() {
        if chart == NONE {
            continue;
        }
        let columns = &mut bare[chart as usize];
        let [width, height] = sizes[chart as usize];
        let mut take = |column: usize, row: usize| {
            let [first, end] = &mut columns[column];
            (*first, *end) = ((*first).min(row as u32), (*end).max(row as u32 + 1));
        };
        // Corners too: a triangle may be thinner than a texel.
        for p in charts.corners[t] {
            take((p[0] as usize).min(width - 1), (p[1] as usize).min(height - 1));
        }
        for (row, span) in spans(&charts.corners[t], width, height) {
            span.for_each(|column| take(column, row));
        }
    }
    bare.into_iter()
        .enumerate()
        .map(|(chart, columns)| padded(chart, &columns, sizes[chart][1], padding))
        .collect()
}

/// The outline with so many texels around it, to all sides.
fn padded(chart: usize, columns: &[[u32; 2]], height: usize, padding: usize) -> Outline {
    let width = columns.len() + 2 * padding;
    let mut wide = vec![[u32::MAX, 0u32]; width];
    for (column, &[first, end]) in columns.iter().enumerate() {
        if first < end {
            for slot in &mut wide[column..=column + 2 * padding] {
                // One row of padding below is where the chart's first row was: all rows move up by it.
                *slot = [slot[0].min(first), slot[1].max(end + 2 * padding as u32)];
            }
        }
    }
    // A column that nothing touches lies between others: it is as they are.
    for column in 0..width {
        if wide[column][1] == 0 {
            wide[column] = if column > 0 { wide[column - 1] } else { [0, height as u32] };
        }
    }
    Outline { chart: chart as u32, height: height + 2 * padding, columns: wide }
}
