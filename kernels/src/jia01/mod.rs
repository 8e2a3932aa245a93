//! Texture-preserving simplification: JIA01.
//!
//! Jia, Liu, Pei, Zhu and Li, "Mesh simplification with texture preservation", Journal of Image and
//! Graphics 6(7), 2001, 613–617, after Johnson and Hebert, "Control of polygonal mesh resolution for 3-D
//! computer vision", 1998. Equation numbers, here and in the parts, are the paper's.
//!
//! | file | what |
//! | --- | --- |
//! | [`simplify`](simplify()) | split, then collapse |
//! | `options` | what a user can set |
//! | [`split`] | splitting long edges |
//! | `measure`, `records` | what a collapse costs and may not do; the sums that are kept of it |
//! | [`shape`], `contrast` | how far a collapse takes the surface, and its attributes |

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
