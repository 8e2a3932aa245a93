//! Fusion of depth maps into a truncated signed distance field (TSDF), and extraction of its surface.
//!
//! | file | content |
//! | --- | --- |
//! | [`field`] | interface of a signed distance field for surface extraction |
//! | [`order`] | Z-order of blocks |
//! | [`voxel`] | voxel data, 12 bytes per voxel |
//! | [`blocks`] | storage of blocks in slots |
//! | [`filter`] | surface normals and discontinuities of a depth map |
//! | [`flatness`] | planarity of a depth map |
//! | [`view`] | a frame prepared for integration |
//! | [`touch`] | blocks near the surface in a frame |
//! | [`integrate`] | integration of a frame |
//! | [`volume`] | the TSDF volume |
//! | [`cubes`], [`surface`] | extraction of the zero surface |
//!
//! The set of touched blocks and the voxel values depend only on the frames, their order and the block
//! coordinates, not on other blocks, the thread count or the instruction set. Space can therefore be split
//! into bricks that are fused independently.

pub mod blocks;
pub mod cubes;
pub mod field;
pub mod filter;
pub mod flatness;
pub mod integrate;
pub mod order;
pub mod surface;
pub mod touch;
pub mod view;
pub mod volume;
pub mod voxel;
