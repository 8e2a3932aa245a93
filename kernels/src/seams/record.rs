//! The progressive record: all that has to be known to have the surface at any number of triangles.

use crate::collapse::logs::{self, in_order};

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

/// What the collapses of one region did to wedges, each named as at the start, and by the place of its collapse among
/// those of the region.
#[derive(Clone, Debug, Default)]
pub struct Changes<const K: usize> {
    /// The collapse, the wedge that became part of another, and that one.
    merged: Vec<(u32, u32, u32)>,
    /// The collapse, the wedge that took new attributes, these, and the corner of the input that has them.
    changed: Vec<(u32, u32, [f64; K], u32)>,
    /// The collapse that what is told next belongs to.
    now: u32,
}

impl<const K: usize> Changes<K> {
    pub fn changed(&mut self, wedge: u32, to: [f64; K], source: u32) {
        self.changed.push((self.now, wedge, to, source));
    }

    pub fn merged(&mut self, wedge: u32, into: u32) {
        self.merged.push((self.now, wedge, into));
    }

    /// The collapse has been told.
    pub fn next(&mut self) {
        self.now += 1;
    }
}

impl<const K: usize> Log<K> {
    /// The collapses of all regions in one order, with what they did to wedges: `changes` has an entry for each of
    /// `logs`. `corners` are wedge and vertex of each corner of the input.
    pub fn new(
        logs: &[logs::Log<3>],
        changes: &[Changes<K>],
        [corner_wedge, corner_vertex]: [Vec<u32>; 2],
    ) -> Self {
        let mut log = Self { corner_wedge, corner_vertex, ..Self::default() };
        // Each region's changes come in the order of its collapses, and so does what `in_order` gives.
        let mut told = vec![(0, 0); changes.len()];
        for (region, i) in in_order(logs) {
            let when = log.removed.len() as u32;
            let (changes, (merged, changed)) = (&changes[region], &mut told[region]);
            for &(_, wedge, to, source) in
                changes.changed[*changed..].iter().take_while(|change| change.0 as usize == i)
            {
                log.changed.push(wedge);
                log.changed_to.push(to);
                log.changed_source.push(source);
                log.changed_when.push(when);
                *changed += 1;
            }
            for &(_, wedge, into) in
                changes.merged[*merged..].iter().take_while(|merge| merge.0 as usize == i)
            {
                log.wedge_removed.push(wedge);
                log.wedge_survivor.push(into);
                log.wedge_when.push(when);
                *merged += 1;
            }
            let merge = &logs[region].merges[i];
            log.removed.push(merge.removed.0);
            log.survivor.push(merge.survivor.0);
            log.places.push(logs[region].path[i]);
        }
        log
    }
}
