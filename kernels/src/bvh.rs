//! A tree of boxes over any shapes: the nearest one to a point, and all whose box meets a box.
//!
//! Median splits along the longest axis of the centres, so that the depth is known and the tree depends on
//! nothing but the input. The shapes themselves stay with the caller, who puts them in the tree's `order`;
//! a *slot* is a place in that order, and neighbouring slots are neighbours in space.

use crate::geometry::Vec3;

/// Shapes in a leaf: their distances cost about as much as those of the boxes that would part them.
const LEAF: usize = 4;
/// Both children of a node wait while one is looked at: one entry a level, and a level halves the shapes.
const STACK: usize = 64;

/// A range of slots, or a node; with the box around it.
#[derive(Clone, Copy, Debug)]
struct Branch {
    low: Vec3,
    high: Vec3,
    /// First slot, or the node's number if `count` is 0.
    start: u32,
    count: u32,
}

#[derive(Clone, Debug)]
pub struct Bvh {
    root: Option<Branch>,
    nodes: Vec<[Branch; 2]>,
}

impl Bvh {
    /// The tree, and the order (shape number of each slot) it asks for. `boxes` are lowest and highest corners.
    pub fn new(boxes: &[[Vec3; 2]]) -> (Self, Vec<u32>) {
        let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
        let mut nodes = Vec::with_capacity(boxes.len() / (LEAF / 2));
        let root = (!order.is_empty()).then(|| build(boxes, &mut order, 0, &mut nodes));
        (Self { root, nodes }, order)
    }

    /// The slot nearest to `p` among those nearer than `best` (slot, squared distance), or `best` itself.
    #[inline]
    pub fn nearest(&self, p: &Vec3, best: (u32, f64), distance2: impl Fn(u32) -> f64) -> (u32, f64) {
        let (mut slot, mut least) = best;
        let Some(root) = self.root else { return best };
        let mut stack = [(0.0, 0, 0); STACK];
        stack[0] = (box_distance2(p, &root), root.start, root.count);
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let (distance, start, count) = stack[height];
            if distance >= least {
                continue;
            }
            if count > 0 {
                for s in start..start + count {
                    let d = distance2(s);
                    if d < least {
                        (slot, least) = (s, d);
                    }
                }
                continue;
            }
            let both = &self.nodes[start as usize];
            let d = both.each_ref().map(|child| box_distance2(p, child));
            // The nearer one on top.
            let first = usize::from(d[0] > d[1]);
            for child in [1 - first, first] {
                if d[child] < least {
                    stack[height] = (d[child], both[child].start, both[child].count);
                    height += 1;
                }
            }
        }
        (slot, least)
    }

    /// Visit every slot whose leaf's box meets the box `low`–`high`, until `visit` returns false. Branches, given by
    /// their node's number and 0 or 1, are left out where `skip` says so.
    #[inline]
    pub fn meeting(
        &self,
        low: &Vec3,
        high: &Vec3,
        mut skip: impl FnMut(u32, usize) -> bool,
        mut visit: impl FnMut(u32) -> bool,
    ) {
        let meets = |b: &Branch| (0..3).all(|i| b.low[i] <= high[i] && b.high[i] >= low[i]);
        let Some(root) = self.root.filter(meets) else { return };
        let mut stack = [(0, 0); STACK];
        stack[0] = (root.start, root.count);
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let (start, count) = stack[height];
            if count > 0 {
                for s in start..start + count {
                    if !visit(s) {
                        return;
                    }
                }
                continue;
            }
            for (i, child) in self.nodes[start as usize].iter().enumerate().rev() {
                if meets(child) && !skip(start, i) {
                    stack[height] = (child.start, child.count);
                    height += 1;
                }
            }
        }
    }

    /// A value for both branches of every node: of the slots in a leaf, and joined upwards.
    pub fn gathered<T: Copy>(
        &self,
        leaf: impl Fn(std::ops::Range<usize>) -> T,
        join: impl Fn(T, T) -> T,
    ) -> Vec<[T; 2]> {
        let mut upwards: Vec<[T; 2]> = Vec::with_capacity(self.nodes.len());
        // A node is numbered before those below it.
        for both in self.nodes.iter().rev() {
            let value = both.each_ref().map(|b| {
                if b.count > 0 {
                    leaf(b.start as usize..(b.start + b.count) as usize)
                } else {
                    let [left, right] = upwards[self.nodes.len() - 1 - b.start as usize];
                    join(left, right)
                }
            });
            upwards.push(value);
        }
        upwards.reverse();
        upwards
    }
}

fn build(boxes: &[[Vec3; 2]], order: &mut [u32], offset: usize, nodes: &mut Vec<[Branch; 2]>) -> Branch {
    if order.len() <= LEAF {
        let (low, high) = around(order.iter().map(|&i| boxes[i as usize]));
        return Branch { low, high, start: offset as u32, count: order.len() as u32 };
    }
    // Twice the centre; halving it would change nothing.
    let centre = |i: u32, axis: usize| boxes[i as usize][0][axis] + boxes[i as usize][1][axis];
    let (low, high) = around(order.iter().map(|&i| [[0, 1, 2].map(|axis| centre(i, axis)); 2]));
    let axis = (0..3).max_by(|&i, &j| (high[i] - low[i]).total_cmp(&(high[j] - low[j]))).unwrap_or(0);
    let middle = order.len() / 2;
    // Equal centres are told apart by number: the result is then one and the same set, however it is found.
    order
        .select_nth_unstable_by(middle, |&i, &j| centre(i, axis).total_cmp(&centre(j, axis)).then(i.cmp(&j)));
    let node = nodes.len();
    let leaf = Branch { low, high, start: 0, count: 0 };
    nodes.push([leaf; 2]);
    let (left, right) = order.split_at_mut(middle);
    let children = [build(boxes, left, offset, nodes), build(boxes, right, offset + middle, nodes)];
    nodes[node] = children;
    let (low, high) = around(children.iter().map(|b| [b.low, b.high]));
    Branch { low, high, start: node as u32, count: 0 }
}

fn around(boxes: impl Iterator<Item = [Vec3; 2]>) -> (Vec3, Vec3) {
    boxes.fold(([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]), |(low, high), b| {
        ([0, 1, 2].map(|i| low[i].min(b[0][i])), [0, 1, 2].map(|i| high[i].max(b[1][i])))
    })
}

#[inline]
fn box_distance2(p: &Vec3, b: &Branch) -> f64 {
    let gap = |i: usize| (b.low[i] - p[i]).max(p[i] - b.high[i]).max(0.0);
    let (x, y, z) = (gap(0), gap(1), gap(2));
    x * x + y * y + z * z
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a lattice, many of them equal.
    fn cloud(count: u32) -> Vec<Vec3> {
        (0..count).map(|i| [i % 7, i / 7 % 5, i * i % 11].map(f64::from)).collect()
    }

    fn distance2(a: &Vec3, b: &Vec3) -> f64 {
        (0..3).map(|i| (a[i] - b[i]).powi(2)).sum()
    }

    #[test]
    fn finds_the_nearest_point_and_those_in_a_box() {
        for count in [0, 1, 4, 5, 300] {
            let points = cloud(count);
            let boxes: Vec<_> = points.iter().map(|&p| [p, p]).collect();
            let (bvh, order) = Bvh::new(&boxes);
            for query in [[3.2, 1.7, 5.1], [-4.0, 9.0, 2.0]] {
                let d = |slot: u32| distance2(&query, &points[order[slot as usize] as usize]);
                let (_, found) = bvh.nearest(&query, (0, f64::INFINITY), d);
                let least = points.iter().map(|p| distance2(p, &query)).fold(f64::INFINITY, f64::min);
                assert_eq!(found, least);
            }
            let (low, high) = ([1.0, 0.5, 2.0], [4.0, 3.0, 9.0]);
            let inside = |p: &Vec3| (0..3).all(|i| low[i] <= p[i] && p[i] <= high[i]);
            let mut found = vec![];
            bvh.meeting(
                &low,
                &high,
                |_, _| false,
                |slot| {
                    found.push(order[slot as usize]);
                    true
                },
            );
            for (i, p) in points.iter().enumerate() {
                assert!(!inside(p) || found.contains(&(i as u32)));
            }
        }
    }
}
