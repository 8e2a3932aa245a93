//! `scanloom.stages._kernels.label_components`.

use numpy::ndarray::ArrayView1;
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use super::memory_guard::with_memory_reserve;
use crate::base::components::Components;

/// Node indices (k,).
#[derive(FromPyObject)]
pub enum Nodes<'py> {
    Short(PyReadonlyArray1<'py, i32>),
    Long(PyReadonlyArray1<'py, i64>),
}

/// Label the connected components of `count` nodes that are joined by pairs. Returns their number, and the label
/// (count,) of each node.
#[pyfunction]
pub fn label_components(
    py: Python<'_>,
    count: usize,
    a: Nodes<'_>,
    b: Nodes<'_>,
) -> PyResult<(usize, Py<PyArray1<i32>>)> {
    if count > i32::MAX as usize {
        return Err(PyValueError::new_err(format!("{count} nodes; at most {} are supported", i32::MAX)));
    }
    with_memory_reserve(count, || {
        let mut components = Components::new(count);
        match (&a, &b) {
            (Nodes::Short(a), Nodes::Short(b)) => {
                join_all(&mut components, count, a.as_array(), b.as_array())
            }
            (Nodes::Short(a), Nodes::Long(b)) => join_all(&mut components, count, a.as_array(), b.as_array()),
            (Nodes::Long(a), Nodes::Short(b)) => join_all(&mut components, count, a.as_array(), b.as_array()),
            (Nodes::Long(a), Nodes::Long(b)) => join_all(&mut components, count, a.as_array(), b.as_array()),
        }?;
        let (number, labels) = components.label();
        Ok((number, PyArray1::from_iter(py, labels.into_iter().map(|label| label as i32)).unbind()))
    })
}

/// Join pairs without copies of the arrays, which can be many times as large as the labels.
fn join_all<A: Copy + Into<i64>, B: Copy + Into<i64>>(
    components: &mut Components,
    count: usize,
    a: ArrayView1<'_, A>,
    b: ArrayView1<'_, B>,
) -> PyResult<()> {
    if a.len() != b.len() {
        return Err(PyValueError::new_err(format!("{} and {} nodes cannot be paired", a.len(), b.len())));
    }
    let known = |node: i64| {
        usize::try_from(node)
            .ok()
            .filter(|&node| node < count)
            .ok_or_else(|| PyValueError::new_err(format!("node {node} does not exist; there are {count}")))
    };
    for (&a, &b) in a.iter().zip(b.iter()) {
        components.join(known(a.into())?, known(b.into())?);
    }
    Ok(())
}
