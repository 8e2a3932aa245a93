//! Fitting a result to its input by least squares.

pub mod fit;
