//! Points of images that are recognised in others, by their descriptors (SIFT: Lowe, "Distinctive image features from
//! scale-invariant keypoints", 2004).
//!
//! | file | what |
//! | --- | --- |
//! | [`matching`] | descriptors of two images that are each other's likest, and distinctly so |

pub mod matching;
