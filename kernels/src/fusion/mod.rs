//! Fusion of depth maps into a truncated signed distance field (TSDF), and extraction of its surface.
//!
//! | file | content |
//! | --- | --- |
//! | [`distance_field`] | interface of a signed distance field for surface extraction |
//! | [`block_order`] | Z-order of blocks |
//! | [`voxel_data`] | voxel data, 12 bytes per voxel |
//! | [`block_storage`] | storage of blocks in slots |
//! | [`depth_filter`] | surface normals and discontinuities of a depth map |
//! | [`planarity`] | planarity of a depth map |
//! | [`frame_view`] | a frame prepared for integration |
//! | [`touched_blocks`] | blocks near the surface in a frame |
//! | [`integration`] | integration of a frame |
//! | [`volume`] | the TSDF volume |
//! | [`cube_table`], [`surface_extraction`] | extraction of the zero surface |
//!
//! The set of touched blocks and the voxel values depend only on the frames, their order and the block
//! coordinates, not on other blocks, the thread count or the instruction set. Space can therefore be split
//! into bricks that are fused independently.

pub mod block_order;
pub mod block_storage;
pub mod cube_table;
pub mod depth_filter;
pub mod distance_field;
pub mod frame_view;
pub mod integration;
pub mod planarity;
pub mod surface_extraction;
pub mod touched_blocks;
pub mod volume;
pub mod voxel_data;
