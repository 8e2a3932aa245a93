//! Small named meshes, and pseudo-random numbers for all tests.

pub type Triangles = Vec<[u32; 3]>;

/// Deterministic pseudo-random numbers (linear congruential generator).
pub struct Noise(pub u64);

impl Noise {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.next() * n as f64) as usize
    }
}

pub fn tetrahedron() -> (Vec<[f64; 3]>, Triangles) {
    let points = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    (points, vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
}

pub fn octahedron() -> (Vec<[f64; 3]>, Triangles) {
    let points = vec![
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [-1.0, 0.0, 0.0],
        [0.0, -1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, 0.0, -1.0],
    ];
    let triangles =
        vec![[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [1, 0, 5], [2, 1, 5], [3, 2, 5], [0, 3, 5]];
    (points, triangles)
}

/// Sheet of w × h squares, each split in two triangles; corner (x, y) is vertex y·(w+1) + x.
pub fn sheet(w: u32, h: u32) -> (Vec<[f64; 3]>, Triangles) {
    let points = (0..=h).flat_map(|y| (0..=w).map(move |x| [f64::from(x), f64::from(y), 0.0])).collect();
    let mut triangles = vec![];
    for y in 0..h {
        for x in 0..w {
            let a = y * (w + 1) + x;
            let (b, c, d) = (a + 1, a + w + 2, a + w + 1);
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    (points, triangles)
}

/// Sheet with a square hole in the middle: two boundary loops.
pub fn sheet_with_hole(n: u32) -> (Vec<[f64; 3]>, Triangles) {
    let (points, mut triangles) = sheet(3 * n, 3 * n);
    let in_hole = |t: &[u32; 3]| {
        let centre = |axis: usize| t.iter().map(|&v| points[v as usize][axis]).sum::<f64>() / 3.0;
        let inside = |x: f64| x > f64::from(n) && x < f64::from(2 * n);
        inside(centre(0)) && inside(centre(1))
    };
    triangles.retain(|t| !in_hole(t));
    (points, triangles)
}

/// Sheet rolled into a torus.
pub fn torus(w: u32, h: u32) -> (Vec<[f64; 3]>, Triangles) {
    let angle = |i: u32, n: u32| std::f64::consts::TAU * f64::from(i) / f64::from(n);
    let mut points = vec![];
    let mut triangles = vec![];
    for y in 0..h {
        for x in 0..w {
            let (a, b) = (angle(x, w), angle(y, h));
            let radius = 3.0 + b.cos();
            points.push([radius * a.cos(), radius * a.sin(), b.sin()]);
            let at = |x: u32, y: u32| (y % h) * w + x % w;
            let (p, q, r, s) = (at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1));
            triangles.extend([[p, q, r], [p, r, s]]);
        }
    }
    (points, triangles)
}

/// Meshes for properties that must hold for every mesh.
pub fn gallery() -> Vec<(&'static str, Vec<[f64; 3]>, Triangles)> {
    let named = |name, (points, triangles)| (name, points, triangles);
    vec![
        named("tetrahedron", tetrahedron()),
        named("octahedron", octahedron()),
        named("one triangle", (vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]])),
        named("sheet", sheet(7, 5)),
        named("sheet with hole", sheet_with_hole(3)),
        named("strip", sheet(9, 1)),
        named("torus", torus(12, 8)),
        named("smallest torus", torus(3, 3)),
        named("two pieces", two_pieces()),
    ]
}

/// The gallery, and two larger meshes.
pub fn large_gallery() -> Vec<(&'static str, Vec<[f64; 3]>, Triangles)> {
    let (hole, hole_triangles) = sheet_with_hole(12);
    let (ring, ring_triangles) = torus(40, 30);
    let mut meshes = gallery();
    meshes.push(("large sheet with hole", hole, hole_triangles));
    meshes.push(("large torus", ring, ring_triangles));
    meshes
}

fn two_pieces() -> (Vec<[f64; 3]>, Triangles) {
    let (mut points, mut triangles) = sheet(4, 4);
    let first = points.len() as u32;
    let (more_points, more) = torus(6, 5);
    points.extend(more_points.iter().map(|p| [p[0], p[1], p[2] + 9.0]));
    triangles.extend(more.iter().map(|t| t.map(|v| v + first)));
    (points, triangles)
}

/// Displace points randomly by up to `by` / 2 per axis, and add `D − 3` random attributes of 0 to 255.
pub fn coloured<const D: usize>(points: &[[f64; 3]], by: f64, seed: u64) -> Vec<[f64; D]> {
    let mut noise = Noise(seed);
    let mut shaken = |p: &[f64; 3]| {
        std::array::from_fn(|i| if i < 3 { p[i] + by * (noise.next() - 0.5) } else { 255.0 * noise.next() })
    };
    points.iter().map(&mut shaken).collect()
}
