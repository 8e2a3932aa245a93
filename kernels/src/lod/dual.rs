//! The dual graph of a mesh: triangles, and the sides they share.

use super::cluster::{Cell, Joint};
use crate::base::geometry::{Vec3, distance2, position, triangle_distance2};
use crate::mesh::bvh::Bvh;

/// Sides shared by two triangles. Where a side is of more than two, each is joined to the next.
pub fn shared_sides<const D: usize>(points: &[[f64; D]], triangles: &[[u32; 3]]) -> Vec<Joint> {
    let mut sides: Vec<(u32, u32, u32)> = Vec::with_capacity(3 * triangles.len());
    for (t, corners) in (0..).zip(triangles) {
        for i in 0..3 {
            let (a, b) = (corners[i], corners[(i + 1) % 3]);
            sides.push((a.min(b), a.max(b), t));
        }
    }
    sides.sort_unstable();
    let length =
        |a: u32, b: u32| distance2(&position(&points[a as usize]), &position(&points[b as usize])).sqrt();
    let both = sides.windows(2).filter(|pair| (pair[0].0, pair[0].1) == (pair[1].0, pair[1].1));
    both.map(|pair| Joint { between: [pair[0].2, pair[1].2], length: length(pair[0].0, pair[0].1) }).collect()
}

/// Joints without length from each component of the surface but the largest to the triangle of that which is nearest to its
/// middle: with them the graph is in one piece.
pub fn links<const D: usize>(points: &[[f64; D]], triangles: &[[u32; 3]], joints: &[Joint]) -> Vec<Joint> {
    let component = components(triangles.len(), joints);
    let mut sizes = vec![0u32; triangles.len()];
    component.iter().for_each(|&c| sizes[c as usize] += 1);
    let Some(largest) = (0..triangles.len()).rev().max_by_key(|&c| sizes[c]) else { return vec![] };
    let members: Vec<u32> =
        (0..triangles.len() as u32).filter(|&t| component[t as usize] as usize == largest).collect();
    let corners = |t: u32| triangles[t as usize].map(|v| position(&points[v as usize]));
    let around = |slot: usize| crate::base::geometry::around(corners(members[slot]).into_iter());
    let (tree, order) = Bvh::new(members.len(), 1, around);
    let mut middles = vec![[0.0; 3]; triangles.len()];
    for (t, &c) in (0..).zip(&component) {
        let middle: &mut Vec3 = &mut middles[c as usize];
        corners(t).iter().for_each(|p| (0..3).for_each(|i| middle[i] += p[i] / 3.0));
    }
    let others = (0..triangles.len()).filter(|&c| sizes[c] > 0 && c != largest);
    let link = |c: usize| {
        let middle = middles[c].map(|x| x / f64::from(sizes[c]));
        let triangle = |slot: u32| members[order[slot as usize] as usize];
        let distance = |slot: u32| triangle_distance2(&middle, corners(triangle(slot)).each_ref());
        let (slot, _) = tree.nearest(&middle, (0, f64::INFINITY), distance);
        Joint { between: [c as u32, triangle(slot)], length: 0.0 }
    };
    others.map(link).collect()
}

/// The first triangle of the component each one is of.
fn components(count: usize, joints: &[Joint]) -> Vec<u32> {
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

/// Each triangle as a cell of its own.
pub fn cells<const D: usize>(points: &[[f64; D]], triangles: &[[u32; 3]]) -> Vec<Cell> {
    triangles
        .iter()
        .map(|corners| Cell::of_triangle(corners.map(|v| position(&points[v as usize]))))
        .collect()
}
