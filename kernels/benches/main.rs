//! Benchmarks of the kernels on one core, for ten thousand, a hundred thousand and a million elements.
//!
//! `make bench` runs all; `make bench BENCH=planar` runs those whose name contains the word. "thrpt" is
//! elements per second; elements are triangles of the input unless stated otherwise.

mod common;

mod bvh;
mod certified;
mod certify;
mod connectivity;
mod fitting;
mod jia01;
mod normal;
mod planar;
mod quadric;
mod seams;
mod snm;
mod spatial;
mod subdivision;
mod weld;

use criterion::{criterion_group, criterion_main};

criterion_group!(
    kernels,
    connectivity::bench,
    spatial::bench,
    weld::bench,
    bvh::bench,
    quadric::bench,
    fitting::bench,
    certified::bench,
    jia01::bench,
    seams::bench,
    planar::bench,
    certify::bench,
    subdivision::bench,
    normal::bench,
    snm::bench,
);
criterion_main!(kernels);
