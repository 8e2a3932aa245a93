//! Certified simplification by attribute quadrics.
//!
//! The quadrics choose the next edge and the new position; the samples of the input decide if the collapse is
//! allowed.

use super::input_surface::InputSurface;
use super::sample_tracker::{
    DEFAULT_MIN_NEEDLE_RATIO, LimitKind, RegionSamples, SAMPLES_PER_TRIANGLE_COST, SampleLimits, SampleLists,
    SampleTracker,
};
use crate::base::ids::EdgeId;
use crate::collapse::engine::{CollapseChange, Measure, PriorityScope, Proposal};
use crate::collapse::method_state::MethodState;
use crate::mesh::collapse_legality::check_triangles;
use crate::mesh::edge_star::EdgeStar;
use crate::mesh::triangle_mesh::Mesh;
use crate::quadric::qem::{Qem, QemState};

/// Additional constraints on collapses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// No new edge may join two locked vertices: see [`crate::mesh::collapse_legality::find_new_chord`].
    pub forbid_chords: bool,
    /// Round coordinates to single precision.
    pub single_precision: bool,
    /// Minimum ratio of height to longest side of any new triangle.
    pub min_needle_ratio: f64,
}

impl Default for Rules {
    fn default() -> Self {
        Self { forbid_chords: false, single_precision: false, min_needle_ratio: DEFAULT_MIN_NEEDLE_RATIO }
    }
}

/// Measure of a region: attribute quadrics plus sample limits.
pub struct BoundedQem<'a, const D: usize, const K: usize> {
    qem: Qem<D, K>,
    tracker: SampleTracker<'a, D>,
    rules: Rules,
}

/// Round a new vertex to what the file can store.
///
/// Colours are 8-bit levels, and the proof must hold for the stored values.
#[inline]
fn round_to_stored<const D: usize>(point: &[f64; D], single: bool) -> [f64; D] {
    std::array::from_fn(|i| match i {
        0..3 if single => f64::from(point[i] as f32),
        0..3 => point[i],
        _ => point[i].round().clamp(0.0, 255.0),
    })
}

impl<const D: usize, const K: usize> Measure<D> for BoundedQem<'_, D, K> {
    type Reason = LimitKind;
    type Change = ();

    const PRIORITY_SCOPE: PriorityScope = PriorityScope::Ring;

    fn forbids_chords(&self) -> bool {
        self.rules.forbid_chords
    }

    #[inline]
    fn priority(&self, mesh: &Mesh<D>, edge: EdgeId) -> Result<f64, LimitKind> {
        self.qem.priority(mesh, edge).map_err(|()| LimitKind::Shape)
    }

    fn propose(&mut self, mesh: &Mesh<D>, star: &EdgeStar<D>) -> Result<Proposal<D, ()>, LimitKind> {
        let proposal = self.qem.propose(mesh, star).map_err(|()| LimitKind::Shape)?;
        let point = match star.end_is_fixed {
            [true, _] => star.end_points[0],
            [_, true] => star.end_points[1],
            _ => round_to_stored(&proposal.point, self.rules.single_precision),
        };
        Ok(Proposal { point, ..proposal })
    }

    fn judge(
        &mut self,
        _: &Mesh<D>,
        star: &EdgeStar<D>,
        proposal: &mut Proposal<D, ()>,
    ) -> Result<(), LimitKind> {
        self.tracker.gather_samples(star);
        let refused = self.tracker.check(star, &proposal.point);
        if refused.is_ok() || star.end_is_fixed != [false, false] {
            return refused;
        }
        for other in [star.end_points[proposal.survivor], star.end_points[1 - proposal.survivor]] {
            if check_triangles(star, &other).is_ok() && self.tracker.check(star, &other).is_ok() {
                proposal.point = other;
                return Ok(());
            }
        }
        refused
    }

    fn commit(&mut self, mesh: &Mesh<D>, star: &EdgeStar<D>, collapsed: &CollapseChange, (): ()) {
        self.qem.commit(mesh, star, collapsed, ());
        self.tracker.commit(star);
    }
}

/// Samples of each triangle of the whole mesh, and their limits.
pub struct BoundedQemState<'a, const D: usize, const K: usize> {
    qem: QemState<K>,
    original: &'a InputSurface<D>,
    limits: &'a SampleLimits,
    pub lists: SampleLists,
    rules: Rules,
}

impl<'a, const D: usize, const K: usize> BoundedQemState<'a, D, K> {
    /// Create the records of a mesh; `importance` is by vertex, or empty.
    pub fn new(
        original: &'a InputSurface<D>,
        limits: &'a SampleLimits,
        weight: f64,
        importance: Vec<f64>,
        lists: SampleLists,
        rules: Rules,
    ) -> Self {
        Self { qem: QemState { weight, importance }, original, limits, lists, rules }
    }
}

/// Importance and samples that remain of a region.
pub struct BoundedQemRegion {
    importance: Vec<f64>,
    sampled: RegionSamples,
}

impl<'a, const D: usize, const K: usize> MethodState<D> for BoundedQemState<'a, D, K> {
    type Measure = BoundedQem<'a, D, K>;
    type RegionState = BoundedQemRegion;

    fn workload(&self, triangles: usize) -> usize {
        triangles + self.lists.samples.len() / SAMPLES_PER_TRIANGLE_COST
    }

    fn load_region(&self, region: &Mesh<D>) -> BoundedQem<'a, D, K> {
        BoundedQem {
            qem: self.qem.load_region(region),
            tracker: SampleTracker::load(self.original, self.limits, &self.lists, region),
            rules: self.rules,
        }
    }

    fn unchanged_region(&self, triangles: &[u32], inside: &[u32]) -> Option<BoundedQemRegion> {
        let importance = <QemState<K> as MethodState<D>>::unchanged_region(&self.qem, triangles, inside)?;
        Some(BoundedQemRegion { importance, sampled: self.lists.unchanged_region(triangles) })
    }

    fn unload_region(measure: BoundedQem<'a, D, K>, region: &Mesh<D>) -> BoundedQemRegion {
        let sampled = measure.tracker.unload(region);
        BoundedQemRegion {
            importance: <QemState<K> as MethodState<D>>::unload_region(measure.qem, region),
            sampled,
        }
    }

    fn join_regions(self, rim: &[u32], pieces: Vec<BoundedQemRegion>) -> Self {
        let (importance, sampled) = pieces.into_iter().map(|p| (p.importance, p.sampled)).unzip();
        let qem = <QemState<K> as MethodState<D>>::join_regions(self.qem, rim, importance);
        Self { qem, lists: self.lists.join(sampled), ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collapse::engine::Refusal;
    use crate::collapse::partition::Partition;
    use crate::collapse::region::{SHARED, Scratch, SimplifiedRegion, find_owners};
    use crate::collapse::whole_mesh::WholeMesh;
    use crate::mesh::collapse_legality::IllegalCollapse;

    /// Create a grid of 6 × 6 squares with locked vertices, in which every edge is refused.
    fn mesh_with_refused_edges() -> WholeMesh<3, LimitKind> {
        let points: Vec<[f64; 3]> =
            (0..49).map(|v| [f64::from(v % 7), f64::from(v / 7), f64::from(v * v % 5)]).collect();
        let corners = (0..36).map(|i| 7 * (i / 6) + i % 6);
        let triangles: Vec<[u32; 3]> = corners.flat_map(|v| [[v, v + 1, v + 8], [v, v + 8, v + 7]]).collect();
        let locked = (0..49).map(|v| v % 3 == 0).collect();
        let mut whole = WholeMesh::new(points, triangles, locked).unwrap();
        whole.refused = vec![[Some(Refusal::Illegal(IllegalCollapse::Fold)); 3]; whole.triangles.len()];
        whole.triangle_source.iter_mut().for_each(|t| *t += 100);
        whole.vertex_source.iter_mut().for_each(|v| *v += 50);
        whole
    }

    #[test]
    fn unchanged_regions_equal_processed_regions() {
        let given = mesh_with_refused_edges();
        let original = InputSurface::new(given.points.clone(), given.triangles.clone());
        let limits = SampleLimits {
            shape: 1.0,
            color: 1.0,
            factors: vec![1.0; 49],
            min_needle_ratio: DEFAULT_MIN_NEEDLE_RATIO,
        };
        let partition = Partition::new(&given.points, &given.triangles, 3, 0, 1);
        let owner = find_owners(49, &given.triangles, &partition, 1);
        let rim: Vec<bool> = owner.into_iter().map(|owner| owner == SHARED).collect();
        let both = [false, true].map(|soon| {
            let whole = mesh_with_refused_edges();
            let importance = (0..49).map(f64::from).collect();
            // Put all samples into a few triangles, so that their order matters.
            let mut lists = SampleLists { starts: vec![0; 73], samples: (0..49).collect() };
            lists.starts[10..].iter_mut().for_each(|s| *s = 20);
            lists.starts[50..].iter_mut().for_each(|s| *s = 49);
            let records =
                BoundedQemState::<3, 0>::new(&original, &limits, 0.0, importance, lists, Rules::default());
            let mut scratch = Scratch::new(49);
            let remains = (0..partition.len())
                .map(|p| {
                    let region = partition.region(p);
                    assert!(whole.is_idle(region, &rim));
                    if soon {
                        return whole.unchanged_region(region, &rim, &records, &mut scratch).unwrap();
                    }
                    let (mesh, refusals) = whole.cut_region(region, &rim, &mut scratch).unwrap();
                    let left = BoundedQemState::unload_region(records.load_region(&mesh), &mesh);
                    SimplifiedRegion::new(&mesh, &whole, |edge| refusals[edge.index()], &[], None, left)
                })
                .collect();
            let (whole, records) = whole.join_regions(&rim, records, remains, 1);
            let WholeMesh { points, triangles, vertex_source, triangle_source, locked, refused } = whole;
            let of_mesh = (points, triangles, vertex_source, triangle_source, locked, refused);
            (of_mesh, records.qem.importance, records.lists.starts, records.lists.samples)
        });
        assert_eq!(both[0], both[1]);
        let mut open = mesh_with_refused_edges();
        open.refused[40][1] = None;
        let all: Vec<u32> = (0..72).collect();
        assert!(!open.is_idle(&all, &[false; 49]) && open.is_idle(&all, &[true; 49]));
    }
}
