//! Decoding of a file into its levels.

use super::level::Level;
use super::normal_mesh::{NormalMesh, RefinementStep};
use super::quantization::QuantizationSteps;
use crate::base::memory_reserve::Reserve;
use crate::snm::{Reader, SnmError};

/// Decode the levels of a file up to level `wanted`. If a later part is damaged, the levels before it are
/// returned with the error.
///
/// # Errors
/// If the base mesh cannot be read or memory is exhausted.
pub fn decode(file: &[u8], wanted: usize) -> Result<(NormalMesh, Option<SnmError>), SnmError> {
    let (mut reader, header, base) = Reader::new(file)?;
    let damaged = |_| SnmError::Damaged { part: 0 };
    let _reserve = Reserve::for_rows(base.positions.len() + base.triangles.len()).map_err(SnmError::Mesh)?;
    let mut levels = vec![Level::from_base(&header, &base).map_err(damaged)?];
    let mut ends = vec![file.len() - reader.remaining_byte_count()];
    let (mut steps, mut damage) = (vec![], None);
    while levels.len() <= wanted {
        let Some(level) = levels.last() else { break };
        let reserve = Reserve::for_rows(level.next_row_count()).map_err(SnmError::Mesh)?;
        let step = QuantizationSteps::for_level(&header, levels.len() - 1);
        let predicted = level.predict_vertices(&header);
        let expected = level.predict_offsets(&header, &step, &predicted);
        match reader.read_level(&level.topology, &expected) {
            Ok(Some(refinement)) => {
                levels.push(level.refine(&header, &step, &predicted, &refinement));
                ends.push(file.len() - reader.remaining_byte_count());
                steps.push(RefinementStep { predicted, refinement });
                reserve.check().map_err(SnmError::Mesh)?;
            }
            Ok(None) => break,
            Err(error) => {
                damage = Some(error);
                break;
            }
        }
    }
    let end = ends.last().copied().unwrap_or(0);
    let made = NormalMesh { header, levels, steps, file: file[..end].to_vec(), ends, encoder_info: None };
    Ok((made, damage))
}
