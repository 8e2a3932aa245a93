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
use super::noise::noise;
use super::place::{Original, Placed, Search};
use super::predict::Predicted;
use super::rim::Rims;
use super::rounding::{Rounding, Samples};
use super::surface::{Place, Surface};
use super::tolerance::{FINEST, MOST_DOUBLINGS, Source, Tolerance, doublings};
use super::unfold::{unfold, unsound_in_base};
use crate::base::errors::KernelError;
use crate::base::geometry::{Vec3, around, diagonal, sub};
use crate::base::progress::Progress;
use crate::base::reserve::Reserve;
use crate::mesh::triangle_mesh::Mesh;
use crate::snm::{Canonical, Writer, canonical, canonical_rounded};
use crate::subdivision::contents::{self, Header, Refinement, Scheme};
use crate::subdivision::topology::Topology;

/// Bases that are tried; the one whose finest level comes closest is taken.
const TRIALS: u64 = 4;
/// Bases that are tried beyond that at most, as long as triangles turn over; where more than a few do, as long as each
/// leaves no more than this part of them: some surfaces are crumpled all over.
const MENDS: u64 = 6;
const FEW: usize = 10;
const HELPED: f64 = 0.7;
/// Tolerances that are tried where nobody gives one, and how many doublings are taken back from one to the next.
const ROUNDINGS: u64 = 4;
const TAKEN_BACK: u32 = 2;
/// All that is tried, at most.
const PASSES: u64 = TRIALS + MENDS + ROUNDINGS;
/// By how much rounding may take the finest level farther off at most: its share of that is a third.
const LOSS: f64 = 1.15;
/// And by this part of their number more triangles may be unsound.
const MORE: usize = 10;
/// So many unsound triangles count as twice the distance.
const DOUBLING: f64 = 10.0;
/// Levels at most where their number is not given.
const MOST_LEVELS: u8 = 4;
/// Steps of a level in those of the next finer one: what is wrong early spreads far.
const STEP_RATIO: f32 = 0.625;
/// Bits of the mantissas of steps: the file is shorter for round numbers.
const MANTISSA: u32 = 3;
/// Spacings of the grid in tolerances, where no levels follow: among the points around a vertex one is near enough.
const GRID_ALONE: f64 = 2.0;
/// Turns of rounding then: from the second on, all vertices know where the others go.
const ROUNDS: usize = 3;
/// Where no levels follow, so many times the distance is told: rounding leaves a small part of the tolerance.
const DISTANCE_ALONE: f64 = 9.0;
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
    /// How far quantisation may take a vertex from the surface, in diagonals of the bounding box. If not given, it follows
    /// from the mesh.
    pub tolerance: Option<f64>,
    /// How far it may take a level of colour.
    pub color_tolerance: f64,
    pub threads: usize,
}

impl Settings {
    /// Whether the base is all there is.
    fn is_alone(&self) -> bool {
        self.levels == Some(0)
    }
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
    /// Triangles of each level that look away from the surface or are needles.
    pub unsound: Vec<usize>,
    /// Largest distance of each level from the input, if that was asked for.
    pub reached: Vec<f64>,
    pub tolerance: Tolerance,
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

/// Whether triangles are unsound, how many levels there are, and how far off the last is, times what unsound triangles
/// count: less is better.
type Rank = (bool, usize, f64);

/// What was made of a base.
struct Trial {
    rank: Rank,
    /// Of the finest level from the input.
    mean_square: f64,
    base: Ordered,
    made: NormalMesh,
    /// What the base was made with, and base triangles with unsound parts.
    importance: Vec<f64>,
    unsound: Vec<usize>,
    /// How places of its vertices were sought.
    thorough: bool,
}

fn rank(made: &NormalMesh, last: &Distance) -> Rank {
    let unsound = made.unsound();
    let dearer = 1.0 + unsound as f64 / DOUBLING;
    (unsound > 0, made.levels.len(), dearer * dearer * last.mean_square)
}

/// The input as the search needs it.
struct Input<'a> {
    points: Vec<Vec3>,
    triangles: &'a [[u32; 3]],
    carried: &'a Carried,
    surface: Surface,
    slots: Vec<u32>,
    /// A place for each vertex: a corner of any triangle that has it.
    places: Vec<Place>,
    /// Of the surface it stands for, if no levels follow, and the mean square of their distance from it.
    samples: Samples,
    apart2: f64,
    /// Whether that surface is another mesh.
    is_light: bool,
}

/// The surface that a simplified mesh stands for.
#[derive(Clone, Copy, Debug)]
pub struct Simplified<'a> {
    pub from_points: &'a [Vec3],
    pub from_triangles: &'a [[u32; 3]],
}

/// Make the normal mesh of a mesh and what its vertices carry. If it is `simplified` and gets no levels, vertices
/// are rounded to where they come nearest to the surface it stands for.
///
/// # Errors
/// As [`Mesh::new`]; [`KernelError::Extent`] if the mesh is too small or too large for the numbers of a file;
/// [`KernelError::Interrupted`].
pub fn remesh(
    points: &[Vec3],
    triangles: &[[u32; 3]],
    carried: &Carried,
    simplified: Option<Simplified<'_>>,
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
    let samples = match simplified {
        _ if !settings.is_alone() => Samples::default(),
        None => Samples::new(&points, &proper, proper.len()),
        Some(Simplified { from_points, from_triangles }) => {
            let from: Vec<Vec3> = from_points.iter().map(|p| sub(p, &shift)).collect();
            Samples::new(&from, from_triangles, proper.len())
        }
    };
    let is_light = simplified.is_some();
    let apart2 = if is_light { samples.mean_square(&surface, settings.threads) } else { 0.0 };
    let input =
        Input { points, triangles: &proper, carried, surface, slots, places, samples, apart2, is_light };

    let mut importance = vec![1.0; input.points.len()];
    let coarse = coarse(mesh, &input.surface, settings.target, !settings.is_alone(), progress)?;
    let mut best: Option<Trial> = None;
    let each = each(settings);
    let mut before = usize::MAX;
    for trial in 0..TRIALS + MENDS {
        let mends = trial >= TRIALS;
        if let Some(best) = best.as_mut().filter(|_| mends) {
            let now = best.made.unsound();
            if now == 0 || now > FEW && now as f64 > HELPED * before as f64 {
                break;
            }
            before = now;
            // The same base but where triangles turn over.
            insist(&mut best.importance, &best.base.base, &best.unsound);
            importance.clone_from(&best.importance);
        }
        let progress = &mut progress.part(trial * each, PASSES * each);
        progress.tell(0, each)?;
        let base = coarse.clone().base(&importance, &input.slots, progress)?;
        if settings.levels.is_none() && settings.max_error <= 0.0 && trial == 0 {
            header.levels = levels_for(base.triangles.len(), input.triangles.len());
        }
        let base = in_order(base, &input, &header, settings)?;
        if best.as_ref().is_some_and(|best| best.thorough && best.base.contents == base.contents) {
            break;
        }
        let care = Care { thorough: mends, most_unsound: usize::MAX };
        let Some((made, last, unsound)) = levels_of(&input, &base, header, settings, care, progress)? else {
            break;
        };
        let used = importance.clone();
        weigh(&mut importance, &input.points, input.triangles, &base.base, &last.from_input);
        insist(&mut importance, &base.base, &unsound);
        let rank = rank(&made, &last);
        // Then there is no other base.
        let is_whole = settings.is_alone() && base.base.triangles.len() == proper.len();
        if best.as_ref().is_none_or(|best| rank < best.rank) {
            let mean_square = last.mean_square;
            best = Some(Trial { rank, mean_square, base, made, importance: used, unsound, thorough: mends });
        }
        if last.mean_square == 0.0 || is_whole {
            break;
        }
    }
    let best = best.ok_or(KernelError::Interrupted)?;
    let Trial { base, mut made, .. } = rounded(best, &input, settings, progress)?;
    if let Some(origin) = &mut made.origin {
        origin.triangles.iter_mut().for_each(|t| *t = source[*t as usize]);
    }
    (made.file, made.ends) = written(&made.header, &base.contents, &made.levels, &made.steps, progress)?;
    Ok(made)
}

/// What one pass is counted as: its levels, the base among them.
fn each(settings: &Settings) -> u64 {
    u64::from(settings.levels.unwrap_or(MOST_LEVELS)) + 1
}

/// The best of all trials once more, as coarse as does no harm, if nobody says how exact it should be.
fn rounded(
    best: Trial,
    input: &Input<'_>,
    settings: &Settings,
    progress: &mut Progress,
) -> Result<Trial, KernelError> {
    let (header, unsound) = (best.made.header, best.made.unsound());
    let distance2 = best.mean_square + input.apart2;
    let (mut doublings, source) = match settings.tolerance {
        Some(_) => (0, Source::Given),
        None => {
            let size = diagonal(&around(input.triangles.iter().flatten().map(|&v| input.points[v as usize])));
            let noise = noise(&input.points, input.triangles, input.surface.normals());
            let told = if settings.is_alone() { DISTANCE_ALONE } else { 1.0 };
            doublings(told * distance2.sqrt() / size, noise / size, settings.max_error / size)
        }
    };
    // Alone, no triangle turns by much against what it was.
    let most_unsound = if settings.is_alone() { usize::MAX } else { unsound + unsound / MORE };
    let care = Care { thorough: best.thorough, most_unsound };
    for attempt in 0..ROUNDINGS {
        if doublings == 0 {
            break;
        }
        let each = each(settings);
        let progress = &mut progress.part((TRIALS + MENDS + attempt) * each, PASSES * each);
        progress.tell(0, each)?;
        let header = coarser(&header, doublings);
        let base = in_order(best.base.base.clone(), input, &header, settings)?;
        let Some((mut made, last, _)) = levels_of(input, &base, header, settings, care, progress)? else {
            doublings = doublings.saturating_sub(TAKEN_BACK);
            continue;
        };
        let rank = rank(&made, &last);
        let reaches = |made: &NormalMesh| {
            let reached = made.origin.as_ref().and_then(|origin| origin.reached.last());
            reached.is_none_or(|reached| *reached <= settings.max_error)
        };
        let now2 = last.mean_square + input.apart2;
        let is_near = now2 <= LOSS * LOSS * distance2.max(f64::from(header.step).powi(2));
        if is_near && reaches(&made) >= reaches(&best.made) {
            if let (Some(origin), None) = (&mut made.origin, settings.tolerance) {
                origin.tolerance = Tolerance::doubled(doublings, source);
            }
            return Ok(Trial { rank, mean_square: last.mean_square, base, made, ..best });
        }
        doublings = doublings.saturating_sub(TAKEN_BACK);
    }
    Ok(best)
}

/// The same with steps doubled so often, and the same origin.
fn coarser(header: &Header, doublings: u32) -> Header {
    let factor = (1u32 << doublings) as f32;
    Header {
        origin: header.origin.map(|k| k >> doublings),
        grid: factor * header.grid,
        step: factor * header.step,
        ..*header
    }
}

impl NormalMesh {
    /// Triangles of all levels that are not sound, as far as that is known.
    pub fn unsound(&self) -> usize {
        self.origin.as_ref().map_or(0, |origin| origin.unsound.iter().sum())
    }
}

fn header(bounds: [Vec3; 2], carried: &Carried, settings: &Settings) -> Result<Header, KernelError> {
    let size = diagonal(&bounds);
    let tolerance = settings.tolerance.unwrap_or(FINEST);
    let step = round_down(tolerance * size / ROUNDED_OFF);
    let grid = if settings.is_alone() { round_down(GRID_ALONE * tolerance * size) } else { 0.5 * step };
    if !grid.is_normal() || !step.is_normal() || size / f64::from(grid) > MOST_GRID_POINTS {
        return Err(KernelError::Extent { diagonal: size });
    }
    let farthest = bounds.iter().flatten().fold(0.0f64, |most, x| most.max(x.abs()));
    let far = farthest > FAR * size || farthest / f64::from(grid) > MOST_GRID_POINTS;
    // On the coarsest grid that may follow from this one.
    let cells = if settings.tolerance.is_some() { 1 } else { 1i64 << MOST_DOUBLINGS };
    let near = |x: f64| cells * (x / f64::from(grid) / cells as f64).round() as i64;
    let origin = if far { bounds[0].map(near) } else { [0; 3] };
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

fn in_order(
    base: Base,
    input: &Input<'_>,
    header: &Header,
    settings: &Settings,
) -> Result<Ordered, KernelError> {
    let positions = base.vertex_source.iter().map(|&v| on_grid(&input.points[v as usize], header)).collect();
    let channels = if header.channels == 0 {
        vec![]
    } else {
        let places = base.vertex_source.iter().map(|&v| &input.places[v as usize]);
        let channels = places.map(|place| input.carried.at(&input.surface, place));
        channels.map(|c| in_units(&c, &[0.0; 4], header)).collect()
    };
    let contents = contents::Base { positions, triangles: base.triangles.clone(), channels };
    let ordered = if settings.is_alone() {
        rounded_order(&contents, &base.vertex_source, input, header, settings.threads)?
    } else {
        canonical(&contents).map_err(KernelError::from)?
    };
    let base = base.reordered(&ordered.vertex_source, &ordered.triangle_source, &ordered.base.triangles);
    Ok(Ordered { base, contents: ordered.base })
}

/// The order of a mesh without levels, its vertices where they come nearest to the surface.
fn rounded_order(
    contents: &contents::Base,
    vertex_source: &[u32],
    input: &Input<'_>,
    header: &Header,
    threads: usize,
) -> Result<Canonical, KernelError> {
    let grid = f64::from(header.grid);
    let exact: Vec<Vec3> =
        vertex_source.iter().map(|&v| input.points[v as usize].map(|x| x / grid)).collect();
    let topology = Topology::new(exact.len(), contents.triangles.clone())?;
    let _reserve = Reserve::for_rows(input.samples.len())?;
    let samples = input.samples.scaled(1.0 / grid);
    let tolerance = if input.is_light { None } else { Some(1.0 / GRID_ALONE) };
    let (mut points, mut ordered) = (exact.clone(), Canonical::default());
    for _ in 0..ROUNDS {
        let mut rounding = Rounding::new(&topology, &exact, points, &samples, tolerance, threads);
        ordered =
            canonical_rounded(contents, &mut |v, bits| rounding.round(v, bits)).map_err(KernelError::from)?;
        points = rounding.into_points();
    }
    Ok(ordered)
}

/// What channels differ by from what is expected, in units.
fn in_units(channels: &[f64; 4], expected: &[f64; 4], header: &Header) -> [i32; 4] {
    std::array::from_fn(|i| {
        let used = i < usize::from(header.channels);
        if used { ((channels[i] - expected[i]) / f64::from(header.units[i])).round() as i32 } else { 0 }
    })
}

/// How places of vertices are sought, and from how many unsound triangles on nobody wants the result.
#[derive(Clone, Copy, Debug)]
struct Care {
    thorough: bool,
    most_unsound: usize,
}

/// The levels over a base, how far the finest is from the input, and base triangles with unsound parts, once for each of
/// these; nothing if there are too many.
fn levels_of(
    input: &Input<'_>,
    ordered: &Ordered,
    header: Header,
    settings: &Settings,
    care: Care,
    progress: &mut Progress,
) -> Result<Option<(NormalMesh, Distance, Vec<usize>)>, KernelError> {
    let Input { points, triangles, carried, surface, slots, places, .. } = input;
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
    let mut faulty = unsound_in_base(&first, &placed, &base.vertex_source, surface, settings.threads);
    let mut unsound = vec![faulty.len()];
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
        let mut found = search.refine();
        progress.check()?;
        let turned = unfold(&search, &mut found, care.thorough);
        progress.check()?;
        unsound.push(turned.len());
        if unsound.iter().sum::<usize>() > care.most_unsound {
            return Ok(None);
        }
        faulty.extend(turned.iter().map(|t| t >> (2 * number)));
        let rim = search.rim(&found);
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
        return levels_of(input, ordered, header, settings, care, progress);
    }
    let source = if settings.tolerance.is_some() { Source::Given } else { Source::Precision };
    let origin = Some(Origin {
        base_source: base.vertex_source.clone(),
        triangles: placed.places.iter().map(|place| surface.triangle(place.slot)).collect(),
        unsound,
        reached,
        tolerance: Tolerance { relative: settings.tolerance.unwrap_or(FINEST), source },
    });
    Ok(Some((NormalMesh { header, levels, steps, file: vec![], ends: vec![], origin }, last, faulty)))
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
