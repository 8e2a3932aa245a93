//! Colours of a mesh from photos.
//!
//! | file | content |
//! | --- | --- |
//! | [`pinhole_camera`] | pinhole cameras |
//! | [`mesh_clusters`] | mesh in clusters, for view-frustum culling |
//! | [`zbuffer`] | visible triangle and depth of each pixel |
//! | [`photo_sampling`] | interpolation of photo colours |
//! | [`photo_view`] | a photo with its depth maps: visibility, score and colour of points |
//! | [`surface_points`] | surface points with their best views |
//! | [`blending`] | blending of photos |
//! | [`pixel_lookup`] | lookup from pixels to surface points |
//! | [`seam_levelling`] | seam levelling |
//! | [`neighbour_colors`] | differences of adjacent texels within one photo |
//! | [`screened_poisson`] | screened Poisson solver on a grid |
//! | [`texel_sources`] | triangles of a simplified mesh and of its original at the texels of an atlas |
//! | [`nearest_points`] | nearest points of a surface, optionally with a facing direction |
//! | [`image_sampling`] | bilinear samples of an image at the texels of an atlas |
//! | [`rendering`] | rendering of the textured mesh |

pub mod blending;
pub mod image_sampling;
pub mod mesh_clusters;
pub mod nearest_points;
pub mod neighbour_colors;
pub mod photo_sampling;
pub mod photo_view;
pub mod pinhole_camera;
pub mod pixel_lookup;
pub mod rendering;
pub mod screened_poisson;
pub mod seam_levelling;
pub mod surface_points;
pub mod texel_sources;
pub mod zbuffer;
