//! What each kernel takes, on one core, for ten thousand, a hundred thousand and a million elements.
//!
//! `make bench` runs all of them; `make bench BENCH=planar` those whose name has the word. "thrpt" is how many elements,
//! triangles of the input if nothing else is said, go through in a second.

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
