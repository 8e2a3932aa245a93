//! The `.snm` container of normal meshes, versions 1 and 2.
//!
//! # Layout
//!
//! ```text
//! file    = "snm" version part part*       the first part: header and base mesh; then one part a level
//! version = 01, or 02 where the header says what is up
//! part    = length checksum coded
//! length  = bytes of `coded`, 7 bits a byte, the lowest first, the top bit set in all but the last
//! checksum= 2 bytes if length < 4096, else 4, the highest first
//! coded   = one stream of the range coder
//! ```
//!
//! A file may end after any part: it is a mesh with fewer levels than its header says. The checksum is a
//! cyclic one over the bytes of `length` and `coded`, polynomial 0x1021 (2 bytes) or 0x04c11db7 (4 bytes),
//! bits neither reflected nor inverted at the end. The register starts as the complement of the checksum of
//! the part before (its lower bits, if that had more), in the first part of 0, or of 1 in version 2; so a part
//! is good only in its place.
//!
//! # Numbers
//!
//! The stream is that of `constriction`'s queue with 16-bit words, the high byte first, and a state of 64
//! bits. Behind the last byte a decoder sees 8 bytes of zeros; asking for more is an error. All that is coded
//! are decisions, each with a probability of 16 bits for `true`, which has the lower part of the interval.
//! *Even* decisions have one half. The other probabilities come from the models of `decisions`, which learn
//! as they are used and go on from part to part. They are worked out in single precision by +, −, ×, ÷ and
//! square root in the order of the source, without fused operations: there the source is the specification.
//! `logistic` holds the functions that other libraries would round differently, `integers` says how a whole
//! number becomes decisions, `linear` how predictions learn.
//!
//! # Header
//!
//! All even decisions. *Number of order k*: Exp-Golomb; x + 2^k has n + 1 bits, n − k times `true`, `false`,
//! then the lower n bits, the highest first. *Real*: the 8 bits of the exponent in single precision, the
//! length of the mantissa without the zeros at its end as a number of order 2, and so many bits. In order:
//! whether the scheme is butterfly; relaxations (order 2), levels (order 3), channels (order 0); the reals
//! grid, step, step ratio and one unit a channel; the three origins, as numbers of order 0, 0, −1, 1, −2, …
//! counted as 0, 1, 2, 3, ….
//!
//! In version 2 what is up follows: whether it is along an axis; if so which (0, 1 or 2, order 0), and whether it is down
//! along it; else three numbers in double precision, each of 64 bits, the highest first. Its length is 1. Version 1 says
//! nothing of it, and is what is written where it is not known.
//!
//! # Base mesh
//!
//! An even decision says whether there is a boundary. Then components follow until a decision says there are
//! no more. A component begins with the positions of the first triangle's corners; the rest grows as `base`
//! says, from one edge of the border to the next in the order of `region`. `lefts` codes what is on the left
//! of an edge and `corners` new vertices. Vertices, triangles and the turn of each triangle are numbered as
//! they come.
//!
//! Each base vertex takes a bit at least, each new vertex of a level 1/1400 bit: what a decoder allocates is
//! bounded by the length of the file, whatever it says.
//!
//! # Levels
//!
//! Edges are numbered as in [`crate::subdivision::topology`] and come in the order of `relations`. For each:
//! unless it is on the boundary, what kind of offset it has (`exceptions`); then the scalar (`scalars`) or
//! the vector (`vectors`). When all are coded, the channels of each edge follow in the same order
//! (`channels`).

mod base;
mod border;
mod channels;
mod chunks;
mod coder;
mod container;
mod corners;
mod decisions;
mod error;
mod exceptions;
mod frame;
mod given;
mod header;
mod integers;
mod lefts;
mod levels;
mod linear;
mod logistic;
mod region;
mod relations;
mod scalars;
mod vectors;

pub use base::{Canonical, canonical, canonical_rounded};
pub use container::{Reader, Writer};
pub use error::SnmError;
