//! The quick proof of colours against brute force, where triangles are larger than the one that is proven.

use super::super::piece::Wanted;
use super::super::surface::Surface;
use super::*;
use crate::geometry::{midpoint, nearest_on_triangle};

type Triangle = [Corner; 3];

/// Numbers from −1 to 1 that look random and are the same every time.
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

    /// About as long as 1. In one case of three its colours lie on one line and follow one direction in space.
    fn large(&mut self) -> Triangle {
        let (across, color, plain) = (self.vector(1.0), self.vector(100.0), self.next() < -0.33);
        [0, 1, 2].map(|_| {
            let at = self.vector(1.0);
            let color = if plain { color.map(|x| x * dot(&across, &at)) } else { self.vector(100.0) };
            Corner { at, color: color.map(|x| f64::from(x as f32)), reach: 0.0 }
        })
    }

    /// Over or beside a large one, and coloured as it, continued, more or less.
    fn small_near(&mut self, large: &Triangle, size: f64, paint: f64) -> Triangle {
        let [places, colors] = [large.map(|c| c.at), large.map(|c| c.color)];
        let facet = Facet::new(&places).unwrap();
        let place = add_scaled(&combine(&self.weights(), &places), 0.3, &self.vector(1.0));
        [0, 1, 2].map(|_| {
            let at = add_scaled(&place, size, &self.vector(1.0));
            let color = add_scaled(&combine(&facet.weights(&at), &colors), paint, &self.vector(1.0));
            Corner { at, color, reach: 0.0 }
        })
    }

    /// A large triangle, a small one and the slack, so that no colour can differ more than it does here: the way
    /// out of the large one is along the gradient, and so is the slack. `share` is how far outside it the small
    /// one is, by the height; negative for inside, and then it is over it.
    fn along_the_gradient(&mut self, share: f64) -> (Triangle, Triangle, f64) {
        // Two equal sides from the tip, and one colour along the third.
        let [a, b, tip] = self.large();
        let (along, middle) = (sub(&b.at, &a.at), midpoint(&a.at, &b.at));
        let down = sub(&middle, &tip.at);
        let down = add_scaled(&down, -dot(&down, &along) / norm2(&along), &along);
        let large = [a, Corner { color: a.color, ..b }, Corner { at: sub(&middle, &down), ..tip }];
        let (places, colors) = (large.map(|c| c.at), large.map(|c| c.color));
        let facet = Facet::new(&places).unwrap();
        let height = norm2(&down).sqrt();
        // Over the triangle the height is no way along its plane.
        let lift = if share < 0.0 { 0.3 } else { 0.0 } / norm2(&along).sqrt();
        let place = add_scaled(&add_scaled(&middle, share, &down), lift, &cross(&along, &down));
        let (drop, own) = (sub(&colors[0], &colors[2]), self.next().abs());
        let small = [0, 1, 2].map(|_| {
            let at = add_scaled(&place, 1e-6 * height, &self.vector(1.0));
            let color = add_scaled(&combine(&facet.weights(&at), &colors), own, &drop);
            Corner { at, color, reach: 0.0 }
        });
        (large, small, 0.1 * height)
    }
}

fn surface(triangles: &[Triangle]) -> Surface {
    let point = |c: &Corner| [c.at[0], c.at[1], c.at[2], c.color[0], c.color[1], c.color[2]];
    let points: Vec<_> = triangles.iter().flatten().map(point).collect();
    let corners: Vec<_> = (0..triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    Surface::new(&points, &corners, 1).unwrap()
}

fn against(target: &Surface, slack: f64) -> Against<'_> {
    Against { target, slack, color_range: f64::INFINITY, with_color: true, wanted: Wanted::None }
}

/// Whether the colour of all of `triangle` is proven to be within `level`.
fn proves(against: &Against<'_>, triangle: &Triangle, level: f64, cover: &mut Cover) -> bool {
    let near = triangle.map(|c| against.target.nearest(&c.at, 0));
    let triangle = [0, 1, 2].map(|i| Corner { reach: near[i].distance, ..triangle[i] });
    cover.proves(against, &triangle, near.map(|f| f.slot), Deviation { shape: 9.0, color: level })
}

/// Corners and other points of a triangle: place and colour.
fn samples(triangle: &Triangle, noise: &mut Noise) -> Vec<(Vec3, Vec3)> {
    let corners = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let weights = corners.into_iter().chain((0..12).map(|_| noise.weights()));
    let of = |w: &Vec3, values: [Vec3; 3]| combine(w, &values);
    weights.map(|w| (of(&w, triangle.map(|c| c.at)), of(&w, triangle.map(|c| c.color)))).collect()
}

/// The distance of a point from a triangle, and the most its colour differs from that of the nearest point
/// or one within the slack of it. Along the lines to the corners the farthest of those are looked at.
fn brute(at: &Vec3, color: &Vec3, triangle: &Triangle, slack: f64) -> (f64, f64) {
    let [places, colors] = [triangle.map(|c| c.at), triangle.map(|c| c.color)];
    let (weights, distance2) = nearest_on_triangle(at, places.each_ref());
    let (place, there) = (combine(&weights, &places), combine(&weights, &colors));
    let most = (0..3).fold(difference(color, &there), |most, k| {
        let length = difference(&places[k], &place);
        let share = if length > slack { slack / length } else { 1.0 };
        most.max(difference(color, &add_scaled(&there, share, &sub(&colors[k], &there))))
    });
    (distance2.sqrt(), most)
}

#[test]
fn no_colour_differs_more_from_a_larger_triangle_than_is_said() {
    let mut noise = Noise(3);
    // By how many corners of the small triangle have their feet beside the large one.
    let mut cases = [0; 4];
    for case in 0..4000 {
        let large = noise.large();
        let size = [0.01, 0.1, 0.4][case % 3];
        let paint = [0.0, 1.0, 50.0][case / 3 % 3];
        let small = noise.small_near(&large, size, paint);
        let slack = [1e-9, 1e-3, 0.05][case / 9 % 3];
        let target = surface(&[large]);
        let samples = samples(&small, &mut noise);
        let found = samples.iter().map(|(at, color)| brute(at, color, &large, slack));
        let (far, truth) = found.fold((0.0f64, 0.0f64), |most, f| (most.0.max(f.0), most.1.max(f.1)));
        let facet = Facet::new(&large.map(|c| c.at)).unwrap();
        let beside = small.iter().filter(|c| facet.weights(&c.at).iter().any(|&w| w < 0.0)).count();
        cases[beside] += 1;
        // No farther than it has to be for all of the small triangle to be looked at.
        let said = larger_differs(&against(&target, slack), &small, 0, far).unwrap();
        assert!(truth <= said + 1e-9 * (1.0 + said), "{case}, {beside} beside: {truth} > {said}");
    }
    assert!(cases.iter().all(|&count| count > 100), "{cases:?}");
}

#[test]
fn a_colour_can_differ_as_much_from_a_larger_triangle_as_is_said() {
    let mut noise = Noise(5);
    for case in 0..200 {
        let (large, small, slack) = noise.along_the_gradient([-0.4, 0.01, 0.2, 1.0][case % 4]);
        let (far, truth) = brute(&small[0].at, &small[0].color, &large, slack);
        let target = surface(&[large]);
        let said = larger_differs(&against(&target, slack), &small, 0, far).unwrap();
        assert!((said - truth).abs() <= 1e-4 * said, "{case}: {said}, not {truth}");
    }
}

#[test]
fn a_larger_triangle_as_near_within_the_slack_as_another_one_counts() {
    let mut noise = Noise(6);
    for case in 0..200 {
        let (large, small, slack) = noise.along_the_gradient([0.2, 1.0][case % 2]);
        let Corner { at, color, .. } = small[0];
        let (far, truth) = brute(&at, &color, &large, slack);
        // The nearest one has the right colour.
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
        let within = |level| proves(&against, &small, level, &mut Cover::default());
        assert!(!within(0.999 * truth) && within(1.01 * truth), "{case}: {truth}");
    }
}

#[test]
fn a_colour_among_larger_triangles_that_passes_the_limit_is_never_proven_within() {
    let mut noise = Noise(7);
    let (mut proven, mut cover) = (0, Cover::default());
    for case in 0..2000 {
        let large = [0; 3].map(|_| noise.large());
        let small = noise.small_near(&large[0], [0.01, 0.1][case % 2], [0.0, 1.0, 50.0][case / 2 % 3]);
        let slack = [1e-9, 1e-3, 0.05][case / 6 % 3];
        let mut truth = 0.0f64;
        for (at, color) in samples(&small, &mut noise) {
            let found = large.map(|triangle| brute(&at, &color, &triangle, slack));
            let least = found.iter().map(|f| f.0).fold(f64::INFINITY, f64::min);
            truth = found.iter().filter(|f| f.0 <= least + slack).map(|f| f.1).fold(truth, f64::max);
        }
        let target = surface(&large);
        let against = against(&target, slack);
        let mut within = |level| proves(&against, &small, level, &mut cover);
        assert!(!within(0.999 * truth), "{case}: not within {truth}");
        proven += usize::from(within(1.5 * truth + 1.0));
    }
    assert!(proven > 500, "{proven}");
}
