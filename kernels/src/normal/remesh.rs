//! From a mesh to its normal mesh.

use super::base_mesh::Base;
use super::carried::Carried;
use super::coarsening::{Target, coarse};
use super::distance::{Distance, Fine, largest, mean_square};
use super::domain::Domain;
use super::found::Found;
use super::grid::{ROUNDED_OFF, Steps, on_grid};
use super::importance::{insist, weigh};
use super::level::Level;
use super::place::{Original, Placed, Search};
use super::predict::Predicted;
use super::rim::Rims;
use super::surface::{Place, Surface};
use super::unfold::unfold;
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, around, diagonal, sub};
use crate::base::progress::Progress;
use crate::base::reserve::Reserve;
use crate::mesh::triangle_mesh::Mesh;
use crate::snm::{Writer, canonical};
use crate::subdivision::contents::{self, Header, Refinement, Scheme};

/// Bases that are tried; the one whose finest level comes closest is taken.
const TRIALS: u64 = 4;
/// Bases that are tried beyond that where triangles turn over.
const MENDS: u64 = 1;
/// Levels at most where their number is not given.
const MOST_LEVELS: u8 = 4;
/// Steps of a level in those of the next finer one: what is wrong early spreads far.
const STEP_RATIO: f32 = 0.625;
/// Bits of the mantissas of steps: the file is shorter for round numbers.
const MANTISSA: u32 = 3;
/// A mesh farther from the origin than this many diagonals gets one of its own.
const FAR: f64 = 4.0;
/// Grid points that 32 bits hold with room for the coder's predictions.
const MOST_GRID_POINTS: f64 = (1u32 << 29) as f64;

/// What a normal mesh is made with.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// At most. If not given, so many that the finest has about as many triangles as the input, or four if `max_error`
    /// says how many.
    pub levels: Option<u8>,
    pub target: Target,
    /// Stop at the first level that is nowhere farther from the input; 0 not to stop.
    pub max_error: f64,
    pub scheme: Scheme,
    pub relaxations: u8,
    /// How far quantisation may take a vertex from the surface, in diagonals of the bounding box.
    pub tolerance: f64,
    /// How far it may take a level of colour.
    pub color_tolerance: f64,
    pub threads: usize,
}

/// How a level was made of the one before.
#[derive(Clone, Debug)]
pub struct Step {
    pub predicted: Predicted,
    pub refinement: Refinement,
}

/// What only the encoder knows.
#[derive(Clone, Debug)]
pub struct Origin {
    pub base_source: Vec<u32>,
    /// The triangle of the input that each vertex of the finest level lies on; coarser levels have the first of them.
    pub triangles: Vec<u32>,
    /// Triangles of the finest level that look away from the surface or are needles.
    pub unsound: usize,
    /// Largest distance of each level from the input, if that was asked for.
    pub reached: Vec<f64>,
}

#[derive(Clone, Debug)]
pub struct NormalMesh {
    pub header: Header,
    pub levels: Vec<Level>,
    /// One less.
    pub steps: Vec<Step>,
    pub file: Vec<u8>,
    /// Bytes of the file up to the end of each level.
    pub ends: Vec<usize>,
    /// None after decoding.
    pub origin: Option<Origin>,
}

/// Whether triangles are unsound, how many levels there are, and how far off the last is: less is better.
type Rank = (bool, usize, f64);

/// The input as the search needs it.
struct Input<'a> {
    points: Vec<Vec3>,
    triangles: &'a [[u32; 3]],
    carried: &'a Carried,
    surface: Surface,
    slots: Vec<u32>,
    /// A place for each vertex: a corner of any triangle that has it.
    places: Vec<Place>,
}

/// Make the normal mesh of a mesh and what its vertices carry.
///
/// # Errors
/// As [`Mesh::new`]; [`KernelError::Extent`] if the mesh is too small or too large for the numbers of a file;
/// [`KernelError::Interrupted`].
pub fn remesh(
    points: &[Vec3],
    triangles: &[[u32; 3]],
    carried: &Carried,
    settings: &Settings,
    progress: &mut Progress,
) -> Result<NormalMesh, KernelError> {
    let mesh = Mesh::new(points.to_vec(), triangles)?;
    let used = || mesh.connectivity.vertices().map(|v| *mesh.point(v));
    let mut header = header(around(used()), carried, settings)?;
    let shift = header.origin.map(|k| k as f64 * f64::from(header.grid));
    let points: Vec<Vec3> = points.iter().map(|p| sub(p, &shift)).collect();
    let mesh = Mesh { points: points.clone(), ..mesh };
    // Triangles that name a vertex twice have no area, and nothing lies on them.
    let proper: Vec<[u32; 3]> = mesh.triangle_source.iter().map(|&t| triangles[t as usize]).collect();
    let surface = Surface::new(&points, &proper, settings.threads);
    let slots = surface.slots();
    let source = mesh.triangle_source.clone();
    let places = at_vertices(points.len(), &surface);
    let input = Input { points, triangles: &proper, carried, surface, slots, places };

    let mut importance = vec![1.0; input.points.len()];
    let coarse = coarse(mesh, &input.surface, settings.target, progress)?;
    let mut best: Option<(Rank, contents::Base, NormalMesh)> = None;
    for trial in 0..TRIALS + MENDS {
        if trial >= TRIALS && best.as_ref().is_some_and(|(rank, ..)| !rank.0) {
            break;
        }
        // In levels, the base among them.
        let each = u64::from(settings.levels.unwrap_or(MOST_LEVELS)) + 1;
        let progress = &mut progress.part(trial * each, (TRIALS + MENDS) * each);
        progress.tell(0, each)?;
        let base = coarse.clone().base(&importance, &input.slots, progress)?;
        if settings.levels.is_none() && settings.max_error <= 0.0 && trial == 0 {
            header.levels = levels_for(base.triangles.len(), input.triangles.len());
        }
        let base = in_order(base, &input, &header)?;
        let (made, last, unsound) = levels_of(&input, &base, header, settings, progress)?;
        let rank = (!unsound.is_empty(), made.levels.len(), last.mean_square);
        let Ordered { base, contents } = base;
        if best.as_ref().is_none_or(|(least, ..)| rank < *least) {
            best = Some((rank, contents, made));
        }
        if last.mean_square == 0.0 {
            break;
        }
        weigh(&mut importance, &input.points, input.triangles, &base, &last.from_input);
        insist(&mut importance, &base, &unsound);
    }
    let (_, contents, mut made) = best.ok_or(KernelError::Interrupted)?;
    if let Some(origin) = &mut made.origin {
        origin.triangles.iter_mut().for_each(|t| *t = source[*t as usize]);
    }
    (made.file, made.ends) = written(&made.header, &contents, &made.levels, &made.steps, progress)?;
    Ok(made)
}

fn header(bounds: [Vec3; 2], carried: &Carried, settings: &Settings) -> Result<Header, KernelError> {
    let size = diagonal(&bounds);
    let step = round_down(settings.tolerance * size / ROUNDED_OFF);
    let grid = 0.5 * step;
    if !grid.is_normal() || !step.is_normal() || size / f64::from(grid) > MOST_GRID_POINTS {
        return Err(KernelError::Extent { diagonal: size });
    }
    let farthest = bounds.iter().flatten().fold(0.0f64, |most, x| most.max(x.abs()));
    let far = farthest > FAR * size || farthest / f64::from(grid) > MOST_GRID_POINTS;
    let origin = if far { bounds[0].map(|x| (x / f64::from(grid)).round() as i64) } else { [0; 3] };
    Ok(Header {
        scheme: settings.scheme,
        relaxations: settings.relaxations,
        origin,
        grid,
        step,
        step_ratio: STEP_RATIO,
        channels: carried.channels(),
        units: carried.units(settings.color_tolerance),
        levels: settings.levels.unwrap_or(MOST_LEVELS),
    })
}

/// Levels after which a base has about as many triangles as are wanted.
fn levels_for(base: usize, triangles: usize) -> u8 {
    let growth = triangles as f64 / base.max(1) as f64;
    (1..MOST_LEVELS).find(|&level| growth < 2.0 * 4f64.powi(level.into())).unwrap_or(MOST_LEVELS)
}

/// A number that is not larger and has a short mantissa.
fn round_down(x: f64) -> f32 {
    let near = x as f32;
    let below = if f64::from(near) > x { near.next_down() } else { near };
    f32::from_bits(below.to_bits() >> (23 - MANTISSA) << (23 - MANTISSA))
}

/// A base in the order of its coder, in whole numbers beside what it stands for.
struct Ordered {
    base: Base,
    contents: contents::Base,
}

fn in_order(base: Base, input: &Input<'_>, header: &Header) -> Result<Ordered, KernelError> {
    let positions = base.vertex_source.iter().map(|&v| on_grid(&input.points[v as usize], header)).collect();
    let channels = if header.channels == 0 {
        vec![]
    } else {
        let places = base.vertex_source.iter().map(|&v| &input.places[v as usize]);
        let channels = places.map(|place| input.carried.at(&input.surface, place));
        channels.map(|c| in_units(&c, &[0.0; 4], header)).collect()
    };
    let contents = contents::Base { positions, triangles: base.triangles.clone(), channels };
    let ordered = canonical(&contents).map_err(KernelError::from)?;
    let base = base.reordered(&ordered.vertex_source, &ordered.triangle_source, &ordered.base.triangles);
    Ok(Ordered { base, contents: ordered.base })
}

/// What channels differ by from what is expected, in units.
fn in_units(channels: &[f64; 4], expected: &[f64; 4], header: &Header) -> [i32; 4] {
    std::array::from_fn(|i| {
        let used = i < usize::from(header.channels);
        if used { ((channels[i] - expected[i]) / f64::from(header.units[i])).round() as i32 } else { 0 }
    })
}

fn levels_of(
    input: &Input<'_>,
    ordered: &Ordered,
    header: Header,
    settings: &Settings,
    progress: &mut Progress,
) -> Result<(NormalMesh, Distance, Vec<usize>), KernelError> {
    let Input { points, triangles, carried, surface, slots, places } = input;
    let Ordered { base, contents } = ordered;
    let first = Level::base(&header, contents)?;
    let rims = Rims::new(&base.chains, |t| triangles[t].map(|v| points[v as usize]), slots);
    let domain = Domain::new(base, &first.topology, surface);
    let original =
        Original { surface, sets: &base.sets, rims: &rims, domain: &domain, threads: settings.threads };
    let mut rim: Vec<_> =
        base.chains.iter().enumerate().map(|(i, chain)| (chain.ends, rims.whole(i as u32))).collect();
    rim.sort_unstable_by_key(|(ends, _)| *ends);
    let mut placed = Placed {
        places: base.vertex_source.iter().map(|&v| places[v as usize]).collect(),
        parameters: base.vertex_source.iter().map(|&v| base.parameters[v as usize]).collect(),
        rim,
    };
    let (mut unsound, mut faulty) = (vec![], vec![]);
    let (mut levels, mut steps, mut reached) = (vec![first], vec![], vec![]);
    let mut last = None;
    while let Some(level) = levels.last() {
        let number = levels.len() - 1;
        let is_finest = number == usize::from(header.levels);
        // Levels grow beyond the input.
        let _reserve = Reserve::for_rows(if is_finest { level.rows() } else { level.next_rows() })?;
        if is_finest || settings.max_error > 0.0 {
            let slots: Vec<u32> = placed.places.iter().map(|place| place.slot).collect();
            let fine = Fine { level, slots: &slots };
            let mut is_last = is_finest;
            if settings.max_error > 0.0 {
                reached.push(largest(points, triangles, surface, &fine, settings.threads));
                is_last |= reached[number] <= settings.max_error;
            }
            if is_last {
                last = Some(mean_square(points, triangles, surface, &fine, settings.threads));
                break;
            }
        }
        progress.tell(levels.len() as u64, u64::from(header.levels) + 1)?;
        let (predicted, step) = (level.predicted(&header), Steps::of(&header, number));
        let search = Search {
            original: &original,
            level,
            number,
            placed: &placed,
            predicted: &predicted,
            steps: &step,
        };
        let (mut found, rim) = search.refine();
        progress.check()?;
        unsound = unfold(&search, &mut found);
        progress.check()?;
        faulty.extend(unsound.iter().map(|t| t >> (2 * number)));
        let parameters: Vec<_> =
            found.iter().enumerate().map(|(edge, f)| search.parameter(edge, &f.place)).collect();
        placed.parameters.extend(parameters);
        placed.places.extend(found.iter().map(|f| f.place));
        placed.rim = rim;
        let refinement = Refinement {
            offsets: found.iter().map(|f| f.offset).collect(),
            channels: channels_of(&found, level, carried, surface, &header),
        };
        progress.check()?;
        let next = level.refined(&header, &step, &predicted, &refinement);
        steps.push(Step { predicted, refinement });
        levels.push(next);
    }
    progress.check()?;
    let last = last.ok_or(KernelError::Interrupted)?;
    if steps.len() < usize::from(header.levels) {
        // Steps depend on how many levels there are.
        let header = Header { levels: steps.len() as u8, ..header };
        return levels_of(input, ordered, header, settings, progress);
    }
    let origin = Some(Origin {
        base_source: base.vertex_source.clone(),
        triangles: placed.places.iter().map(|place| surface.triangle(place.slot)).collect(),
        unsound: unsound.len(),
        reached,
    });
    Ok((NormalMesh { header, levels, steps, file: vec![], ends: vec![], origin }, last, faulty))
}

fn channels_of(
    found: &[Found],
    level: &Level,
    carried: &Carried,
    surface: &Surface,
    header: &Header,
) -> Vec<[i32; 4]> {
    if header.channels == 0 {
        return vec![];
    }
    let of = |(edge, f): (usize, &Found)| {
        in_units(&carried.at(surface, &f.place), &level.channels_between(edge), header)
    };
    found.iter().enumerate().map(of).collect()
}

/// The file, and where each level ends in it.
fn written(
    header: &Header,
    base: &contents::Base,
    levels: &[Level],
    steps: &[Step],
    progress: &Progress,
) -> Result<(Vec<u8>, Vec<usize>), KernelError> {
    let mut writer = Writer::new(header, base)?;
    let mut ends = vec![writer.bytes().len()];
    for (number, (level, step)) in levels.iter().zip(steps).enumerate() {
        let _reserve = Reserve::for_rows(level.next_rows())?;
        let expected = level.expected(header, &Steps::of(header, number), &step.predicted);
        writer.level(&level.topology, &expected, &step.refinement)?;
        ends.push(writer.bytes().len());
        progress.check()?;
    }
    Ok((writer.finish(), ends))
}

/// Vertices of the input as places; those that no triangle has mean nothing.
fn at_vertices(count: usize, surface: &Surface) -> Vec<Place> {
    let mut places = vec![Place { slot: 0, barycentric: [0.0; 3], point: [0.0; 3] }; count];
    for slot in (0..surface.len() as u32).rev() {
        for (i, v) in surface.vertices(slot).into_iter().enumerate() {
            let mut barycentric = [0.0; 3];
            barycentric[i] = 1.0;
            places[v as usize] = surface.place(slot, barycentric);
        }
    }
    places
}
