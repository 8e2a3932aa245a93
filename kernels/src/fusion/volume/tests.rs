use std::collections::HashMap;

use super::*;
use crate::base::progress::RunControl;
use crate::fusion::block_order::block_key;
use crate::fusion::frame_view::{DepthNoiseModel, FrameImages, FusionCamera};
use crate::fusion::planarity::Planarity;
use crate::fusion::surface_extraction::BlockBox;
use crate::fusion::touched_blocks::{MeasuredSurface, collect_touched_blocks};
use crate::fusion::voxel_data::{MAX_WEIGHT, WEIGHT_UNIT};

const VOXEL: f64 = 0.02;
const TRUNCATION: f64 = 0.06;
const WEIGHING: DepthNoiseModel = DepthNoiseModel { typical: 0.02, constant: 0.008, quadratic: 0.002 };

/// Deterministic pseudo-random numbers from 0 to 1.
struct PseudoRandom(u64);

impl PseudoRandom {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// Synthetic depth map of a wall with a step, with noise, holes and colours.
struct SyntheticFrame {
    camera: FusionCamera,
    depth: Vec<f32>,
    normal: [Vec<f32>; 3],
    obliqueness: Vec<f32>,
    wanted: Vec<bool>,
    color: Vec<u8>,
    flatness: Planarity,
}

impl SyntheticFrame {
    fn new(draw: &mut PseudoRandom) -> Self {
        let (width, height) = (61, 47);
        let (turn, tilt) = (draw.next() - 0.5, 0.3 * draw.next());
        let (s, c) = turn.sin_cos();
        let pose = [
            [c, tilt * s, s, 0.3 * draw.next()],
            [-tilt, 1.0, 0.0, 0.2 * draw.next() - 3.0],
            [-s, 0.0, c, -1.5 - draw.next()],
        ];
        let camera = FusionCamera::new((width, height), [55.0, 56.0], [29.3, 24.1], pose);
        let slope = [draw.next() - 0.5, draw.next() - 0.5];
        let mut shot = Self {
            camera,
            depth: vec![],
            normal: [vec![], vec![], vec![]],
            obliqueness: vec![],
            wanted: vec![],
            color: vec![],
            flatness: Planarity::new(&[], 0, 0),
        };
        for i in 0..width * height {
            let x = ((i % width) as f64 - 29.3) / 55.0;
            let y = ((i / width) as f64 - 24.1) / 56.0;
            // The dot product of the scaled normal and the pixel ray is −1.
            let (p, q) = (slope[0], slope[1]);
            let inverse = (0.45 + if x > 0.1 { 0.2 } else { 0.0 }) * (1.0 + p * x + q * y);
            let normal = [-p, -q, -1.0].map(|n| n / (1.0 + p * x + q * y));
            let hole = draw.next() < 0.05;
            let noise = 1.0 + 0.01 * (draw.next() - 0.5);
            shot.depth.push(if hole || inverse < 0.1 { 0.0 } else { (noise / inverse) as f32 });
            (0..3).for_each(|k| shot.normal[k].push(normal[k] as f32));
            shot.obliqueness.push(normal.iter().map(|n| n * n).sum::<f64>().sqrt() as f32);
            shot.wanted.push(draw.next() < 0.9);
            (0..3).for_each(|_| shot.color.push((256.0 * draw.next()) as u8));
        }
        shot.flatness = Planarity::new(&shot.depth, width, height);
        shot
    }

    fn view(&self, threads: usize) -> FrameView {
        let color = Some(&*self.color);
        let images = FrameImages { depth: &self.depth, obliqueness: &self.obliqueness, color };
        FrameView::new(self.camera, images, WEIGHING, TRUNCATION as f32, threads)
    }

    fn touched(&self, within: Option<BlockBox>) -> Vec<u64> {
        let surface = MeasuredSurface {
            depth: &self.depth,
            normal: [0, 1, 2].map(|k| &*self.normal[k]),
            obliqueness: &self.obliqueness,
            wanted: &self.wanted,
        };
        collect_touched_blocks(&self.camera, surface, VOXEL, TRUNCATION as f32, within).unwrap()
    }
}

fn make_frames(count: usize) -> Vec<SyntheticFrame> {
    let mut draw = PseudoRandom(7);
    (0..count).map(|_| SyntheticFrame::new(&mut draw)).collect()
}

fn fuse_frames(
    shots: &[SyntheticFrame],
    within: Option<BlockBox>,
    add: IntegrateBlock,
    threads: usize,
) -> TsdfVolume {
    let control = RunControl::default();
    let mut volume = TsdfVolume::new(VOXEL, TRUNCATION, true, 1 << 20).with_variant(add);
    for shot in shots {
        volume
            .integrate(&shot.touched(within), &shot.view(threads), threads, &Progress::new(&control))
            .unwrap();
    }
    volume
}

/// All stored data of a block, as bits.
type Bits = (Vec<u32>, Vec<u16>, Vec<u8>, Vec<u16>, Vec<u8>);

fn bits(volume: &TsdfVolume) -> HashMap<u64, Bits> {
    let blocks = volume.blocks();
    let of = |slot| {
        let (distances, colors) = (blocks.distances(slot), blocks.colors(slot).unwrap());
        (
            distances.sum.as_flattened().iter().map(|sum| sum.to_bits()).collect(),
            distances.weight.concat(),
            distances.frames.concat(),
            colors.fractions.concat(),
            colors.levels.concat().concat(),
        )
    };
    (0..blocks.count()).map(|slot| (blocks.key(slot), of(slot))).collect()
}

/// Reference observation of a voxel by a frame, in double precision.
enum ReferenceObservation {
    NotObserved,
    /// Distance, weight and colour.
    Observed(f64, f64, [f64; 3]),
    Ambiguous,
}

fn observe_reference(shot: &SyntheticFrame, place: [f64; 3]) -> ReferenceObservation {
    const NEARLY: f64 = 2e-3;
    let (width, height) = (shot.camera.width as f64, shot.camera.height as f64);
    let at = shot.camera.inverse.map(|r| r[0] * place[0] + r[1] * place[1] + r[2] * place[2] + r[3]);
    if at[2] <= 0.0 {
        return ReferenceObservation::NotObserved;
    }
    let [u, v] = [0, 1].map(|k| at[k] / at[2] * shot.camera.focal[k] + shot.camera.centre[k]);
    let near_edge = [u + 0.5, v + 0.5, u + 0.5 - width, v + 0.5 - height].iter().any(|d| d.abs() < NEARLY);
    let near_tie =
        [u, v].iter().any(|c| (c - c.floor() - 0.5).abs() < NEARLY || (c - c.round()).abs() < NEARLY);
    if near_edge || near_tie {
        return ReferenceObservation::Ambiguous;
    }
    if !(-0.5..width - 0.5).contains(&u) || !(-0.5..height - 0.5).contains(&v) {
        return ReferenceObservation::NotObserved;
    }
    let (u, v) = (u.clamp(0.0, width - 1.0), v.clamp(0.0, height - 1.0));
    let pixel =
        |x: f64, y: f64| (y.min(height - 1.0) as usize) * shot.camera.width + x.min(width - 1.0) as usize;
    let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]
        .map(|(dx, dy)| (pixel(u.floor() + dx, v.floor() + dy), dx, dy));
    let nearest = pixel(u.round(), v.round());
    let (fu, fv) = (u - u.floor(), v - v.floor());
    let mixed = |value: &dyn Fn(usize) -> f64| {
        corners
            .iter()
            .map(|&(i, dx, dy)| {
                value(i) * if dx > 0.0 { fu } else { 1.0 - fu } * if dy > 0.0 { fv } else { 1.0 - fv }
            })
            .sum::<f64>()
    };
    let inverse = |i: usize| 1.0 / f64::from(shot.depth[i]);
    let scale = |i: usize| 1.0 / (f64::from(shot.obliqueness[i]) * TRUNCATION);
    let (inverse, scale) = if corners.iter().all(|&(i, ..)| shot.depth[i] > 0.0) {
        (mixed(&inverse), mixed(&scale))
    } else if shot.depth[nearest] > 0.0 {
        (inverse(nearest), scale(nearest))
    } else {
        return ReferenceObservation::NotObserved;
    };
    let distance = (1.0 / inverse - at[2]) * scale;
    if (distance.abs() - 1.0).abs() < NEARLY || (distance - 8.0).abs() < 10.0 * NEARLY {
        return ReferenceObservation::Ambiguous;
    }
    if distance < -1.0 {
        return ReferenceObservation::NotObserved;
    }
    let z = f64::from(shot.depth[nearest]);
    let deviation = f64::from(WEIGHING.constant) + f64::from(WEIGHING.quadratic) * z * z;
    let flat = f64::from(shot.flatness.row(nearest / shot.camera.width)[nearest % shot.camera.width / 4]);
    let worth = flat + (1.0 - flat) / f64::from(shot.obliqueness[nearest]).powi(2);
    let weight = f64::from(WEIGHT_UNIT) * (f64::from(WEIGHING.typical) / deviation).powi(2) * worth;
    if (weight - weight.floor() - 0.5).abs() < NEARLY {
        return ReferenceObservation::Ambiguous;
    }
    let weight = weight.round().clamp(1.0, MAX_WEIGHT.into());
    // Full weight up to three standard deviations behind the surface, then decreasing over one and a half
    // voxels.
    let noise = f64::from(WEIGHING.constant) + f64::from(WEIGHING.quadratic) * at[2] * at[2];
    let faded = ((-distance * TRUNCATION - (3.0 * noise).max(0.5 * VOXEL)) / (1.5 * VOXEL)).clamp(0.0, 1.0);
    let weight = weight * (1.0 - faded);
    if (weight - weight.floor() - 0.5).abs() < 20.0 * NEARLY {
        return ReferenceObservation::Ambiguous;
    }
    let color = [0, 1, 2].map(|c| f64::from(shot.color[3 * nearest + c]));
    ReferenceObservation::Observed(distance, weight.round().max(1.0), color)
}

#[test]
fn voxels_hold_what_double_precision_and_no_tricks_say() {
    let shots = make_frames(5);
    let touched: Vec<Vec<u64>> = shots.iter().map(|shot| shot.touched(None)).collect();
    let volume = fuse_frames(&shots, None, instruction_variants()[0].1, 2);
    let (mut compared, mut colored) = (0, 0);
    for slot in 0..volume.block_count() {
        let (block, key) = (DistanceField::block_coordinates(&volume, slot), volume.blocks.key(slot));
        let (distances, colors) = (volume.blocks.distances(slot), volume.blocks.colors(slot).unwrap());
        'voxels: for voxel in 0..BLOCK_VOXELS {
            let within = [voxel % 8, voxel / 8 % 8, voxel / 64];
            let place = [0, 1, 2].map(|k| f64::from(block[k] * 8 + within[k] as i32) * VOXEL);
            let (mut sum, mut weight, mut frames) = (0.0, 0.0, 0);
            let mut color: Option<[f64; 3]> = None;
            for shot in shots.iter().zip(&touched).filter(|(_, keys)| keys.binary_search(&key).is_ok()) {
                match observe_reference(shot.0, place) {
                    ReferenceObservation::Ambiguous => continue 'voxels,
                    ReferenceObservation::NotObserved => {}
                    ReferenceObservation::Observed(distance, own, seen) => {
                        (sum, weight) = (sum + own * distance.min(1.0), weight + own);
                        frames += i32::from(distance < 8.0);
                        if distance < 1.0 {
                            let share = own / weight;
                            color = Some(color.map_or(seen, |color| {
                                [0, 1, 2].map(|c| color[c] + share * (seen[c] - color[c]))
                            }));
                        }
                    }
                }
            }
            assert_eq!(
                (f64::from(distances.weight.as_flattened()[voxel]), i32::from(distances.frames(voxel))),
                (weight, frames)
            );
            if weight > 0.0 {
                assert!((f64::from(distances.distance_of(voxel, 0)) - sum / weight).abs() < 2e-4);
                compared += 1;
            }
            if let Some(color) = color {
                let found = colors.color_of(voxel);
                assert!((0..3).all(|c| (f64::from(found[c]) - color[c]).abs() < 0.1), "{found:?} {color:?}");
                colored += 1;
            }
        }
    }
    assert!(compared > 20_000 && colored > 10_000, "{compared} {colored}");
}

#[test]
fn every_set_of_instructions_and_any_number_of_threads_give_the_same_bits() {
    let shots = make_frames(4);
    let (_, plain) = *instruction_variants().last().unwrap();
    let expected = bits(&fuse_frames(&shots, None, plain, 1));
    for (name, add) in instruction_variants() {
        for threads in [1, 2, 7] {
            assert!(
                bits(&fuse_frames(&shots, None, add, threads)) == expected,
                "{name} on {threads} threads"
            );
        }
    }
}

#[test]
fn a_brick_is_fused_alone_as_it_is_among_others() {
    let shots = make_frames(4);
    let add = instruction_variants()[0].1;
    let whole = bits(&fuse_frames(&shots, None, add, 1));
    let middle = [8, -19, 0];
    let mut together = HashMap::new();
    for part in 0..8 {
        let low = [0, 1, 2].map(|k| if part >> k & 1 == 0 { -1000 } else { middle[k] });
        let high = [0, 1, 2].map(|k| if part >> k & 1 == 0 { middle[k] } else { 1000 });
        together.extend(bits(&fuse_frames(&shots, Some(BlockBox { low, high }), add, 1)));
    }
    assert!(together == whole);
}

/// Fuse frames that see a wall straight on at a distance of 1 m.
fn fuse_wall(count: u32, noise: impl Fn(u32) -> f32, color: impl Fn(u32) -> u8) -> (TsdfVolume, u64) {
    let pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
    let camera = FusionCamera::new((40, 40), [50.0, 50.0], [20.0, 20.0], pose);
    let control = RunControl::default();
    let mut volume = TsdfVolume::new(VOXEL, TRUNCATION, true, 10);
    let block = block_key([0, 0, 6]);
    for k in 0..count {
        let (depth, color) = (vec![1.0 + noise(k); 1600], vec![color(k); 4800]);
        let images = FrameImages { depth: &depth, obliqueness: &[1.0; 1600], color: Some(&color) };
        let weighing = DepthNoiseModel { typical: 1.0, constant: 1.0, quadratic: 0.0 };
        let view = FrameView::new(camera, images, weighing, TRUNCATION as f32, 1);
        volume.integrate(&[block], &view, 1, &Progress::new(&control)).unwrap();
    }
    (volume, block)
}

#[test]
fn thousands_of_frames_leave_no_bias() {
    // A voxel 0.4 truncations in front of the wall; the noise has zero mean, and no pattern that rounding
    // could follow.
    let (volume, _) =
        fuse_wall(5000, |k| (k * 7919 % 5000) as f32 / 5000.0 * 0.04 - 0.02, |k| (k * 31 % 200) as u8);
    let (z, slot) = (48, 0);
    let voxel = (z - 48) * 64;
    let expected = (1.0 - z as f64 * VOXEL) / TRUNCATION;
    let found = f64::from(volume.blocks.distances(slot).distance_of(voxel, 1));
    assert!((found - expected).abs() < 2e-3, "{found} {expected}");
    assert_eq!(volume.blocks.distances(slot).frames(voxel), 255);
    let color = volume.blocks.colors(slot).unwrap().color_of(voxel)[0];
    assert!((color - 99.5).abs() < 12.0, "{color}");
}

#[test]
fn a_colour_that_does_not_change_is_kept_however_often_it_is_seen() {
    for level in [0, 1, 127, 200, 255] {
        let (volume, _) = fuse_wall(300, |_| 0.0, |_| level);
        assert_eq!(volume.blocks.colors(0).unwrap().color_of(0), [f32::from(level); 3]);
    }
}

#[test]
fn fewer_frames_than_asked_for_are_none() {
    let (volume, _) = fuse_wall(3, |_| 0.0, |_| 9);
    let mut distances = [0.0; BLOCK_VOXELS];
    volume.distances(0, 3, &mut distances);
    // 1 − 0.96 is two voxels.
    assert!((distances[0] - 2.0).abs() < 1e-4 && (distances[0] - volume.distance(0, 0, 3)).abs() < 1e-9);
    volume.distances(0, 4, &mut distances);
    assert!(distances.iter().all(|d| d.is_nan()) && volume.distance(0, 0, 4).is_nan());
    let counts = volume.observation_histogram(None);
    assert!(counts[3] > 0 && counts.iter().sum::<u64>() == counts[3]);
    let high = volume.block_coordinates(0).map(|c| c + 1);
    let here = volume.observation_histogram(Some(BlockBox { low: volume.block_coordinates(0), high }));
    assert!(0 < here[3] && here[3] <= counts[3]);
    assert_eq!(volume.observation_histogram(Some(BlockBox { low: high, high })), [0; 256]);
}

#[test]
fn a_volume_that_may_not_grow_says_so_and_stays_as_it_is() {
    let shots = make_frames(2);
    let control = RunControl::default();
    let progress = Progress::new(&control);
    let mut volume = TsdfVolume::new(VOXEL, TRUNCATION, true, shots[0].touched(None).len());
    volume.integrate(&shots[0].touched(None), &shots[0].view(1), 1, &progress).unwrap();
    let before = bits(&volume);
    let refused = volume.integrate(&shots[1].touched(None), &shots[1].view(1), 1, &progress);
    assert!(matches!(refused, Err(KernelError::TooManyBlocks { .. })), "{refused:?}");
    assert!(bits(&volume) == before);
}

#[test]
fn a_surface_touches_the_blocks_it_passes_through() {
    // All points on the surface and up to half a truncation around it, from every pixel.
    for shot in make_frames(3) {
        let keys = shot.touched(None);
        let mut missing = 0;
        let mut all = 0;
        for i in (0..shot.depth.len()).filter(|&i| shot.depth[i] > 0.0 && shot.wanted[i]) {
            let z = f64::from(shot.depth[i]);
            let x = ((i % 61) as f64 - shot.camera.centre[0]) / shot.camera.focal[0];
            let y = ((i / 61) as f64 - shot.camera.centre[1]) / shot.camera.focal[1];
            let normal = [0, 1, 2].map(|k| f64::from(shot.normal[k][i] / shot.obliqueness[i]));
            for share in [-0.5, -0.25, 0.0, 0.25, 0.5] {
                let at = [x * z, y * z, z];
                let at: [f64; 3] = std::array::from_fn(|k| at[k] + share * TRUNCATION * normal[k]);
                let there = shot.camera.pose.map(|r| r[0] * at[0] + r[1] * at[1] + r[2] * at[2] + r[3]);
                let block = there.map(|c| (c / (8.0 * VOXEL)).floor() as i32);
                all += 1;
                missing += i32::from(keys.binary_search(&block_key(block)).is_err());
            }
        }
        assert!(missing * 500 < all, "{missing} of {all}");
    }
}

#[test]
fn a_pose_that_is_far_off_is_an_error() {
    let mut shot = make_frames(1).remove(0);
    shot.camera.pose[1][3] = 1e6;
    let surface = MeasuredSurface {
        depth: &shot.depth,
        normal: [0, 1, 2].map(|k| &*shot.normal[k]),
        obliqueness: &shot.obliqueness,
        wanted: &shot.wanted,
    };
    let found = collect_touched_blocks(&shot.camera, surface, VOXEL, TRUNCATION as f32, None);
    assert!(matches!(found, Err(KernelError::OutOfBlockRange { .. })), "{found:?}");
}
