//! The progressive record: all that has to be known to have the surface at any number of triangles.

use crate::base::ids::VertexId;

/// Collapses in their order, and what each did to wedges.
#[derive(Clone, Debug, Default)]
pub struct Log<const K: usize> {
    /// Vertices by the numbers of `corner_vertex`: which vanished, which took it in, and where that went.
    pub removed: Vec<u32>,
    pub survivor: Vec<u32>,
    pub places: Vec<[f64; 3]>,
    /// Wedges that became part of others, and the collapse that did it.
    pub wedge_removed: Vec<u32>,
    pub wedge_survivor: Vec<u32>,
    pub wedge_when: Vec<u32>,
    /// Wedges that took new attributes, and the collapse that gave them.
    pub changed: Vec<u32>,
    pub changed_to: Vec<[f64; K]>,
    /// The corner of the input that has the same, if one has.
    pub changed_source: Vec<u32>,
    pub changed_when: Vec<u32>,
    /// Wedge and vertex of each corner of the input; none in triangles that were left out.
    pub corner_wedge: Vec<u32>,
    pub corner_vertex: Vec<u32>,
}

impl<const K: usize> Log<K> {
    /// The collapse that what is told next belongs to, until it is told itself.
    fn now(&self) -> u32 {
        self.removed.len() as u32
    }

    pub fn changed(&mut self, wedge: u32, to: [f64; K], source: u32) {
        self.changed.push(wedge);
        self.changed_to.push(to);
        self.changed_source.push(source);
        self.changed_when.push(self.now());
    }

    pub fn merged(&mut self, wedge: u32, into: u32) {
        self.wedge_removed.push(wedge);
        self.wedge_survivor.push(into);
        self.wedge_when.push(self.now());
    }

    pub fn collapsed(&mut self, removed: VertexId, survivor: VertexId, place: [f64; 3]) {
        self.removed.push(removed.0);
        self.survivor.push(survivor.0);
        self.places.push(place);
    }
}
