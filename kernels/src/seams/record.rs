//! Progressive record: the data needed to restore the surface at any number of triangles.

use crate::collapse::logs::{self, in_order};

/// Ordered collapses, with their effects on wedges.
#[derive(Clone, Debug, Default)]
pub struct Log<const K: usize> {
    /// Vertices as numbered in `corner_vertex`: removed vertex, survivor, and new position of the survivor.
    pub removed: Vec<u32>,
    pub survivor: Vec<u32>,
    pub places: Vec<[f64; 3]>,
    /// Merged wedges: removed wedge, remaining wedge, and index of the collapse.
    pub wedge_removed: Vec<u32>,
    pub wedge_survivor: Vec<u32>,
    pub wedge_when: Vec<u32>,
    /// Wedges with new attributes.
    pub changed: Vec<u32>,
    pub changed_to: Vec<[f64; K]>,
    /// Corner of the input with equal attributes, or `NONE`.
    pub changed_source: Vec<u32>,
    pub changed_when: Vec<u32>,
    /// Wedge and vertex of each corner of the input; `NONE` in dropped triangles.
    pub corner_wedge: Vec<u32>,
    pub corner_vertex: Vec<u32>,
}

/// Effects of the collapses of one region on wedges. Wedges have their initial names; collapses are numbered
/// in the region.
#[derive(Clone, Debug, Default)]
pub struct Changes<const K: usize> {
    /// Index of the collapse, removed wedge, remaining wedge.
    merged: Vec<(u32, u32, u32)>,
    /// Index of the collapse, wedge, new attributes, corner of the input with equal attributes.
    changed: Vec<(u32, u32, [f64; K], u32)>,
    /// Index of the collapse being recorded.
    now: u32,
}

impl<const K: usize> Changes<K> {
    /// Record that a wedge has new attributes.
    pub fn changed(&mut self, wedge: u32, to: [f64; K], source: u32) {
        self.changed.push((self.now, wedge, to, source));
    }

    /// Record that a wedge merged into another one.
    pub fn merged(&mut self, wedge: u32, into: u32) {
        self.merged.push((self.now, wedge, into));
    }

    /// Finish recording a collapse.
    pub fn next(&mut self) {
        self.now += 1;
    }
}

impl<const K: usize> Log<K> {
    /// Order the collapses of all regions, with their effects on wedges.
    ///
    /// `changes` has one entry for each of `logs`. `corner_wedge` and `corner_vertex` are by corner of the
    /// input.
    pub fn new(
        logs: &[logs::Log<3>],
        changes: &[Changes<K>],
        [corner_wedge, corner_vertex]: [Vec<u32>; 2],
    ) -> Self {
        let mut log = Self { corner_wedge, corner_vertex, ..Self::default() };
        // `in_order` keeps the order of the collapses within a region, so one cursor per region is enough.
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
