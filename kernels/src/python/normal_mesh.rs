//! `scanloom.stages._kernels.remesh` and `decode_normal_mesh`.

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::create_exception;
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use super::arrays::{column_array, copy_triangles, id_array, rows, triangle_array};
use super::background_work::run_detached;
use super::memory_guard::with_memory_reserve;
use crate::base::errors::KernelError;
use crate::base::geometry::Vec3;
use crate::base::parallel::resolve_thread_count;
use crate::normal::coarsening::Target;
use crate::normal::decode::decode;
use crate::normal::input::OriginalSurface;
use crate::normal::level::Level;
use crate::normal::normal_mesh::{NormalMesh as Made, RefinementStep};
use crate::normal::quantization::QuantizationSteps;
use crate::normal::remesh::remesh as make;
use crate::normal::settings::Settings;
use crate::normal::tolerance::ToleranceSource;
use crate::normal::vertex_attributes::{VertexAttributes, to_rgb};
use crate::snm::SnmError as DecodeError;
use crate::subdivision::snm_contents::{Offset, Scheme};

create_exception!(
    scanloom.stages._kernels,
    SnmError,
    PyValueError,
    "The bytes are not an `.snm` file, or are damaged before the end of the base mesh."
);

/// Base mesh with its levels.
#[pyclass(frozen, module = "scanloom.stages._kernels")]
pub struct NormalMesh {
    made: Made,
    #[pyo3(get)]
    damage: Option<String>,
}

#[pymethods]
impl NormalMesh {
    #[getter]
    fn levels(&self) -> usize {
        self.made.steps.len()
    }

    #[getter]
    fn encoded_levels(&self) -> usize {
        self.made.header.levels.into()
    }

    #[getter]
    fn folded_counts(&self) -> Vec<usize> {
        self.made.encoder_info.as_ref().map_or(vec![], |origin| origin.fold_counts.clone())
    }

    #[getter]
    fn tolerance(&self) -> Option<f64> {
        self.made.encoder_info.as_ref().map(|origin| origin.tolerance.relative)
    }

    #[getter]
    fn tolerance_source(&self) -> Option<&'static str> {
        self.made.encoder_info.as_ref().map(|origin| match origin.tolerance.source {
            ToleranceSource::Given => "given",
            ToleranceSource::Distance => "distance",
            ToleranceSource::Noise => "noise",
            ToleranceSource::Bound => "bound",
            ToleranceSource::Precision => "precision",
        })
    }

    #[getter]
    fn data<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.made.file)
    }

    #[getter]
    fn level_ends(&self) -> Vec<usize> {
        self.made.ends.clone()
    }

    #[getter]
    fn up(&self) -> Option<[f64; 3]> {
        self.made.header.up
    }

    #[getter]
    fn base_source(&self, py: Python<'_>) -> PyResult<Option<Py<PyArray1<i32>>>> {
        let Some(origin) = &self.made.encoder_info else { return Ok(None) };
        with_memory_reserve(origin.base_source.len(), || {
            Ok(Some(id_array(py, origin.base_source.iter().copied())))
        })
    }

    #[getter]
    fn reached(&self) -> Vec<f64> {
        self.made.encoder_info.as_ref().map_or(vec![], |origin| origin.max_distances.clone())
    }

    fn vertices(&self, py: Python<'_>, level: usize) -> PyResult<Py<PyArray2<f64>>> {
        self.guarded(level, || {
            column_array(py, &self.to_caller_coordinates(&self.level(level)?.points), 0..3)
        })
    }

    fn triangles(&self, py: Python<'_>, level: usize) -> PyResult<Py<PyArray2<i32>>> {
        self.guarded(level, || triangle_array(py, &self.level(level)?.topology.triangles))
    }

    fn colors(&self, py: Python<'_>, level: usize) -> PyResult<Option<Py<PyArray2<u8>>>> {
        self.guarded(level, || {
            let channels = &self.level(level)?.channels;
            if self.made.header.channels < 3 {
                return Ok(None);
            }
            let values: Vec<u8> = channels.iter().flat_map(|&[y, o, g, _]| to_rgb([y, o, g])).collect();
            Ok(Some(PyArray1::from_vec(py, values).reshape([channels.len(), 3])?.unbind()))
        })
    }

    fn confidence(&self, py: Python<'_>, level: usize) -> PyResult<Option<Py<PyArray1<f64>>>> {
        self.guarded(level, || {
            let channels = &self.level(level)?.channels;
            let place = match self.made.header.channels {
                1 => 0,
                4 => 3,
                _ => return Ok(None),
            };
            Ok(Some(PyArray1::from_vec(py, channels.iter().map(|c| c[place]).collect()).unbind()))
        })
    }

    fn hit_triangle(&self, py: Python<'_>, level: usize) -> PyResult<Option<Py<PyArray1<i32>>>> {
        self.guarded(level, || {
            let count = self.level(level)?.points.len();
            let Some(origin) = &self.made.encoder_info else { return Ok(None) };
            Ok(Some(id_array(py, origin.vertex_triangles[..count].iter().copied())))
        })
    }

    fn kinds(&self, py: Python<'_>, level: usize) -> PyResult<Py<PyArray1<u8>>> {
        self.guarded(level, || {
            let (coarse, step) = self.step(level)?;
            let kind = |(edge, offset): (usize, &Offset)| match offset {
                Offset::Scalar(_) | Offset::Unrelaxed(_) => 0,
                Offset::Vector(_) if coarse.topology.is_boundary_edge(edge) => 2,
                Offset::Vector(_) => 1,
            };
            let kinds = step.refinement.offsets.iter().enumerate().map(kind).collect();
            Ok(PyArray1::from_vec(py, kinds).unbind())
        })
    }

    fn offsets(&self, py: Python<'_>, level: usize) -> PyResult<Py<PyArray2<f64>>> {
        self.guarded(level, || {
            let (_, step) = self.step(level)?;
            let steps = QuantizationSteps::for_level(&self.made.header, level - 1);
            let metres = |offset: &Offset| match offset {
                Offset::Scalar(d) | Offset::Unrelaxed(d) => [f64::from(*d) * steps.scalar, 0.0, 0.0],
                Offset::Vector(d) => d.map(|d| f64::from(d) * steps.vector),
            };
            let rows: Vec<Vec3> = step.refinement.offsets.iter().map(metres).collect();
            column_array(py, &rows, 0..3)
        })
    }

    fn predicted(&self, py: Python<'_>, level: usize) -> PyResult<Py<PyArray2<f64>>> {
        self.guarded(level, || {
            let (_, step) = self.step(level)?;
            let offsets = step.refinement.offsets.iter().enumerate();
            let from = offsets.map(|(edge, offset)| match offset {
                Offset::Unrelaxed(_) => step.predicted.unrelaxed[edge],
                _ => step.predicted.points[edge],
            });
            column_array(py, &self.to_caller_coordinates(&from.collect::<Vec<_>>()), 0..3)
        })
    }

    fn frames(&self, py: Python<'_>, level: usize) -> PyResult<Py<PyArray2<f64>>> {
        self.guarded(level, || {
            let (_, step) = self.step(level)?;
            let normals: Vec<Vec3> = step.predicted.frames.iter().map(|frame| frame[0]).collect();
            column_array(py, &normals, 0..3)
        })
    }
}

impl NormalMesh {
    /// Run `work` with a memory reserve for the output of a level.
    fn guarded<R>(&self, level: usize, work: impl FnOnce() -> PyResult<R>) -> PyResult<R> {
        let level = self.level(level)?;
        with_memory_reserve(level.points.len() + level.topology.triangles.len(), work)
    }

    fn level(&self, level: usize) -> PyResult<&Level> {
        self.made
            .levels
            .get(level)
            .ok_or_else(|| PyIndexError::new_err(format!("level {level} does not exist")))
    }

    /// Return the previous level, and the step from it to this level.
    fn step(&self, level: usize) -> PyResult<(&Level, &RefinementStep)> {
        let none = || PyIndexError::new_err(format!("level {level} has no refinement step"));
        let before = level.checked_sub(1).ok_or_else(none)?;
        let step = self.made.steps.get(before).ok_or_else(none)?;
        Ok((self.level(before)?, step))
    }

    /// Convert points to the caller's coordinates.
    fn to_caller_coordinates(&self, points: &[Vec3]) -> Vec<Vec3> {
        let header = &self.made.header;
        let shift = header.origin.map(|k| k as f64 * f64::from(header.grid));
        points.iter().map(|p| [0, 1, 2].map(|i| p[i] + shift[i])).collect()
    }
}

/// Build a normal mesh; `colors` and `confidence` may be empty.
#[pyfunction]
#[pyo3(signature = (vertices, colors, confidence, triangles, original, *, levels, base_triangles, base_error,
                    ignore_cost_limit, max_error, butterfly, relaxations, tolerance, color_tolerance, up,
                    threads, progress))]
#[allow(clippy::too_many_arguments)]
pub fn remesh(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    colors: PyReadonlyArray2<'_, u8>,
    confidence: PyReadonlyArray1<'_, f64>,
    triangles: PyReadonlyArray2<'_, i32>,
    original: Option<(PyReadonlyArray2<'_, f64>, PyReadonlyArray2<'_, i32>)>,
    levels: Option<u8>,
    base_triangles: usize,
    base_error: f64,
    ignore_cost_limit: bool,
    max_error: f64,
    butterfly: bool,
    relaxations: u8,
    tolerance: Option<f64>,
    color_tolerance: f64,
    up: Option<[f64; 3]>,
    #[pyo3(from_py_with = extract_thread_count)] threads: usize,
    progress: Py<PyAny>,
) -> PyResult<NormalMesh> {
    let (vertices, colors) = (vertices.as_array(), colors.as_array());
    let colored = colors.ncols() > 0;
    let count = vertices.nrows();
    with_memory_reserve(count + triangles.as_array().nrows(), || {
        let confidence = confidence.as_array().to_vec();
        if vertices.ncols() != 3
            || (colored && colors.dim() != (count, 3))
            || !(confidence.is_empty() || confidence.len() == count)
        {
            return Err(PyValueError::new_err(format!(
                "vertices have shape {:?}, colors {:?}, confidence {}; n × 3, n × 3 or n × 0, n or 0 are expected",
                vertices.shape(),
                colors.shape(),
                confidence.len()
            )));
        }
        if confidence.iter().any(|c| !c.is_finite()) {
            return Err(PyValueError::new_err("confidence has a value that is not finite"));
        }
        let points: Vec<Vec3> = vertices.rows().into_iter().map(|r| [r[0], r[1], r[2]]).collect();
        let colors =
            if colored { colors.rows().into_iter().map(|r| [r[0], r[1], r[2]]).collect() } else { vec![] };
        let triangles = copy_triangles(&triangles, points.len())?;
        let carried = VertexAttributes { colors, confidence };
        let settings = Settings {
            levels,
            target: Target { triangles: base_triangles, error: base_error, ignore_cost_limit },
            max_error,
            scheme: if butterfly { Scheme::Butterfly } else { Scheme::Linear },
            relaxations,
            tolerance,
            color_tolerance,
            up,
            threads,
        };
        let original = match &original {
            Some((vertices, triangles)) => {
                let points = rows(vertices)?;
                let triangles = copy_triangles(triangles, points.len())?;
                Some((points, triangles))
            }
            None => None,
        };
        let made = run_detached(py, Some(&progress), false, |progress| {
            let simplified = original.as_ref().map(|(points, triangles)| OriginalSurface {
                from_points: points,
                from_triangles: triangles,
            });
            make(&points, &triangles, &carried, simplified, &settings, progress)
        })?;
        Ok(NormalMesh { made, damage: None })
    })
}

fn extract_thread_count(wanted: &Bound<'_, PyAny>) -> PyResult<usize> {
    Ok(resolve_thread_count(wanted.extract()?))
}

/// Decode a file up to a level, −1 for all. Damaged levels after the base mesh are dropped, and `damage`
/// describes the damage.
#[pyfunction]
pub fn decode_normal_mesh(py: Python<'_>, data: &[u8], level: i64) -> PyResult<NormalMesh> {
    let wanted = usize::try_from(level).unwrap_or(usize::MAX);
    with_memory_reserve(data.len(), || {
        let (made, damage) = py.detach(|| decode(data, wanted)).map_err(|error| match error {
            DecodeError::Mesh(KernelError::OutOfMemory) => KernelError::OutOfMemory.into(),
            _ => SnmError::new_err(error.to_string()),
        })?;
        Ok(NormalMesh { made, damage: damage.map(|why| why.to_string()) })
    })
}
