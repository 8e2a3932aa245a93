//! `.snm` container: files are read back part by part, and damaged parts are rejected.

use crate::promises::common::{Noise, Triangles, gallery, sheet, torus};
use scanloom_kernels::base::ids::{EdgeId, VertexId};
use scanloom_kernels::mesh::collapse_legality::{VertexMarks, can_collapse};
use scanloom_kernels::mesh::connectivity::Connectivity;
use scanloom_kernels::snm::{Reader, SnmError, Writer, to_canonical};
use scanloom_kernels::subdivision::snm_contents::{BaseContents, Header, Offset, Refinement, Scheme};
use scanloom_kernels::subdivision::topology::Topology;

/// Draw a random number of either sign with a magnitude below 2^bits, uniform in its logarithm.
fn number(noise: &mut Noise, bits: f64) -> i32 {
    let magnitude = (noise.next() * bits).exp2() - 1.0;
    let sign = if noise.next() < 0.5 { -1.0 } else { 1.0 };
    (sign * magnitude) as i32
}

fn header(levels: u8, channels: u8) -> Header {
    Header {
        scheme: Scheme::Butterfly,
        relaxations: 3,
        origin: [0, -(1 << 50), 77],
        grid: 0.123_456,
        step: 1.5e-9,
        step_ratio: 2.0,
        channels,
        units: std::array::from_fn(|i| if i < channels.into() { 0.1 + i as f32 } else { 0.0 }),
        levels,
        up: [None, Some([0.0, -1.0, 0.0]), Some([0.6, -0.0, -0.8])][usize::from(levels) % 3],
    }
}

fn base(
    points: &[[f64; 3]],
    triangles: Triangles,
    channels: u8,
    noise: &mut Noise,
    bits: f64,
) -> BaseContents {
    let positions = points.iter().map(|p| p.map(|x| (1000.0 * x) as i32 + number(noise, bits))).collect();
    BaseContents { positions, triangles, channels: values(points.len(), channels, noise, bits) }
}

fn values(count: usize, channels: u8, noise: &mut Noise, bits: f64) -> Vec<[i32; 4]> {
    let mut value = || std::array::from_fn(|i| if i < channels.into() { number(noise, bits) } else { 0 });
    (0..count).map(|_| value()).take(if channels == 0 { 0 } else { count }).collect()
}

fn refinement(topology: &Topology, channels: u8, noise: &mut Noise, bits: f64) -> Refinement {
    let mut offset = |edge| {
        if topology.is_boundary_edge(edge) || noise.next() < 0.1 {
            Offset::Vector([(); 3].map(|()| number(noise, bits)))
        } else if noise.next() < 0.1 {
            Offset::Unrelaxed(number(noise, bits))
        } else {
            Offset::Scalar(number(noise, bits))
        }
    };
    let offsets = (0..topology.edges.len()).map(&mut offset).collect();
    Refinement { offsets, channels: values(topology.edges.len(), channels, noise, bits) }
}

struct Made {
    header: Header,
    base: BaseContents,
    refinements: Vec<Refinement>,
    file: Vec<u8>,
    /// End of each part in the file, in bytes.
    ends: Vec<usize>,
}

fn made(base: BaseContents, levels: u8, channels: u8, noise: &mut Noise, bits: f64) -> Made {
    let header = header(levels, channels);
    let base = to_canonical(&base).unwrap().base;
    let mut topology = Topology::new(base.positions.len(), base.triangles.clone()).unwrap();
    let mut writer = Writer::new(&header, &base).unwrap();
    let mut ends = vec![writer.bytes().len()];
    let mut refinements = vec![];
    for _ in 0..levels {
        let refinement = refinement(&topology, channels, noise, bits);
        writer.write_level(&topology, &[], &refinement).unwrap();
        ends.push(writer.bytes().len());
        refinements.push(refinement);
        topology = topology.subdivide();
    }
    Made { header, base, refinements, file: writer.finish(), ends }
}

/// Read as many parts of a file as possible, and return the error that stopped reading.
fn read(file: &[u8]) -> Result<(Header, BaseContents, Vec<Refinement>, Option<SnmError>), SnmError> {
    let (mut reader, header, base) = Reader::new(file)?;
    let mut refinements = vec![];
    let Ok(mut topology) = Topology::new(base.positions.len(), base.triangles.clone()) else {
        return Err(SnmError::Damaged { part: 0 });
    };
    loop {
        match reader.read_level(&topology, &[]) {
            Ok(Some(refinement)) => refinements.push(refinement),
            Ok(None) => return Ok((header, base, refinements, None)),
            Err(error) => return Ok((header, base, refinements, Some(error))),
        }
        topology = topology.subdivide();
    }
}

fn assert_reads(made: &Made, name: &str) {
    let (header, base, refinements, stopped) = read(&made.file).unwrap();
    assert_eq!(header, made.header, "{name}");
    assert_eq!(base, made.base, "{name}");
    assert!(refinements == made.refinements, "{name}");
    assert_eq!(stopped, None, "{name}");
}

/// Collapse random edges of the gallery meshes, for irregular valences, boundaries and handles.
fn random_meshes() -> Vec<(String, Vec<[f64; 3]>, Triangles)> {
    let mut meshes = vec![];
    for (name, points, triangles) in gallery() {
        for seed in 0..3u32 {
            let mut noise = Noise(seed.into());
            let mut connectivity = Connectivity::from_triangles(points.len(), &triangles).unwrap();
            let mut marks = VertexMarks::new(points.len());
            for _ in 0..points.len() * seed as usize {
                let edge = EdgeId::from_index(noise.below(connectivity.edge_slots()));
                if connectivity.is_edge(edge) && can_collapse(&connectivity, edge, &mut marks).is_ok() {
                    let [survivor, _] = connectivity.ends(edge);
                    connectivity.collapse(edge, survivor);
                }
            }
            let left = connectivity.triangles().map(|t| connectivity.corners(t).map(|VertexId(v)| v));
            meshes.push((format!("{name} {seed}"), points.clone(), left.collect()));
        }
    }
    meshes
}

#[test]
fn what_is_written_is_read() {
    for (name, points, triangles) in random_meshes() {
        let mut noise = Noise(5);
        for (channels, bits) in [(0, 0.9), (3, 5.0), (4, 31.0f64)] {
            let base = base(&points, triangles.clone(), channels, &mut noise, bits.min(20.0));
            assert_reads(&made(base, 2, channels, &mut noise, bits), &name);
        }
    }
}

#[test]
fn the_largest_numbers_are_kept() {
    let mut noise = Noise(8);
    let (points, triangles) = torus(5, 4);
    let extreme = |noise: &mut Noise| [i32::MIN, i32::MAX, 0, -1][noise.below(4)];
    let mut extremes =
        || -> Vec<[i32; 4]> { (0..60).map(|_| [(); 4].map(|()| extreme(&mut noise))).collect() };
    let positions = extremes()[..20].iter().map(|p| [p[0], p[1], p[2]]).collect();
    let base = to_canonical(&BaseContents { positions, triangles, channels: extremes()[..20].to_vec() })
        .unwrap()
        .base;
    assert_eq!(points.len(), 20);
    let topology = Topology::new(20, base.triangles.clone()).unwrap();
    let offset = |&[a, b, c, d]: &[i32; 4]| if d < 0 { Offset::Scalar(a) } else { Offset::Vector([a, b, c]) };
    let refinement = Refinement { offsets: extremes().iter().map(offset).collect(), channels: extremes() };
    let header = Header { origin: [i64::MIN, i64::MAX, 0], grid: f32::MAX, ..header(1, 4) };
    let mut writer = Writer::new(&header, &base).unwrap();
    writer.write_level(&topology, &[], &refinement).unwrap();
    let file = writer.finish();
    assert_eq!(read(&file).unwrap(), (header, base, vec![refinement], None));
}

#[test]
fn what_is_up_is_kept_and_takes_a_byte_along_an_axis() {
    let (points, triangles) = sheet(3, 2);
    let base = to_canonical(&base(&points, triangles, 0, &mut Noise(4), 3.0)).unwrap().base;
    let file = |up| Writer::new(&Header { up, ..header(0, 0) }, &base).unwrap().finish();
    let plain = file(None).len();
    for axis in 0..3 {
        for sign in [1.0, -1.0] {
            let mut up = [0.0; 3];
            up[axis] = sign;
            let made = file(Some(up));
            assert!(made.len() <= plain + 1, "{} {plain}", made.len());
            assert_eq!(Reader::new(&made).unwrap().1.up, Some(up));
        }
    }
    let tilted = [0.004_913, -0.894_4, -0.447_2];
    let length = tilted.iter().map(|x: &f64| x * x).sum::<f64>().sqrt();
    let up = tilted.map(|x| x / length);
    let made = file(Some(up));
    assert!(made.len() <= plain + 25);
    assert_eq!(Reader::new(&made).unwrap().1.up, Some(up));
}

#[test]
fn the_order_of_the_coder_renumbers_and_stays() {
    for (name, points, triangles) in random_meshes() {
        let given = base(&points, triangles, 2, &mut Noise(3), 3.0);
        let found = to_canonical(&given).unwrap();
        assert_eq!(found.triangle_source.len(), given.triangles.len(), "{name}");
        for (new, &old) in found.vertex_source.iter().enumerate() {
            assert_eq!(found.base.positions[new], given.positions[old as usize], "{name}");
            assert_eq!(found.base.channels[new], given.channels[old as usize], "{name}");
        }
        let mut met = vec![false; given.triangles.len()];
        for (&new, &old) in found.base.triangles.iter().zip(&found.triangle_source) {
            assert!(!std::mem::replace(&mut met[old as usize], true), "{name}");
            let turned = new.map(|v| found.vertex_source[v as usize]);
            let [a, b, c] = given.triangles[old as usize];
            assert!([[a, b, c], [b, c, a], [c, a, b]].contains(&turned), "{name}");
        }
        let again = to_canonical(&found.base).unwrap();
        assert_eq!(again.base, found.base, "{name}");
        assert!(again.vertex_source.iter().enumerate().all(|(new, &old)| new == old as usize), "{name}");
    }
}

#[test]
fn a_file_cut_anywhere_gives_the_levels_that_are_whole() {
    for (_, points, triangles) in random_meshes().into_iter().step_by(8) {
        let mut noise = Noise(2);
        let base = base(&points, triangles, 1, &mut noise, 4.0);
        let made = made(base, 2, 1, &mut noise, 4.0);
        for end in 0..made.file.len() {
            let part = made.ends.iter().filter(|&&whole| whole <= end).count();
            let expected = match (end, part) {
                (0..3, _) => Err(SnmError::Magic),
                (_, 0) => Err(SnmError::Truncated { part: 0 }),
                _ => {
                    let stop = (!made.ends.contains(&end)).then_some(SnmError::Truncated { part });
                    Ok((made.header, made.base.clone(), made.refinements[..part - 1].to_vec(), stop))
                }
            };
            assert_eq!(read(&made.file[..end]), expected, "{end}");
        }
        let longer = [&made.file[..], &[7; 9]].concat();
        assert_eq!(read(&longer).unwrap().3, Some(SnmError::TrailingBytes { bytes: 9 }));
    }
}

#[test]
fn any_wrong_byte_is_found_and_levels_before_it_are_kept() {
    for (name, points, triangles) in random_meshes().into_iter().step_by(5) {
        let mut noise = Noise(6);
        let base = base(&points, triangles, 0, &mut noise, 3.0);
        let made = made(base, 2, 0, &mut noise, 3.0);
        for at in 0..made.file.len() {
            let part = made.ends.iter().filter(|&&whole| whole <= at).count();
            // Flipping 3 turns one version into the other.
            for flip in [1, 3, 128, 1 + noise.below(255) as u8] {
                let mut wrong = made.file.clone();
                wrong[at] ^= flip;
                match read(&wrong) {
                    Err(_) => assert_eq!(part, 0, "{name} {at}"),
                    Ok((header, base, refinements, stop)) => {
                        assert!(part > 0 && stop.is_some(), "{name} {at}");
                        assert_eq!((header, &base), (made.header, &made.base), "{name} {at}");
                        assert_eq!(refinements, made.refinements[..part - 1], "{name} {at}");
                    }
                }
            }
        }
    }
}

#[test]
fn what_does_not_fit_is_not_written() {
    let (points, triangles) = sheet(3, 2);
    let noise = &mut Noise(4);
    let given = base(&points, triangles, 0, noise, 3.0);
    let base = to_canonical(&given).unwrap().base;
    let header = header(1, 0);
    let refuses = |header: &Header, base: &BaseContents| Writer::new(header, base).is_err();
    assert!(refuses(&Header { grid: 0.0, ..header }, &base));
    assert!(refuses(&Header { step: f32::NAN, ..header }, &base));
    assert!(refuses(&Header { channels: 5, ..header }, &base));
    for up in [[0.0; 3], [1.0, 1.0, 0.0], [f64::NAN, 0.0, 0.0], [0.0, f64::INFINITY, 0.0]] {
        assert!(refuses(&Header { up: Some(up), ..header }, &base));
    }
    let mut turned = base.clone();
    turned.triangles[1].rotate_left(1);
    assert!(refuses(&header, &turned));
    let mut turned_over = base.clone();
    turned_over.triangles[1].reverse();
    assert!(matches!(Writer::new(&header, &turned_over), Err(SnmError::Mesh(_))));

    let topology = Topology::new(base.positions.len(), base.triangles.clone()).unwrap();
    let good = refinement(&topology, 0, noise, 3.0);
    let level = |header: &Header, topology: &Topology, expected: &[i32], refinement: &Refinement| {
        Writer::new(header, &base).unwrap().write_level(topology, expected, refinement)
    };
    assert_eq!(level(&header, &topology, &[], &good), Ok(()));
    let misfits = |result| assert!(matches!(result, Err(SnmError::InvalidInput(_))));
    misfits(level(&header, &topology, &[1], &good));
    misfits(level(&header, &topology.subdivide(), &[], &good));
    misfits(level(&Header { levels: 0, ..header }, &topology, &[], &good));
    let mut short = good.clone();
    short.offsets.pop();
    misfits(level(&header, &topology, &[], &short));
    let mut inside = good.clone();
    let boundary = (0..topology.edges.len()).find(|&edge| topology.is_boundary_edge(edge)).unwrap();
    inside.offsets[boundary] = Offset::Scalar(0);
    misfits(level(&header, &topology, &[], &inside));
    let mut unrelaxed = good.clone();
    let interior = (0..topology.edges.len()).find(|&edge| !topology.is_boundary_edge(edge)).unwrap();
    unrelaxed.offsets[interior] = Offset::Unrelaxed(1);
    assert_eq!(level(&header, &topology, &[], &unrelaxed), Ok(()));
    misfits(level(&Header { relaxations: 0, ..header }, &topology, &[], &unrelaxed));
}

#[test]
fn what_is_expected_shortens_the_file_and_must_be_the_same_again() {
    let (points, triangles) = torus(12, 8);
    let noise = &mut Noise(9);
    let base = to_canonical(&base(&points, triangles, 0, noise, 0.0)).unwrap().base;
    let topology = Topology::new(base.positions.len(), base.triangles.clone()).unwrap();
    let offsets: Vec<i32> = topology.edges.iter().map(|_| number(noise, 9.0)).collect();
    let expected: Vec<i32> = offsets.iter().map(|x| 16 * x + number(noise, 5.0)).collect();
    let refinement =
        Refinement { offsets: offsets.into_iter().map(Offset::Scalar).collect(), channels: vec![] };
    let written = |expected: &[i32]| {
        let mut writer = Writer::new(&header(1, 0), &base).unwrap();
        writer.write_level(&topology, expected, &refinement).unwrap();
        writer.finish()
    };
    let (plain, short) = (written(&[]), written(&expected));
    assert!(10 * short.len() < 9 * plain.len(), "{} {}", short.len(), plain.len());
    let (mut reader, _, _) = Reader::new(&short).unwrap();
    assert_eq!(reader.read_level(&topology, &expected).unwrap(), Some(refinement));
    assert_eq!(reader.read_level(&topology.subdivide(), &[]), Ok(None));
    assert_eq!(reader.remaining_byte_count(), 0);
}
