//! Decoding of a file into its levels.

use super::grid::Steps;
use super::level::Level;
use super::normal_mesh::{NormalMesh, Step};
use crate::base::reserve::Reserve;
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
    let mut levels = vec![Level::base(&header, &base).map_err(damaged)?];
    let mut ends = vec![file.len() - reader.left()];
    let (mut steps, mut damage) = (vec![], None);
    while levels.len() <= wanted {
        let Some(level) = levels.last() else { break };
        let reserve = Reserve::for_rows(level.next_rows()).map_err(SnmError::Mesh)?;
        let step = Steps::of(&header, levels.len() - 1);
        let predicted = level.predicted(&header);
        let expected = level.expected(&header, &step, &predicted);
        match reader.level(&level.topology, &expected) {
            Ok(Some(refinement)) => {
                levels.push(level.refined(&header, &step, &predicted, &refinement));
                ends.push(file.len() - reader.left());
                steps.push(Step { predicted, refinement });
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
    let made = NormalMesh { header, levels, steps, file: file[..end].to_vec(), ends, origin: None };
    Ok((made, damage))
}
