//! Coding of the header, in the same stream as the base mesh.

use super::coder::{Coder, Exhausted};
use crate::subdivision::snm_contents::{Header, Scheme};

/// Code the header. A decoder only uses the presence of `code_up` in its argument.
pub(super) fn code_header<C: Coder>(coder: &mut C, header: &Header) -> Result<Header, Exhausted> {
    let butterfly = coder.code_even(header.scheme == Scheme::Butterfly)?;
    let relaxations = code_number(coder, header.relaxations.into(), 2)? as u8;
    let levels = code_number(coder, header.levels.into(), 3)? as u8;
    let channels = code_number(coder, header.channels.into(), 0)? as u8;
    let grid = code_real(coder, header.grid)?;
    let step = code_real(coder, header.step)?;
    let step_ratio = code_real(coder, header.step_ratio)?;
    let mut units = [0.0; 4];
    for (unit, &given) in units.iter_mut().zip(&header.units).take(channels.into()) {
        *unit = code_real(coder, given)?;
    }
    let mut origin = [0; 3];
    for (axis, &given) in origin.iter_mut().zip(&header.origin) {
        *axis = from_zigzag(code_number(coder, to_zigzag(given), 0)?);
    }
    let up = header.up.map(|given| code_up(coder, given)).transpose()?;
    let scheme = if butterfly { Scheme::Butterfly } else { Scheme::Linear };
    Ok(Header { scheme, relaxations, origin, grid, step, step_ratio, channels, units, levels, up })
}

/// Code the up direction: one of six axis directions, or three numbers. An invalid axis decodes to the zero
/// vector.
fn code_up<C: Coder>(coder: &mut C, given: [f64; 3]) -> Result<[f64; 3], Exhausted> {
    let along = given.iter().position(|x| x.abs() == 1.0);
    let axis = along.filter(|_| given.iter().filter(|&&x| x == 0.0).count() == 2);
    let mut decoded = [0.0; 3];
    if coder.code_even(axis.is_some())? {
        let number = code_number(coder, axis.unwrap_or(0) as u64, 0)?;
        let down = coder.code_even(axis.is_some_and(|axis| given[axis] < 0.0))?;
        if let Some(along) = usize::try_from(number).ok().and_then(|axis| decoded.get_mut(axis)) {
            *along = if down { -1.0 } else { 1.0 };
        }
        return Ok(decoded);
    }
    for (along, given) in decoded.iter_mut().zip(given) {
        let mut bits = 0;
        for i in (0..u64::BITS).rev() {
            bits |= u64::from(coder.code_even(given.to_bits() >> i & 1 != 0)?) << i;
        }
        *along = f64::from_bits(bits);
    }
    Ok(decoded)
}

fn to_zigzag(x: i64) -> u64 {
    ((x << 1) ^ (x >> 63)) as u64
}

fn from_zigzag(x: u64) -> i64 {
    (x >> 1) as i64 ^ -((x & 1) as i64)
}

/// Code an Exp-Golomb number of order `order`.
fn code_number<C: Coder>(coder: &mut C, value: u64, order: u32) -> Result<u64, Exhausted> {
    let value = u128::from(value) + (1 << order);
    let mut length = order;
    while length < 64 && coder.code_even(value >> (length + 1) != 0)? {
        length += 1;
    }
    let mut decoded = 1u128;
    for i in (0..length).rev() {
        decoded = decoded << 1 | u128::from(coder.code_even(value >> i & 1 != 0)?);
    }
    Ok((decoded - (1 << order)) as u64)
}

/// Code a positive single-precision number: its exponent, then its mantissa without trailing zeros.
fn code_real<C: Coder>(coder: &mut C, value: f32) -> Result<f32, Exhausted> {
    const MANTISSA: u32 = 23;
    let bits = value.to_bits();
    let mut decoded = 0;
    for i in (MANTISSA..31).rev() {
        decoded |= u32::from(coder.code_even(bits >> i & 1 != 0)?) << i;
    }
    let given = MANTISSA - (bits | 1 << MANTISSA).trailing_zeros();
    let length = code_number(coder, given.into(), 2)?.min(MANTISSA.into()) as u32;
    for i in (MANTISSA - length..MANTISSA).rev() {
        decoded |= u32::from(coder.code_even(bits >> i & 1 != 0)?) << i;
    }
    Ok(f32::from_bits(decoded))
}
