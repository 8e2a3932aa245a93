//! Texture-preserving simplification (JIA01).
//!
//! Jia, Liu, Pei, Zhu and Li, "Mesh simplification with texture preservation", Journal of Image and Graphics
//! 6(7), 2001, 613–617, after Johnson and Hebert, "Control of polygonal mesh resolution for 3-D computer
//! vision", 1998. All equation numbers refer to the former paper.
//!
//! | file | content |
//! | --- | --- |
//! | [`simplify`](simplify()) | the whole method: split, then collapse |
//! | `options` | parameters |
//! | [`edge_splitting`] | splitting long edges |
//! | `measure`, `accumulated_sums` | cost and constraints of a collapse; accumulated sums |
//! | [`shape_change`], `attribute_contrast` | change of the surface and of its attributes by a collapse |

mod accumulated_sums;
mod attribute_contrast;
pub mod edge_splitting;
mod measure;
mod options;
pub mod shape_change;
mod simplify;

pub use attribute_contrast::texture_change;
pub use measure::{AccumulatedChange, Change, Jia01, StopRule};
pub use options::{Limits, Options};
pub use simplify::{JiaRefusals, JiaResult, simplify};
