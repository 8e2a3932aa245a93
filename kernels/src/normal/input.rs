//! A mesh as the search for its levels needs it.

use super::carried::Carried;
use super::rounding::Samples;
use super::settings::Settings;
use super::surface::{Place, Surface};
use crate::base::geometry::{Vec3, sub};

/// The surface that a simplified mesh stands for.
#[derive(Clone, Copy, Debug)]
pub struct Simplified<'a> {
    pub from_points: &'a [Vec3],
    pub from_triangles: &'a [[u32; 3]],
}

pub struct Input<'a> {
    pub points: Vec<Vec3>,
    pub triangles: &'a [[u32; 3]],
    pub carried: &'a Carried,
    pub surface: Surface,
    pub slots: Vec<u32>,
    /// A place for each vertex: a corner of any triangle that has it.
    pub places: Vec<Place>,
    /// Of the surface it stands for, if no levels follow, and the mean square of their distance from it.
    pub samples: Samples,
    pub apart2: f64,
    /// Whether that surface is another mesh.
    pub is_light: bool,
}

impl<'a> Input<'a> {
    /// Of triangles that name no vertex twice, moved by `-shift` as their points are already.
    pub fn new(
        points: Vec<Vec3>,
        triangles: &'a [[u32; 3]],
        carried: &'a Carried,
        simplified: Option<Simplified<'_>>,
        shift: &Vec3,
        settings: &Settings,
    ) -> Self {
        let surface = Surface::new(&points, triangles, settings.threads);
        let samples = match simplified {
            _ if !settings.is_alone() => Samples::default(),
            None => Samples::new(&points, triangles, triangles.len()),
            Some(Simplified { from_points, from_triangles }) => {
                let from: Vec<Vec3> = from_points.iter().map(|p| sub(p, shift)).collect();
                Samples::new(&from, from_triangles, triangles.len())
            }
        };
        let is_light = simplified.is_some();
        let apart2 = if is_light { samples.mean_square(&surface, settings.threads) } else { 0.0 };
        let (slots, places) = (surface.slots(), at_vertices(points.len(), &surface));
        Self { points, triangles, carried, surface, slots, places, samples, apart2, is_light }
    }
}

/// Vertices of the input as places; those that no triangle has mean nothing.
fn at_vertices(count: usize, surface: &Surface) -> Vec<Place> {
    let mut places = vec![Place { slot: 0, barycentric: [0.0; 3], point: [0.0; 3] }; count];
    for slot in (0..surface.len() as u32).rev() {
        for (i, v) in surface.vertices(slot).into_iter().enumerate() {
            let mut barycentric = [0.0; 3];
            barycentric[i] = 1.0;
            places[v as usize] = surface.place(slot, barycentric);
        }
    }
    places
}
