//! Charts in images: the largest first, each turned by quarters to where its middle comes to lie highest, also in the gaps
//! between those that lie there already.

use std::collections::BTreeMap;

use super::charts::Charts;
use super::neighbours::NONE;
use super::page::Page;
use super::shape::{Shape, TURNS, turned};
use crate::base::errors::KernelError;
use crate::base::progress::Progress;

/// Shapes whose sides differ by less than this factor are looked for a place from where the last one of them lies.
/// With a smaller one, and more steps in `Page::find`, images are a few rows lower after twice the time.
const ALIKE: f64 = 1.3;

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

/// A page, and a place on it: column, row.
type Place = (usize, [usize; 2]);

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
    let mut members: Vec<Vec<u32>> = vec![vec![]; charts.count];
    let mut sizes = vec![[1usize; 2]; charts.count];
    for (t, &chart) in charts.of.iter().enumerate() {
        if chart != NONE {
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
    let mut packed = Packed {
        pages: vec![u16::MAX; charts.of.len()],
        corners: vec![[[0.0; 2]; 3]; charts.of.len()],
        heights: vec![],
    };
    let mut pages: Vec<Page> = vec![];
    let mut places = BTreeMap::new();
    for chart in order {
        progress.check()?;
        let flat: Vec<_> = members[chart].iter().map(|&t| charts.corners[t as usize]).collect();
        let mut best: Option<(Place, Shape, usize)> = None;
        for turns in 0..TURNS {
            let (corners, size) = turned(&flat, sizes[chart], turns);
            let shape = Shape::new(&corners, size, padding);
            let kind = [shape.width, shape.height].map(|s| (s as f64).log(ALIKE) as u32);
            let from = places.entry((turns, kind)).or_insert((0, [0, 0]));
            *from = place(&mut pages, &shape, *from, side);
            let lowest = |(page, [_, y]): Place, shape: &Shape| (page, 2 * y + shape.height);
            if best.as_ref().is_none_or(|(at, other, _)| lowest(*from, &shape) < lowest(*at, other)) {
                best = Some((*from, shape, turns));
            }
        }
        let Some(((page, at), shape, turns)) = best else { continue };
        if page >= usize::from(u16::MAX) {
            return Err(KernelError::TooManyTriangles { wanted: page as f64, limit: u16::MAX.into() });
        }
        pages[page].put(&shape, at);
        let (corners, _) = turned(&flat, sizes[chart], turns);
        for (&t, corners) in members[chart].iter().zip(corners) {
            packed.pages[t as usize] = page as u16;
            packed.corners[t as usize] =
                corners.map(|p| [p[0] + (at[0] + padding) as f64, p[1] + (at[1] + padding) as f64]);
        }
    }
    pages.retain(|page| page.height > 0);
    packed.heights = pages.iter().map(|page| page.height).collect();
    Ok(packed)
}

/// The first place for a shape, on a new page if there is none.
fn place(pages: &mut Vec<Page>, shape: &Shape, (first, at): Place, side: usize) -> Place {
    for (number, page) in pages.iter().enumerate().skip(first) {
        if let Some(found) = page.find(shape, if number == first { at } else { [0, 0] }) {
            return (number, found);
        }
    }
    pages.push(Page::new(side));
    (pages.len() - 1, [0, 0])
}
