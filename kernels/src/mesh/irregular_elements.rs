//! Irregular elements of a triangle list, and its topological counts.
//!
//! The classes follow Wang, Lu and Pan, "Dynamic evaluation and modification for progressive mesh hierarchies"
//! (2012, section 2.1.2), plus borders and duplicate triangles. The mesh may be non-manifold and may repeat
//! vertices in a triangle; such triangles have no edges.
//!
//! Angles are compared by their sine and cosine, because arc tangents would take most of the time.

use crate::base::components::Components;
use crate::base::geometry::{Vec3, cross, dot, norm2, sub};
use crate::base::parallel::collect;

/// Maximum ratio of the doubled area to the squared longest edge of a degenerate triangle.
const MAX_FLATNESS: f64 = 1e-10;

/// Bits of a triangle, and of its corners.
const DEGENERATE: u8 = 1;
const CAP: u8 = 2;
const NEEDLE: u8 = 4;
/// Bit of a corner, shifted by 0 to 2: its angle is less than the limit of spikes.
const ACUTE: u8 = 8;

/// Angle limits in radians.
#[derive(Clone, Copy, Debug)]
pub struct AngleLimits {
    /// A triangle with a smaller corner is a needle; with a corner above π minus this, a cap.
    pub corner: f64,
    /// Neighbours are folded if the angle of their normals is above π minus this.
    pub fold: f64,
    /// An inner vertex is a spike if its corners sum to less than this.
    pub spike: f64,
}

/// Irregular elements: vertices, edges (the smaller vertex first), or triangles, ascending.
#[derive(Debug, Default)]
pub struct IrregularElements {
    pub border_edges: Vec<[u32; 2]>,
    pub nonmanifold_edges: Vec<[u32; 2]>,
    pub inconsistent_edges: Vec<[u32; 2]>,
    pub singular_vertices: Vec<u32>,
    pub focal_vertices: Vec<u32>,
    pub singular_border_triangles: Vec<u32>,
    pub degenerate_triangles: Vec<u32>,
    pub duplicate_triangles: Vec<u32>,
    pub caps: Vec<u32>,
    pub needles: Vec<u32>,
    pub sharp_edges: Vec<[u32; 2]>,
    pub spikes: Vec<u32>,
    pub counts: Counts,
}

/// Counts of a triangle list. All but `repeating` and `referenced` exclude triangles that repeat a vertex.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    pub edges: usize,
    pub boundary_loops: usize,
    pub components: usize,
    /// Vertices of triangles that repeat no vertex.
    pub used: usize,
    /// Vertices of any triangle.
    pub referenced: usize,
    /// Triangles that repeat a vertex.
    pub repeating: usize,
}

/// Find the irregular elements. All indices must be below the number of points.
pub fn find_irregular_elements(
    points: &[Vec3],
    triangles: &[[u32; 3]],
    limits: AngleLimits,
    threads: usize,
) -> IrregularElements {
    let shapes = collect(triangles.len(), threads, |t| measure_triangle(points, triangles[t], limits));
    let list = |bit: u8| -> Vec<u32> {
        (0..triangles.len() as u32).filter(|&t| shapes[t as usize] & bit != 0).collect()
    };
    let mut found = IrregularElements {
        degenerate_triangles: list(DEGENERATE),
        caps: list(CAP),
        needles: list(NEEDLE),
        ..IrregularElements::default()
    };
    let halfedges = Halfedges::sort(triangles, points.len());
    let mut vertices = vec![AroundVertex::default(); points.len()];
    for corners in triangles {
        let is_proper = !repeats_vertex(corners);
        found.counts.repeating += usize::from(!is_proper);
        for &v in corners {
            vertices[v as usize].is_referenced = true;
            vertices[v as usize].corners += u32::from(is_proper);
        }
    }
    let (border, joins) = visit_edges(triangles, &halfedges, &mut vertices, &mut found);
    let mut fans = join_fans(triangles, &halfedges);
    for (t, corners) in triangles.iter().enumerate().filter(|(_, corners)| !repeats_vertex(corners)) {
        for (k, &v) in corners.iter().enumerate() {
            vertices[v as usize].fans += u32::from(fans.find_root(3 * t + k) == 3 * t + k);
        }
    }
    found.counts.boundary_loops = count_loops(&mut fans, &border);
    drop(fans);
    let which = |is: &dyn Fn(&AroundVertex) -> bool| {
        (0..points.len() as u32).filter(|&v| is(&vertices[v as usize])).collect::<Vec<u32>>()
    };
    found.counts.used = which(&|at| at.corners > 0).len();
    found.counts.referenced = which(&|at| at.is_referenced).len();
    found.counts.components = found.counts.used - joins;
    found.singular_vertices = which(&|at| at.fans > 1);
    found.focal_vertices = which(&|at| at.border_ends > 2);
    let is_alone = |&v: &u32| {
        let at = &vertices[v as usize];
        at.fans > 1 && 2 * at.corners == at.neighbours
    };
    let is_lone =
        |&t: &u32| !repeats_vertex(&triangles[t as usize]) && triangles[t as usize].iter().any(is_alone);
    found.singular_border_triangles = match found.singular_vertices.is_empty() {
        true => vec![],
        false => (0..triangles.len() as u32).filter(is_lone).collect(),
    };
    found.sharp_edges = find_folds(points, triangles, &halfedges, &shapes, limits.fold);
    found.spikes = find_spikes(points, triangles, &shapes, &vertices, limits.spike);
    found
}

/// Triangles and edges around a vertex, of triangles that repeat no vertex.
#[derive(Clone, Debug, Default)]
struct AroundVertex {
    corners: u32,
    neighbours: u32,
    fans: u32,
    border_ends: u32,
    is_referenced: bool,
    /// True if an edge here has another number of triangles than two.
    has_irregular_edge: bool,
}

/// Halfedges sorted by edge, then by index; halfedge 3 t + k leaves corner k of triangle t.
struct Halfedges {
    sorted: Vec<u32>,
    /// The larger vertex of each sorted halfedge.
    upper: Vec<u32>,
    /// First sorted halfedge of each vertex that is the smaller one of an edge; one more entry for the end.
    start: Vec<u32>,
}

impl Halfedges {
    fn sort(triangles: &[[u32; 3]], vertex_count: usize) -> Self {
        let ends = |h: usize| {
            let corners = &triangles[h / 3];
            let (a, b) = (corners[h % 3], corners[(h + 1) % 3]);
            (a.min(b), a.max(b))
        };
        let proper = |h: &usize| !repeats_vertex(&triangles[h / 3]);
        let mut start = vec![0u32; vertex_count + 2];
        (0..3 * triangles.len()).filter(proper).for_each(|h| start[ends(h).0 as usize + 2] += 1);
        for v in 2..start.len() {
            start[v] += start[v - 1];
        }
        let mut keys = vec![(0u32, 0u32); start.last().map_or(0, |&count| count as usize)];
        for h in (0..3 * triangles.len()).filter(proper) {
            let (lower, upper) = ends(h);
            let slot = &mut start[lower as usize + 1];
            keys[*slot as usize] = (upper, h as u32);
            *slot += 1;
        }
        start.pop();
        start.windows(2).for_each(|range| keys[range[0] as usize..range[1] as usize].sort_unstable());
        let (upper, sorted) = keys.into_iter().unzip();
        Self { sorted, upper, start }
    }

    /// Iterate over the edges: smaller vertex, larger vertex, and halfedges.
    fn edges(&self) -> impl Iterator<Item = ([u32; 2], &[u32])> {
        self.start.windows(2).enumerate().flat_map(move |(lower, range)| {
            let mut at = range[0] as usize;
            let end = range[1] as usize;
            std::iter::from_fn(move || {
                let upper = *self.upper[..end].get(at)?;
                let first = at;
                at += self.upper[at..end].iter().take_while(|&&other| other == upper).count();
                Some(([lower as u32, upper], &self.sorted[first..at]))
            })
        })
    }
}

fn repeats_vertex([a, b, c]: &[u32; 3]) -> bool {
    a == b || b == c || c == a
}

/// Return the next halfedge of the same triangle.
fn next(h: u32) -> u32 {
    if h % 3 == 2 { h - 2 } else { h + 1 }
}

fn tail(triangles: &[[u32; 3]], h: u32) -> u32 {
    triangles[h as usize / 3][h as usize % 3]
}

/// Check whether a halfedge runs from the smaller to the larger vertex.
fn is_forward(triangles: &[[u32; 3]], h: u32) -> bool {
    tail(triangles, h) < tail(triangles, next(h))
}

/// Compute the bits of a triangle.
fn measure_triangle(points: &[Vec3], triangle: [u32; 3], limits: AngleLimits) -> u8 {
    let corners = triangle.map(|v| points[v as usize]);
    let sides = [0, 1, 2].map(|k| sub(&corners[(k + 1) % 3], &corners[k]));
    let longest = sides.iter().map(norm2).fold(0.0, f64::max);
    // Twice the area, which is the sine of each corner times the lengths of its sides.
    let doubled_area = norm2(&cross(&sides[0], &sides[2])).sqrt();
    let cosines = [0, 1, 2].map(|k| -dot(&sides[k], &sides[(k + 2) % 3]));
    let is_degenerate = repeats_vertex(&triangle) || doubled_area <= MAX_FLATNESS * longest;
    let limit = limits.corner.tan();
    let is_cap = cosines.iter().any(|&c| c < 0.0 && doubled_area < -c * limit);
    let is_needle = cosines.iter().any(|&c| c > 0.0 && doubled_area < c * limit);
    let mut bits = match (is_degenerate, is_cap, is_needle) {
        (true, ..) => DEGENERATE,
        (_, true, _) => CAP,
        (.., true) => NEEDLE,
        _ => 0,
    };
    let (sine, cosine) = limits.spike.sin_cos();
    for (k, &c) in cosines.iter().enumerate() {
        // The angle of a side without length is 0.
        if doubled_area * cosine < c * sine || doubled_area == 0.0 && c >= 0.0 {
            bits |= ACUTE << k;
        }
    }
    bits
}

/// Find irregular edges and duplicate triangles, and count what is around each vertex. Returns the halfedges of
/// border edges, and the number of edges that join two components.
fn visit_edges(
    triangles: &[[u32; 3]],
    halfedges: &Halfedges,
    vertices: &mut [AroundVertex],
    found: &mut IrregularElements,
) -> (Vec<u32>, usize) {
    let (mut border, mut joins) = (vec![], 0);
    let mut joined = Components::new(vertices.len());
    let mut thirds: Vec<(u32, u32)> = vec![];
    for (ends, group) in halfedges.edges() {
        found.counts.edges += 1;
        joins += usize::from(joined.join(ends[0] as usize, ends[1] as usize));
        let is_border = group.len() == 1;
        for v in ends {
            let at = &mut vertices[v as usize];
            at.neighbours += 1;
            at.border_ends += u32::from(is_border);
            at.has_irregular_edge |= group.len() != 2;
        }
        match *group {
            [only] => {
                border.push(only);
                found.border_edges.push(ends);
            }
            [one, other] => {
                if is_forward(triangles, one) == is_forward(triangles, other) {
                    found.inconsistent_edges.push(ends);
                }
            }
            _ => found.nonmanifold_edges.push(ends),
        }
        if group.len() > 1 {
            // Triangles with the same vertices share their edges, and have the same third vertex. Each set is
            // counted at its smallest edge only.
            let third = |&h: &u32| (tail(triangles, next(next(h))), h / 3);
            thirds.clear();
            thirds.extend(group.iter().map(third).filter(|&(vertex, _)| vertex > ends[1]));
            thirds.sort_unstable();
            let again = thirds.windows(2).filter(|pair| pair[0].0 == pair[1].0).map(|pair| pair[1].1);
            found.duplicate_triangles.extend(again);
        }
    }
    found.duplicate_triangles.sort_unstable();
    (border, joins)
}

/// Join the corners of each vertex that edges connect.
fn join_fans(triangles: &[[u32; 3]], halfedges: &Halfedges) -> Components {
    let mut fans = Components::new(3 * triangles.len());
    for (_, group) in halfedges.edges() {
        for pair in group.windows(2) {
            let (mut here, mut there) = (pair[1], next(pair[1]));
            if tail(triangles, pair[0]) != tail(triangles, here) {
                (here, there) = (there, here);
            }
            fans.join(pair[0] as usize, here as usize);
            fans.join(next(pair[0]) as usize, there as usize);
        }
    }
    fans
}

/// Count the loops of border edges; at a singular vertex, a loop continues along its own fan.
fn count_loops(fans: &mut Components, border: &[u32]) -> usize {
    let mut ends: Vec<usize> =
        border.iter().flat_map(|&h| [h, next(h)]).map(|corner| fans.find_root(corner as usize)).collect();
    ends.sort_unstable();
    ends.dedup();
    let joins = border.iter().filter(|&&h| fans.join(h as usize, next(h) as usize)).count();
    ends.len() - joins
}

/// Find the edges whose two triangles are folded onto each other.
fn find_folds(
    points: &[Vec3],
    triangles: &[[u32; 3]],
    halfedges: &Halfedges,
    shapes: &[u8],
    limit: f64,
) -> Vec<[u32; 2]> {
    let slope = limit.tan();
    let normal = |h: u32| {
        let [a, b, c] = triangles[h as usize / 3].map(|v| &points[v as usize]);
        cross(&sub(b, a), &sub(c, a))
    };
    let is_folded = |one: u32, other: u32| {
        if [one, other].iter().any(|&h| shapes[h as usize / 3] & DEGENERATE != 0) {
            return false;
        }
        // For inconsistently oriented neighbours, one normal is reversed.
        let sign = if is_forward(triangles, one) == is_forward(triangles, other) { -1.0 } else { 1.0 };
        let (one, other) = (normal(one), normal(other));
        let cosine = sign * dot(&one, &other);
        cosine < 0.0 && norm2(&cross(&one, &other)).sqrt() < -cosine * slope
    };
    let folded = |(ends, group): ([u32; 2], &[u32])| match *group {
        [one, other] => is_folded(one, other).then_some(ends),
        _ => None,
    };
    halfedges.edges().filter_map(folded).collect()
}

/// Find inner vertices whose corners sum to less than the limit.
fn find_spikes(
    points: &[Vec3],
    triangles: &[[u32; 3]],
    shapes: &[u8],
    vertices: &[AroundVertex],
    limit: f64,
) -> Vec<u32> {
    // Corners below the limit are counted first: most vertices have another one, and their angles are not
    // needed.
    let mut acute = vec![0u32; vertices.len()];
    let proper = || triangles.iter().enumerate().filter(|(_, corners)| !repeats_vertex(corners));
    for (t, corners) in proper() {
        for (k, &v) in corners.iter().enumerate() {
            acute[v as usize] += u32::from(shapes[t] & (ACUTE << k) != 0);
        }
    }
    let is_candidate = |v: usize| {
        let at = &vertices[v];
        at.corners > 0 && acute[v] == at.corners && !at.has_irregular_edge && at.fans == 1
    };
    let mut candidates: Vec<(u32, f64)> =
        (0..vertices.len()).filter(|&v| is_candidate(v)).map(|v| (v as u32, 0.0)).collect();
    if candidates.is_empty() {
        return vec![];
    }
    for (_, corners) in proper() {
        for (k, &v) in corners.iter().enumerate() {
            let Ok(place) = candidates.binary_search_by_key(&v, |&(vertex, _)| vertex) else { continue };
            let [a, b, c] = [0, 1, 2].map(|i| &points[corners[(k + i) % 3] as usize]);
            let (one, other) = (sub(b, a), sub(c, a));
            candidates[place].1 += norm2(&cross(&one, &other)).sqrt().atan2(dot(&one, &other));
        }
    }
    candidates.into_iter().filter(|&(_, sum)| sum < limit).map(|(v, _)| v).collect()
}
