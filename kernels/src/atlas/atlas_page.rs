//! Page of the atlas: an image with a bitmap of occupied texels.

use super::chart_outline::ChartOutline;

const WORD_BITS: usize = 64;
/// Number of steps per shape height in the vertical search for a position.
const STEPS_PER_HEIGHT: usize = 16;

/// Occupied texels of an atlas image.
#[derive(Debug)]
pub struct AtlasPage {
    side: usize,
    /// 64-bit words per row.
    words_per_row: usize,
    occupied: Vec<u64>,
    /// Longest range of free columns in each row.
    longest_free_runs: Vec<usize>,
    /// Number of used rows.
    pub height: usize,
}

impl AtlasPage {
    /// Create an empty page of `side` × `side` texels.
    pub fn new(side: usize) -> Self {
        let words = side.div_ceil(WORD_BITS);
        Self {
            side,
            words_per_row: words,
            occupied: vec![0; words * side],
            longest_free_runs: vec![side; side],
            height: 0,
        }
    }

    /// Find the first free position for a shape from `from` on, in row-major order. None if the page has no
    /// space.
    pub fn find_position(&self, shape: &ChartOutline, from: [usize; 2]) -> Option<[usize; 2]> {
        if shape.width > self.side || shape.height > self.side {
            return None;
        }
        let step = (shape.height / STEPS_PER_HEIGHT).max(1);
        let widest: Vec<usize> = (0..shape.height)
            .map(|row| {
                shape.row_ranges(row).iter().map(|range| (range[1] - range[0]) as usize).max().unwrap_or(0)
            })
            .collect();
        let mut x = from[0];
        // Row that blocked the last position; tested first because it probably blocks the next one, too.
        let mut worst = 0;
        for y in (from[1]..=self.side - shape.height).step_by(step) {
            if widest.iter().zip(&self.longest_free_runs[y..]).any(|(wanted, free)| wanted > free) {
                x = 0;
                continue;
            }
            'place: while x + shape.width <= self.side {
                for row in std::iter::once(worst).chain(0..shape.height) {
                    for range in shape.row_ranges(row) {
                        if let Some(last) = self.last_occupied(y + row, range.map(|c| c as usize + x)) {
                            worst = row;
                            x = last + 1 - range[0] as usize;
                            continue 'place;
                        }
                    }
                }
                return Some([x, y]);
            }
            x = 0;
        }
        None
    }

    /// Mark the texels of a shape as occupied, at a position found by [`AtlasPage::find_position`].
    pub fn insert(&mut self, shape: &ChartOutline, [x, y]: [usize; 2]) {
        for row in 0..shape.height {
            for range in shape.row_ranges(row) {
                for (word, mask) in word_masks(range.map(|c| c as usize + x)) {
                    self.occupied[(y + row) * self.words_per_row + word] |= mask;
                }
            }
            self.longest_free_runs[y + row] = self.longest_free(y + row);
        }
        self.height = self.height.max(y + shape.height);
    }

    /// Compute the length of the longest range of free columns in a row.
    fn longest_free(&self, row: usize) -> usize {
        let (mut longest, mut start) = (0, 0);
        for (index, &word) in
            self.occupied[row * self.words_per_row..][..self.words_per_row].iter().enumerate()
        {
            let mut rest = word;
            while rest != 0 {
                let bit = rest.trailing_zeros() as usize;
                longest = longest.max((index * WORD_BITS + bit).saturating_sub(start));
                // Continue after the run of set bits.
                let run = (rest >> bit).trailing_ones() as usize;
                start = index * WORD_BITS + bit + run;
                rest = if bit + run < WORD_BITS { rest & (u64::MAX << (bit + run)) } else { 0 };
            }
        }
        longest.max(self.side.saturating_sub(start))
    }

    /// Find the last occupied column in a range of a row.
    fn last_occupied(&self, row: usize, range: [usize; 2]) -> Option<usize> {
        let words = &self.occupied[row * self.words_per_row..][..self.words_per_row];
        word_masks(range).rev().find_map(|(word, mask)| {
            let taken = words[word] & mask;
            (taken != 0).then(|| word * WORD_BITS + WORD_BITS - 1 - taken.leading_zeros() as usize)
        })
    }
}

/// Iterate over the words that contain columns of a range, each with a mask of those columns.
fn word_masks([start, end]: [usize; 2]) -> impl DoubleEndedIterator<Item = (usize, u64)> {
    (start / WORD_BITS..end.div_ceil(WORD_BITS)).map(move |word| {
        let first = start.saturating_sub(word * WORD_BITS);
        let after = (end - word * WORD_BITS).min(WORD_BITS);
        (word, (u64::MAX >> (WORD_BITS - after)) & (u64::MAX << first))
    })
}
