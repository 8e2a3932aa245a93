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
//! | [`split`] | splitting long edges |
//! | `measure`, `records` | cost and constraints of a collapse; accumulated sums |
//! | [`shape`], `contrast` | change of the surface and of its attributes by a collapse |

mod contrast;
mod measure;
mod options;
mod records;
pub mod shape;
mod simplify;
pub mod split;

pub use contrast::texture_change;
pub use measure::{Accumulated, Bound, Change, Jia01};
pub use options::{Limits, Options};
pub use simplify::{Refused, Simplified, simplify};
