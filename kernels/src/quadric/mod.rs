//! Simplification by attribute quadrics, and the default weight of colours.
//!
//! | file | content |
//! | --- | --- |
//! | [`simplify`] | the method |
//! | [`vertex_removal`] | its fast first part: removal of independent vertices |
//! | [`qem`] | the measure of the second part |
//! | [`color_weight`] | estimate of the colour weight from the data |
//! | [`weight_trial`] | limit on the colour weight from its measured shape error |

pub mod color_weight;
pub mod qem;
pub mod simplify;
pub mod vertex_removal;
pub mod weight_trial;
