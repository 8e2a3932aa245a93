//! Simplification by attribute quadrics, and the default weight of colours.
//!
//! | file | content |
//! | --- | --- |
//! | [`qem`] | the measure |
//! | [`balance`] | estimate of the colour weight from the data |
//! | [`trial`] | limit on the colour weight from its measured shape error |

pub mod balance;
pub mod qem;
pub mod trial;
