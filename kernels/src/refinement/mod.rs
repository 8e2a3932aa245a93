//! Refinement of a fused mesh: the surface of the scene without the noise of the sensor.
//!
//! | module | content |
//! | --- | --- |
//! | [`refiner`] | the steps in order, with their constants |
//! | [`short_edges`] | removal of the thin triangles of marching cubes |
//! | [`normal_filter`] | bilateral filter of triangle normals, and vertices that fit them |
//! | [`boundary`] | smooth boundaries |
//! | [`outlines`] | boundaries at the outlines in the depth maps |
//! | [`depth_frame`] | depth map of a frame |
//! | [`observations`] | distances of the depth measurements from each vertex |
//! | [`votes`] | votes of depth maps for and against surface |
//! | [`residual`] | smooth correction towards the measurements |
//! | [`plane_growth`] | planar patches within the standard deviation of the vertices |
//! | [`plane_merging`] | adjacent patches that are one plane |
//! | [`creases`] | vertices moved onto planes, and straight creases between them |
//! | [`folds`] | steps shortened where they fold triangles |

pub mod boundary;
pub mod creases;
pub mod depth_frame;
pub mod folds;
pub mod normal_filter;
pub mod observations;
pub mod outlines;
pub mod plane_growth;
pub mod plane_merging;
pub mod refiner;
pub mod residual;
pub mod short_edges;
pub mod votes;
