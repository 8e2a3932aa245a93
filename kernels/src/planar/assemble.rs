//! All patches together: triangulate each, and put vertices back where the result would not be a manifold.
//!
//! Vertices only come back, and a patch that cannot be had otherwise keeps its triangles, so that this ends: at the
//! latest with the input.

use super::border::{Borders, trace};
use super::patches::{Options, Patch, Patches, Planar};
use super::polygon::Polygon;
use super::reasons;
use super::retriangulate::{Triangles, Unsound, is_left, triangulate};
use super::straighten::{straighten, tolerance};
use crate::base::errors::KernelError;
use crate::base::geometry::dot;
use crate::base::ids::{HalfedgeId, TriangleId, VertexId};
use crate::base::parallel;
use crate::base::progress::Progress;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::Mesh;

/// After so many tries a patch gets all vertices of its border back, and then keeps its triangles.
const MOST_TRIES: u8 = 8;

/// Patches that one thread takes at a time.
const BATCH: usize = 64;

#[derive(Clone)]
enum Outcome {
    New(Vec<([u32; 3], u32)>),
    /// Vertices without which there is no triangulation.
    PutBack(Vec<VertexId>),
    /// Vertices that are too far from what has become of their chord since others were put back.
    Tighten(Vec<VertexId>),
    /// Nothing to gain.
    Keep,
    /// Nothing has helped.
    GiveUp,
}

/// What comes of an assembly.
pub enum Assembled {
    Whole(Box<Planar>),
    /// Some patches lie over themselves, seen along their normals.
    Folded {
        patches: Patches,
        is_folded: Vec<bool>,
        first: First,
    },
}

/// What comes of the patches before any two of them have to agree.
pub struct First {
    /// Vertices on borders that stay.
    stays: Vec<bool>,
    outcomes: Vec<Outcome>,
}

/// An assembly of patches of which some have been divided since.
pub struct Known {
    /// Which of its patches each one is; none for those that are new.
    pub was: Vec<Option<u32>>,
    pub first: First,
}

/// Where an assembly is `known` already, patches that lie over themselves keep their triangles.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn assemble<const D: usize>(
    mesh: &Mesh<D>,
    patches: Patches,
    options: &Options,
    mut known: Option<Known>,
    progress: &mut Progress,
) -> Result<Assembled, KernelError> {
    let is_last = known.is_some();
    let borders = trace(&mesh.connectivity, &patches, options.threads, progress)?;
    let before = known.as_ref().map(|known| (known.first.stays.as_slice(), known.was.as_slice()));
    let stays = straighten(mesh, &patches, &borders, before, options, progress)?;
    let count = patches.patches.len();
    let mut assembly = Assembly {
        mesh,
        options,
        members: by_patch(&patches),
        patches: &patches,
        borders: &borders,
        stays,
        kept: vec![false; count],
        is_folded: vec![false; count],
        tries: vec![0; count],
        forbidden: vec![],
        triangles: vec![vec![]; count],
        edges: vec![],
        has_changed: vec![true; count],
        rounds: 0,
    };
    let stays = if is_last { vec![] } else { assembly.stays.clone() };
    let mut first = First { stays, outcomes: vec![] };
    let mut open: Vec<u32> = (0..count as u32).collect();
    while !open.is_empty() {
        let outcomes = assembly.outcomes(&open, known.take().as_ref(), progress)?;
        if assembly.rounds == 1 && !is_last {
            first.outcomes = outcomes.clone();
        }
        open = assembly.settle(&open, outcomes);
        if open.is_empty() && !is_last && assembly.is_folded.contains(&true) {
            let is_folded = assembly.is_folded;
            return Ok(Assembled::Folded { patches, is_folded, first });
        }
        if open.is_empty() {
            open = assembly.conflicts();
        }
    }
    let bounds = assembly.bounds();
    let refused = reasons::count(mesh, &patches, &borders, options);
    let (vertex_source, triangles, triangle_source, triangle_patch) = assembly.output();
    let (kept, rounds) = (assembly.kept, assembly.rounds);
    Ok(Assembled::Whole(Box::new(Planar {
        triangles,
        vertex_source,
        triangle_source,
        triangle_patch,
        patches,
        bounds,
        kept,
        refused,
        rounds,
    })))
}

/// The triangles of the input sorted by patch, and where each patch begins.
fn by_patch(patches: &Patches) -> (Vec<u32>, Vec<u32>) {
    let mut starts = vec![0u32; patches.patches.len() + 1];
    patches.of.iter().for_each(|&p| starts[p as usize + 1] += 1);
    (0..patches.patches.len()).for_each(|p| starts[p + 1] += starts[p]);
    let mut next = starts.clone();
    let mut members = vec![0; patches.of.len()];
    for (t, &p) in patches.of.iter().enumerate() {
        members[next[p as usize] as usize] = t as u32;
        next[p as usize] += 1;
    }
    (members, starts)
}

struct Assembly<'a, const D: usize> {
    mesh: &'a Mesh<D>,
    options: &'a Options,
    patches: &'a Patches,
    borders: &'a Borders,
    members: (Vec<u32>, Vec<u32>),
    /// Vertices on borders that the result has.
    stays: Vec<bool>,
    /// Patches that keep their triangles, inner vertices included.
    kept: Vec<bool>,
    /// Those of them that have no triangulation though all vertices of their borders are there.
    is_folded: Vec<bool>,
    tries: Vec<u8>,
    /// Edges that a patch must not have inside, as they are elsewhere; sorted.
    forbidden: Vec<(u32, [VertexId; 2])>,
    /// The triangles of each patch that does not keep its own, and their sources.
    triangles: Vec<Vec<([u32; 3], u32)>>,
    /// Of the result, sorted, but for the patches that have changed.
    edges: Vec<Edge>,
    /// Patches whose edges may be others since these were gathered.
    has_changed: Vec<bool>,
    rounds: usize,
}

impl<const D: usize> Assembly<'_, D> {
    fn polygon(&self, patch: u32) -> Polygon<'_> {
        let number = patch as usize;
        Polygon::new(self.mesh, self.borders, number, &self.patches.patches[number], &self.stays)
    }

    /// Triangulate some patches.
    fn outcomes(
        &mut self,
        open: &[u32],
        known: Option<&Known>,
        progress: &Progress,
    ) -> Result<Vec<Outcome>, KernelError> {
        self.rounds += 1;
        let outcome = |&p: &u32| self.known_outcome(p, known).unwrap_or_else(|| self.retriangulate(p));
        let batches = open.len().div_ceil(BATCH);
        let outcomes = parallel::map(
            batches,
            self.options.threads,
            || (),
            |_, batch| {
                let end = open.len().min((batch + 1) * BATCH);
                progress.check()?;
                Ok(open[batch * BATCH..end].iter().map(outcome).collect::<Vec<_>>())
            },
        );
        let outcomes = outcomes.into_iter().collect::<Result<Vec<_>, KernelError>>()?;
        Ok(outcomes.into_iter().flatten().collect())
    }

    /// What has come of a patch before, if it and what stays of its border are the same.
    fn known_outcome(&self, patch: u32, known: Option<&Known>) -> Option<Outcome> {
        let known = known?;
        let was = known.was[patch as usize]?;
        let mut border = self.borders.loops(patch as usize).flatten();
        let is_same = |&h: &HalfedgeId| {
            let v = self.mesh.connectivity.origin(h).index();
            self.stays[v] == known.first.stays[v]
        };
        border.all(is_same).then(|| known.first.outcomes[was as usize].clone())
    }

    /// Take what has come of some patches; returns those that have to be done again.
    fn settle(&mut self, open: &[u32], outcomes: Vec<Outcome>) -> Vec<u32> {
        let mut again = vec![];
        for (&patch, outcome) in open.iter().zip(outcomes) {
            self.has_changed[patch as usize] = true;
            match outcome {
                Outcome::New(triangles) => self.triangles[patch as usize] = triangles,
                Outcome::PutBack(vertices) => {
                    self.tries[patch as usize] += 1;
                    again.push(patch);
                    vertices.into_iter().for_each(|v| self.put_back(v, &mut again));
                }
                Outcome::Tighten(vertices) => {
                    again.push(patch);
                    vertices.into_iter().for_each(|v| self.put_back(v, &mut again));
                }
                Outcome::Keep => self.keep(patch, &mut again),
                Outcome::GiveUp => {
                    self.is_folded[patch as usize] = self.patches.patches[patch as usize].faces > 1;
                    self.keep(patch, &mut again);
                }
            }
        }
        self.once_each(again)
    }

    fn once_each(&self, mut again: Vec<u32>) -> Vec<u32> {
        again.sort_unstable();
        again.dedup();
        again.retain(|&p| !self.kept[p as usize]);
        again
    }

    fn put_back(&mut self, v: VertexId, again: &mut Vec<u32>) {
        if !std::mem::replace(&mut self.stays[v.index()], true) {
            let triangles = self.mesh.connectivity.fan(v).map(|h| Connectivity::triangle(h).index());
            again.extend(triangles.map(|t| self.patches.of[t]));
        }
    }

    fn keep(&mut self, patch: u32, again: &mut Vec<u32>) {
        self.kept[patch as usize] = true;
        self.has_changed[patch as usize] = true;
        self.triangles[patch as usize] = vec![];
        let borders = self.borders;
        for &h in borders.loops(patch as usize).flatten() {
            self.put_back(self.mesh.connectivity.origin(h), again);
        }
    }

    fn retriangulate(&self, number: u32) -> Outcome {
        let patch = &self.patches.patches[number as usize];
        let inner = self.borders.inside[number as usize];
        if patch.faces == 1 && self.polygon_is_whole(number) {
            return Outcome::Keep;
        }
        if !self.borders.is_planar(number as usize, patch.faces) || dot(&patch.normal, &patch.normal) == 0.0 {
            return Outcome::GiveUp;
        }
        let polygon = self.polygon(number);
        if inner == 0 && polygon.is_whole() {
            return Outcome::Keep;
        }
        if self.rounds > 1 {
            let most = tolerance(patch, self.options);
            let too_far = |c| polygon.farthest(self.mesh, c).filter(|(_, away)| *away > most);
            let far: Vec<VertexId> = (0..polygon.corners.len()).filter_map(too_far).map(|(v, _)| v).collect();
            if !far.is_empty() {
                return Outcome::Tighten(far);
            }
        }
        let found = triangulate(&polygon).and_then(|found| self.without_forbidden(number, &polygon, found));
        match found {
            Ok(triangles) => Outcome::New(self.with_sources(&polygon, &triangles)),
            Err(Unsound(chords)) => self.relieved(number, &polygon, &chords),
        }
    }

    fn polygon_is_whole(&self, patch: u32) -> bool {
        let mut border = self.borders.loops(patch as usize).flatten();
        border.all(|&h| self.stays[self.mesh.connectivity.origin(h).index()])
    }

    /// Vertices to put back: of the chords in the way, or of all, if these are not known.
    fn relieved(&self, number: u32, polygon: &Polygon<'_>, chords: &[usize]) -> Outcome {
        let tries = self.tries[number as usize];
        if tries > MOST_TRIES || polygon.is_whole() {
            return Outcome::GiveUp;
        }
        if tries == MOST_TRIES {
            let all = self.borders.loops(number as usize).flatten();
            return Outcome::PutBack(all.map(|&h| self.mesh.connectivity.origin(h)).collect());
        }
        let mut back = polygon.all_of_bare_loops();
        let farthest = |&c: &usize| polygon.farthest(self.mesh, c).map(|(v, _)| v);
        back.extend(chords.iter().filter_map(farthest));
        if back.is_empty() {
            // Small loops are the likely ones to have gone astray.
            let longest = polygon.loops.iter().map(|l| l.len()).max().unwrap_or(0);
            let small = polygon.loops.iter().filter(|l| l.len() < longest).flat_map(Clone::clone);
            back.extend(small.filter_map(|c| farthest(&c)));
        }
        if back.is_empty() {
            back.extend((0..polygon.corners.len()).filter_map(|c| farthest(&c)));
        }
        Outcome::PutBack(back)
    }

    fn with_sources(&self, polygon: &Polygon<'_>, triangles: &Triangles) -> Vec<([u32; 3], u32)> {
        let corner = |c: u32| &polygon.corners[c as usize];
        let sourced =
            |t: &[u32; 3]| (t.map(|c| corner(c).vertex.0), Connectivity::triangle(corner(t[0]).halfedge).0);
        triangles.iter().map(sourced).collect()
    }

    /// Flip the edges that are elsewhere already.
    fn without_forbidden(
        &self,
        number: u32,
        polygon: &Polygon<'_>,
        mut triangles: Triangles,
    ) -> Result<Triangles, Unsound> {
        let from = self.forbidden.partition_point(|f| f.0 < number);
        let own: Vec<[VertexId; 2]> =
            self.forbidden[from..].iter().take_while(|f| f.0 == number).map(|f| f.1).collect();
        let vertex = |c: u32| polygon.corners[c as usize].vertex;
        let is_forbidden = |a: u32, b: u32| own.binary_search(&sorted(vertex(a), vertex(b))).is_ok();
        for _ in 0..2 * own.len() {
            let Some((t, side)) = (0..triangles.len())
                .flat_map(|t| (0..3).map(move |side| (t, side)))
                .find(|&(t, side)| is_forbidden(triangles[t][side], triangles[t][(side + 1) % 3]))
            else {
                return Ok(triangles);
            };
            let [a, b, c] = [0, 1, 2].map(|i| triangles[t][(side + i) % 3]);
            let across =
                (0..triangles.len()).flat_map(|t| (0..3).map(move |side| (t, side))).find(|&(u, side)| {
                    let ends = (triangles[u][side], triangles[u][(side + 1) % 3]);
                    vertex(ends.0) == vertex(b) && vertex(ends.1) == vertex(a)
                });
            let Some((u, other)) = across else { return Err(Unsound(vec![])) };
            let d = triangles[u][(other + 2) % 3];
            let flipped = [[a, d, c], [d, b, c]];
            if is_forbidden(c, d) || !flipped.iter().all(|&f| is_left(polygon, f)) {
                return Err(Unsound(vec![]));
            }
            (triangles[t], triangles[u]) = (flipped[0], flipped[1]);
        }
        if own.is_empty() { Ok(triangles) } else { Err(Unsound(vec![])) }
    }
}

fn sorted(a: VertexId, b: VertexId) -> [VertexId; 2] {
    [a.min(b), a.max(b)]
}

/// What an edge of the result is; in the order in which one of several between the same vertices may stay.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
enum Kind {
    /// An edge of the input.
    Own,
    /// A chord of a border.
    Chord,
    /// An edge inside a patch.
    Inner,
}

/// An edge of the result: its ends, what it is, which one of its kind, and whose.
type Edge = ([VertexId; 2], Kind, u32, u32);

impl<const D: usize> Assembly<'_, D> {
    /// Resolve what makes the result no manifold; returns the patches that have to be done again.
    fn conflicts(&mut self) -> Vec<u32> {
        let edges = self.gathered_edges();
        let mut again = vec![];
        for same in edges.chunk_by(|e, f| e.0 == f.0) {
            // The first may stay, seen from both sides.
            let first = (same[0].1, same[0].2);
            for edge in same.iter().filter(|e| (e.1, e.2) != first) {
                self.resolve(edge, &mut again);
            }
        }
        self.edges = edges;
        self.forbidden.sort_unstable();
        self.forbidden.dedup();
        if again.is_empty() {
            self.look_at_whole(&mut again);
        }
        self.once_each(again)
    }

    /// All edges, sorted; those of patches that have not changed are known.
    fn gathered_edges(&mut self) -> Vec<Edge> {
        let count = self.has_changed.len();
        let changed: Vec<u32> = (0..count as u32).filter(|&p| self.has_changed[p as usize]).collect();
        let mut fresh: Vec<Edge> = parallel::map(
            changed.len().div_ceil(BATCH),
            self.options.threads,
            || (),
            |_, batch| {
                let end = changed.len().min((batch + 1) * BATCH);
                changed[batch * BATCH..end].iter().flat_map(|&p| self.edges(p)).collect::<Vec<_>>()
            },
        )
        .concat();
        fresh.sort_unstable();
        let mut edges = std::mem::take(&mut self.edges);
        edges.retain(|edge| !self.has_changed[edge.3 as usize]);
        edges.extend(fresh);
        // Of two sorted runs a stable sort makes one.
        edges.sort();
        self.has_changed.fill(false);
        edges
    }

    fn edges(&self, patch: u32) -> Vec<Edge> {
        let connectivity = &self.mesh.connectivity;
        let mut edges = vec![];
        if self.kept[patch as usize] {
            for &t in self.members(patch) {
                for h in (3 * t..3 * t + 3).map(HalfedgeId) {
                    let ends = sorted(connectivity.origin(h), connectivity.target(h));
                    edges.push((ends, Kind::Own, connectivity.edge(h).0, patch));
                }
            }
            return edges;
        }
        let polygon = self.polygon(patch);
        let mut border: Vec<[VertexId; 2]> = vec![];
        for (c, corner) in polygon.corners.iter().enumerate() {
            let ends = sorted(corner.vertex, polygon.corners[corner.next].vertex);
            let (mut length, mut least) = (0, u32::MAX);
            for h in polygon.chord(c) {
                (length, least) = (length + 1, least.min(connectivity.edge(h).0));
            }
            edges.push((ends, if length == 1 { Kind::Own } else { Kind::Chord }, least, patch));
            border.push(ends);
        }
        border.sort_unstable();
        for (triangle, _) in &self.triangles[patch as usize] {
            for side in 0..3 {
                let [a, b] = [triangle[side], triangle[(side + 1) % 3]].map(VertexId);
                // Once from each side.
                if a < b && border.binary_search(&[a, b]).is_err() {
                    edges.push(([a, b], Kind::Inner, patch, patch));
                }
            }
        }
        edges
    }

    fn members(&self, patch: u32) -> &[u32] {
        let (members, starts) = &self.members;
        &members[starts[patch as usize] as usize..starts[patch as usize + 1] as usize]
    }

    fn resolve(&mut self, &(ends, kind, least, patch): &Edge, again: &mut Vec<u32>) {
        self.tries[patch as usize] = self.tries[patch as usize].saturating_add(1);
        if self.tries[patch as usize] > 2 * MOST_TRIES {
            return self.keep(patch, again);
        }
        match kind {
            Kind::Own => {}
            Kind::Inner => {
                self.forbidden.push((patch, ends));
                again.push(patch);
            }
            Kind::Chord => {
                let polygon = self.polygon(patch);
                let edge = |h| self.mesh.connectivity.edge(h).0;
                let chord =
                    (0..polygon.corners.len()).find(|&c| polygon.chord(c).map(edge).min() == Some(least));
                let vertex = chord.and_then(|c| polygon.farthest(self.mesh, c));
                if let Some((v, _)) = vertex {
                    self.put_back(v, again);
                }
            }
        }
    }

    /// Single edges are sound by now; two triangles back to back are not, and nothing else may be wrong.
    fn look_at_whole(&mut self, again: &mut Vec<u32>) {
        let (vertices, triangles, _, patch) = self.output();
        let wrong = match Connectivity::from_triangles(vertices.len(), &triangles) {
            Ok(_) => return,
            Err(KernelError::SameVertices(pairs)) => pairs.into_iter().flatten().collect::<Vec<u32>>(),
            Err(KernelError::PinchedVertices(pinched)) => (0..triangles.len() as u32)
                .filter(|&t| triangles[t as usize].iter().any(|v| pinched.binary_search(v).is_ok()))
                .collect(),
            Err(_) => (0..triangles.len() as u32).collect(),
        };
        let mut concerned: Vec<u32> = wrong.iter().map(|&t| patch[t as usize]).collect();
        concerned.sort_unstable();
        concerned.dedup();
        concerned.retain(|&p| !self.kept[p as usize]);
        for number in concerned {
            let relief = self.relieved(number, &self.polygon(number), &[]);
            match relief {
                Outcome::PutBack(vertices) => {
                    self.tries[number as usize] += 1;
                    vertices.into_iter().for_each(|v| self.put_back(v, again));
                }
                _ => self.keep(number, again),
            }
            again.push(number);
        }
        // What is kept has changed the result even where nothing is left to be done again.
        if self.once_each(again.clone()).is_empty() {
            self.look_at_whole(again);
        }
    }

    /// How far the surfaces are apart in each patch at most, in shape and in colour.
    fn bounds(&self) -> Vec<[f64; 2]> {
        let mut bounds = vec![[0.0; 2]; self.patches.patches.len()];
        parallel::fill(&mut bounds, self.options.threads, |p| {
            let patch: &Patch = &self.patches.patches[p];
            if self.kept[p] {
                return [0.0; 2];
            }
            let polygon = self.polygon(p as u32);
            let away = (0..polygon.corners.len()).filter_map(|c| polygon.farthest(self.mesh, c));
            let aside = away.map(|(_, away)| away).fold(0.0, f64::max);
            [patch.thickness().hypot(aside), 2.0 * patch.residual + patch.gradient * aside]
        });
        bounds
    }

    #[allow(clippy::type_complexity)]
    fn output(&self) -> (Vec<u32>, Vec<[u32; 3]>, Vec<u32>, Vec<u32>) {
        let connectivity = &self.mesh.connectivity;
        let (mut triangles, mut sources, mut patch) = (vec![], vec![], vec![]);
        for p in 0..self.patches.patches.len() as u32 {
            if self.kept[p as usize] {
                for &t in self.members(p) {
                    triangles.push(connectivity.corners(TriangleId(t)).map(|v| v.0));
                    sources.push(t);
                }
            } else {
                for &(triangle, source) in &self.triangles[p as usize] {
                    triangles.push(triangle);
                    sources.push(source);
                }
            }
            patch.resize(triangles.len(), p);
        }
        let mut number = vec![u32::MAX; self.mesh.points.len()];
        triangles.iter().flatten().for_each(|&v| number[v as usize] = 0);
        let mut vertices = vec![];
        for (v, number) in number.iter_mut().enumerate().filter(|(_, n)| **n == 0) {
            *number = vertices.len() as u32;
            vertices.push(v as u32);
        }
        triangles.iter_mut().flatten().for_each(|v| *v = number[*v as usize]);
        sources.iter_mut().for_each(|t| *t = self.mesh.triangle_source[*t as usize]);
        (vertices, triangles, sources, patch)
    }
}
