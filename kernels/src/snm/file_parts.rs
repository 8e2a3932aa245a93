//! Parts of a file, each with the length of its coded bytes, a checksum and the bytes.
//!
//! The checksum is a CRC over length and bytes, initialised with the checksum of the previous part. Parts in
//! the wrong order are therefore detected. Short parts have 16 bits (CCITT polynomial), parts of [`LONG_PART_BYTES`]
//! bytes or more have 32 bits (IEEE 802.3). Any single wrong byte is detected.

use super::error::SnmError;

/// Coded length in bytes from which checksums have four bytes.
const LONG_PART_BYTES: usize = 4096;

/// Append a part to `file`. `before` is the checksum of the previous part, and is updated.
pub(super) fn append_part(file: &mut Vec<u8>, coded: &[u8], before: &mut u32) {
    let start = file.len();
    let mut rest = coded.len();
    while rest >= 128 {
        file.push(rest as u8 | 128);
        rest >>= 7;
    }
    file.push(rest as u8);
    *before = compute_checksum(*before, &[&file[start..], coded]);
    let size = checksum_byte_count(coded.len());
    file.extend(&before.to_be_bytes()[4 - size..]);
    file.extend(coded);
}

/// Take part number `part` off the front of `file`, and verify its checksum.
pub(super) fn take_part<'a>(
    file: &mut &'a [u8],
    part: usize,
    before: &mut u32,
) -> Result<&'a [u8], SnmError> {
    let (mut length, mut digits) = (0, 0);
    loop {
        let &digit = file.get(digits).ok_or(SnmError::Truncated { part })?;
        length |= usize::from(digit & 127) << (7 * digits);
        digits += 1;
        if digit < 128 {
            break;
        }
        if digits == 5 {
            return Err(SnmError::Damaged { part });
        }
    }
    let (digits, rest) = file.split_at(digits);
    let size = checksum_byte_count(length);
    if rest.len() < size || rest.len() - size < length {
        return Err(SnmError::Truncated { part });
    }
    let (stated, rest) = rest.split_at(size);
    let (coded, rest) = rest.split_at(length);
    let found = compute_checksum(*before, &[digits, coded]);
    if found.to_be_bytes()[4 - size..] != *stated {
        return Err(SnmError::Damaged { part });
    }
    *before = found;
    *file = rest;
    Ok(coded)
}

fn checksum_byte_count(length: usize) -> usize {
    if length < LONG_PART_BYTES { 2 } else { 4 }
}

/// Compute the CRC of `parts`. The length of the last one selects the polynomial.
fn compute_checksum(start: u32, parts: &[&[u8]]) -> u32 {
    let length = parts.last().map_or(0, |part| part.len());
    let (bits, polynomial) = if length < LONG_PART_BYTES { (16, 0x1021) } else { (32, 0x04c1_1db7) };
    let mut remainder = !start << (32 - bits);
    for &byte in parts.iter().copied().flatten() {
        remainder ^= u32::from(byte) << 24;
        for _ in 0..8 {
            let carry = remainder >> 31 != 0;
            remainder <<= 1;
            if carry {
                remainder ^= polynomial << (32 - bits);
            }
        }
    }
    remainder >> (32 - bits)
}
