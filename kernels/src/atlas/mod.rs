//! Texture atlas: the surface flattened into images.
//!
//! | file | content |
//! | --- | --- |
//! | [`triangle_adjacency`] | adjacent triangles of any mesh |
//! | [`segmentation`] | segmentation of a surface into charts |
//! | [`charts`] | growth and flattening of charts |
//! | [`chart_merging`] | dissolution of small charts into their neighbours |
//! | [`chart_bitmap`] | occupied texels of a chart |
//! | [`chart_outline`] | padded outline of a chart |
//! | [`atlas_page`] | occupied texels of an image |
//! | [`packing`] | packing of charts into images |
//! | [`texels`] | rasterisation: triangle and barycentric weights of each texel |

pub mod atlas_page;
pub mod chart_bitmap;
pub mod chart_merging;
pub mod chart_outline;
pub mod charts;
pub mod packing;
pub mod segmentation;
pub mod texels;
pub mod triangle_adjacency;
