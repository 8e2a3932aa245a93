//! Quadrics of shape and attributes, shared by several methods.

pub mod lanes;
pub mod local_quadric;
pub mod placement;
pub mod quadric;
