//! Charts, seams and wedges.
//!
//! A wedge is a run of corners around a vertex with equal attributes in one chart (Hoppe, "New quadric metric
//! for simplifying meshes with appearance attributes", 1999). A vertex inside a chart has one wedge, a vertex
//! on a seam has two or more.

use super::surface::SeamSurface;
use crate::base::ids::{EdgeId, HalfedgeId, VertexId};
use crate::mesh::connectivity::Connectivity;
use crate::mesh::triangle_mesh::Mesh;

/// Marks the absence of a corner, a wedge or a triangle.
pub const ABSENT: u32 = u32::MAX;

/// Return the corner of the input at the origin of a halfedge.
pub fn input_corner(mesh: &Mesh<3>, h: HalfedgeId) -> usize {
    3 * mesh.triangle_source[h.index() / 3] as usize + (h.0 % 3) as usize
}

/// Mark seams: edges where texture coordinates or materials differ, and boundaries.
pub fn find_seams<const K: usize>(mesh: &Mesh<3>, surface: &SeamSurface<K>) -> Vec<bool> {
    let connectivity = &mesh.connectivity;
    let look = |h: HalfedgeId| {
        let corner = input_corner(mesh, h);
        let t = corner / 3;
        let uv = if surface.textured[t] { uv_of(&surface.corners[corner]) } else { [0.0; 2] };
        (surface.materials[t], surface.textured[t], uv)
    };
    let is_seam = |edge: EdgeId| {
        let h = connectivity.halfedge(edge);
        let twin = connectivity.twin(h);
        twin.is_none()
            || look(h) != look(Connectivity::next(twin))
            || look(Connectivity::next(h)) != look(twin)
    };
    (0..connectivity.edge_slots()).map(|e| is_seam(EdgeId::from_index(e))).collect()
}

/// Number the charts: connected components of triangles, separated by seams.
pub fn label_charts(connectivity: &Connectivity, is_seam: &[bool]) -> Vec<u32> {
    let mut chart = vec![ABSENT; connectivity.triangle_slots()];
    let mut count = 0;
    let mut open = vec![];
    for start in 0..chart.len() {
        if chart[start] != ABSENT {
            continue;
        }
        chart[start] = count;
        open.push(start);
        while let Some(t) = open.pop() {
            for h in (3 * t..3 * t + 3).map(HalfedgeId::from_index) {
                let beyond = connectivity.twin(h).index() / 3;
                if !is_seam[connectivity.edge(h).index()] && chart[beyond] == ABSENT {
                    chart[beyond] = count;
                    open.push(beyond);
                }
            }
        }
        count += 1;
    }
    chart
}

/// Return the first two attributes, or zeros if there are fewer.
#[inline]
pub fn uv_of<const K: usize>(attributes: &[f64; K]) -> [f64; 2] {
    if K < 2 { [0.0; 2] } else { [attributes[0], attributes[1]] }
}

/// A wedge: the common state of its corners.
#[derive(Clone, Copy, Debug)]
pub struct Wedge<const K: usize> {
    pub attributes: [f64; K],
    /// Initial index.
    pub initial_index: u32,
    /// Corner of the input with exactly equal attributes, or `ABSENT` once they have changed.
    pub source: u32,
    /// Input triangle that contains the texture coordinate.
    pub home_triangle: u32,
    pub chart: u32,
    pub is_textured: bool,
}

/// Create the wedges of a surface before any collapse; also returns the wedge of each corner.
pub fn create_wedges<const K: usize>(
    mesh: &Mesh<3>,
    surface: &SeamSurface<K>,
    is_seam: &[bool],
) -> (Vec<Wedge<K>>, Vec<u32>) {
    let connectivity = &mesh.connectivity;
    let chart = label_charts(connectivity, is_seam);
    let attributes = |h: HalfedgeId| &surface.corners[input_corner(mesh, h)];
    // Test if a corner has the same wedge as the previous one, clockwise.
    let goes_on = |h: HalfedgeId, before: HalfedgeId| {
        !is_seam[connectivity.edge(h).index()] && attributes(h) == attributes(before)
    };
    let mut of_corner = vec![ABSENT; 3 * connectivity.triangle_slots()];
    let mut wedges = Vec::with_capacity(mesh.points.len());
    let mut fan = vec![];
    for v in connectivity.vertices() {
        fan.clear();
        fan.extend(connectivity.fan(v));
        // In a closed fan, start where a wedge starts.
        if !connectivity.is_boundary_vertex(v) {
            let last = fan.len() - 1;
            let begin = (0..=last).find(|&i| !goes_on(fan[i], fan[if i == 0 { last } else { i - 1 }]));
            fan.rotate_left(begin.unwrap_or(0));
        }
        for (i, &h) in fan.iter().enumerate() {
            if i == 0 || !goes_on(h, fan[i - 1]) {
                let source = input_corner(mesh, h);
                wedges.push(Wedge {
                    attributes: *attributes(h),
                    initial_index: wedges.len() as u32,
                    source: source as u32,
                    home_triangle: h.0 / 3,
                    chart: chart[h.index() / 3],
                    is_textured: surface.textured[source / 3],
                });
            }
            of_corner[h.index()] = wedges.len() as u32 - 1;
        }
    }
    (wedges, of_corner)
}

/// Wedges of a region.
pub struct Wedges<const K: usize> {
    /// Wedge of each corner, by halfedge.
    pub of_corner: Vec<u32>,
    pub all: Vec<Wedge<K>>,
}

impl<const K: usize> Wedges<K> {
    /// Set the attributes and home of a wedge. Returns true if the attributes changed.
    ///
    /// `merged` are the wedges it was merged from. If one of them has exactly the same attributes, its source
    /// is used.
    pub fn set_attributes(&mut self, wedge: u32, merged: [u32; 2], attributes: [f64; K], home: u32) -> bool {
        self.all[wedge as usize].home_triangle = home;
        if self.get(wedge).attributes == attributes {
            return false;
        }
        let same = merged.into_iter().find(|&w| w != ABSENT && self.get(w).attributes == attributes);
        let source = same.map_or(ABSENT, |w| self.get(w).source);
        let wedge = &mut self.all[wedge as usize];
        (wedge.attributes, wedge.source) = (attributes, source);
        true
    }

    /// Return the wedge of a corner, given by its halfedge.
    #[inline]
    pub fn wedge_of(&self, h: HalfedgeId) -> u32 {
        self.of_corner[h.index()]
    }

    #[inline]
    pub fn get(&self, wedge: u32) -> &Wedge<K> {
        &self.all[wedge as usize]
    }

    /// Return the texture coordinate of a wedge.
    #[inline]
    pub fn uv(&self, wedge: u32) -> [f64; 2] {
        uv_of(&self.get(wedge).attributes)
    }

    /// Test if two wedges are at the same point of one chart.
    #[inline]
    pub fn has_same_uv(&self, a: u32, b: u32) -> bool {
        if a == b {
            return true;
        }
        let (one, other) = (self.get(a), self.get(b));
        one.chart == other.chart && (!one.is_textured || self.uv(a) == self.uv(b))
    }

    /// Test if an edge is a seam: a texture seam, a change of material, or a boundary.
    pub fn is_seam(&self, connectivity: &Connectivity, edge: EdgeId) -> bool {
        let h = connectivity.halfedge(edge);
        let twin = connectivity.twin(h);
        twin.is_none()
            || !self.has_same_uv(self.wedge_of(h), self.wedge_of(Connectivity::next(twin)))
            || !self.has_same_uv(self.wedge_of(Connectivity::next(h)), self.wedge_of(twin))
    }

    /// Find the wedge of all corners of a vertex; `None` if there are several.
    pub fn single_wedge(&self, connectivity: &Connectivity, v: VertexId) -> Option<u32> {
        let mut fan = connectivity.fan(v).map(|h| self.wedge_of(h));
        let first = fan.next()?;
        fan.all(|wedge| wedge == first).then_some(first)
    }
}
