//! Bounds between two surfaces are never below brute force, for any triangles.

use crate::promises::common::{Noise, coloured, gallery, sheet};
use scanloom_kernels::base::errors::KernelError;
use scanloom_kernels::base::geometry::{nearest_on_triangle, position_of, triangle_distance2};
use scanloom_kernels::base::progress::{Progress, RunControl};
use scanloom_kernels::certify::{
    COLOR_SLACK, Certificate, Deviation, Options, Surface, Verdict, bound_whole, certify, certify_triangles,
    decide,
};

type Soup<const D: usize> = (Vec<[f64; D]>, Vec<[u32; 3]>);

fn bounds<const D: usize>(result: &Soup<D>, original: &Soup<D>, options: &Options) -> Certificate {
    let (result, original) = (surface(result).unwrap(), surface(original).unwrap());
    certify(&result, &original, options, &mut Progress::new(&RunControl::default())).unwrap()
}

fn surface<const D: usize>((points, triangles): &Soup<D>) -> Result<Surface, KernelError> {
    Surface::new(points, triangles, 2)
}

fn distance<const D: usize>(p: &[f64; 3], (points, triangles): &Soup<D>) -> f64 {
    let to = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| position_of(&points[v as usize]));
        triangle_distance2(p, [&a, &b, &c])
    };
    triangles.iter().map(to).fold(f64::INFINITY, f64::min).sqrt()
}

/// Pair every mesh of the gallery with a copy whose points are moved randomly.
fn pairs() -> Vec<(&'static str, Soup<6>, Soup<6>)> {
    let mut noise = Noise(11);
    let moved = |(name, points, triangles): (&'static str, Vec<[f64; 3]>, Vec<[u32; 3]>)| {
        let coloured: Vec<[f64; 6]> = coloured(&points, 0.0, 5);
        let shaken = coloured.iter().map(|p| p.map(|x| x + 0.3 * (noise.next() - 0.5))).collect();
        (name, (coloured, triangles.clone()), (shaken, triangles))
    };
    gallery().into_iter().map(moved).collect()
}

#[test]
fn no_point_is_farther_than_its_triangles_bound() {
    let mut noise = Noise(4);
    for (name, result, original) in pairs() {
        let found = bounds(&result, &original, &Options::default());
        for (mesh, other, of) in [(&result, &original, &found.result), (&original, &result, &found.original)]
        {
            for (t, corners) in mesh.1.iter().enumerate() {
                let corners = corners.map(|v| position_of(&mesh.0[v as usize]));
                for _ in 0..20 {
                    let (u, v) = (noise.next(), noise.next());
                    let weights =
                        if u + v < 1.0 { [u, v, 1.0 - u - v] } else { [1.0 - u, 1.0 - v, u + v - 1.0] };
                    let p = [0, 1, 2].map(|i| (0..3).map(|k| weights[k] * corners[k][i]).sum());
                    let d = distance(&p, other);
                    assert!(d <= of[t].shape, "{name} {t}: {d} > {:?}", of[t]);
                    assert!(of[t].shape <= found.bound.shape && of[t].color <= found.bound.color);
                }
            }
        }
        assert!(found.attained.is_within(found.bound), "{name}");
        assert!(found.bound.shape <= 1.06 * found.attained.shape + 3.0 * found.slack, "{name}");
    }
}

#[test]
fn selected_triangles_are_bounded_and_others_are_not() {
    let nothing = Deviation { shape: 0.0, color: 1.0 / 512.0 };
    for (name, result, original) in pairs() {
        let surfaces = [&result, &original].map(|mesh| surface(mesh).unwrap());
        let control = RunControl::default();
        let some = |asked: [&[u32]; 2]| {
            let mut progress = Progress::new(&control);
            certify_triangles(&surfaces[0], &surfaces[1], &Options::default(), asked, &mut progress).unwrap()
        };
        let all = bounds(&result, &original, &Options::default());
        let numbers = [&result, &original].map(|mesh| (0..mesh.1.len() as u32).collect::<Vec<_>>());
        let same = some([&numbers[0], &numbers[1]]);
        assert_eq!((&same.result, &same.original, same.bound), (&all.result, &all.original, all.bound));

        let one = result.1.len() / 2;
        let found = some([&[one as u32], &[0]]);
        let most = found.from_result[one].max(found.original[0]);
        assert_eq!(found.bound, most, "{name}");
        for (t, own) in found.from_result.iter().enumerate() {
            assert_eq!(t != one, *own == nothing, "{name} {t}");
            assert!(found.result[t].is_within(most) && own.is_within(found.result[t]), "{name} {t}");
        }
        assert!(found.original[1..].iter().all(|other| *other == nothing), "{name}");
        // Deviation from the one triangle asked for is attributed to some triangle of the result.
        let fallen = found.result.iter().fold(Deviation::default(), |most, d| most.max(*d));
        assert!(found.original[0].shape <= fallen.shape, "{name}");
        for (mesh, other, t, of) in
            [(&result, &original, one, found.from_result[one]), (&original, &result, 0, found.original[0])]
        {
            let corners = mesh.1[t].map(|v| position_of(&mesh.0[v as usize]));
            let middle = [0, 1, 2].map(|i| corners.iter().map(|c| c[i]).sum::<f64>() / 3.0);
            assert!(corners.iter().chain([&middle]).all(|p| distance(p, other) <= of.shape), "{name}");
        }
    }
}

#[test]
fn more_effort_decides_what_few_pieces_leave_open() {
    let mut open = [0; 2];
    for (_, result, original) in pairs() {
        let surfaces = [&result, &original].map(|mesh| surface(mesh).unwrap());
        let attained = bounds(&result, &original, &Options::default()).attained;
        let limit = Deviation { shape: 1.002 * attained.shape, color: 1.002 * attained.color };
        let numbers = [&result, &original].map(|mesh| (0..mesh.1.len() as u32).collect::<Vec<_>>());
        let control = RunControl::default();
        let decided = |effort| {
            let options = Options { effort, limit: Some(limit), ..Options::default() };
            let asked = [&numbers[0][..], &numbers[1][..]];
            let mut progress = Progress::new(&control);
            decide(&surfaces[0], &surfaces[1], &options, asked, &mut progress).unwrap().concat()
        };
        let [few, more] = [0.0, 8.0].map(decided);
        assert!(few.iter().zip(&more).all(|(few, more)| more.bound.is_within(few.bound)));
        // Neither proven nor found to exceed the limit.
        let is_open = |v: &&Verdict| !v.bound.is_within(limit) && v.attained.is_within(limit);
        open = [open[0] + few.iter().filter(is_open).count(), open[1] + more.iter().filter(is_open).count()];
    }
    assert!(2 * open[1] < open[0], "{open:?}");
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    for (name, result, original) in pairs() {
        let with = |threads| bounds(&result, &original, &Options { threads, ..Options::default() });
        let (one, three) = (with(1), with(3));
        assert_eq!(
            (one.result, one.original, one.pieces),
            (three.result, three.original, three.pieces),
            "{name}"
        );
        assert_eq!((one.bound, one.attained), (three.bound, three.attained), "{name}");
    }
}

#[test]
fn a_decision_agrees_with_the_bounds() {
    for (name, result, original) in pairs() {
        let full = bounds(&result, &original, &Options::default());
        let passes = |limit: Deviation| {
            let found = bounds(&result, &original, &Options { limit: Some(limit), ..Options::default() });
            !found.bound.is_within(limit)
        };
        let times = |by: f64| Deviation { shape: by * full.bound.shape, color: by * full.bound.color };
        assert!(!passes(times(1.01)), "{name}");
        assert!(passes(Deviation { shape: 0.9 * full.attained.shape, color: f64::INFINITY }), "{name}");
    }
}

#[test]
fn bound_of_the_whole_is_valid_and_tight() {
    let all = |result: &Soup<6>, original: &Soup<6>, options: &Options| {
        let (result, original) = (surface(result).unwrap(), surface(original).unwrap());
        bound_whole(&result, &original, options, &mut Progress::new(&RunControl::default())).unwrap()
    };
    for (name, result, original) in pairs() {
        let absolute_tolerance = Deviation::default();
        for tolerance in [0.05, 0.2].map(|t| Deviation { shape: t, color: t }) {
            let options = Options { tolerance, absolute_tolerance, ..Options::default() };
            let (found, full) =
                (all(&result, &original, &options), bounds(&result, &original, &Options::default()));
            assert!(full.attained.is_within(found.bound), "{name} {found:?} {:?}", full.attained);
            assert!(found.attained.is_within(found.bound), "{name}");
            assert!(found.attained.is_within(full.bound), "{name}");
            let enough = options.sufficient_bound(found.attained);
            assert!(found.bound.shape <= enough.shape + 3.0 * full.slack, "{name}");
            assert!(found.bound.color <= enough.color + COLOR_SLACK, "{name} {found:?}");
        }
    }
    let nothing = (vec![], vec![]);
    let (name, soup, _) = pairs().remove(0);
    let one_sided = all(&nothing, &soup, &Options::default());
    assert_eq!(one_sided.bound.shape, f64::INFINITY, "{name}");
    assert_eq!(all(&nothing, &nothing, &Options::default()), Verdict::default());
}

#[test]
fn decisions_do_not_depend_on_the_selection() {
    for (name, result, original) in pairs() {
        let full = bounds(&result, &original, &Options::default());
        for (shape, color) in [(0.2, 0.2), (0.5, 0.7), (0.9, f64::INFINITY), (1.01, 1.01)] {
            let limit = Deviation { shape: shape * full.bound.shape, color: color * full.bound.color };
            let options = Options { limit: Some(limit), ..Options::default() };
            let whole = bounds(&result, &original, &options);
            let surfaces = [surface(&result).unwrap(), surface(&original).unwrap()];
            let ask = |asked: &[Vec<u32>; 2], threads| {
                let options = Options { threads, ..options };
                let control = RunControl::default();
                let [one, other] = &surfaces;
                let asked = asked.each_ref().map(Vec::as_slice);
                decide(one, other, &options, asked, &mut Progress::new(&control)).unwrap()
            };
            let everything = [&result, &original].map(|(_, triangles)| (0..triangles.len() as u32).collect());
            let all = ask(&everything, 1);
            assert_eq!(all, ask(&everything, 3), "{name}");
            for (found, bounds) in all.iter().zip([&whole.from_result, &whole.original]) {
                for (verdict, bound) in found.iter().zip(bounds) {
                    assert_eq!(verdict.bound.is_within(limit), bound.is_within(limit), "{name}");
                    assert!(verdict.bound.shape >= limit.shape && verdict.attained.is_within(whole.attained));
                }
            }
            for step in [2, 7] {
                let some: [Vec<u32>; 2] =
                    everything.each_ref().map(|all| all.iter().rev().step_by(step).copied().collect());
                let expected: [Vec<Verdict>; 2] =
                    [0, 1].map(|i| some[i].iter().map(|&t| all[i][t as usize]).collect());
                assert_eq!(ask(&some, 2), expected, "{name}");
            }
        }
    }
}

/// Build a bumpy sheet over 12 × 12 with colours that depend on the position.
fn bumps(squares: u32, noise: &mut Noise, by: f64) -> Soup<6> {
    let (points, triangles) = sheet(squares, squares);
    let step = 12.0 / f64::from(squares);
    let points = points.iter().map(|p| {
        let (x, y) = (step * p[0], step * p[1]);
        let mut shaken = |at: f64| at + by * (noise.next() - 0.5);
        let z = 0.4 * (0.9 * x).sin() * (0.7 * y).cos();
        let colors = [120.0 + 60.0 * (0.5 * x).sin(), 10.0 * x, 9.0 * y + 4.0 * x];
        let at = [shaken(x), shaken(y), shaken(z)];
        [at[0], at[1], at[2], colors[0] + 20.0 * by * noise.next(), colors[1], colors[2]]
    });
    (points.collect(), triangles)
}

/// Interpolate the corners of a triangle.
fn blended(weights: [f64; 3], corners: [[f64; 6]; 3]) -> [f64; 6] {
    std::array::from_fn(|i| (0..3).map(|k| weights[k] * corners[k][i]).sum())
}

/// Measure the distance to a triangle soup, and the difference to its colour.
fn deviation(p: &[f64; 6], (points, triangles): &Soup<6>) -> Deviation {
    let mut nearest = Deviation { shape: f64::INFINITY, color: 0.0 };
    for t in triangles {
        let corners = t.map(|v| points[v as usize]);
        let at = corners.map(|c| position_of(&c));
        let (weights, distance2) = nearest_on_triangle(&position_of(p), at.each_ref());
        if distance2 < nearest.shape {
            let there = blended(weights, corners);
            let color = (3..6).map(|i| (p[i] - there[i]).powi(2)).sum::<f64>().sqrt();
            nearest = Deviation { shape: distance2, color };
        }
    }
    Deviation { shape: nearest.shape.sqrt(), ..nearest }
}

/// Large triangles against many small ones and vice versa, with a hole, and with a tear along an edge.
#[test]
fn no_point_exceeds_a_proven_limit() {
    let mut noise = Noise(8);
    for (squares, by) in [(2, 0.0), (3, 0.1), (4, 0.3), (12, 0.05)] {
        let original = bumps(12, &mut noise, by);
        let mut holed = original.clone();
        holed.1.drain(150..154);
        let mut torn = original.clone();
        for t in &mut torn.1[100..120] {
            *t = t.map(|v| {
                torn.0.push(torn.0[v as usize].map(|x| x + 0.02));
                torn.0.len() as u32 - 1
            });
        }
        let result = bumps(squares, &mut noise, by);
        for original in [&original, &holed, &torn] {
            let full = bounds(&result, original, &Options::default());
            for share in [0.2, 0.5, 0.8] {
                let limit = Deviation { shape: share * full.bound.shape, color: share * full.bound.color };
                let found = bounds(&result, original, &Options { limit: Some(limit), ..Options::default() });
                let mut proven = 0;
                for (mesh, other, of) in
                    [(&result, original, &found.from_result), (original, &result, &found.original)]
                {
                    for (t, _) in of.iter().enumerate().filter(|(_, bound)| bound.is_within(limit)) {
                        proven += 1;
                        for i in 0..4 {
                            let (u, v) = (noise.next(), noise.next());
                            let inside = [u * (1.0 - v), u * v, 1.0 - u];
                            let weights = if i == 0 { [u, 1.0 - u, 0.0] } else { inside };
                            let p = blended(weights, mesh.1[t].map(|v| mesh.0[v as usize]));
                            let here = deviation(&p, other);
                            assert!(
                                here.is_within(limit),
                                "{squares} {by} {share} {t}: {here:?} > {limit:?}"
                            );
                        }
                    }
                }
                assert!(share < 0.5 || proven > 20, "{squares} {by} {share}: {proven}");
            }
        }
    }
}

/// A square of the sheet is missing; its centre is half a square from the rest.
#[test]
fn hole_below_a_large_triangle_is_detected() {
    let (points, mut triangles) = sheet(12, 12);
    let corner = |x: f64, y: f64| [x, y, 0.1];
    let result: Soup<3> = (
        vec![corner(0.0, 0.0), corner(12.0, 0.0), corner(12.0, 12.0), corner(0.0, 12.0)],
        vec![[0, 1, 2], [0, 2, 3]],
    );
    // Column 8 of row 3 is below the first triangle.
    triangles.drain(2 * (3 * 12 + 8)..2 * (3 * 12 + 9));
    let original = (points, triangles);
    for (limit, proven) in [(0.45, [false, true]), (0.55, [true, true]), (0.09, [false, false])] {
        let limit = Deviation { shape: limit, color: f64::INFINITY };
        let found = bounds(&result, &original, &Options { limit: Some(limit), ..Options::default() });
        assert_eq!([0, 1].map(|t| found.from_result[t].is_within(limit)), proven, "{limit:?}");
    }
}

#[test]
fn every_triangle_whose_box_meets_is_visited() {
    let (points, triangles) = sheet(9, 4);
    let one = Surface::new(&points, &triangles, 1).unwrap();
    let (low, high) = ([2.0, 1.5, -1.0], [4.5, 1.5, 1.0]);
    let mut found = vec![];
    one.visit_triangles_in_box(&low, &high, |t| found.push(t));
    found.sort_unstable();
    let meets = |corners: &[u32; 3]| {
        (0..3).all(|i| {
            let at = corners.map(|v| points[v as usize][i]);
            at.iter().any(|x| *x <= high[i]) && at.iter().any(|x| *x >= low[i])
        })
    };
    let expected: Vec<u32> = (0..triangles.len() as u32).filter(|&t| meets(&triangles[t as usize])).collect();
    assert_eq!(found, expected);
}

/// Scaling by a power of two is exact, so the pieces must be the same.
#[test]
fn the_unit_of_length_does_not_matter() {
    for (name, result, original) in pairs() {
        let scaled = |s: f64| {
            let of = |(points, triangles): &Soup<6>| {
                let points = points.iter().map(|p| [p[0] * s, p[1] * s, p[2] * s, p[3], p[4], p[5]]);
                (points.collect(), triangles.clone())
            };
            bounds(&of(&result), &of(&original), &Options::default())
        };
        let here = scaled(1.0);
        for s in [2f64.powi(-40), 2f64.powi(40)] {
            let there = scaled(s);
            assert_eq!(
                (there.bound.shape / s, there.bound.color),
                (here.bound.shape, here.bound.color),
                "{name}"
            );
            assert_eq!(there.pieces, here.pieces, "{name}");
        }
    }
}

#[test]
fn missing_part_is_attributed_to_adjacent_triangles() {
    let (points, triangles) = sheet(6, 1);
    let left = triangles[..6].to_vec();
    let found = bounds(&(points.clone(), left), &(points, triangles), &Options::default());
    // Half of the sheet is missing: its far end is three squares from the last edge.
    assert!((3.0..3.0 * 1.06).contains(&found.bound.shape), "{:?}", found.bound);
    assert!(found.result[0].shape < 1e-3);
    assert!(found.original[..6].iter().all(|d| d.shape < 1e-3));
}

#[test]
fn invalid_indices_and_numbers_are_reported() {
    let (mut points, mut triangles) = sheet(1, 1);
    triangles[1][2] = 9;
    let wrong = KernelError::IndexOutOfRange { triangle: 1, vertex: 9, vertices: 4 };
    assert_eq!(Surface::new(&points, &triangles, 1).unwrap_err(), wrong);
    points[2][1] = f64::NAN;
    assert_eq!(Surface::new(&points, &triangles, 1).unwrap_err(), KernelError::NotFinite { vertex: 2 });
}

#[test]
fn the_caller_can_stop_the_work() {
    let soup = sheet(300, 200);
    let one = surface(&soup).unwrap();
    let control = RunControl::default();
    control.abort();
    let stopped = certify(&one, &one, &Options::default(), &mut Progress::new(&control));
    assert!(matches!(stopped, Err(KernelError::Interrupted)));
}

#[test]
fn empty_surface_is_infinitely_far() {
    let (soup, nothing): (Soup<3>, Soup<3>) = (sheet(1, 1), (vec![], vec![]));
    let found = bounds(&nothing, &soup, &Options::default());
    assert!(found.original.iter().all(|d| d.shape == f64::INFINITY));
    assert_eq!(bounds(&nothing, &nothing, &Options::default()).bound.shape, 0.0);
}
