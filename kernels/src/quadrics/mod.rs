//! Quadrics of shape and attributes, for every method that is led by them.

pub mod placement;
pub mod quadric;
