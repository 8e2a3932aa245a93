//! Dual graph of a mesh: triangles as nodes, shared edges as joints.

use super::clustering::{Cell, Joint};
use crate::base::geometry::{Vec3, distance2, position_of, triangle_distance2};
use crate::mesh::bvh::Bvh;

/// Find pairs of triangles that share an edge. At non-manifold edges, triangles are paired in sequence.
pub fn find_shared_edges<const D: usize>(points: &[[f64; D]], triangles: &[[u32; 3]]) -> Vec<Joint> {
    // Edge packed into one sortable number, with its triangle.
    let mut sides: Vec<(u64, u32)> = Vec::with_capacity(3 * triangles.len());
    for (t, corners) in (0..).zip(triangles) {
        for i in 0..3 {
            let (a, b) = (corners[i], corners[(i + 1) % 3]);
            sides.push((u64::from(a.min(b)) << 32 | u64::from(a.max(b)), t));
        }
    }
    sides.sort_unstable();
    let length = |side: u64| {
        let [a, b] = [side >> 32, side & u64::from(u32::MAX)].map(|v| position_of(&points[v as usize]));
        distance2(&a, &b).sqrt()
    };
    let both = sides.windows(2).filter(|pair| pair[0].0 == pair[1].0);
    both.map(|pair| Joint { between: [pair[0].1, pair[1].1], length: length(pair[0].0) }).collect()
}

/// Compute zero-length joints that connect the graph. Each component except the largest gets two: to the
/// nearest larger component and to the nearest other component. Distances are measured from its centroid; the
/// joint starts at its triangle of lowest index.
pub fn link_components<const D: usize>(
    points: &[[f64; D]],
    triangles: &[[u32; 3]],
    joints: &[Joint],
) -> Vec<Joint> {
    let component = label_components(triangles.len(), joints);
    let mut sizes = vec![0u32; triangles.len()];
    component.iter().for_each(|&c| sizes[c as usize] += 1);
    let mut others: Vec<u32> = (0..triangles.len() as u32).filter(|&c| sizes[c as usize] > 0).collect();
    others.sort_by_key(|&c| std::cmp::Reverse(sizes[c as usize]));
    let mut rank = vec![0u32; triangles.len()];
    (0..).zip(&others).for_each(|(r, &c)| rank[c as usize] = r);
    if others.len() < 2 {
        return vec![];
    }
    let corners = |t: u32| triangles[t as usize].map(|v| position_of(&points[v as usize]));
    let around = |t: usize| crate::base::geometry::bounding_box(corners(t as u32).into_iter());
    let (tree, order) = Bvh::new(triangles.len(), 1, around);
    let mut middles: Vec<Vec3> = vec![[0.0; 3]; triangles.len()];
    for (t, &c) in (0..).zip(&component) {
        let middle = &mut middles[c as usize];
        corners(t).iter().for_each(|p| (0..3).for_each(|i| middle[i] += p[i] / 3.0));
    }
    let nearest = |c: u32, is_one: &dyn Fn(u32) -> bool| {
        let middle = middles[c as usize].map(|x| x / f64::from(sizes[c as usize]));
        let distance = |slot: u32| {
            let t = order[slot as usize];
            if is_one(component[t as usize]) {
                triangle_distance2(&middle, corners(t).each_ref())
            } else {
                f64::INFINITY
            }
        };
        let (slot, away) = tree.find_nearest(&middle, (0, f64::INFINITY), distance);
        // Components are also joined if their distance overflows.
        let to = if away < f64::INFINITY { order[slot as usize] } else { others[0] };
        Joint { between: [c, to], length: 0.0 }
    };
    let both = others.iter().skip(1).flat_map(|&c| {
        let larger = nearest(c, &|other| rank[other as usize] < rank[c as usize]);
        [larger, nearest(c, &|other| other != c)]
    });
    both.collect()
}

/// Label each triangle with the lowest triangle index of its connected component.
fn label_components(count: usize, joints: &[Joint]) -> Vec<u32> {
    let mut first: Vec<u32> = (0..count as u32).collect();
    fn find(first: &mut [u32], mut t: u32) -> u32 {
        while first[t as usize] != t {
            first[t as usize] = first[first[t as usize] as usize];
            t = first[t as usize];
        }
        t
    }
    for joint in joints {
        let [a, b] = joint.between.map(|t| find(&mut first, t));
        first[a.max(b) as usize] = a.min(b);
    }
    (0..count as u32).map(|t| find(&mut first, t)).collect()
}

/// Create one cell per triangle.
pub fn make_cells<const D: usize>(points: &[[f64; D]], triangles: &[[u32; 3]]) -> Vec<Cell> {
    triangles
        .iter()
        .map(|corners| Cell::from_triangle(corners.map(|v| position_of(&points[v as usize]))))
        .collect()
}
