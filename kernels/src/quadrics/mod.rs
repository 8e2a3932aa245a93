//! Quadrics of shape and attributes, for every method that is led by them.

pub mod lanes;
pub mod placement;
pub mod quadric;
