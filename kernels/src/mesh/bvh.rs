//! Bounding volume hierarchy (BVH): nearest shape to a point, and shapes whose box overlaps a box or a line.
//!
//! Nodes are split at the median along the longest axis of the box centres. The depth is therefore bounded,
//! and the tree depends on the input only. The tree does not store the shapes: the caller sorts them into the
//! tree's `order`. A *slot* is a position in that order, and nearby slots are close in space.
//!
//! Boxes are in single precision, rounded outwards, and normalised to the bounding box of all shapes. Their
//! relative precision therefore does not depend on the distance from the origin or the unit of length.

use crate::base::geometry::Vec3;
use crate::base::parallel::run_concurrently;

/// Maximum shapes per leaf. Half as many are no faster, and their boxes take twice the memory.
const LEAF_SHAPES: usize = 8;
/// Depth of the traversal stack: one entry per level. Each level halves the shapes, which have 32-bit
/// indices.
const STACK_DEPTH: usize = 32;
/// Limit of the scale's exponent, so that squared lengths neither overflow nor underflow in double precision.
const MAX_SCALE_EXPONENT: i32 = 250;
/// Minimum number of shapes for a second thread.
const MIN_PARALLEL_SHAPES: usize = 1 << 13;
const EMPTY_BOX: [Vec3; 2] = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];

/// Minimum and maximum corner, in normalised coordinates.
type SingleBox = [[f32; 3]; 2];

/// Range of slots (leaf) or node, with its bounding box.
#[derive(Clone, Copy, Debug)]
struct Branch {
    around: SingleBox,
    /// First slot; or the node index if `count` is 0.
    start: u32,
    count: u32,
}

/// Bounding volume hierarchy over shapes stored by the caller.
#[derive(Clone, Debug)]
pub struct Bvh {
    root: Option<Branch>,
    nodes: Vec<[Branch; 2]>,
    /// Bounding box of the shape in each slot. It rejects most shapes of a leaf, so that these need not be
    /// loaded.
    boxes: Vec<SingleBox>,
    /// Origin of the normalised coordinates, and their scale: a power of two.
    origin: Vec3,
    scale: f64,
}

impl Bvh {
    /// Build the tree over `count` shapes; also returns the order (shape index of each slot). `around` gives
    /// the minimum and maximum corner of each shape's box. The result does not depend on the thread count.
    pub fn new(count: usize, threads: usize, around: impl Fn(usize) -> [Vec3; 2]) -> (Self, Vec<u32>) {
        let [low, high] = (0..count).map(&around).fold(EMPTY_BOX, |all, one| {
            [[0, 1, 2].map(|i| all[0][i].min(one[0][i])), [0, 1, 2].map(|i| all[1][i].max(one[1][i]))]
        });
        let mut tree = Self { root: None, nodes: vec![], boxes: vec![], origin: [0.0; 3], scale: 1.0 };
        let mut order: Vec<u32> = (0..count as u32).collect();
        if count > 0 {
            tree.origin = [0, 1, 2].map(|i| 0.5 * (low[i] + high[i]));
            let extent = (0..3).map(|i| high[i] - low[i]).fold(0.0, f64::max);
            let exponent = (extent.to_bits() >> 52) as i32 - 1023;
            tree.scale = 2f64.powi(-exponent.clamp(-MAX_SCALE_EXPONENT, MAX_SCALE_EXPONENT));
            let boxes: Vec<SingleBox> = (0..count).map(|i| tree.round_outwards(around(i))).collect();
            tree.nodes.reserve_exact(count / (LEAF_SHAPES / 2));
            tree.root = Some(build_branch(&boxes, &mut order, 0, &mut tree.nodes, threads));
            tree.nodes.shrink_to_fit();
            tree.boxes = order.iter().map(|&i| boxes[i as usize]).collect();
        }
        (tree, order)
    }

    #[inline]
    fn to_local(&self, p: &Vec3) -> Vec3 {
        [0, 1, 2].map(|i| (p[i] - self.origin[i]) * self.scale)
    }

    /// Convert a box to normalised coordinates, rounded outwards.
    #[inline]
    fn round_outwards(&self, [low, high]: [Vec3; 2]) -> SingleBox {
        [self.to_local(&low).map(round_down), self.to_local(&high).map(|x| -round_down(-x))]
    }

    /// Find the slot nearest to `p` and nearer than `best` (slot, squared distance); returns `best` if no
    /// slot is nearer.
    #[inline]
    pub fn find_nearest(&self, p: &Vec3, best: (u32, f64), distance2: impl Fn(u32) -> f64) -> (u32, f64) {
        let (mut slot, mut least) = best;
        let Some(root) = self.root else { return best };
        let (local, unit2) = (self.to_local(p), self.scale * self.scale);
        let mut far = least * unit2;
        let mut stack = [(0.0, 0, 0); STACK_DEPTH];
        stack[0] = (box_distance2(&local, &root.around), root.start, root.count);
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let (distance, start, count) = stack[height];
            if distance >= far {
                continue;
            }
            if count > 0 {
                for s in start..start + count {
                    if box_distance2(&local, &self.boxes[s as usize]) >= far {
                        continue;
                    }
                    let d = distance2(s);
                    if d < least {
                        (slot, least) = (s, d);
                        far = least * unit2;
                    }
                }
                continue;
            }
            let both = &self.nodes[start as usize];
            let d = both.each_ref().map(|child| box_distance2(&local, &child.around));
            // Push the nearer child last, so that it is visited first.
            let first = usize::from(d[0] > d[1]);
            for child in [1 - first, first] {
                if d[child] < far {
                    stack[height] = (d[child], both[child].start, both[child].count);
                    height += 1;
                }
            }
        }
        (slot, least)
    }

    /// Visit every slot whose box overlaps the box `low`–`high`, until `visit` returns false. Branches,
    /// identified by node index and child 0 or 1, are pruned if `skip` returns true.
    #[inline]
    pub fn visit_overlapping(
        &self,
        low: &Vec3,
        high: &Vec3,
        mut skip: impl FnMut(u32, usize) -> bool,
        mut visit: impl FnMut(u32) -> bool,
    ) {
        let [low, high] = self.round_outwards([*low, *high]);
        let meets = |b: &SingleBox| (0..3).all(|i| b[0][i] <= high[i] && b[1][i] >= low[i]);
        let Some(root) = self.root.filter(|root| meets(&root.around)) else { return };
        let mut stack = [(0, 0); STACK_DEPTH];
        stack[0] = (root.start, root.count);
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let (start, count) = stack[height];
            if count > 0 {
                for s in start..start + count {
                    if meets(&self.boxes[s as usize]) && !visit(s) {
                        return;
                    }
                }
                continue;
            }
            for (i, child) in self.nodes[start as usize].iter().enumerate().rev() {
                if meets(&child.around) && !skip(start, i) {
                    stack[height] = (child.start, child.count);
                    height += 1;
                }
            }
        }
    }

    /// Visit every slot in the leaves whose box intersects the line through `p` along `direction` within
    /// ±`reach` times the direction's length. `visit` returns the new reach.
    #[inline]
    pub fn visit_along_line(
        &self,
        p: &Vec3,
        direction: &Vec3,
        reach: f64,
        mut visit: impl FnMut(u32, f64) -> f64,
    ) {
        let Some(root) = self.root else { return };
        let local = self.to_local(p);
        let inverse = direction.map(|x| 1.0 / (x * self.scale));
        let mut reach = reach;
        let mut stack = [(0.0, 0, 0); STACK_DEPTH];
        stack[0] = (line_distance(&local, &inverse, &root.around), root.start, root.count);
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let (distance, start, count) = stack[height];
            if distance > reach {
                continue;
            }
            if count > 0 {
                for s in start..start + count {
                    reach = visit(s, reach);
                }
                continue;
            }
            let both = &self.nodes[start as usize];
            let d = both.each_ref().map(|child| line_distance(&local, &inverse, &child.around));
            // Push the nearer child last, so that it is visited first.
            let first = usize::from(d[0] > d[1]);
            for child in [1 - first, first] {
                if d[child] <= reach {
                    stack[height] = (d[child], both[child].start, both[child].count);
                    height += 1;
                }
            }
        }
    }

    /// Compute a value for both children of every node, bottom-up: `leaf` for a range of slots, `join_boxes` for
    /// two children.
    pub fn gather_bottom_up<T: Copy>(
        &self,
        leaf: impl Fn(std::ops::Range<usize>) -> T,
        join: impl Fn(T, T) -> T,
    ) -> Vec<[T; 2]> {
        let mut upwards: Vec<[T; 2]> = Vec::with_capacity(self.nodes.len());
        // Child nodes have higher indices than their parent.
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

fn build_branch(
    boxes: &[SingleBox],
    order: &mut [u32],
    offset: usize,
    nodes: &mut Vec<[Branch; 2]>,
    threads: usize,
) -> Branch {
    if order.len() <= LEAF_SHAPES {
        let around = join_boxes(order.iter().map(|&i| boxes[i as usize]));
        return Branch { around, start: offset as u32, count: order.len() as u32 };
    }
    // Twice the centre; the factor does not matter.
    let centre = |i: u32, axis: usize| boxes[i as usize][0][axis] + boxes[i as usize][1][axis];
    let [low, high] = join_boxes(order.iter().map(|&i| [[0, 1, 2].map(|axis| centre(i, axis)); 2]));
    let axis = (0..3).max_by(|&i, &j| (high[i] - low[i]).total_cmp(&(high[j] - low[j]))).unwrap_or(0);
    let middle = order.len() / 2;
    // Ties are broken by index, so that the split is unique whatever algorithm finds it.
    order
        .select_nth_unstable_by(middle, |&i, &j| centre(i, axis).total_cmp(&centre(j, axis)).then(i.cmp(&j)));
    let node = nodes.len();
    let unknown = Branch { around: [low, high], start: 0, count: 0 };
    nodes.push([unknown; 2]);
    let (left, right) = order.split_at_mut(middle);
    let children = if threads > 1 && middle > MIN_PARALLEL_SHAPES {
        let mut beyond = vec![];
        let (mut first, mut second) = (unknown, unknown);
        run_concurrently(
            threads,
            || second = build_branch(boxes, right, offset + middle, &mut beyond, threads / 2),
            || first = build_branch(boxes, left, offset, nodes, threads - threads / 2),
        );
        let before = nodes.len() as u32;
        let moved = |b: Branch| if b.count > 0 { b } else { Branch { start: b.start + before, ..b } };
        nodes.extend(beyond.iter().map(|children| children.map(moved)));
        [first, moved(second)]
    } else {
        [build_branch(boxes, left, offset, nodes, 1), build_branch(boxes, right, offset + middle, nodes, 1)]
    };
    nodes[node] = children;
    Branch { around: join_boxes(children.iter().map(|b| b.around)), start: node as u32, count: 0 }
}

fn join_boxes(boxes: impl Iterator<Item = SingleBox>) -> SingleBox {
    boxes.fold([[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]], |all, one| {
        [[0, 1, 2].map(|i| all[0][i].min(one[0][i])), [0, 1, 2].map(|i| all[1][i].max(one[1][i]))]
    })
}

/// Round to the largest single-precision number that is not above `x`.
#[inline]
fn round_down(x: f64) -> f32 {
    let near = x as f32;
    if f64::from(near) > x { near.next_down() } else { near }
}

#[inline]
fn box_distance2(p: &Vec3, [low, high]: &SingleBox) -> f64 {
    let gap = |i: usize| (f64::from(low[i]) - p[i]).max(p[i] - f64::from(high[i])).max(0.0);
    let (x, y, z) = (gap(0), gap(1), gap(2));
    x * x + y * y + z * z
}

/// Compute the distance to a box along a line, in either direction; infinity if the line misses the box.
/// `inverse` is the reciprocal of each coordinate of the direction.
#[inline]
fn line_distance(p: &Vec3, inverse: &Vec3, [low, high]: &SingleBox) -> f64 {
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    for i in 0..3 {
        // A line in the plane of a box face gives 0 · ∞ = NaN, which must not restrict the interval.
        let a = (f64::from(low[i]) - p[i]) * inverse[i];
        let b = (f64::from(high[i]) - p[i]) * inverse[i];
        let (near, far) = if a < b { (a, b) } else { (b, a) };
        enter = if near > enter { near } else { enter };
        leave = if far < leave { far } else { leave };
    }
    // Tolerance for rounding, so that a box that is only touched is not missed.
    let slack = 1e-12 * (enter.abs() + leave.abs());
    if enter > leave + slack { f64::INFINITY } else { enter.max(-leave).max(0.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a lattice, with many duplicates.
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
            let (bvh, order) = Bvh::new(points.len(), 1, |i| [points[i]; 2]);
            for query in [[3.2, 1.7, 5.1], [-4.0, 9.0, 2.0]] {
                let d = |slot: u32| distance2(&query, &points[order[slot as usize] as usize]);
                let (_, found) = bvh.find_nearest(&query, (0, f64::INFINITY), d);
                let least = points.iter().map(|p| distance2(p, &query)).fold(f64::INFINITY, f64::min);
                assert_eq!(found, least);
            }
            let (low, high) = ([1.0, 0.5, 2.0], [4.0, 3.0, 9.0]);
            let inside = |p: &Vec3| (0..3).all(|i| low[i] <= p[i] && p[i] <= high[i]);
            let mut found = vec![];
            bvh.visit_overlapping(
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

    #[test]
    fn any_number_of_threads_builds_the_same_tree() {
        let points = cloud(60_000);
        let build = |threads| Bvh::new(points.len(), threads, |i| [points[i]; 2]);
        let (tree, order) = build(1);
        for threads in [2, 3] {
            let (other, other_order) = build(threads);
            assert_eq!(order, other_order);
            assert_eq!(format!("{tree:?}"), format!("{other:?}"));
        }
    }
}
