//! Arithmetic coding of binary decisions, with the range coder of `constriction`.
//!
//! Encoder and decoder run through the models identically. [`Coder::code_bit`] receives the decision to encode and
//! returns the coded one; a decoder ignores its argument.

use std::borrow::Borrow;
use std::num::NonZeroU16;

use constriction::Queue;
use constriction::backends::ReadWords;
use constriction::stream::model::{DecoderModel, EncoderModel, EntropyModel};
use constriction::stream::queue::{EncoderSituation, RangeDecoder, RangeEncoder};
use constriction::stream::{Decode, Encode};

/// Error for decoding past the end of the data, which only damaged files cause.
#[derive(Debug)]
pub(super) struct Exhausted;

/// Encoder or decoder of binary decisions.
pub(super) trait Coder {
    /// Code a decision that is `true` with probability `p`/65536.
    fn code_bit(&mut self, p: NonZeroU16, bit: bool) -> Result<bool, Exhausted>;

    /// Code a decision with probability 1/2.
    fn code_even(&mut self, bit: bool) -> Result<bool, Exhausted> {
        const HALF: NonZeroU16 = NonZeroU16::new(1 << 15).unwrap();
        self.code_bit(HALF, bit)
    }
}

const PRECISION: usize = 16;

/// Binary model; `true` has the lower part of the interval.
#[derive(Clone, Copy)]
struct Bernoulli(NonZeroU16);

impl Bernoulli {
    fn interval(self, bit: bool) -> (u16, NonZeroU16) {
        let p = self.0.get();
        // 65536 − p is within 1..=65535, as p is.
        if bit { (0, self.0) } else { (p, NonZeroU16::new(p.wrapping_neg()).unwrap_or(NonZeroU16::MIN)) }
    }
}

impl EntropyModel<PRECISION> for Bernoulli {
    type Symbol = bool;
    type Probability = u16;
}

impl EncoderModel<PRECISION> for Bernoulli {
    fn left_cumulative_and_probability(&self, symbol: impl Borrow<bool>) -> Option<(u16, NonZeroU16)> {
        Some(self.interval(*symbol.borrow()))
    }
}

impl DecoderModel<PRECISION> for Bernoulli {
    fn quantile_function(&self, quantile: u16) -> (bool, u16, NonZeroU16) {
        let bit = quantile < self.0.get();
        let (left, width) = self.interval(bit);
        (bit, left, width)
    }
}

/// Range encoder. With 16-bit words and a 64-bit state, 16-bit probabilities are rounded by at most 2^-32.
#[derive(Default)]
pub(super) struct Encoder(RangeEncoder<u16, u64>);

impl Coder for Encoder {
    fn code_bit(&mut self, p: NonZeroU16, bit: bool) -> Result<bool, Exhausted> {
        // Cannot fail: both decisions have positive probability, and the output vector grows.
        self.0.encode_symbol(bit, Bernoulli(p)).map_err(|_| Exhausted)?;
        Ok(bit)
    }
}

impl Encoder {
    /// Return the bytes, with the shortest ending that identifies the last interval if zeros follow.
    pub(super) fn finish(self) -> Vec<u8> {
        let (mut words, state, situation) = self.0.into_raw_parts();
        let (lower, range) = (u128::from(state.lower()), u128::from(state.range().get()));
        let round_up = |kept: u32| lower.div_ceil(1 << (64 - 8 * kept)) << (64 - 8 * kept);
        // The range is at least 2^48, so two bytes always suffice.
        let kept = (0..2).find(|&kept| round_up(kept) < lower + range).unwrap_or(2);
        let point = round_up(kept);
        let carry = point >> 64 != 0;
        if let EncoderSituation::Inverted(count, first) = situation {
            words.push(if carry { first.wrapping_add(1) } else { first });
            words.extend(std::iter::repeat_n(if carry { 0 } else { u16::MAX }, count.get() - 1));
        }
        let mut bytes: Vec<u8> = words.into_iter().flat_map(u16::to_be_bytes).collect();
        bytes.extend(&(point as u64).to_be_bytes()[..kept as usize]);
        bytes
    }
}

/// Bytes as 16-bit words, followed by as many zeros as a decoder reads ahead.
struct WordReader<'a> {
    bytes: &'a [u8],
    zeros: usize,
}

impl ReadWords<u16, Queue> for WordReader<'_> {
    type ReadError = Exhausted;

    fn read(&mut self) -> Result<Option<u16>, Exhausted> {
        let (word, rest) = match *self.bytes {
            [a, b, ref rest @ ..] => (u16::from_be_bytes([a, b]), rest),
            [a] => (u16::from_be_bytes([a, 0]), [].as_slice()),
            [] => {
                self.zeros = self.zeros.checked_sub(1).ok_or(Exhausted)?;
                (0, [].as_slice())
            }
        };
        self.bytes = rest;
        Ok(Some(word))
    }

    fn maybe_exhausted(&self) -> bool {
        self.bytes.is_empty()
    }
}

/// Range decoder, the inverse of [`Encoder`].
pub(super) struct Decoder<'a>(RangeDecoder<u16, u64, WordReader<'a>>);

impl<'a> Decoder<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Result<Self, Exhausted> {
        RangeDecoder::with_backend(WordReader { bytes, zeros: 4 }).map(Self)
    }
}

impl Coder for Decoder<'_> {
    fn code_bit(&mut self, p: NonZeroU16, _: bool) -> Result<bool, Exhausted> {
        self.0.decode_symbol(Bernoulli(p)).map_err(|_| Exhausted)
    }
}

/// Coder that writes nothing. It determines the order in which the models meet vertices and triangles.
pub(super) struct DryRunCoder;

impl Coder for DryRunCoder {
    fn code_bit(&mut self, _: NonZeroU16, bit: bool) -> Result<bool, Exhausted> {
        Ok(bit)
    }
}
