//! Recognition of image points by their descriptors (SIFT: Lowe, "Distinctive image features from
//! scale-invariant keypoints", 2004).
//!
//! | file | content |
//! | --- | --- |
//! | [`matching`] | mutual nearest-neighbour matching with ratio test |

pub mod matching;
