//! Simplification by attribute quadrics, and how much a colour counts in it.
//!
//! | file | what |
//! | --- | --- |
//! | [`qem`] | the measure |
//! | [`balance`] | how much a level of colour should count: what follows from the data |
//! | [`trial`] | and what that costs in shape |

pub mod balance;
pub mod qem;
pub mod trial;
