//! Conversion between NumPy arrays and meshes.

use std::ops::Range;

use numpy::ndarray::ArrayView2;
use numpy::{Element, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::base::errors::KernelError;

/// Points with their attributes, and triangles.
type PointsAndTriangles<const D: usize> = (Vec<[f64; D]>, Vec<[u32; 3]>);

/// Vertex attributes (n, k): colour levels, or floating-point numbers.
#[derive(FromPyObject)]
pub enum Attributes<'py> {
    Levels(PyReadonlyArray2<'py, u8>),
    Numbers(PyReadonlyArray2<'py, f64>),
}

impl Attributes<'_> {
    /// Return the shape [n, k].
    pub fn shape(&self) -> [usize; 2] {
        match self {
            Self::Levels(levels) => levels.as_array().dim().into(),
            Self::Numbers(numbers) => numbers.as_array().dim().into(),
        }
    }
}

/// Arrays of a mesh, as passed from Python.
pub struct MeshInputs<'py> {
    pub vertices: PyReadonlyArray2<'py, f64>,
    pub attributes: Attributes<'py>,
    pub triangles: PyReadonlyArray2<'py, i32>,
}

impl MeshInputs<'_> {
    /// Return the attributes per vertex: 0 or 3 (RGB) are valid, else [`unsupported_attributes`].
    pub fn attribute_count(&self) -> usize {
        self.attributes.shape()[1]
    }

    /// Return the number of vertices plus triangles.
    pub fn row_count(&self) -> usize {
        self.vertices.as_array().nrows() + self.triangles.as_array().nrows()
    }

    /// Copy points and triangles; checks their shapes and signs.
    pub fn copy_mesh<const D: usize>(&self) -> PyResult<PointsAndTriangles<D>> {
        let points = copy_points::<D>(&self.vertices, &self.attributes)?;
        let triangles = copy_triangles(&self.triangles, points.len())?;
        Ok((points, triangles))
    }

    /// Copy an array with one value per vertex, or an empty one.
    pub fn per_vertex<T: Element + Copy>(
        &self,
        name: &str,
        values: &PyReadonlyArray1<'_, T>,
    ) -> PyResult<Vec<T>> {
        let values = values.as_array().to_vec();
        if values.is_empty() || values.len() == self.vertices.as_array().nrows() {
            return Ok(values);
        }
        Err(PyValueError::new_err(format!("{name} must have one value for each vertex")))
    }
}

/// Make the error for an unsupported number of attributes.
pub fn unsupported_attributes(k: usize) -> PyErr {
    PyValueError::new_err(format!("{k} attributes per vertex; 0 or 3 (RGB) are supported"))
}

/// Copy vertices and attributes into points; checks their shapes.
pub fn copy_points<const D: usize>(
    vertices: &PyReadonlyArray2<'_, f64>,
    attributes: &Attributes<'_>,
) -> PyResult<Vec<[f64; D]>> {
    match attributes {
        Attributes::Levels(levels) => join_columns(vertices.as_array(), levels.as_array()),
        Attributes::Numbers(numbers) => join_columns(vertices.as_array(), numbers.as_array()),
    }
}

fn join_columns<T: Copy + Into<f64>, const D: usize>(
    vertices: ArrayView2<'_, f64>,
    attributes: ArrayView2<'_, T>,
) -> PyResult<Vec<[f64; D]>> {
    if vertices.ncols() != 3 || attributes.nrows() != vertices.nrows() {
        return Err(PyValueError::new_err(format!(
            "vertices have shape {:?} and attributes {:?}; n × 3 and n × k are expected",
            vertices.shape(),
            attributes.shape()
        )));
    }
    let (vertices, attributes) = (vertices.as_standard_layout(), attributes.as_standard_layout());
    let places = vertices.as_slice().unwrap_or_default().chunks_exact(3);
    let k = D - 3;
    let values = attributes.as_slice().unwrap_or_default();
    let point = |(v, place): (usize, &[f64])| {
        std::array::from_fn(|i| if i < 3 { place[i] } else { values[k * v + i - 3].into() })
    };
    Ok(places.enumerate().map(point).collect())
}

/// Copy triangles; rejects negative indices.
pub fn copy_triangles(triangles: &PyReadonlyArray2<'_, i32>, vertices: usize) -> PyResult<Vec<[u32; 3]>> {
    let triangles = triangles.as_array();
    if triangles.ncols() != 3 {
        return Err(PyValueError::new_err(format!(
            "triangles have shape {:?}; m × 3 is expected",
            triangles.shape()
        )));
    }
    let triangles = triangles.as_standard_layout();
    let values = triangles.as_slice().unwrap_or_default();
    if let Some(place) = values.iter().position(|&v| v < 0) {
        let (triangle, vertex) = (place / 3, values[place].into());
        return Err(KernelError::IndexOutOfRange { triangle, vertex, vertices }.into());
    }
    Ok(values.chunks_exact(3).map(|t| [t[0] as u32, t[1] as u32, t[2] as u32]).collect())
}

/// Copy some columns of a table. For points, columns 0..3 are the position, and attributes follow.
pub fn column_array<const D: usize>(
    py: Python<'_>,
    rows: &[[f64; D]],
    columns: Range<usize>,
) -> PyResult<Py<PyArray2<f64>>> {
    let shape = [rows.len(), columns.len()];
    let values: Vec<f64> = rows.iter().flat_map(|row| &row[columns.clone()]).copied().collect();
    Ok(PyArray1::from_vec(py, values).reshape(shape)?.unbind())
}

/// Convert triangles to an array (m, 3).
pub fn triangle_array(py: Python<'_>, triangles: &[[u32; 3]]) -> PyResult<Py<PyArray2<i32>>> {
    let values: Vec<i32> = triangles.iter().flatten().map(|&v| v as i32).collect();
    Ok(PyArray1::from_vec(py, values).reshape([triangles.len(), 3])?.unbind())
}

/// Convert indices to an array (n,).
pub fn id_array(py: Python<'_>, ids: impl Iterator<Item = u32>) -> Py<PyArray1<i32>> {
    PyArray1::from_vec(py, ids.map(|id| id as i32).collect()).unbind()
}

/// Copy an array of rows with D numbers.
pub fn rows<T: Element + Copy, const D: usize>(array: &PyReadonlyArray2<'_, T>) -> PyResult<Vec<[T; D]>> {
    let array = array.as_array();
    if array.ncols() != D {
        return Err(PyValueError::new_err(format!(
            "an array has shape {:?}; n × {D} is expected",
            array.shape()
        )));
    }
    Ok((0..array.nrows()).map(|i| std::array::from_fn(|k| array[[i, k]])).collect())
}
