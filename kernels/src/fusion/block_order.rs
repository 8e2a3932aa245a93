//! Z-order of blocks (Morton 1966). Neighbours in space are close in the order. The blocks of an aligned cube
//! whose side is a power of two are contiguous.

/// Block coordinates must be within ± this value.
pub const MAX_COORDINATE: i32 = 1 << 20;

/// Compute the Z-order key of a block.
pub fn block_key(block: [i32; 3]) -> u64 {
    let [x, y, z] = block.map(|c| spread_bits((c + MAX_COORDINATE) as u64));
    x | y << 1 | z << 2
}

/// Compute the block of a Z-order key.
pub fn block_of_key(key: u64) -> [i32; 3] {
    [key, key >> 1, key >> 2].map(|bits| gather_bits(bits) as i32 - MAX_COORDINATE)
}

/// Insert two zeros before each of 21 bits.
fn spread_bits(bits: u64) -> u64 {
    let bits = bits & 0x1f_ffff;
    let bits = (bits | bits << 32) & 0x001f_0000_0000_ffff;
    let bits = (bits | bits << 16) & 0x001f_0000_ff00_00ff;
    let bits = (bits | bits << 8) & 0x100f_00f0_0f00_f00f;
    let bits = (bits | bits << 4) & 0x10c3_0c30_c30c_30c3;
    (bits | bits << 2) & 0x1249_2492_4924_9249
}

fn gather_bits(bits: u64) -> u64 {
    let bits = bits & 0x1249_2492_4924_9249;
    let bits = (bits | bits >> 2) & 0x10c3_0c30_c30c_30c3;
    let bits = (bits | bits >> 4) & 0x100f_00f0_0f00_f00f;
    let bits = (bits | bits >> 8) & 0x001f_0000_ff00_00ff;
    let bits = (bits | bits >> 16) & 0x001f_0000_0000_ffff;
    (bits | bits >> 32) & 0x1f_ffff
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_tells_its_block() {
        for block_there in [
            [0, 0, 0],
            [1, -2, 3],
            [-MAX_COORDINATE, MAX_COORDINATE - 1, 77],
            [MAX_COORDINATE - 1, -1, -MAX_COORDINATE],
        ] {
            assert_eq!(block_of_key(block_key(block_there)), block_there);
        }
    }

    #[test]
    fn blocks_of_a_cube_follow_each_other() {
        let mut keys: Vec<u64> =
            (0..64).map(|i| block_key([-12 + i % 4, 20 + i / 4 % 4, -4 + i / 16])).collect();
        keys.sort_unstable();
        assert!(keys.windows(2).all(|pair| pair[1] == pair[0] + 1));
    }
}
