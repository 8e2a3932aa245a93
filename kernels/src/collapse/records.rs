//! What a method knows of the whole mesh from round to round.

use crate::collapse::engine::Measure;
use crate::mesh::triangle_mesh::Mesh;

/// What a measure remembers of the whole mesh.
pub trait Records<const D: usize>: Sized + Send + Sync {
    type Measure: Measure<D> + Send;
    /// What is left of a region's records.
    type Remains: Send;

    /// Whether all merges of a run are kept, also where nobody asks for them.
    const KEEPS_MERGES: bool = true;

    /// How much there is to look at in a mesh of so many triangles, counted in triangles of their own.
    fn size(&self, triangles: usize) -> usize {
        triangles
    }

    /// Leave to no region alone what must be seen together, and is in several: `owner` says for each vertex which region
    /// it is of.
    fn keep_together(&self, _owner: &mut [u32]) {}

    /// A measure for a region, whose sources are numbers of the whole mesh.
    fn load(&self, region: &Mesh<D>) -> Self::Measure;

    /// What [`Self::load`] and [`Self::unload`] make of a region in which nothing happens, given its triangles and the
    /// vertices that are not on the rim; none if that is not known without a mesh.
    fn untouched(&self, _triangles: &[u32], _inside: &[u32]) -> Option<Self::Remains> {
        None
    }

    /// Records of the vertices that are not on the rim, and of the triangles, in their order.
    fn unload(measure: Self::Measure, region: &Mesh<D>) -> Self::Remains;

    /// Records of the next whole mesh: its vertices are those of `rim` (numbers of this one), then those of
    /// each region.
    fn join(self, rim: &[u32], remains: Vec<Self::Remains>) -> Self;
}
