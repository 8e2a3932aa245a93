//! Simplification by attribute quadrics, and the default weight of colours.
//!
//! | file | content |
//! | --- | --- |
//! | [`qem`] | the measure |
//! | [`color_weight`] | estimate of the colour weight from the data |
//! | [`weight_trial`] | limit on the colour weight from its measured shape error |

pub mod color_weight;
pub mod qem;
pub mod weight_trial;
