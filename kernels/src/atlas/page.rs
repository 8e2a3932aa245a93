//! An image that charts are put into: which of its texels are taken.

use super::shape::Shape;

const WORD: usize = 64;
/// Of a shape's height, steps in which places for it are looked for from top to bottom.
const STEPS: usize = 16;

#[derive(Debug)]
pub struct Page {
    side: usize,
    /// Words of a row.
    words: usize,
    taken: Vec<u64>,
    /// Rows that are used.
    pub height: usize,
}

impl Page {
    pub fn new(side: usize) -> Self {
        let words = side.div_ceil(WORD);
        Self { side, words, taken: vec![0; words * side], height: 0 }
    }

    /// The first place with room for a shape, from a place on: row by row, and from the left.
    pub fn find(&self, shape: &Shape, from: [usize; 2]) -> Option<[usize; 2]> {
        if shape.width > self.side || shape.height > self.side {
            return None;
        }
        let step = (shape.height / STEPS).max(1);
        let mut x = from[0];
        // The row that is in the way most often.
        let mut worst = 0;
        for y in (from[1]..=self.side - shape.height).step_by(step) {
            'place: while x + shape.width <= self.side {
                for row in std::iter::once(worst).chain(0..shape.height) {
                    for range in shape.row(row) {
                        if let Some(last) = self.last_taken(y + row, range.map(|c| c as usize + x)) {
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

    pub fn put(&mut self, shape: &Shape, [x, y]: [usize; 2]) {
        for row in 0..shape.height {
            for range in shape.row(row) {
                for (word, mask) in masks(range.map(|c| c as usize + x)) {
                    self.taken[(y + row) * self.words + word] |= mask;
                }
            }
        }
        self.height = self.height.max(y + shape.height);
    }

    /// The last column of a range that is taken.
    fn last_taken(&self, row: usize, range: [usize; 2]) -> Option<usize> {
        let words = &self.taken[row * self.words..][..self.words];
        masks(range).rev().find_map(|(word, mask)| {
            let taken = words[word] & mask;
            (taken != 0).then(|| word * WORD + WORD - 1 - taken.leading_zeros() as usize)
        })
    }
}

/// Words that hold columns of a range, and which of their bits.
fn masks([start, end]: [usize; 2]) -> impl DoubleEndedIterator<Item = (usize, u64)> {
    (start / WORD..end.div_ceil(WORD)).map(move |word| {
        let first = start.saturating_sub(word * WORD);
        let after = (end - word * WORD).min(WORD);
        (word, (u64::MAX >> (WORD - after)) & (u64::MAX << first))
    })
}
