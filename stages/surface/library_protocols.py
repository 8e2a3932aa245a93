"""Protocols of the Open3D and trimesh classes.

They allow type annotations without an import of these libraries. Only members that scanloom uses are listed.
"""

# ruff: noqa: D102  (members are documented by their library)

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Tensor(Protocol):
    """Protocol of open3d.core.Tensor."""

    def cpu(self) -> Tensor: ...

    def numpy(self) -> NDArray[np.generic]: ...


class TensorImage(Protocol):
    """Protocol of open3d.t.geometry.Image."""

    def cpu(self) -> TensorImage: ...

    def as_tensor(self) -> Tensor: ...


class TensorMaterial(Protocol):
    """Protocol of open3d.visualization.Material."""

    @property
    def texture_maps(self) -> TextureMaps: ...


class TextureMaps(Protocol):
    """Protocol of a material's images by name."""

    def __contains__(self, name: str, /) -> bool: ...

    def __getitem__(self, name: str, /) -> TensorImage: ...


class TensorMap(Protocol):
    """Protocol of vertex or triangle attributes by name."""

    def __contains__(self, name: str, /) -> bool: ...

    def __getitem__(self, name: str, /) -> Tensor: ...


class Open3DMesh(Protocol):
    """Protocol of open3d.t.geometry.TriangleMesh."""

    @property
    def vertex(self) -> TensorMap: ...

    @property
    def triangle(self) -> TensorMap: ...

    @property
    def material(self) -> TensorMaterial: ...

    def has_valid_material(self) -> bool: ...


class LegacyImage(Protocol):
    """Protocol of open3d.geometry.Image."""

    def is_empty(self) -> bool: ...


class Open3DLegacyMesh(Protocol):
    """Protocol of open3d.geometry.TriangleMesh."""

    @property
    def vertices(self) -> Iterable[NDArray[np.float64]]: ...

    @property
    def triangles(self) -> Iterable[NDArray[np.int32]]: ...

    @property
    def vertex_colors(self) -> Iterable[NDArray[np.float64]]: ...

    @property
    def vertex_normals(self) -> Iterable[NDArray[np.float64]]: ...

    @property
    def triangle_uvs(self) -> Iterable[NDArray[np.float64]]: ...

    @property
    def triangle_material_ids(self) -> Iterable[int]: ...

    @property
    def textures(self) -> Sequence[LegacyImage]: ...

    def has_vertex_colors(self) -> bool: ...

    def has_vertex_normals(self) -> bool: ...

    def has_triangle_uvs(self) -> bool: ...


class TrimeshMesh(Protocol):
    """Protocol of trimesh.Trimesh."""

    @property
    def vertices(self) -> NDArray[np.float64]: ...

    @property
    def faces(self) -> NDArray[np.int64]: ...

    @property
    def vertex_normals(self) -> NDArray[np.float64]: ...

    @property
    def visual(self) -> object: ...

    # Names of computed attributes. Reading `compute_vertex_normals` would compute them.
    @property
    def _cache(self) -> Container[str]: ...
