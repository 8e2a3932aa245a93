//! The colours of a mesh from photos of it.
//!
//! | file | what |
//! | --- | --- |
//! | [`pinhole`] | cameras and where they stand |
//! | [`clusters`] | the mesh in parts, of which a camera looks at few |
//! | [`zbuffer`] | which triangle a camera sees at each pixel |
//! | [`pixels`] | colours between pixels |
//! | [`view`] | a photo with what its camera sees, and the colour of a point in it |
//! | [`surface_points`] | points of the surface, each with its best few views |
//! | [`blend`] | one colour of many |
//! | [`image`] | points as they lie in an image |
//! | [`level`] | borders levelled where photos end |
//! | [`neighbours`] | texels beside each other as one photo shows both |
//! | [`screened`] | the field whose differences come nearest to wanted ones |
//! | [`texel_sources`] | triangles of a simplified mesh and of its original under the texels of an atlas |
//! | [`nearest`] | nearest points of a surface, also among those that face a given way |
//! | [`sampling`] | bilinear samples of an image under the texels of an atlas |
//! | [`shade`] | the textured mesh as a camera sees it |

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
