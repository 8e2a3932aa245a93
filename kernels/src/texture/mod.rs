//! Colours of a mesh from photos.
//!
//! | file | content |
//! | --- | --- |
//! | [`pinhole`] | pinhole cameras |
//! | [`clusters`] | mesh in clusters, for view-frustum culling |
//! | [`zbuffer`] | visible triangle and depth of each pixel |
//! | [`pixels`] | interpolation of photo colours |
//! | [`view`] | a photo with its depth maps: visibility, score and colour of points |
//! | [`surface_points`] | surface points with their best views |
//! | [`blend`] | blending of photos |
//! | [`image`] | lookup from pixels to surface points |
//! | [`level`] | seam levelling |
//! | [`neighbours`] | differences of adjacent texels within one photo |
//! | [`screened`] | screened Poisson solver on a grid |
//! | [`texel_sources`] | triangles of a simplified mesh and of its original at the texels of an atlas |
//! | [`nearest`] | nearest points of a surface, optionally with a facing direction |
//! | [`sampling`] | bilinear samples of an image at the texels of an atlas |
//! | [`shade`] | rendering of the textured mesh |

pub mod blend;
pub mod clusters;
pub mod image;
pub mod level;
pub mod nearest;
pub mod neighbours;
pub mod pinhole;
pub mod pixels;
pub mod sampling;
pub mod screened;
pub mod shade;
pub mod surface_points;
pub mod texel_sources;
pub mod view;
pub mod zbuffer;
