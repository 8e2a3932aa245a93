//! The progressive record: all that has to be known to have the surface at any number of triangles.

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
