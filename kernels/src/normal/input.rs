//! Input mesh, prepared for the vertex search.

use super::rounding::Samples;
use super::settings::Settings;
use super::surface::{Surface, SurfacePoint};
use super::vertex_attributes::VertexAttributes;
use crate::base::geometry::{Vec3, sub};

/// Original surface that a simplified input mesh approximates.
#[derive(Clone, Copy, Debug)]
pub struct OriginalSurface<'a> {
    pub from_points: &'a [Vec3],
    pub from_triangles: &'a [[u32; 3]],
}

/// Input mesh with its attributes, search structure and surface samples.
pub struct Input<'a> {
    pub points: Vec<Vec3>,
    pub triangles: &'a [[u32; 3]],
    pub attributes: &'a VertexAttributes,
    pub surface: Surface,
    pub slots: Vec<u32>,
    /// Surface point of each vertex: a corner of any triangle that uses it.
    pub surface_points: Vec<SurfacePoint>,
    /// Samples of the surface to approximate if no levels follow, and their mean squared distance from the
    /// input mesh.
    pub samples: Samples,
    pub sample_distance2: f64,
    /// True if that surface is another mesh, that is, the input is simplified.
    pub is_simplified: bool,
}

impl<'a> Input<'a> {
    /// Prepare a mesh whose triangles have three distinct vertices. `points` are already translated by
    /// `-shift`.
    pub fn new(
        points: Vec<Vec3>,
        triangles: &'a [[u32; 3]],
        carried: &'a VertexAttributes,
        simplified: Option<OriginalSurface<'_>>,
        shift: &Vec3,
        settings: &Settings,
    ) -> Self {
        let surface = Surface::new(&points, triangles, settings.threads);
        let samples = match simplified {
            _ if !settings.is_base_only() => Samples::default(),
            None => Samples::new(&points, triangles, triangles.len()),
            Some(OriginalSurface { from_points, from_triangles }) => {
                let from: Vec<Vec3> = from_points.iter().map(|p| sub(p, shift)).collect();
                Samples::new(&from, from_triangles, triangles.len())
            }
        };
        let is_light = simplified.is_some();
        let apart2 = if is_light { samples.measure_mean_square(&surface, settings.threads) } else { 0.0 };
        let (slots, places) = (surface.slots(), locate_vertices(points.len(), &surface));
        Self {
            points,
            triangles,
            attributes: carried,
            surface,
            slots,
            surface_points: places,
            samples,
            sample_distance2: apart2,
            is_simplified: is_light,
        }
    }
}

/// Compute a surface point for each input vertex. Entries of unused vertices are meaningless.
fn locate_vertices(count: usize, surface: &Surface) -> Vec<SurfacePoint> {
    let mut places = vec![SurfacePoint { slot: 0, barycentric: [0.0; 3], point: [0.0; 3] }; count];
    for slot in (0..surface.len() as u32).rev() {
        for (i, v) in surface.vertices(slot).into_iter().enumerate() {
            let mut barycentric = [0.0; 3];
            barycentric[i] = 1.0;
            places[v as usize] = surface.point_at(slot, barycentric);
        }
    }
    places
}
