//! Least-squares fit of a result to its input.

pub mod least_squares;
