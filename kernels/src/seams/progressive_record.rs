//! Progressive record: the data needed to restore the surface at any number of triangles.

use crate::collapse::collapse_log::{self, order_for_replay};

/// Ordered collapses, with their effects on wedges.
#[derive(Clone, Debug, Default)]
pub struct ProgressiveRecord<const K: usize> {
    /// Vertices as numbered in `corner_vertex`: removed vertex, survivor, and new position of the survivor.
    pub removed: Vec<u32>,
    pub survivor: Vec<u32>,
    pub survivor_points: Vec<[f64; 3]>,
    /// Merged wedges: removed wedge, remaining wedge, and index of the collapse.
    pub wedge_removed: Vec<u32>,
    pub wedge_survivor: Vec<u32>,
    pub wedge_collapse_index: Vec<u32>,
    /// Wedges with new attributes.
    pub changed_wedges: Vec<u32>,
    pub changed_attributes: Vec<[f64; K]>,
    /// Corner of the input with equal attributes, or `NONE`.
    pub changed_source: Vec<u32>,
    pub changed_collapse_index: Vec<u32>,
    /// Wedge and vertex of each corner of the input; `NONE` in dropped triangles.
    pub corner_wedge: Vec<u32>,
    pub corner_vertex: Vec<u32>,
}

/// Effects of the collapses of one region on wedges. Wedges have their initial names; collapses are numbered
/// in the region.
#[derive(Clone, Debug, Default)]
pub struct WedgeChanges<const K: usize> {
    /// Index of the collapse, removed wedge, remaining wedge.
    merged: Vec<(u32, u32, u32)>,
    /// Index of the collapse, wedge, new attributes, corner of the input with equal attributes.
    changed: Vec<(u32, u32, [f64; K], u32)>,
    /// Index of the collapse being recorded.
    collapse_index: u32,
}

impl<const K: usize> WedgeChanges<K> {
    /// Record that a wedge has new attributes.
    pub fn changed(&mut self, wedge: u32, to: [f64; K], source: u32) {
        self.changed.push((self.collapse_index, wedge, to, source));
    }

    /// Record that a wedge merged into another one.
    pub fn merged(&mut self, wedge: u32, into: u32) {
        self.merged.push((self.collapse_index, wedge, into));
    }

    /// Finish recording a collapse.
    pub fn finish_collapse(&mut self) {
        self.collapse_index += 1;
    }
}

impl<const K: usize> ProgressiveRecord<K> {
    /// Order the collapses of all regions, with their effects on wedges.
    ///
    /// `changes` has one entry for each of `logs`. `corner_wedge` and `corner_vertex` are by corner of the
    /// input.
    pub fn new(
        logs: &[collapse_log::RegionLog<3>],
        changes: &[WedgeChanges<K>],
        [corner_wedge, corner_vertex]: [Vec<u32>; 2],
    ) -> Self {
        let mut log = Self { corner_wedge, corner_vertex, ..Self::default() };
        // `in_order` keeps the order of the collapses within a region, so one cursor per region is enough.
        let mut told = vec![(0, 0); changes.len()];
        for (region, i) in order_for_replay(logs) {
            let when = log.removed.len() as u32;
            let (changes, (merged, changed)) = (&changes[region], &mut told[region]);
            for &(_, wedge, to, source) in
                changes.changed[*changed..].iter().take_while(|change| change.0 as usize == i)
            {
                log.changed_wedges.push(wedge);
                log.changed_attributes.push(to);
                log.changed_source.push(source);
                log.changed_collapse_index.push(when);
                *changed += 1;
            }
            for &(_, wedge, into) in
                changes.merged[*merged..].iter().take_while(|merge| merge.0 as usize == i)
            {
                log.wedge_removed.push(wedge);
                log.wedge_survivor.push(into);
                log.wedge_collapse_index.push(when);
                *merged += 1;
            }
            let merge = &logs[region].merges[i];
            log.removed.push(merge.removed.0);
            log.survivor.push(merge.survivor.0);
            log.survivor_points.push(logs[region].survivor_points[i]);
        }
        log
    }
}
