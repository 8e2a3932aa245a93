//! Texture atlas: the surface flattened into images.
//!
//! | file | content |
//! | --- | --- |
//! | [`neighbours`] | adjacent triangles of any mesh |
//! | [`cut`] | segmentation of a surface into charts |
//! | [`charts`] | growth and flattening of charts |
//! | [`absorb`] | dissolution of small charts into their neighbours |
//! | [`bitmap`] | occupied texels of a chart |
//! | [`shape`] | padded outline of a chart |
//! | [`page`] | occupied texels of an image |
//! | [`pack`] | packing of charts into images |
//! | [`texels`] | rasterisation: triangle and barycentric weights of each texel |

pub mod absorb;
pub mod bitmap;
pub mod charts;
pub mod cut;
pub mod neighbours;
pub mod pack;
pub mod page;
pub mod shape;
pub mod texels;
