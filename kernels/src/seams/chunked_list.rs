//! A list in parts, which can be joined without copying.

/// Concatenation of the results of all regions, with consecutive indices.
#[derive(Clone, Debug)]
pub struct ChunkedList<T> {
    parts: Vec<Vec<T>>,
    /// Index of the first element of each part.
    starts: Vec<u32>,
    count: u32,
}

impl<T> Default for ChunkedList<T> {
    fn default() -> Self {
        Self { parts: vec![], starts: vec![], count: 0 }
    }
}

impl<T> ChunkedList<T> {
    /// Create from one part.
    pub fn from_part(part: Vec<T>) -> Self {
        let mut joined = Self::default();
        joined.push(part);
        joined
    }

    /// Append a part.
    pub fn push(&mut self, part: Vec<T>) {
        self.starts.push(self.count);
        self.count += part.len() as u32;
        self.parts.push(part);
    }

    pub fn len(&self) -> usize {
        self.count as usize
    }

    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Return the element with an index.
    pub fn get(&self, number: u32) -> &T {
        let part = self.part_index(number);
        &self.parts[part][(number - self.starts[part]) as usize]
    }

    /// Find the part that contains an element.
    pub fn part_index(&self, number: u32) -> usize {
        self.starts.partition_point(|&start| start <= number) - 1
    }

    /// Return the index of the first element of a part.
    pub fn part_start(&self, part: usize) -> u32 {
        self.starts[part]
    }

    pub fn iter(&self) -> impl Iterator<Item = &T> {
        self.parts.iter().flatten()
    }
}
