//! Coding of integers as binary decisions.
//!
//! Let `e` be the expected magnitude and k = max(0, ⌊log2 e⌋ − 2). The upper part |x| >> k is coded in unary
//! up to [`MAX_UNARY`], one decision per step; larger values continue as an Exp-Golomb number. The lower k bits
//! follow with probability 1/2, then the sign of non-zero numbers. The number of decisions hardly depends on
//! the size of the number, as long as the expectation has the right order of magnitude.

use super::coder::{Coder, Exhausted};
use super::decisions::{Decisions, Rates};

/// Maximum length of the unary part.
const MAX_UNARY: usize = 18;
/// Maximum bits of the number beyond the unary part.
const MAX_SUFFIX_BITS: usize = 40;

/// Prior knowledge about a number.
pub(super) struct NumberPrior<const F: usize, const N: usize> {
    /// Expected magnitude.
    pub expected: f32,
    /// A constant 1, then logarithms of magnitudes that the number may have.
    pub features: [f32; F],
    pub contexts: [usize; N],
    /// Logit of a positive sign, and a context for the sign.
    pub sign_logit: f32,
    pub sign_context: usize,
}

/// Adaptive models of a family of integers.
pub(super) struct IntegerModels<const F: usize, const N: usize> {
    magnitudes: Decisions<F, N>,
    signs: Decisions<2, 1>,
}

impl<const F: usize, const N: usize> IntegerModels<F, N> {
    /// Create the models. `weights` holds the initial feature weights of the first steps; later steps use the
    /// last row.
    pub(super) fn new(rates: Rates, weights: &[[f32; F]], sizes: [usize; N], sides: usize) -> Self {
        let last = weights.len() - 1;
        let weights: Vec<[f32; F]> =
            (0..MAX_UNARY + MAX_SUFFIX_BITS).map(|step| weights[step.min(last)]).collect();
        Self {
            magnitudes: Decisions::new(rates, &weights, sizes),
            signs: Decisions::new(rates, &[[0.0, 1.0]], [sides]),
        }
    }

    /// Code `value`, with a magnitude below 2^39.
    pub(super) fn code<C: Coder>(
        &mut self,
        coder: &mut C,
        known: &NumberPrior<F, N>,
        value: i64,
    ) -> Result<i64, Exhausted> {
        // Exponent of the expectation, read from the bits to avoid rounding.
        let exponent = (known.expected.to_bits() >> 23) as i32 - 127;
        let k = (exponent - 2).clamp(0, MAX_SUFFIX_BITS as i32 - 1) as u32;
        let mut features = known.features;
        for feature in &mut features[1..] {
            *feature -= k as f32 * std::f32::consts::LN_2;
        }
        let upper = self.code_upper(coder, &features, &known.contexts, value.unsigned_abs() >> k)?;
        if upper >> (MAX_SUFFIX_BITS as u32 - k) != 0 {
            return Err(Exhausted);
        }
        let mut magnitude = upper << k;
        for i in (0..k).rev() {
            magnitude |= u64::from(coder.code_even(value.unsigned_abs() >> i & 1 != 0)?) << i;
        }
        if magnitude == 0 {
            return Ok(0);
        }
        let positive =
            self.signs.code_bit(coder, 0, &[1.0, known.sign_logit], &[known.sign_context], value > 0)?;
        Ok(if positive { magnitude as i64 } else { -(magnitude as i64) })
    }

    fn code_upper<C: Coder>(
        &mut self,
        coder: &mut C,
        features: &[f32; F],
        contexts: &[usize; N],
        upper: u64,
    ) -> Result<u64, Exhausted> {
        for step in 0..MAX_UNARY {
            if !self.magnitudes.code_bit(coder, step, features, contexts, upper > step as u64)? {
                return Ok(step as u64);
            }
        }
        let rest = upper.saturating_sub(MAX_UNARY as u64) + 1;
        let mut length = 0;
        while length < MAX_SUFFIX_BITS - 1
            && self.magnitudes.code_bit(
                coder,
                MAX_UNARY + length,
                features,
                contexts,
                rest >> (length + 1) != 0,
            )?
        {
            length += 1;
        }
        let mut decoded = 1;
        for i in (0..length).rev() {
            decoded = decoded << 1 | u64::from(coder.code_even(rest >> i & 1 != 0)?);
        }
        Ok(decoded - 1 + MAX_UNARY as u64)
    }
}
