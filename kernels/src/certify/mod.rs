//! Proven bounds on the deviation of two surfaces in shape and colour, for every point.
//!
//! Sampling (Cignoni, Rocchini and Scopigno, "Metro: measuring error on simplified surfaces", 1998) measures
//! the samples only. Here every triangle is covered by convex pieces, and each piece is bounded as a whole:
//!
//! * *shape*: the distance to one triangle is convex, so its maximum over a piece is at a corner. The distance
//!   to a surface grows by at most the distance moved. Refining where the bound is largest goes back to Tang,
//!   Lee and Kim, "Interactive Hausdorff distance computation for general polygonal models", 2009.
//! * *colour*: a piece is clipped against every triangle that its nearest points may be on. Nearest points on
//!   one face, side or corner move linearly. The difference of two linear colours is largest at a corner.
//!   Elsewhere the gradient bounds the error of that assumption.
//!
//! The meshes may have holes, several layers and triangles without area. If several points are equally near,
//! the bound on colour holds for each of them. It also holds on each triangle that is at most `slack` farther
//! away than the nearest one: for its nearest point, and for all its points within `slack` of that. A
//! single-precision search returns one of these triangles, and then the nearest point on it.
//!
//! The bound does not hold for every point that is at most `slack` farther away: at height h over a face,
//! these points are within √(2h · slack) of the foot. It does not hold for all meshes with vertices rounded
//! to single precision either. If a triangle turns by an angle, feet move by h × angle. That exceeds the
//! slack if h is many times its height.
//!
//! | file | content |
//! | --- | --- |
//! | `proof` | bounds between two surfaces, or decisions about given bounds |
//! | `one_sided_proof` | one direction: triangles of one surface against the other |
//! | `refinement`, `decision` | cutting a triangle into pieces until its bound is tight, or the decision is made |
//! | `piece_bounds`, `coverage_proof` | bounds of a piece on shape and colour; the fast proof for a whole triangle |
//! | `triangle_frame` | coordinates in the plane of a triangle |
//! | `facet`, `polygon` | nearest points on a triangle; convex pieces |
//! | `surface` | a surface with a search tree |

mod coverage_proof;
mod decision;
mod facet;
mod one_sided_proof;
mod piece_bounds;
mod polygon;
mod proof;
mod refinement;
mod surface;
mod triangle_frame;

pub use one_sided_proof::Verdict;
pub use piece_bounds::Deviation;
pub use proof::{
    COLOR_SLACK, Certificate, Options, bound_whole, certify, certify_triangles, decide, decide_with_limit,
    slack,
};
pub use surface::{NEEDLE_RATIO, Surface};
