//! `.snm` container of normal meshes, versions 1 and 2.
//!
//! # Layout
//!
//! ```text
//! file    = "snm" version part part*       first part: header and base mesh; then one part per level
//! version = 01, or 02 if the header contains the up direction
//! part    = length checksum coded
//! length  = bytes of `coded`, 7 bits per byte, lowest first, top bit set in all but the last byte
//! checksum= 2 bytes if length < 4096, else 4, highest first
//! coded   = one stream of the range coder
//! ```
//!
//! A file may end after any part; it then is a mesh with fewer levels than its header declares. The checksum
//! is a CRC over the bytes of `length` and `coded`, with polynomial 0x1021 (2 bytes) or 0x04c11db7 (4 bytes).
//! Bits are neither reflected nor inverted at the end. The register starts as the complement of the previous
//! part's checksum (its lower bits, if it was longer). Before the first part, the checksum counts as 0 in
//! version 1 and as 1 in version 2. A part is thus valid only in its position.
//!
//! # Numbers
//!
//! The stream has the format of `constriction`'s queue with 16-bit words, high byte first, and a 64-bit
//! state. After the last byte a decoder reads 8 bytes of zeros; reading more is an error. All data are binary
//! decisions, each with a 16-bit probability of `true`, which has the lower part of the interval. *Even*
//! decisions have probability 1/2. All other probabilities come from the models of `decisions`, which learn
//! with each decision and are kept from part to part. They are computed in single precision by +, −, ×, ÷ and
//! square root in the order of the source, without fused operations. For them, the source code is the
//! specification. `logistic` contains functions that libraries round differently. `integers` defines the
//! decisions of an integer, `linear` the adaptive prediction.
//!
//! # Header
//!
//! All decisions are even. *Number of order k*: Exp-Golomb. For x + 2^k with n + 1 bits: n − k times `true`,
//! then `false`, then the lower n bits, highest first. *Real*: the 8 exponent bits in single precision, the
//! length of the mantissa without trailing zeros as a number of order 2, then these mantissa bits. In order:
//! true for the butterfly scheme; relaxations (order 2), levels (order 3), channels (order 0); the reals
//! grid, step, step ratio and one unit per channel; the three origins as numbers of order 0, with 0, −1, 1,
//! −2, … mapped to 0, 1, 2, 3, ….
//!
//! Version 2 continues with the up direction, a unit vector. The first decision is true for an axis
//! direction. Then follow the axis (0, 1 or 2, order 0) and a decision that is true for the negative
//! direction. Otherwise three double-precision numbers follow, 64 bits each, highest first. Version 1 has no
//! up direction; it is written if none is known.
//!
//! # Base mesh
//!
//! An even decision is true if the mesh has a boundary. Then components follow, each announced by a decision.
//! A component starts with the positions of the first triangle's corners. It grows as described in `base_traversal`,
//! from one border edge to the next, in the order defined by `region`. `gate_symbols` codes the symbol of each
//! border edge, `base_vertices` the new vertices. Vertices, triangles and the first corner of each triangle are
//! numbered in coding order.
//!
//! Each base vertex takes at least one bit, each new vertex of a level at least 1/1400 bit. The memory of a
//! decoder is thus bounded by the length of the file.
//!
//! # Levels
//!
//! Edges are numbered as in [`crate::subdivision::topology`] and coded in the order of `relations`. Interior
//! edges start with the kind of their offset (`offset_kinds`). The scalar (`scalar_offsets`) or vector (`vector_offsets`)
//! follows. After all offsets, the channels of each edge follow in the same order (`channels`).

mod base_traversal;
mod base_vertices;
mod border;
mod channels;
mod coder;
mod container;
mod decisions;
mod encoder_input;
mod error;
mod file_parts;
mod frame;
mod gate_symbols;
mod header;
mod integers;
mod linear;
mod logistic;
mod offset_kinds;
mod refinements;
mod region;
mod relations;
mod scalar_offsets;
mod vector_offsets;

pub use base_traversal::{CanonicalBase, to_canonical, to_canonical_rounded};
pub use container::{Reader, Writer};
pub use error::SnmError;
