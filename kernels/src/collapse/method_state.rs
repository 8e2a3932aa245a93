//! State of a simplification method for the whole mesh, between rounds.

use crate::collapse::engine::Measure;
use crate::mesh::triangle_mesh::Mesh;

/// State of a measure for the whole mesh.
pub trait MethodState<const D: usize>: Sized + Send + Sync {
    type Measure: Measure<D> + Send;
    /// State of a region after simplification.
    type RegionState: Send;

    /// Keep the merges of all rounds, even if they are not requested.
    const KEEPS_MERGES: bool = true;

    /// Return the workload of a mesh, in units of triangles; it determines the number of regions.
    fn workload(&self, triangles: usize) -> usize {
        triangles
    }

    /// Mark vertices that must be processed together but belong to several regions.
    ///
    /// `owner` is the region of each vertex; such vertices become shared.
    fn share_linked_vertices(&self, _owner: &mut [u32]) {}

    /// Create the measure of a region. Sources in `region` are indices in the whole mesh.
    fn load_region(&self, region: &Mesh<D>) -> Self::Measure;

    /// Compute the result of [`Self::load_region`] and [`Self::unload_region`] for a region without collapses.
    ///
    /// `triangles` are its triangles, `inside` its vertices that are not on the rim. `None` if a mesh is
    /// needed to compute it.
    fn unchanged_region(&self, _triangles: &[u32], _inside: &[u32]) -> Option<Self::RegionState> {
        None
    }

    /// Return the state of a simplified region, in mesh order.
    ///
    /// It contains the vertices that are not on the rim, and the triangles.
    fn unload_region(measure: Self::Measure, region: &Mesh<D>) -> Self::RegionState;

    /// Join the regions to the state of the next mesh.
    ///
    /// Its vertices are `rim` (indices in this mesh), followed by the vertices of each region.
    fn join_regions(self, rim: &[u32], remains: Vec<Self::RegionState>) -> Self;
}
