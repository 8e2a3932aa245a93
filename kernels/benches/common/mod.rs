//! Input surfaces and the measuring function of all benchmarks.

use std::cell::OnceCell;
use std::time::Duration;

use criterion::{BatchSize, Criterion, SamplingMode, Throughput};
use scanloom_kernels::base::progress::{Progress, RunControl};

pub type Triangles = Vec<[u32; 3]>;

const SIZES: [(&str, usize); 3] = [("10k", 10_000), ("100k", 100_000), ("1M", 1_000_000)];

/// Benchmark a function on inputs of all sizes. Each input is built once, on first use; every run gets a
/// copy.
pub fn measure<I: Clone, O>(
    criterion: &mut Criterion,
    name: &str,
    make: impl Fn(usize) -> I,
    run: impl Fn(I) -> O,
) {
    let mut group = criterion.benchmark_group(name);
    // The slowest benchmarks take many seconds per run.
    group.sample_size(10).sampling_mode(SamplingMode::Flat);
    group.warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(2));
    for (label, size) in SIZES {
        let input = OnceCell::new();
        group.throughput(Throughput::Elements(size as u64));
        group.bench_function(label, |bencher| {
            let input = input.get_or_init(|| make(size));
            bencher.iter_batched(|| input.clone(), &run, BatchSize::PerIteration);
        });
    }
    group.finish();
}

/// Run a closure with a progress handle that nobody observes.
pub fn alone<T>(run: impl FnOnce(&mut Progress) -> T) -> T {
    run(&mut Progress::new(&RunControl::default()))
}

/// Hash a position to a pseudo-random number from 0 to 1; neighbours are uncorrelated.
fn noise(x: u32, y: u32) -> f64 {
    let mixed = (u64::from(x) << 32 | u64::from(y)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mixed = (mixed ^ mixed >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((mixed ^ mixed >> 32) & 0xffff) as f64 / 65536.0
}

/// Compute the numbers of squares along both axes of a field with about `size` triangles, two per square.
fn squares(size: usize) -> [u32; 2] {
    let half = size as u32 / 2;
    let across =
        (1..=half).take_while(|n| n * n <= half).filter(|n| half.is_multiple_of(*n)).last().unwrap_or(1);
    [across, half / across]
}

/// Build the coloured height field of benches/simplify_speed.py with vertex spacing 1: depth-camera noise,
/// and smooth waves of colour.
pub fn field(size: usize) -> (Vec<[f64; 6]>, Triangles) {
    let [w, h] = squares(size);
    let point = |x: u32, y: u32| {
        let (u, v) = (f64::from(x), f64::from(y));
        let about = |k: u32, width: f64| width * (noise(x + k * (w + 1), y) - 0.5);
        let height = 3.0 * (u / 17.0).sin() * (v / 23.0).cos() + about(0, 0.17);
        let color = |k: u32, wave: f64| (128.0 + wave + about(k, 3.5)).floor();
        let red = color(1, 60.0 * (u / 31.0).sin());
        let green = color(2, 60.0 * (v / 19.0).cos());
        let blue = color(3, 40.0 * ((u + v) / 41.0).sin());
        [u, v, height, red, green, blue]
    };
    let points = (0..=h).flat_map(|y| (0..=w).map(move |x| point(x, y))).collect();
    let triangles = (0..h).flat_map(|y| (0..w).map(move |x| y * (w + 1) + x)).flat_map(|a| {
        let (b, c, d) = (a + 1, a + w + 2, a + w + 1);
        [[a, b, c], [a, c, d]]
    });
    (points, triangles.collect())
}

/// Build the positions and triangles of the field without colours.
pub fn plain_field(size: usize) -> (Vec<[f64; 3]>, Triangles) {
    let (points, triangles) = field(size);
    (points.iter().map(|p| [p[0], p[1], p[2]]).collect(), triangles)
}
