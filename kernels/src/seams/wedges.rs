//! Wedges: runs of corners around a vertex with equal attributes (Hoppe, "New quadric metric for simplifying meshes with
//! appearance attributes", 1999). A vertex inside a chart has one, one on a seam two or more.

use super::Surface;
use crate::connectivity::Connectivity;
use crate::ids::{EdgeId, HalfedgeId, VertexId};
use crate::mesh::Mesh;

/// No corner of the input, no triangle.
pub const NONE: u32 = u32::MAX;

pub struct Wedges<const K: usize> {
    /// Wedge of each corner, by its halfedge.
    pub of_corner: Vec<u32>,
    pub attributes: Vec<[f64; K]>,
    /// The corner of the input that has these attributes to the bit; none once they have changed.
    pub source: Vec<u32>,
    /// A triangle of the input whose image holds the texture coordinate.
    pub home: Vec<u32>,
    pub material: Vec<i32>,
    pub is_textured: Vec<bool>,
}

impl<const K: usize> Wedges<K> {
    pub fn new(mesh: &Mesh<3>, surface: &Surface<K>) -> Self {
        let connectivity = &mesh.connectivity;
        let input = |h: HalfedgeId| 3 * mesh.triangle_source[h.index() / 3] + h.0 % 3;
        let look = |h: HalfedgeId| {
            let corner = input(h) as usize;
            (&surface.corners[corner], surface.materials[corner / 3], surface.textured[corner / 3])
        };
        let mut wedges = Self {
            of_corner: vec![NONE; 3 * connectivity.triangle_slots()],
            attributes: Vec::with_capacity(mesh.points.len()),
            source: Vec::with_capacity(mesh.points.len()),
            home: Vec::with_capacity(mesh.points.len()),
            material: Vec::with_capacity(mesh.points.len()),
            is_textured: Vec::with_capacity(mesh.points.len()),
        };
        let mut fan = vec![];
        for v in connectivity.vertices() {
            fan.clear();
            fan.extend(connectivity.fan(v));
            // A closed fan begins where a wedge does.
            if !connectivity.is_boundary_vertex(v) {
                let begin =
                    (0..fan.len()).find(|&i| look(fan[i]) != look(fan[(i + fan.len() - 1) % fan.len()]));
                fan.rotate_left(begin.unwrap_or(0));
            }
            for (i, &h) in fan.iter().enumerate() {
                if i == 0 || look(h) != look(fan[i - 1]) {
                    let (attributes, material, is_textured) = look(h);
                    wedges.attributes.push(*attributes);
                    wedges.source.push(input(h));
                    wedges.home.push(h.0 / 3);
                    wedges.material.push(material);
                    wedges.is_textured.push(is_textured);
                }
                wedges.of_corner[h.index()] = wedges.attributes.len() as u32 - 1;
            }
        }
        wedges
    }

    #[inline]
    pub fn of(&self, h: HalfedgeId) -> u32 {
        self.of_corner[h.index()]
    }

    /// Texture coordinate of a wedge.
    #[inline]
    pub fn uv(&self, wedge: u32) -> [f64; 2] {
        // Without room for a texture coordinate there is none.
        if K < 2 { [0.0; 2] } else { self.attributes[wedge as usize][..2].try_into().unwrap_or_default() }
    }

    /// Whether two wedges look alike where they meet: one image, one place in it.
    #[inline]
    pub fn is_same_place(&self, a: u32, b: u32) -> bool {
        if a == b {
            return true;
        }
        let (i, j) = (a as usize, b as usize);
        let alike = self.material[i] == self.material[j] && self.is_textured[i] == self.is_textured[j];
        alike && (!self.is_textured[i] || self.uv(a) == self.uv(b))
    }

    /// Whether the surface's image is torn at an edge, or its material changes, or it ends.
    pub fn is_seam(&self, connectivity: &Connectivity, edge: EdgeId) -> bool {
        let h = connectivity.halfedge(edge);
        let twin = connectivity.twin(h);
        twin.is_none()
            || !self.is_same_place(self.of(h), self.of(Connectivity::next(twin)))
            || !self.is_same_place(self.of(Connectivity::next(h)), self.of(twin))
    }

    /// The wedge of all corners of a vertex, if there is only one.
    pub fn only(&self, connectivity: &Connectivity, v: VertexId) -> Option<u32> {
        let mut fan = connectivity.fan(v).map(|h| self.of(h));
        let first = fan.next()?;
        fan.all(|wedge| wedge == first).then_some(first)
    }
}
