//! The surface laid out in images.
//!
//! | file | what |
//! | --- | --- |
//! | [`neighbours`] | triangles across edges, of any mesh |
//! | [`charts`] | pieces of the surface that lie flat, each in a plane |
//! | [`bitmap`] | the texels of a chart |
//! | [`pack`] | charts in images |
//! | [`texels`] | what lies under each texel |

pub mod bitmap;
pub mod charts;
pub mod neighbours;
pub mod pack;
pub mod texels;
