//! Certified simplification by attribute quadrics.
//!
//! The quadrics choose the next edge and the new position; the samples of the input decide if the collapse is
//! allowed.

use super::original::Original;
use super::tracker::{Bound, LEAST_HEIGHT, Limits, Lists, SAMPLES, Sampled, Tracker};
use crate::base::ids::EdgeId;
use crate::collapse::engine::{Collapsed, Measure, Proposal, Reach};
use crate::collapse::records::Records;
use crate::mesh::legality::keeps_triangles;
use crate::mesh::star::Star;
use crate::mesh::triangle_mesh::Mesh;
use crate::quadric::qem::{Qem, QemRecords};

/// Additional constraints on collapses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// No new edge may join two locked vertices: see [`crate::mesh::legality::new_chord`].
    pub without_chords: bool,
    /// Round coordinates to single precision.
    pub single: bool,
    /// Minimum ratio of height to longest side of any new triangle.
    pub needle: f64,
}

impl Default for Rules {
    fn default() -> Self {
        Self { without_chords: false, single: false, needle: LEAST_HEIGHT }
    }
}

/// Measure of a region: attribute quadrics plus sample limits.
pub struct Tracked<'a, const D: usize, const K: usize> {
    qem: Qem<D, K>,
    tracker: Tracker<'a, D>,
    rules: Rules,
}

/// Round a new vertex to what the file can store.
///
/// Colours are 8-bit levels, and the proof must hold for the stored values.
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

/// Samples of each triangle of the whole mesh, and their limits.
pub struct TrackedRecords<'a, const D: usize, const K: usize> {
    qem: QemRecords<K>,
    original: &'a Original<D>,
    limits: &'a Limits,
    pub lists: Lists,
    rules: Rules,
}

impl<'a, const D: usize, const K: usize> TrackedRecords<'a, D, K> {
    /// Create the records of a mesh; `importance` is by vertex, or empty.
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

/// Importance and samples that remain of a region.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collapse::engine::Refusal;
    use crate::collapse::partition::Partition;
    use crate::collapse::region::{Remains, SHARED, Scratch, find_owners};
    use crate::collapse::whole::Whole;
    use crate::mesh::legality::Illegal;

    /// Create a grid of 6 × 6 squares with locked vertices, in which every edge is refused.
    fn idle() -> Whole<3, Bound> {
        let points: Vec<[f64; 3]> =
            (0..49).map(|v| [f64::from(v % 7), f64::from(v / 7), f64::from(v * v % 5)]).collect();
        let corners = (0..36).map(|i| 7 * (i / 6) + i % 6);
        let triangles: Vec<[u32; 3]> = corners.flat_map(|v| [[v, v + 1, v + 8], [v, v + 8, v + 7]]).collect();
        let locked = (0..49).map(|v| v % 3 == 0).collect();
        let mut whole = Whole::new(points, triangles, locked).unwrap();
        whole.refused = vec![[Some(Refusal::Illegal(Illegal::Fold)); 3]; whole.triangles.len()];
        whole.triangle_source.iter_mut().for_each(|t| *t += 100);
        whole.vertex_source.iter_mut().for_each(|v| *v += 50);
        whole
    }

    #[test]
    fn what_nothing_happens_to_is_left_as_if_it_had_been_worked_on() {
        let given = idle();
        let original = Original::new(given.points.clone(), given.triangles.clone());
        let limits = Limits { shape: 1.0, color: 1.0, factors: vec![1.0; 49], needle: LEAST_HEIGHT };
        let partition = Partition::new(&given.points, &given.triangles, 3, 0, 1);
        let owner = find_owners(49, &given.triangles, &partition, 1);
        let rim: Vec<bool> = owner.into_iter().map(|owner| owner == SHARED).collect();
        let both = [false, true].map(|soon| {
            let whole = idle();
            let importance = (0..49).map(f64::from).collect();
            // Put all samples into a few triangles, so that their order matters.
            let mut lists = Lists { starts: vec![0; 73], samples: (0..49).collect() };
            lists.starts[10..].iter_mut().for_each(|s| *s = 20);
            lists.starts[50..].iter_mut().for_each(|s| *s = 49);
            let records =
                TrackedRecords::<3, 0>::new(&original, &limits, 0.0, importance, lists, Rules::default());
            let mut scratch = Scratch::new(49);
            let remains = (0..partition.len())
                .map(|p| {
                    let region = partition.region(p);
                    assert!(whole.is_idle(region, &rim));
                    if soon {
                        return whole.untouched(region, &rim, &records, &mut scratch).unwrap();
                    }
                    let (mesh, refusals) = whole.cut(region, &rim, &mut scratch).unwrap();
                    let left = TrackedRecords::unload(records.load(&mesh), &mesh);
                    Remains::new(&mesh, &whole, |edge| refusals[edge.index()], &[], None, left)
                })
                .collect();
            let (whole, records) = whole.join(&rim, records, remains, 1);
            let Whole { points, triangles, vertex_source, triangle_source, locked, refused } = whole;
            let of_mesh = (points, triangles, vertex_source, triangle_source, locked, refused);
            (of_mesh, records.qem.importance, records.lists.starts, records.lists.samples)
        });
        assert_eq!(both[0], both[1]);
        let mut open = idle();
        open.refused[40][1] = None;
        let all: Vec<u32> = (0..72).collect();
        assert!(!open.is_idle(&all, &[false; 49]) && open.is_idle(&all, &[true; 49]));
    }
}
