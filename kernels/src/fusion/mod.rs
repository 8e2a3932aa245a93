//! Depth maps fused into a signed distance field, and the surface of it.
//!
//! | file | what |
//! | --- | --- |
//! | [`field`] | what a field is, as its surface is taken from it |
//! | [`order`] | blocks of voxels in Z-order |
//! | [`voxel`] | what is kept of a voxel, in 12 bytes |
//! | [`blocks`] | all blocks of a field, each in a slot |
//! | [`filter`] | how obliquely a depth map sees its surface, and where it is torn |
//! | [`flatness`] | where it shows planes |
//! | [`view`] | a depth map as it goes into a field |
//! | [`touch`] | the blocks that a frame has something to say of |
//! | [`integrate`] | adding a frame to them |
//! | [`volume`] | the field that frames are added to |
//! | [`cubes`], [`surface`] | its zero surface |
//!
//! Whether a block is touched and what its voxels hold depends on the frames, their order and the block's own coordinates
//! alone: not on other blocks, on threads, or on the set of instructions. So space can be cut into bricks that are fused
//! one by one.

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
