//! Splitting of long edges: the first phase of JIA01 (step 1), which evens out edge lengths.

use crate::base::errors::KernelError;
use crate::base::geometry::distance2;
use crate::base::ids::EdgeId;
use crate::base::memory_reserve::Reserve;
use crate::base::progress::Progress;
use crate::collapse::edge_queue::EdgeQueue;
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::Mesh;

/// Split every edge longer than `longest` at its midpoint, longest first. Returns the number of splits.
///
/// # Errors
/// [`KernelError::TooManyTriangles`], before any split if that can be predicted.
pub fn split_long_edges<const D: usize>(
    mesh: &mut Mesh<D>,
    longest: f64,
    triangle_limit: usize,
    progress: &mut Progress,
) -> Result<u64, KernelError> {
    let length = |mesh: &Mesh<D>, edge: EdgeId| {
        let [a, b] = mesh.connectivity.ends(edge);
        distance2(mesh.point(a), mesh.point(b)).sqrt()
    };
    let triangle_limit = triangle_limit.min(Connectivity::MAX_TRIANGLES);
    let foreseen = predict_triangle_count(mesh, longest, length);
    if foreseen > triangle_limit as f64 {
        return Err(KernelError::TooManyTriangles { wanted: foreseen, limit: triangle_limit });
    }
    let long = mesh.connectivity.edges().filter_map(|edge| {
        let length = length(mesh, edge);
        (length > longest).then_some((edge, -length))
    });
    let mut queue = EdgeQueue::new(mesh.connectivity.edge_slots(), long);
    let mut splits = 0;
    let mut reserve = Reserve::for_rows(0)?;
    while let Some(edge) = queue.pop() {
        if mesh.connectivity.triangle_count() + 2 > triangle_limit {
            let wanted = mesh.connectivity.triangle_count() as f64 + 2.0;
            return Err(KernelError::TooManyTriangles { wanted, limit: triangle_limit });
        }
        let new = mesh.split(edge);
        splits += 1;
        reserve.ensure_rows(2 * mesh.connectivity.triangle_count())?;
        for edge in [edge].into_iter().chain(new).filter(|e| e.is_some()) {
            let length = length(mesh, edge);
            if length > longest {
                queue.set(edge, -length);
            }
        }
        progress.check_periodically()?;
    }
    Ok(splits)
}

/// Compute a lower bound on the number of triangles after splitting.
///
/// An edge of length l becomes 2^⌈log2(l/L)⌉ edges, and each split bisects the adjacent triangles. New edges
/// across them may be long, too, but are not counted.
fn predict_triangle_count<const D: usize>(
    mesh: &Mesh<D>,
    longest: f64,
    length: impl Fn(&Mesh<D>, EdgeId) -> f64,
) -> f64 {
    let added = |edge| {
        let halvings = (length(mesh, edge) / longest).log2().ceil().max(0.0);
        let beside = if mesh.connectivity.is_boundary_edge(edge) { 1.0 } else { 2.0 };
        (halvings.exp2() - 1.0) * beside
    };
    mesh.connectivity.triangle_count() as f64 + mesh.connectivity.edges().map(added).sum::<f64>()
}
