//! Assembly of all patches: triangulate each, and restore border vertices until the result is manifold.
//!
//! Vertices are only ever restored, and a patch that cannot be triangulated keeps its triangles. The loop
//! therefore terminates, in the worst case with the input mesh.

use std::sync::OnceLock;

use super::assembly_state::{Assembly, BATCH};
use super::border::trace_borders;
use super::border_straightening::straighten_borders;
use super::patch_triangulation::Outcome;
use super::patches::{Options, Patches, PlanarMesh};
use super::separation_reasons;
use crate::base::errors::KernelError;
use crate::base::ids::HalfedgeId;
use crate::base::parallel;
use crate::base::progress::Progress;
use crate::mesh::triangle_mesh::Mesh;

/// Result of an assembly.
pub enum AssemblyResult {
    Complete(Box<PlanarMesh>),
    /// Some patches overlap themselves in the projection along their normals.
    Folded {
        patches: Patches,
        is_folded: Vec<bool>,
        first: FirstRound,
    },
}

/// Results of the first round, before patches are made consistent with each other.
pub struct FirstRound {
    /// True for border vertices that are kept.
    stays: Vec<bool>,
    outcomes: Vec<Outcome>,
}

/// Results of an earlier assembly, of which some patches have been split since.
pub struct EarlierAssembly {
    /// Index of each patch in the earlier assembly; None for new patches.
    pub earlier_index: Vec<Option<u32>>,
    pub first_round: FirstRound,
}

/// Assemble the patches into a mesh. With results of an earlier assembly (`known`), patches that overlap
/// themselves keep their triangles.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn assemble<const D: usize>(
    mesh: &Mesh<D>,
    patches: Patches,
    options: &Options,
    mut known: Option<EarlierAssembly>,
    progress: &mut Progress,
) -> Result<AssemblyResult, KernelError> {
    let is_last = known.is_some();
    let borders = trace_borders(&mesh.connectivity, &patches, options.threads, progress)?;
    let before =
        known.as_ref().map(|known| (known.first_round.stays.as_slice(), known.earlier_index.as_slice()));
    let stays = straighten_borders(mesh, &patches, &borders, before, options, progress)?;
    let count = patches.patches.len();
    let mut assembly = Assembly {
        mesh,
        options,
        members: OnceLock::new(),
        patches: &patches,
        borders: &borders,
        stays,
        keeps_triangles: vec![false; count],
        is_folded: vec![false; count],
        attempt_counts: vec![0; count],
        forbidden: vec![],
        triangles: vec![vec![]; count],
        edges: vec![],
        has_changed: vec![true; count],
        rounds: 0,
    };
    let stays = if is_last { vec![] } else { assembly.stays.clone() };
    let mut first = FirstRound { stays, outcomes: vec![] };
    let mut open: Vec<u32> = (0..count as u32).collect();
    while !open.is_empty() {
        let outcomes = assembly.triangulate_patches(&open, known.take().as_ref(), progress)?;
        if assembly.rounds == 1 && !is_last {
            first.outcomes = outcomes.clone();
        }
        open = assembly.store_outcomes(&open, outcomes);
        if open.is_empty() && !is_last && assembly.is_folded.contains(&true) {
            let is_folded = assembly.is_folded;
            return Ok(AssemblyResult::Folded { patches, is_folded, first });
        }
        if open.is_empty() {
            open = assembly.resolve_conflicts();
        }
    }
    let bounds = assembly.compute_bounds();
    let refused = separation_reasons::count_reasons(mesh, &patches, &borders, options);
    let (vertex_source, triangles, triangle_source, triangle_patch) = assembly.build_output();
    let (kept, rounds) = (assembly.keeps_triangles, assembly.rounds);
    Ok(AssemblyResult::Complete(Box::new(PlanarMesh {
        triangles,
        vertex_source,
        triangle_source,
        triangle_patch,
        patches,
        bounds,
        keeps_triangles: kept,
        separation_counts: refused,
        rounds,
    })))
}

impl<const D: usize> Assembly<'_, D> {
    /// Triangulate some patches in parallel.
    fn triangulate_patches(
        &mut self,
        open: &[u32],
        known: Option<&EarlierAssembly>,
        progress: &Progress,
    ) -> Result<Vec<Outcome>, KernelError> {
        self.rounds += 1;
        let outcome = |&p: &u32| self.find_earlier_outcome(p, known).unwrap_or_else(|| self.retriangulate(p));
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

    /// Look up the earlier result of a patch, if the patch and its kept border vertices are unchanged.
    fn find_earlier_outcome(&self, patch: u32, known: Option<&EarlierAssembly>) -> Option<Outcome> {
        let known = known?;
        let was = known.earlier_index[patch as usize]?;
        let mut border = self.borders.trace_patch_loops(patch as usize).flatten();
        let is_same = |&h: &HalfedgeId| {
            let v = self.mesh.connectivity.origin(h).index();
            self.stays[v] == known.first_round.stays[v]
        };
        border.all(is_same).then(|| known.first_round.outcomes[was as usize].clone())
    }

    /// Store the results of some patches. Returns the patches that must be triangulated again.
    fn store_outcomes(&mut self, open: &[u32], outcomes: Vec<Outcome>) -> Vec<u32> {
        let mut again = vec![];
        for (&patch, outcome) in open.iter().zip(outcomes) {
            self.has_changed[patch as usize] = true;
            match outcome {
                Outcome::Triangulated(triangles) => self.triangles[patch as usize] = triangles,
                Outcome::Restore(vertices) => {
                    self.attempt_counts[patch as usize] += 1;
                    again.push(patch);
                    vertices.into_iter().for_each(|v| self.restore_vertex(v, &mut again));
                }
                Outcome::RestoreDistant(vertices) => {
                    again.push(patch);
                    vertices.into_iter().for_each(|v| self.restore_vertex(v, &mut again));
                }
                Outcome::Keep => self.keep_patch(patch, &mut again),
                Outcome::Untriangulable => {
                    self.is_folded[patch as usize] = self.patches.patches[patch as usize].faces > 1;
                    self.keep_patch(patch, &mut again);
                }
            }
        }
        self.sort_unique(again)
    }
}
