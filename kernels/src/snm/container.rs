//! Writer and reader of `.snm` files, part by part.

use crate::subdivision::topology::Topology;

use super::base_traversal::BaseTraversal;
use super::coder::{Decoder, Encoder, Exhausted};
use super::encoder_input::EncoderInput;
use super::error::SnmError;
use super::file_parts;
use super::header;
use super::refinements::RefinementModels;
use crate::subdivision::snm_contents::{BaseContents, Header, Refinement};

/// First bytes of every file; the version follows.
const MAGIC: [u8; 3] = *b"snm";
/// Versions of files without and with an up direction.
const VERSION_PLAIN: u8 = 1;
const VERSION_WITH_UP: u8 = 2;
/// Maximum deviation of a direction's squared length from 1.
const UNIT_LENGTH_TOLERANCE: f64 = 1e-9;

/// Writer of an `.snm` file, level by level.
pub struct Writer {
    file: Vec<u8>,
    checksum: u32,
    levels: RefinementModels,
    remaining_levels: u8,
}

impl Writer {
    /// Start a file with its base mesh, which must be in the order of [`super::base_traversal::canonical`].
    ///
    /// # Errors
    /// [`SnmError::InvalidInput`] if the base is in another order, a header value is not positive and finite, or
    /// the up direction is no unit vector.
    pub fn new(header: &Header, base: &BaseContents) -> Result<Self, SnmError> {
        if !is_valid_header(header) {
            return Err(SnmError::InvalidInput(
                "the header has an invalid grid, step, unit, channel count or up direction",
            ));
        }
        let given = EncoderInput::new(base)?;
        let mut coder = Encoder::default();
        let too_large = |Exhausted| SnmError::InvalidInput("the base mesh is too large");
        header::code_header(&mut coder, header).map_err(too_large)?;
        let mut walk = BaseTraversal::new(&mut coder, Some(given), header.channels.into());
        walk.run().map_err(too_large)?;
        if walk.region.base != *base {
            return Err(SnmError::InvalidInput("the base mesh is not in coder order"));
        }
        let mut file = MAGIC.to_vec();
        let version = if header.up.is_some() { VERSION_WITH_UP } else { VERSION_PLAIN };
        file.push(version);
        let mut checksum = initial_checksum(version);
        file_parts::append_part(&mut file, &coder.finish(), &mut checksum);
        let levels = RefinementModels::new(header, base);
        Ok(Self { file, checksum, levels, remaining_levels: header.levels })
    }

    /// Append a refinement of `topology`. `expected` holds the offsets that the caller predicts, one per
    /// edge, in 1/16 steps; or it is empty. A reader must pass the same values.
    ///
    /// # Errors
    /// [`SnmError::InvalidInput`] if lengths differ, a boundary vertex has a scalar, or the header declares fewer
    /// levels.
    pub fn write_level(
        &mut self,
        topology: &Topology,
        expected: &[i32],
        refinement: &Refinement,
    ) -> Result<(), SnmError> {
        if !self.levels.is_next_level(topology, expected, Some(refinement)) {
            return Err(SnmError::InvalidInput("the refinement does not match the previous level"));
        }
        self.remaining_levels = self
            .remaining_levels
            .checked_sub(1)
            .ok_or(SnmError::InvalidInput("there are more levels than the header declares"))?;
        let mut coder = Encoder::default();
        let coded = self.levels.code_level(&mut coder, topology, expected, Some(refinement));
        coded.map_err(|Exhausted| SnmError::InvalidInput("a level is too large"))?;
        file_parts::append_part(&mut self.file, &coder.finish(), &mut self.checksum);
        Ok(())
    }

    /// Return the bytes written so far. They are a valid file after every level.
    pub fn bytes(&self) -> &[u8] {
        &self.file
    }

    /// Return the bytes of the file.
    pub fn finish(self) -> Vec<u8> {
        self.file
    }
}

/// Reader of an `.snm` file, level by level.
pub struct Reader<'a> {
    file: &'a [u8],
    checksum: u32,
    levels: RefinementModels,
    part: usize,
    declared_levels: usize,
}

impl<'a> Reader<'a> {
    /// Read the header and the base mesh. Manifoldness is only checked when its [`Topology`] is built.
    ///
    /// # Errors
    /// If the file is no `.snm` file, has another version, or is truncated or damaged within the base mesh.
    pub fn new(file: &'a [u8]) -> Result<(Self, Header, BaseContents), SnmError> {
        let rest = file.strip_prefix(&MAGIC).ok_or(SnmError::Magic)?;
        let (&version, mut rest) = rest.split_first().ok_or(SnmError::Truncated { part: 0 })?;
        if ![VERSION_PLAIN, VERSION_WITH_UP].contains(&version) {
            return Err(SnmError::Version(version));
        }
        let mut checksum = initial_checksum(version);
        let coded = file_parts::take_part(&mut rest, 0, &mut checksum)?;
        let damaged = |Exhausted| SnmError::Damaged { part: 0 };
        let mut coder = Decoder::new(coded).map_err(damaged)?;
        let up = (version == VERSION_WITH_UP).then_some([0.0; 3]);
        let header = header::code_header(&mut coder, &Header { up, ..Header::default() }).map_err(damaged)?;
        if !is_valid_header(&header) {
            return Err(SnmError::Damaged { part: 0 });
        }
        let mut walk = BaseTraversal::new(&mut coder, None, header.channels.into());
        walk.run().map_err(damaged)?;
        let base = walk.region.base;
        let promised = header.levels.into();
        let levels = RefinementModels::new(&header, &base);
        Ok((Self { file: rest, checksum, levels, part: 0, declared_levels: promised }, header, base))
    }

    /// Number of unread bytes.
    pub fn remaining_byte_count(&self) -> usize {
        self.file.len()
    }

    /// Read the next refinement. None at the end of the file, also if it has fewer levels than declared.
    ///
    /// # Errors
    /// If this level is truncated or damaged: earlier levels stay valid, later ones cannot be read. Also if
    /// bytes follow the last level.
    pub fn read_level(
        &mut self,
        topology: &Topology,
        expected: &[i32],
    ) -> Result<Option<Refinement>, SnmError> {
        if self.file.is_empty() {
            return Ok(None);
        }
        if self.part == self.declared_levels {
            return Err(SnmError::TrailingBytes { bytes: self.file.len() });
        }
        if !self.levels.is_next_level(topology, expected, None) {
            return Err(SnmError::InvalidInput("the topology is not the next finer level"));
        }
        let part = self.part + 1;
        let coded = file_parts::take_part(&mut self.file, part, &mut self.checksum)?;
        self.part = part;
        let damaged = |Exhausted| SnmError::Damaged { part };
        let mut coder = Decoder::new(coded).map_err(damaged)?;
        self.levels.code_level(&mut coder, topology, expected, None).map(Some).map_err(damaged)
    }
}

/// Initial checksum before the first part. It depends on the version, so a changed version byte is detected.
fn initial_checksum(version: u8) -> u32 {
    u32::from(version - VERSION_PLAIN)
}

fn is_valid_header(header: &Header) -> bool {
    let units = &header.units[..usize::from(header.channels.min(4))];
    let is_direction =
        |up: [f64; 3]| (up.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < UNIT_LENGTH_TOLERANCE;
    header.channels <= 4
        && header.up.is_none_or(is_direction)
        && [header.grid, header.step, header.step_ratio]
            .iter()
            .chain(units)
            .all(|&x| x.is_normal() && x > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn next(state: &mut u64) -> u64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        *state >> 33
    }

    fn noise(state: &mut u64, length: usize) -> Vec<u8> {
        // Runs of one byte drive models to their extremes.
        let run = 1 + next(state) as usize % 9;
        let bytes: Vec<u8> = (0..length.div_ceil(run)).map(|_| next(state) as u8).collect();
        bytes.into_iter().flat_map(|byte| std::iter::repeat_n(byte, run)).take(length).collect()
    }

    /// Correct checksums do not exclude forged files, so their contents must be harmless, too.
    #[test]
    fn noise_with_good_checksums_is_refused_or_read_within_bounds() {
        let state = &mut 7;
        let mut read = [0; 2];
        for round in 0..3000 {
            let up = [None, Some([0.0, -1.0, 0.0]), Some([0.6, 0.0, 0.8])][round % 3];
            let header = Header { grid: 1.0, step: 1.0, step_ratio: 2.0, levels: 3, up, ..Header::default() };
            let mut file = MAGIC.to_vec();
            let version = if up.is_some() { VERSION_WITH_UP } else { VERSION_PLAIN };
            file.push(version);
            let mut checksum = initial_checksum(version);
            let length = next(state) as usize % 200;
            let mut coded = noise(state, length);
            if round % 2 == 0 {
                // Noise after a valid header.
                let mut coder = Encoder::default();
                header::code_header(&mut coder, &header).unwrap();
                coded.splice(0..0, coder.finish());
            }
            file_parts::append_part(&mut file, &coded, &mut checksum);
            for _ in 0..3 {
                let length = next(state) as usize % 50;
                file_parts::append_part(&mut file, &noise(state, length), &mut checksum);
            }
            let Ok((mut reader, _, base)) = Reader::new(&file) else { continue };
            read[0] += 1;
            assert!(
                base.positions.len() <= 8 * (coded.len() + 8),
                "{} of {}",
                base.positions.len(),
                coded.len()
            );
            assert!(base.triangles.len() <= 16 * (coded.len() + 8));
            let Ok(mut topology) = Topology::new(base.positions.len(), base.triangles) else { continue };
            while let Ok(Some(refinement)) = reader.read_level(&topology, &[]) {
                assert_eq!(refinement.offsets.len(), topology.edges.len());
                read[1] += 1;
                topology = topology.subdivide();
            }
        }
        assert!(read.iter().all(|&count| count > 100), "{read:?}");
    }
}
