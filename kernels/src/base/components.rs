//! Connected components of a graph.

/// Union-find over nodes whose pairs arrive one by one; 4 bytes per node.
///
/// The root of a component is its first node, so that labels do not depend on the order of the pairs.
#[derive(Debug)]
pub struct Components {
    parents: Vec<u32>,
}

impl Components {
    /// Create `count` components of one node each.
    pub fn new(count: usize) -> Self {
        Self { parents: (0..count as u32).collect() }
    }

    /// Join the components of two nodes; returns false if they were joined before.
    pub fn join(&mut self, a: usize, b: usize) -> bool {
        let (a, b) = (self.find_root(a), self.find_root(b));
        let (first, second) = (a.min(b), a.max(b));
        self.parents[second] = first as u32;
        first != second
    }

    /// Number the components by their first node. Returns their number and the label of each node.
    pub fn label(mut self) -> (usize, Vec<u32>) {
        let mut count = 0;
        for node in 0..self.parents.len() {
            // Parents come first, so they have labels instead of parents already.
            let parent = self.parents[node] as usize;
            if parent == node {
                self.parents[node] = count;
                count += 1;
            } else {
                self.parents[node] = self.parents[parent];
            }
        }
        (count as usize, self.parents)
    }

    /// Find the first node of the component of a node.
    pub fn find_root(&mut self, node: usize) -> usize {
        let mut at = node;
        loop {
            let parent = self.parents[at] as usize;
            if parent == at {
                return at;
            }
            // Halving of paths keeps them short.
            self.parents[at] = self.parents[parent];
            at = parent;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Components;

    #[test]
    fn components_are_numbered_by_their_first_node() {
        for pairs in [[(5, 1), (4, 2), (2, 5)], [(2, 5), (5, 1), (4, 2)]] {
            let mut components = Components::new(7);
            pairs.iter().for_each(|&(a, b)| _ = components.join(a, b));
            assert_eq!(components.label(), (4, vec![0, 1, 1, 2, 1, 1, 3]));
        }
    }

    #[test]
    fn a_long_chain_is_one_component_in_any_order() {
        let count = 10_000;
        for step in [1, 7, 9_998] {
            let mut components = Components::new(count);
            for i in 0..count - 1 {
                let at = (i * step) % (count - 1);
                components.join(at + 1, at);
            }
            assert_eq!(components.label(), (1, vec![0; count]));
        }
    }

    #[test]
    fn nothing_has_no_components() {
        assert_eq!(Components::new(0).label(), (0, vec![]));
    }
}
