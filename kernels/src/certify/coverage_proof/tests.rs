//! The fast proof of colours against brute force, for target triangles larger or smaller than the proven
//! triangle.

use super::super::piece_bounds::AttributionMode;
use super::super::surface::Surface;
use super::*;
use crate::base::geometry::{add_scaled, cross, dot, midpoint, nearest_on_triangle, norm2, sub};

type Triangle = [Corner; 3];

/// Deterministic pseudo-random numbers from −1 to 1.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn vector(&mut self, size: f64) -> Vec3 {
        [0, 1, 2].map(|_| size * self.next())
    }

    fn weights(&mut self) -> Vec3 {
        let parts = [0, 1, 2].map(|_| self.next().abs());
        parts.map(|x| x / parts.iter().sum::<f64>())
    }

    /// Create a random triangle with sides of about 1.
    ///
    /// In one case of three, its colour changes along one direction only.
    fn large(&mut self) -> Triangle {
        let (across, color, plain) = (self.vector(1.0), self.vector(100.0), self.next() < -0.33);
        [0, 1, 2].map(|_| {
            let at = self.vector(1.0);
            let color = if plain { color.map(|x| x * dot(&across, &at)) } else { self.vector(100.0) };
            Corner { at, color: color.map(|x| f64::from(x as f32)), reach: 0.0 }
        })
    }

    /// Create a random small triangle above or next to `large`.
    ///
    /// Its colours continue the large one, plus noise of size `paint`.
    fn small_near(&mut self, large: &Triangle, size: f64, paint: f64) -> Triangle {
        let [places, colors] = [large.map(|c| c.at), large.map(|c| c.color)];
        let facet = Facet::new(&places).unwrap();
        let place = add_scaled(&weighted_sum(&self.weights(), &places), 0.3, &self.vector(1.0));
        [0, 1, 2].map(|_| {
            let at = add_scaled(&place, size, &self.vector(1.0));
            let color = add_scaled(&weighted_sum(&facet.weights(&at), &colors), paint, &self.vector(1.0));
            Corner { at, color, reach: 0.0 }
        })
    }

    /// Build the worst case for [`bound_color_to_larger`]: a large triangle, a small one, and the slack.
    ///
    /// The vector from the large triangle to the small one, and the slack, both follow the colour gradient.
    /// `share` is the distance outside the large triangle relative to its height; if negative, the small
    /// triangle is above it.
    fn along_the_gradient(&mut self, share: f64) -> (Triangle, Triangle, f64) {
        // An isosceles triangle whose base has a constant colour.
        let [a, b, tip] = self.large();
        let (along, middle) = (sub(&b.at, &a.at), midpoint(&a.at, &b.at));
        let down = sub(&middle, &tip.at);
        let down = add_scaled(&down, -dot(&down, &along) / norm2(&along), &along);
        let large = [a, Corner { color: a.color, ..b }, Corner { at: sub(&middle, &down), ..tip }];
        let (places, colors) = (large.map(|c| c.at), large.map(|c| c.color));
        let facet = Facet::new(&places).unwrap();
        let height = norm2(&down).sqrt();
        // Above the triangle, the height is no distance along its plane.
        let lift = if share < 0.0 { 0.3 } else { 0.0 } / norm2(&along).sqrt();
        let place = add_scaled(&add_scaled(&middle, share, &down), lift, &cross(&along, &down));
        let (drop, own) = (sub(&colors[0], &colors[2]), self.next().abs());
        let small = [0, 1, 2].map(|_| {
            let at = add_scaled(&place, 1e-6 * height, &self.vector(1.0));
            let color = add_scaled(&weighted_sum(&facet.weights(&at), &colors), own, &drop);
            Corner { at, color, reach: 0.0 }
        });
        (large, small, 0.1 * height)
    }

    /// Build the worst case for [`View::bound_color_to_smaller`]: a large triangle, a smaller one, a point, and the
    /// slack.
    ///
    /// The tip of the smaller triangle points along the colour gradient of the large one, and the point is
    /// beyond the tip. `height` is the height of the smaller triangle; negative below the large one.
    fn beyond_the_tip(&mut self, height: f64, own: f64) -> (Triangle, Triangle, Corner, f64) {
        let (tip, unit) = (self.vector(1.0), |v: Vec3| v.map(|x| x / norm2(&v).sqrt()));
        let down = unit(self.vector(1.0));
        let along = unit(cross(&down, &self.vector(1.0)));
        let up = cross(&along, &down);
        let (color, drop) = (self.vector(100.0), self.vector(100.0));
        let corner = |x: f64, y: f64, z: f64, more: f64| {
            let at = add_scaled(&add_scaled(&add_scaled(&tip, x, &along), y, &down), z, &up);
            Corner { at, color: add_scaled(&color, y + more, &drop), reach: 0.0 }
        };
        let large = [corner(0.0, 0.0, 0.0, 0.0), corner(1.0, 1.0, 0.0, 0.0), corner(-1.0, 1.0, 0.0, 0.0)];
        // Thin, so that the direction to each corner is the direction of the gradient.
        let small = [(0.0, 0.5), (1e-4, 0.4), (-1e-4, 0.4)].map(|(x, y)| corner(x, y, height, -own));
        (large, small, corner(0.0, 0.5 + 0.25, 0.0, 0.0), 0.05)
    }
}

fn surface(triangles: &[Triangle]) -> Surface {
    let point = |c: &Corner| [c.at[0], c.at[1], c.at[2], c.color[0], c.color[1], c.color[2]];
    let points: Vec<_> = triangles.iter().flatten().map(point).collect();
    let corners: Vec<_> = (0..triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    Surface::new(&points, &corners, 1).unwrap()
}

fn against(target: &Surface, slack: f64) -> BoundContext<'_> {
    BoundContext {
        target,
        slack,
        color_range: f64::INFINITY,
        with_color: true,
        attribution: AttributionMode::None,
    }
}

/// Test if the colours of all of `triangle` are proven to be within `level`.
fn proves(against: &BoundContext<'_>, triangle: &Triangle, level: f64, cover: &mut CoverageProof) -> bool {
    let near = triangle.map(|c| against.target.nearest(&c.at, 0));
    let triangle = [0, 1, 2].map(|i| Corner { reach: near[i].distance, ..triangle[i] });
    cover.proves(against, &triangle, near.map(|f| f.slot), Deviation { shape: 9.0, color: level }, None)
}

/// Sample the corners and random points of a triangle: position and colour.
fn samples(triangle: &Triangle, noise: &mut Noise) -> Vec<(Vec3, Vec3)> {
    let corners = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let weights = corners.into_iter().chain((0..12).map(|_| noise.weights()));
    let of = |w: &Vec3, values: [Vec3; 3]| weighted_sum(w, &values);
    weights.map(|w| (of(&w, triangle.map(|c| c.at)), of(&w, triangle.map(|c| c.color)))).collect()
}

/// Compute the brute-force distance to a triangle, and the largest colour difference near the foot.
///
/// Colours are compared within the slack of the nearest point, on the lines to the corners only.
fn brute_force_deviation(at: &Vec3, color: &Vec3, triangle: &Triangle, slack: f64) -> (f64, f64) {
    let [places, colors] = [triangle.map(|c| c.at), triangle.map(|c| c.color)];
    let (weights, distance2) = nearest_on_triangle(at, places.each_ref());
    let (place, there) = (weighted_sum(&weights, &places), weighted_sum(&weights, &colors));
    let most = (0..3).fold(difference(color, &there), |most, k| {
        let length = difference(&places[k], &place);
        let share = if length > slack { slack / length } else { 1.0 };
        most.max(difference(color, &add_scaled(&there, share, &sub(&colors[k], &there))))
    });
    (distance2.sqrt(), most)
}

#[test]
fn color_bound_to_larger_triangle_is_never_exceeded() {
    let mut noise = Noise(3);
    // Test cases by the number of corners of the small triangle that project outside the large one.
    let mut cases = [0; 4];
    for case in 0..4000 {
        let large = noise.large();
        let size = [0.01, 0.1, 0.4][case % 3];
        let paint = [0.0, 1.0, 50.0][case / 3 % 3];
        let small = noise.small_near(&large, size, paint);
        let slack = [1e-9, 1e-3, 0.05][case / 9 % 3];
        let target = surface(&[large]);
        let samples = samples(&small, &mut noise);
        let found = samples.iter().map(|(at, color)| brute_force_deviation(at, color, &large, slack));
        let (far, truth) = found.fold((0.0f64, 0.0f64), |most, f| (most.0.max(f.0), most.1.max(f.1)));
        let facet = Facet::new(&large.map(|c| c.at)).unwrap();
        let beside = small.iter().filter(|c| facet.weights(&c.at).iter().any(|&w| w < 0.0)).count();
        cases[beside] += 1;
        // The smallest `around` that covers all of the small triangle.
        let said = bound_color_to_larger(&against(&target, slack), &small, 0, far).unwrap();
        assert!(truth <= said + 1e-9 * (1.0 + said), "{case}, {beside} beside: {truth} > {said}");
    }
    assert!(cases.iter().all(|&count| count > 100), "{cases:?}");
}

#[test]
fn color_bound_to_larger_triangle_is_tight() {
    let mut noise = Noise(5);
    for case in 0..200 {
        let (large, small, slack) = noise.along_the_gradient([-0.4, 0.01, 0.2, 1.0][case % 4]);
        let (far, truth) = brute_force_deviation(&small[0].at, &small[0].color, &large, slack);
        let target = surface(&[large]);
        let said = bound_color_to_larger(&against(&target, slack), &small, 0, far).unwrap();
        assert!((said - truth).abs() <= 1e-4 * truth, "{case}: {said}, not {truth}");
    }
}

#[test]
fn larger_triangles_within_the_slack_count() {
    let mut noise = Noise(6);
    for case in 0..200 {
        let (large, small, slack) = noise.along_the_gradient([0.2, 1.0][case % 2]);
        let Corner { at, color, .. } = small[0];
        let (far, truth) = brute_force_deviation(&at, &color, &large, slack);
        // The nearest triangle has the right colour.
        let [a, b, c] = large.map(|c| c.at);
        let normal = cross(&sub(&b, &a), &sub(&c, &a));
        let floor = add_scaled(&at, (far - 0.99 * slack) / norm2(&normal).sqrt(), &normal);
        let nearest = [sub(&b, &a), sub(&c, &b), sub(&a, &c)].map(|side| Corner {
            at: add_scaled(&floor, 1.0, &side),
            color,
            reach: 0.0,
        });
        let target = surface(&[large, nearest]);
        let against = against(&target, slack);
        let within = |level| proves(&against, &small, level, &mut CoverageProof::default());
        assert!(!within(0.999 * truth) && within(1.01 * truth), "{case}: {truth}");
    }
}

#[test]
fn color_bound_to_smaller_triangle_is_never_exceeded() {
    let mut noise = Noise(8);
    // Number of compared points: feet of points of the small triangle, and points around the feet.
    let mut compared = [0; 2];
    for case in 0..4000 {
        let large = noise.large();
        let small = noise.small_near(&large, [0.01, 0.1, 0.4][case % 3], [0.0, 1.0, 50.0][case / 3 % 3]);
        let slack = [1e-9, 1e-3, 0.05][case / 9 % 3];
        let Some(view) = TriangleFrame::new(&large) else { continue };
        let target = surface(&[small]);
        // The target stores colours in single precision.
        let colors = target.corner_colors(0);
        let small = [0, 1, 2].map(|i| Corner { color: colors[i], ..small[i] });
        let seen = ProjectedTriangle { slot: 0, points: small.map(|c| view.project(&c.at)) };
        let corners = large.map(|c| c.at);
        let facet = Facet::new(&corners).unwrap();
        let height = small.iter().map(|c| facet.height(&c.at).abs()).fold(0.0, f64::max);
        let around = height * [0.5, 1.0, 1.01, 1.5][case / 27 % 4] + slack;
        let mut truth = 0.0f64;
        for (at, _) in samples(&small, &mut noise) {
            for reach in [0.0, 0.3, 1.0] {
                // A random direction from the foot.
                let weights = facet.weights(&add_scaled(&at, reach * around, &noise.vector(1.0)));
                if weights.iter().all(|&w| w >= 0.0) {
                    let (x, color) =
                        (weighted_sum(&weights, &corners), weighted_sum(&weights, &large.map(|c| c.color)));
                    let (far, most) = brute_force_deviation(&x, &color, &small, slack);
                    if far <= around {
                        truth = truth.max(most);
                        compared[usize::from(reach > 0.0)] += 1;
                    }
                }
            }
        }
        let said = view.bound_color_to_smaller(&against(&target, slack), &seen, around);
        assert!(truth <= said + 1e-9 * (1.0 + said), "{case}: {truth} > {said}");
    }
    assert!(compared.iter().all(|&count| count > 5000), "{compared:?}");
}

#[test]
fn color_bound_to_smaller_triangle_is_tight() {
    let mut noise = Noise(9);
    for case in 0..200 {
        let (height, own) = ([0.0, 0.1, -0.1, 0.4, -0.4][case % 5], [0.0, 0.7][case / 5 % 2]);
        let (large, small, beyond, slack) = noise.beyond_the_tip(height, own);
        let (far, truth) = brute_force_deviation(&beyond.at, &beyond.color, &small, slack);
        let (view, target) = (TriangleFrame::new(&large).unwrap(), surface(&[small]));
        let seen = ProjectedTriangle { slot: 0, points: small.map(|c| view.project(&c.at)) };
        let said = view.bound_color_to_smaller(&against(&target, slack), &seen, far);
        assert!((said - truth).abs() <= 1e-4 * truth, "{case}: {said}, not {truth}");
    }
}

#[test]
fn intersecting_triangle_has_full_distance_along_the_plane() {
    let mut noise = Noise(10);
    for case in 0..100 {
        let (large, mut small, ..) = noise.beyond_the_tip(0.0, 0.3);
        let view = TriangleFrame::new(&large).unwrap();
        // Only the corners far from the tip leave the plane, to both sides or to one.
        let lift = [0.1, -0.1][case % 2];
        small[1].at = add_scaled(&small[1].at, lift, &view.axes[2]);
        small[2].at = add_scaled(&small[2].at, if case % 4 < 2 { -lift } else { lift }, &view.axes[2]);
        let target = surface(&[small]);
        let seen = ProjectedTriangle { slot: 0, points: small.map(|c| view.project(&c.at)) };
        let drop = difference(&large[1].color, &large[0].color);
        let said = view.bound_color_to_smaller(&against(&target, 0.05), &seen, 0.25);
        let truth = (0.3 + 0.25 + 0.05) * drop;
        assert!((said - truth).abs() <= 1e-4 * truth, "{case}: {said}, not {truth}");
    }
}

#[test]
fn smaller_triangles_within_the_slack_count() {
    let mut noise = Noise(13);
    for case in 0..200 {
        let (near, own) = (0.3, [0.0, 0.7][case % 2]);
        let (large, small, _, slack) = noise.beyond_the_tip(near + 0.025, own);
        // The nearest triangle has the right colour, and is so large that it is below all of the other one.
        let view = TriangleFrame::new(&large).unwrap();
        let middle = Polygon::new(large).centre().0;
        let floor = large.map(|c| {
            let at = add_scaled(&middle.at, 3.0, &sub(&c.at, &middle.at));
            let color = add_scaled(&middle.color, 3.0, &sub(&c.color, &middle.color));
            Corner { at: add_scaled(&at, -near, &view.axes[2]), color, reach: 0.0 }
        });
        let target = surface(&[small, floor]);
        let against = against(&target, slack);
        let drop = difference(&large[1].color, &large[0].color);
        let along = ((near + slack).powi(2) - (near + slack / 2.0).powi(2)).sqrt();
        let truth = (own + along + slack) * drop;
        let within = |level| proves(&against, &large, level, &mut CoverageProof::default());
        assert!(!within(0.999 * truth) && within(1.01 * truth), "{case}: {truth}");
    }
}

/// Compute the largest colour difference between points and their nearest triangles by brute force.
///
/// All triangles within the slack of the nearest one count.
fn greatest_difference(
    places: impl IntoIterator<Item = (Vec3, Vec3)>,
    triangles: &[Triangle],
    slack: f64,
) -> f64 {
    let mut truth = 0.0;
    for (at, color) in places {
        let found: Vec<_> =
            triangles.iter().map(|triangle| brute_force_deviation(&at, &color, triangle, slack)).collect();
        let least = found.iter().map(|f| f.0).fold(f64::INFINITY, f64::min);
        truth = found.iter().filter(|f| f.0 <= least + slack).map(|f| f.1).fold(truth, f64::max);
    }
    truth
}

/// Test if 1.5 × `truth` is proven; assert that less than `truth` is not.
fn proves_no_less(
    against: &BoundContext<'_>,
    triangle: &Triangle,
    truth: f64,
    cover: &mut CoverageProof,
) -> bool {
    assert!(!proves(against, triangle, 0.999 * truth, cover), "not within {truth}");
    proves(against, triangle, 1.5 * truth + 1.0, cover)
}

#[test]
fn excess_color_among_smaller_triangles_is_never_proven() {
    let mut noise = Noise(12);
    let (mut proven, mut cover) = (0, CoverageProof::default());
    for case in 0..2000 {
        let large = noise.large();
        let size = [0.01, 0.1][case % 2];
        let small = [0; 3].map(|_| noise.small_near(&large, size, [0.0, 1.0, 50.0][case / 2 % 3]));
        let slack = [1e-9, 1e-3, 0.05][case / 6 % 3];
        let target = surface(&small);
        let corners = large.map(|c| c.at);
        let facet = Facet::new(&corners).unwrap();
        let feet = small.iter().flat_map(|t| samples(t, &mut noise)).map(|(at, _)| facet.weights(&at));
        let under = feet.filter(|weights| weights.iter().all(|&w| w >= 0.0));
        let at_feet: Vec<_> = under
            .map(|weights| {
                (weighted_sum(&weights, &corners), weighted_sum(&weights, &large.map(|c| c.color)))
            })
            .collect();
        let places = samples(&large, &mut noise).into_iter().chain(at_feet);
        let truth = greatest_difference(places, &small, slack);
        let against = against(&target, slack);
        proven += usize::from(proves_no_less(&against, &large, truth, &mut cover));
    }
    assert!(proven > 500, "{proven}");
}

#[test]
fn excess_color_among_larger_triangles_is_never_proven() {
    let mut noise = Noise(7);
    let (mut proven, mut cover) = (0, CoverageProof::default());
    for case in 0..2000 {
        let large = [0; 3].map(|_| noise.large());
        let small = noise.small_near(&large[0], [0.01, 0.1][case % 2], [0.0, 1.0, 50.0][case / 2 % 3]);
        let slack = [1e-9, 1e-3, 0.05][case / 6 % 3];
        let truth = greatest_difference(samples(&small, &mut noise), &large, slack);
        let target = surface(&large);
        let against = against(&target, slack);
        proven += usize::from(proves_no_less(&against, &small, truth, &mut cover));
    }
    assert!(proven > 500, "{proven}");
}

#[test]
fn point_triangle_has_all_its_colors_at_one_point() {
    let corner = |x: f64, y: f64, z: f64, color: f64| Corner { at: [x, y, z], color: [color; 3], reach: 0.0 };
    let floor = |z: f64| [corner(0.0, 0.0, z, 0.0), corner(1.0, 0.0, z, 0.0), corner(0.0, 1.0, z, 0.0)];
    let point = [0.0, 100.0, 200.0].map(|color| corner(0.3, 0.3, 0.0, color));
    let target = surface(&[floor(0.0), point]);
    let against = against(&target, 1e-6);
    let truth = 200.0 * 3f64.sqrt();
    let within = |level| proves(&against, &floor(0.1), level, &mut CoverageProof::default());
    assert!(!within(0.999 * truth) && within(1.01 * truth));
}

/// Build a bumpy sheet of `squares` × `squares` over a triangle and its surroundings.
///
/// Heights vary by `rough`; colours follow the triangle plus noise of size `paint`.
fn sheet(triangle: &Triangle, squares: usize, rough: f64, paint: f64, noise: &mut Noise) -> Vec<[Corner; 3]> {
    let view = TriangleFrame::new(triangle).unwrap();
    let [low, high] = [f64::min, f64::max].map(|pick| {
        [0, 1].map(|i| view.corners[1..].iter().fold(view.corners[0][i], |m, corner| pick(m, corner[i])))
    });
    let places = (0..=squares).flat_map(|j| (0..=squares).map(move |i| [i, j]));
    let corners: Vec<Corner> = places
        .map(|place| {
            let at = [0, 1].map(|k| {
                let share = 1.4 * place[k] as f64 / squares as f64 - 0.2;
                low[k] + (share + 0.2 / squares as f64 * noise.next()) * (high[k] - low[k])
            });
            let height = 0.2 + rough * noise.next();
            let in_plane = add_scaled(&add_scaled(&view.origin, at[0], &view.axes[0]), at[1], &view.axes[1]);
            let color = add_scaled(&view.color_at(&at), paint, &noise.vector(1.0));
            let color = color.map(|x| f64::from(x as f32));
            Corner { at: add_scaled(&in_plane, height, &view.axes[2]), color, reach: 0.0 }
        })
        .collect();
    let number = |i: usize, j: usize| corners[j * (squares + 1) + i];
    let squares = (0..squares).flat_map(|j| (0..squares).map(move |i| (i, j)));
    squares
        .flat_map(|(i, j)| {
            let [a, b, c, d] = [number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
        .collect()
}

/// Create a surface in which corners at equal positions are one vertex.
fn surface_with_shared_vertices(triangles: &[Triangle]) -> Surface {
    let mut points: Vec<[f64; 6]> = vec![];
    let mut number = |c: &Corner| {
        let [[x, y, z], [r, g, b]] = [c.at, c.color];
        let point = [x, y, z, r, g, b];
        points.iter().position(|p| *p == point).unwrap_or_else(|| {
            points.push(point);
            points.len() - 1
        }) as u32
    };
    let corners: Vec<[u32; 3]> = triangles.iter().map(|t| t.each_ref().map(&mut number)).collect();
    Surface::new(&points, &corners, 1).unwrap()
}

#[test]
fn excess_color_below_a_sheet_is_never_proven() {
    let mut noise = Noise(17);
    let (mut proven, mut cells, mut cover) = (0, 0, CoverageProof::default());
    for case in 0..600 {
        let triangle = noise.large();
        if TriangleFrame::new(&triangle).is_none() {
            continue;
        }
        let (squares, rough) = ([1, 3, 6][case % 3], [0.02, 0.15][case / 3 % 2]);
        let sheet = sheet(&triangle, squares, rough, [1.0, 10.0, 50.0][case / 6 % 3], &mut noise);
        let slack = [1e-9, 1e-6, 1e-3][case / 18 % 3];
        let places: Vec<_> = (0..4).flat_map(|_| samples(&triangle, &mut noise)).collect();
        let far = |at: &Vec3| {
            sheet.iter().map(|t| brute_force_deviation(at, at, t, 0.0).0).fold(f64::INFINITY, f64::min)
        };
        let farthest = places.iter().map(|(at, _)| far(at)).fold(0.0, f64::max);
        let truth = greatest_difference(places, &sheet, slack);
        let target = surface_with_shared_vertices(&sheet);
        let against = against(&target, slack);
        cover.cells.clear();
        assert!(!proves(&against, &triangle, 0.999 * truth, &mut cover), "{case}: not within {truth}");
        cells += usize::from(cover.cells.len() > 1);
        if proves(&against, &triangle, 1.1 * truth + 1.0, &mut cover) {
            proven += 1;
            assert!(farthest <= cover.reach + 1e-9, "{case}: {farthest} > {}", cover.reach);
        }
    }
    // Most cases need cells, so the test does exercise them.
    assert!(proven > 150 && cells > 300, "{proven} {cells}");
}

/// Test if a triangle is proven to be within `limit` of a sheet without colours.
fn covers(corners: [Vec3; 3], sheet: &[[Vec3; 3]], limit: f64) -> bool {
    let of = |at: Vec3| Corner { at, color: [0.0; 3], reach: 0.0 };
    let target = surface_with_shared_vertices(&sheet.iter().map(|t| t.map(of)).collect::<Vec<_>>());
    let against = BoundContext { with_color: false, ..against(&target, 1e-9) };
    let near = corners.map(|at| target.nearest(&at, 0));
    let triangle = [0, 1, 2].map(|i| Corner { reach: near[i].distance, ..of(corners[i]) });
    let limit = Deviation { shape: limit, color: f64::INFINITY };
    CoverageProof::default().proves(&against, &triangle, near.map(|f| f.slot), limit, None)
}

#[test]
fn border_along_the_sides_still_covers_the_triangle() {
    let mut noise = Noise(18);
    let mut compared = 0;
    for _ in 0..200 {
        let triangle = noise.large();
        let [a, b, c] = triangle.map(|c| c.at);
        let Some(view) = TriangleFrame::new(&triangle) else { continue };
        if squared_area_and_length(&[a, b, c]).0 < 0.1 {
            continue;
        }
        compared += 1;
        let height = 0.05;
        let tip = add_scaled(&weighted_sum(&[0.3, 0.3, 0.4], &[a, b, c]), height, &view.axes[2]);
        let roof = [[a, b, tip], [b, c, tip], [c, a, tip]];
        assert!(covers([a, b, c], &roof, 1.01 * height));
        assert!(!covers([a, b, c], &roof, 0.99 * height));
        // Borders that continue from two corners away from the triangle.
        let beyond = add_scaled(&add_scaled(&a, 1.0, &sub(&b, &c)), height, &view.axes[2]);
        assert!(covers([a, b, c], &[roof[0], roof[1], roof[2], [b, a, beyond]], 1.01 * height));
        // A gap between two corners and the tip, and a gap that starts at a corner.
        assert!(!covers([a, b, c], &roof[1..], 1.01 * height));
        let side = weighted_sum(&[0.5, 0.5, 0.0], &[a, b, c]);
        assert!(!covers([a, b, c], &[[a, side, tip], roof[1], roof[2]], 1.01 * height));
    }
    assert!(compared > 100, "{compared}");
}
