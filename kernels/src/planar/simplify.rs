//! Main loop: grow patches, assemble them, and split folded patches.

use super::assemble::{self, Assembled, Known};
use super::patches::{Options, Planar, facets};
use super::propagate;
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
) -> Result<Planar, KernelError> {
    let facets = facets(mesh, options.threads);
    let mut patches = propagate::propagate::<D, K>(mesh, &facets, options, progress)?;
    let mut known = None;
    loop {
        match assemble::assemble(mesh, patches, options, known, progress)? {
            Assembled::Whole(planar) => return Ok(*planar),
            Assembled::Folded { patches: found, is_folded, first } => {
                let was;
                (patches, was) =
                    propagate::separate::<D, K>(mesh, &facets, &found, &is_folded, options, progress)?;
                known = Some(Known { was, first });
            }
        }
    }
}
