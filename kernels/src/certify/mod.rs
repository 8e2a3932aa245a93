//! Proven bounds on how far two surfaces are apart, in shape and in colour, everywhere.
//!
//! Sampling (Cignoni, Rocchini and Scopigno, "Metro: measuring error on simplified surfaces", 1998) sees the samples
//! only. Here every triangle is covered by convex pieces, and each is bounded as a whole:
//!
//! * *shape*: the distance to one triangle is convex, and so at most its value at one of the piece's corners; and the
//!   distance to a surface grows no faster than one moves. Refining where the bound is greatest goes back to Tang, Lee
//!   and Kim, "Interactive Hausdorff distance computation for general polygonal models", 2009.
//! * *colour*: a piece is clipped against every triangle its nearest points may be on. Where they are on one
//!   face, side or corner they move linearly, and the difference of two linear colours is greatest at a corner;
//!   elsewhere the gradient bounds what is missing.
//!
//! Nothing is asked of the meshes: holes, several layers, triangles without area are all right. Where several points
//! are equally near, the bound on colour holds for each of them. It also holds on each triangle no more than `slack`
//! farther away than the nearest one: there for the nearest point and all points of it within `slack` of that.
//! A search in single precision takes any of these triangles for the nearest, and then finds the nearest point on it.
//!
//! It does not hold for every point no more than `slack` farther away: over a face at height h those are all within
//! √(2h · slack) of the foot. Nor does it hold for all vertices that are rounded to single precision: where a triangle
//! turns by an angle, feet move by h times that, which passes the slack where h is many times the triangle's height.
//!
//! | file | what |
//! | --- | --- |
//! | `proof` | bounds on two surfaces, or whether they keep given ones |
//! | `side` | one direction of it: triangles of one surface against the other |
//! | `refine`, `decide` | cutting a triangle into pieces until its bound is close, or the question decided |
//! | `piece`, `cover` | what is known of a piece: its shape, its colour |
//! | `view` | a triangle as what it is looked at from |
//! | `facet`, `polygon` | nearest points on a triangle; convex pieces |
//! | `surface` | a surface that can be searched |

mod cover;
mod decide;
mod facet;
mod piece;
mod polygon;
mod proof;
mod refine;
mod side;
mod surface;
mod view;

pub use piece::Deviation;
pub use proof::{
    COLOR_SLACK, Certificate, Options, certify, certify_some, decide, decide_within, greatest, slack,
};
pub use side::Verdict;
pub use surface::{NEEDLE, Surface};
