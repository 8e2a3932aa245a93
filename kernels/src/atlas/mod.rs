//! The surface laid out in images.
//!
//! | file | what |
//! | --- | --- |
//! | [`neighbours`] | triangles across edges, of any mesh |
//! | [`cut`] | a surface cut into charts |
//! | [`charts`] | pieces of the surface that lie flat, each in a plane |
//! | [`absorb`] | small charts taken up by those around them |
//! | [`bitmap`] | the texels of a chart |
//! | [`shape`] | the room that a chart takes |
//! | [`page`] | an image, and which of its texels are taken |
//! | [`pack`] | charts in images |
//! | [`texels`] | what lies under each texel |

pub mod absorb;
pub mod bitmap;
pub mod charts;
pub mod cut;
pub mod neighbours;
pub mod pack;
pub mod page;
pub mod shape;
pub mod texels;
