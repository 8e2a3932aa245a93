//! Simplification within bounds: attribute quadrics say which edge goes next and where it goes to, samples of
//! the input say whether it may.

use super::original::Original;
use super::tracker::{Bound, LEAST_HEIGHT, Limits, Lists, SAMPLES, Sampled, Tracker};
use crate::base::ids::EdgeId;
use crate::collapse::engine::{Collapsed, Measure, Proposal, Reach};
use crate::collapse::records::Records;
use crate::mesh::legality::keeps_triangles;
use crate::mesh::star::Star;
use crate::mesh::triangle_mesh::Mesh;
use crate::quadric::qem::{Qem, QemRecords};

/// What else is asked of a collapse.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// No edge may come to join two locked vertices that none joins yet: see [`crate::mesh::legality::new_chord`].
    pub without_chords: bool,
    /// Coordinates are those that single precision has.
    pub single: bool,
    /// Height over longest side below which no triangle may come.
    pub needle: f64,
}

impl Default for Rules {
    fn default() -> Self {
        Self { without_chords: false, single: false, needle: LEAST_HEIGHT }
    }
}

pub struct Tracked<'a, const D: usize, const K: usize> {
    qem: Qem<D, K>,
    tracker: Tracker<'a, D>,
    rules: Rules,
}

/// Colours are 8-bit levels: what is proven of them must hold for what is stored.
#[inline]
fn rounded<const D: usize>(point: &[f64; D], single: bool) -> [f64; D] {
    std::array::from_fn(|i| match i {
        0..3 if single => f64::from(point[i] as f32),
        0..3 => point[i],
        _ => point[i].round().clamp(0.0, 255.0),
    })
}

impl<const D: usize, const K: usize> Measure<D> for Tracked<'_, D, K> {
    type Bound = Bound;
    type Change = ();

    const REACH: Reach = Reach::Ring;

    fn without_chords(&self) -> bool {
        self.rules.without_chords
    }

    #[inline]
    fn priority(&self, mesh: &Mesh<D>, edge: EdgeId) -> Result<f64, Bound> {
        self.qem.priority(mesh, edge).map_err(|()| Bound::Shape)
    }

    fn propose(&mut self, mesh: &Mesh<D>, star: &Star<D>) -> Result<Proposal<D, ()>, Bound> {
        let proposal = self.qem.propose(mesh, star).map_err(|()| Bound::Shape)?;
        let point = match star.end_stays {
            [true, _] => star.end_points[0],
            [_, true] => star.end_points[1],
            _ => rounded(&proposal.point, self.rules.single),
        };
        Ok(Proposal { point, ..proposal })
    }

    fn judge(&mut self, _: &Mesh<D>, star: &Star<D>, proposal: &mut Proposal<D, ()>) -> Result<(), Bound> {
        self.tracker.gather(star);
        let refused = self.tracker.allows(star, &proposal.point);
        if refused.is_ok() || star.end_stays != [false, false] {
            return refused;
        }
        for other in [star.end_points[proposal.survivor], star.end_points[1 - proposal.survivor]] {
            if keeps_triangles(star, &other).is_ok() && self.tracker.allows(star, &other).is_ok() {
                proposal.point = other;
                return Ok(());
            }
        }
        refused
    }

    fn commit(&mut self, mesh: &Mesh<D>, star: &Star<D>, collapsed: &Collapsed, (): ()) {
        self.qem.commit(mesh, star, collapsed, ());
        self.tracker.commit(star);
    }
}

/// Which samples belong to which triangle of the whole mesh, and what they may do.
pub struct TrackedRecords<'a, const D: usize, const K: usize> {
    qem: QemRecords<K>,
    original: &'a Original<D>,
    limits: &'a Limits,
    pub lists: Lists,
    rules: Rules,
}

impl<'a, const D: usize, const K: usize> TrackedRecords<'a, D, K> {
    /// Records of a mesh with the importance of its vertices, or none.
    pub fn new(
        original: &'a Original<D>,
        limits: &'a Limits,
        weight: f64,
        importance: Vec<f64>,
        lists: Lists,
        rules: Rules,
    ) -> Self {
        Self { qem: QemRecords { weight, importance }, original, limits, lists, rules }
    }
}

/// What is left of a region's quadrics and samples.
pub struct TrackedRemains {
    importance: Vec<f64>,
    sampled: Sampled,
}

impl<'a, const D: usize, const K: usize> Records<D> for TrackedRecords<'a, D, K> {
    type Measure = Tracked<'a, D, K>;
    type Remains = TrackedRemains;

    fn size(&self, triangles: usize) -> usize {
        triangles + self.lists.samples.len() / SAMPLES
    }

    fn load(&self, region: &Mesh<D>) -> Tracked<'a, D, K> {
        Tracked {
            qem: self.qem.load(region),
            tracker: Tracker::load(self.original, self.limits, &self.lists, region),
            rules: self.rules,
        }
    }

    fn untouched(&self, triangles: &[u32], inside: &[u32]) -> Option<TrackedRemains> {
        let importance = <QemRecords<K> as Records<D>>::untouched(&self.qem, triangles, inside)?;
        Some(TrackedRemains { importance, sampled: self.lists.untouched(triangles) })
    }

    fn unload(measure: Tracked<'a, D, K>, region: &Mesh<D>) -> TrackedRemains {
        let sampled = measure.tracker.unload(region);
        TrackedRemains { importance: <QemRecords<K> as Records<D>>::unload(measure.qem, region), sampled }
    }

    fn join(self, rim: &[u32], pieces: Vec<TrackedRemains>) -> Self {
        let (importance, sampled) = pieces.into_iter().map(|p| (p.importance, p.sampled)).unzip();
        let qem = <QemRecords<K> as Records<D>>::join(self.qem, rim, importance);
        Self { qem, lists: self.lists.join(sampled), ..self }
    }
}
