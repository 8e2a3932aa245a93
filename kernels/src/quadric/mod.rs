//! Simplification by attribute quadrics, and the default weight of colours.
//!
//! | file | content |
//! | --- | --- |
//! | [`simplify`] | the method |
//! | [`independent_collapses`] | its fast first part: independent edges, in passes |
//! | [`qem`] | the measure of the second part, edge by edge |
//! | [`color_weight`] | estimate of the colour weight from the data |
//! | [`weight_trial`] | limit on the colour weight from its measured shape error |

pub mod color_weight;
pub mod independent_collapses;
pub mod qem;
pub mod simplify;
pub mod weight_trial;
