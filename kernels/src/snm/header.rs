//! The header, in the same stream as the base mesh.

use super::coder::{Coder, Exhausted};
use crate::subdivision::contents::{Header, Scheme};

/// Code the header; what a decoder is given counts for nothing.
pub(super) fn code<C: Coder>(coder: &mut C, header: &Header) -> Result<Header, Exhausted> {
    let butterfly = coder.even(header.scheme == Scheme::Butterfly)?;
    let relaxations = number(coder, header.relaxations.into(), 2)? as u8;
    let levels = number(coder, header.levels.into(), 3)? as u8;
    let channels = number(coder, header.channels.into(), 0)? as u8;
    let grid = real(coder, header.grid)?;
    let step = real(coder, header.step)?;
    let step_ratio = real(coder, header.step_ratio)?;
    let mut units = [0.0; 4];
    for (unit, &given) in units.iter_mut().zip(&header.units).take(channels.into()) {
        *unit = real(coder, given)?;
    }
    let mut origin = [0; 3];
    for (axis, &given) in origin.iter_mut().zip(&header.origin) {
        *axis = zigzag_back(number(coder, zigzag(given), 0)?);
    }
    let scheme = if butterfly { Scheme::Butterfly } else { Scheme::Linear };
    Ok(Header { scheme, relaxations, origin, grid, step, step_ratio, channels, units, levels })
}

fn zigzag(x: i64) -> u64 {
    ((x << 1) ^ (x >> 63)) as u64
}

fn zigzag_back(x: u64) -> i64 {
    (x >> 1) as i64 ^ -((x & 1) as i64)
}

/// An Exp-Golomb number of order `order`.
fn number<C: Coder>(coder: &mut C, value: u64, order: u32) -> Result<u64, Exhausted> {
    let value = u128::from(value) + (1 << order);
    let mut length = order;
    while length < 64 && coder.even(value >> (length + 1) != 0)? {
        length += 1;
    }
    let mut decoded = 1u128;
    for i in (0..length).rev() {
        decoded = decoded << 1 | u128::from(coder.even(value >> i & 1 != 0)?);
    }
    Ok((decoded - (1 << order)) as u64)
}

/// A positive number in single precision: its exponent, and its mantissa without the zeros at the end.
fn real<C: Coder>(coder: &mut C, value: f32) -> Result<f32, Exhausted> {
    const MANTISSA: u32 = 23;
    let bits = value.to_bits();
    let mut decoded = 0;
    for i in (MANTISSA..31).rev() {
        decoded |= u32::from(coder.even(bits >> i & 1 != 0)?) << i;
    }
    let given = MANTISSA - (bits | 1 << MANTISSA).trailing_zeros();
    let length = number(coder, given.into(), 2)?.min(MANTISSA.into()) as u32;
    for i in (MANTISSA - length..MANTISSA).rev() {
        decoded |= u32::from(coder.even(bits >> i & 1 != 0)?) << i;
    }
    Ok(f32::from_bits(decoded))
}
