//! Mesh kernels of scanloom: a pure library; the Python layer sits behind the `python` feature.

#[cfg(feature = "python")]
mod python;
