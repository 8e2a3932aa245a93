//! Main loop: grow patches, assemble them, and split folded patches.

use super::assembly_loop::{self, AssemblyResult, EarlierAssembly};
use super::patches::{Options, PlanarMesh, compute_facets};
use super::segmentation;
use crate::base::errors::KernelError;
use crate::base::progress::Progress;
use crate::mesh::triangle_mesh::Mesh;

/// Simplify a mesh. Triangles around locked vertices are kept.
///
/// # Errors
/// [`KernelError::Interrupted`].
pub fn simplify<const D: usize, const K: usize>(
    mesh: &Mesh<D>,
    options: &Options,
    progress: &mut Progress,
) -> Result<PlanarMesh, KernelError> {
    let facets = compute_facets(mesh, options.threads);
    let mut patches = segmentation::segment_patches::<D, K>(mesh, &facets, options, progress)?;
    let mut known = None;
    loop {
        match assembly_loop::assemble(mesh, patches, options, known, progress)? {
            AssemblyResult::Complete(planar) => return Ok(*planar),
            AssemblyResult::Folded { patches: found, is_folded, first } => {
                let was;
                (patches, was) = segmentation::split_folded_patches::<D, K>(
                    mesh, &facets, &found, &is_folded, options, progress,
                )?;
                known = Some(EarlierAssembly { earlier_index: was, first_round: first });
            }
        }
    }
}
