"""Simplifiers with a common interface.

Each takes a mesh, a triangle count and a setting. It returns the call that is measured, and a function that
converts its result to a Mesh. One-time work of a tool's user, such as filling the tool's own mesh class,
stays outside the call.
"""

from __future__ import annotations

import ctypes
import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import metadata
from typing import Any

import numpy as np

from peers import native
from peers.native import Missing
from scanloom.stages._open3d import open3d
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.simplification.color_weight import color_weight
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.convert import as_mesh, to_open3d, to_open3d_legacy
from scanloom.stages.surface.mesh import Mesh

Prepared = tuple[Callable[[], Any], Callable[[Any], Mesh]]


@dataclass(frozen=True)
class Tool:
    """Simplifier and its settings.

    Attributes
    ----------
    prepare : returns the call to measure, and the conversion of its result.
    version : returns the version; raises Missing if the tool cannot be called.
    keeps_color : True if the result has colours. Meshes without colours run with the first setting only.
    settings : keyword arguments of `prepare`, by name in the table.
    is_quadric : True if the tool uses quadric errors, as most do.
    """

    name: str
    prepare: Callable[..., Prepared]
    version: Callable[[], str]
    keeps_color: bool
    settings: Mapping[str, Mapping[str, float]]
    is_quadric: bool = True


def package(name: str) -> Callable[[], str]:
    """Return a function that imports a Python package and returns its version."""

    def version() -> str:
        try:
            importlib.import_module(name)
            return metadata.version(name)
        except (ImportError, OSError, metadata.PackageNotFoundError) as error:
            raise Missing(str(error)) from error

    return version


def ours(mesh: Mesh, triangles: int, weight: float) -> Prepared:
    """Prepare `simplify`; `weight` multiplies the default colour weight."""
    # The default is derived inside the measured call, as it is for users.
    scale = None if weight == 1 else weight * color_weight(mesh, triangles)
    return lambda: simplify(mesh, triangles=triangles, attribute_scale=scale), lambda result: result.mesh


def open3d_legacy(mesh: Mesh, triangles: int) -> Prepared:
    """Prepare Open3D's legacy quadric decimation, which averages colours."""
    given = to_open3d_legacy(mesh)
    return lambda: given.simplify_quadric_decimation(triangles), as_mesh


def open3d_tensor(mesh: Mesh, triangles: int) -> Prepared:
    """Prepare Open3D's tensor decimation, which uses VTK and drops colours."""
    given = to_open3d(mesh.with_(colors=None))
    reduction = 1 - triangles / len(mesh.triangles)
    return lambda: given.simplify_quadric_decimation(reduction), as_mesh


def pymeshlab(mesh: Mesh, triangles: int) -> Prepared:
    """Prepare MeshLab's quadric edge collapse with its defaults."""
    import pymeshlab

    colors = {} if mesh.colors is None else {"v_color_matrix": rgba(mesh.colors)}
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.triangles, **colors))

    def result(_: Any) -> Mesh:
        light = meshes.current_mesh()
        colors = None if mesh.colors is None else levels(light.vertex_color_matrix()[:, :3] * 255)
        return Mesh(light.vertex_matrix(), light.face_matrix(), colors)

    return lambda: meshes.meshing_decimation_quadric_edge_collapse(targetfacenum=triangles), result


def fast_simplification(mesh: Mesh, triangles: int) -> Prepared:
    """Prepare fast-simplification, which collapses edges below a rising threshold."""
    import fast_simplification

    def call() -> Any:
        return fast_simplification.simplify(mesh.vertices, mesh.triangles, target_count=triangles)

    return call, lambda result: Mesh(result[0], result[1].astype(np.int32))


def vtk(mesh: Mesh, triangles: int, weight: float) -> Prepared:
    """Prepare VTK's quadric decimation with colours as attributes.

    VTK scales the weight by the range of the colours.
    """
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
    from vtkmodules.vtkFiltersCore import vtkQuadricDecimation

    points, cells, given, decimation = vtkPoints(), vtkCellArray(), vtkPolyData(), vtkQuadricDecimation()
    points.SetData(numpy_to_vtk(mesh.vertices, deep=True))
    cells.SetData(3, numpy_to_vtkIdTypeArray(mesh.triangles.astype(np.int64).ravel(), deep=True))
    given.SetPoints(points)
    given.SetPolys(cells)
    decimation.SetInputData(given)
    decimation.SetTargetReduction(1 - triangles / len(mesh.triangles))
    if mesh.colors is not None:
        scalars = numpy_to_vtk(mesh.colors.astype(np.float32), deep=True)
        scalars.SetName("colors")  # VTK silently ignores attributes without a name.
        given.GetPointData().SetScalars(scalars)
        decimation.AttributeErrorMetricOn()
        decimation.ScalarsAttributeOn()
        decimation.SetScalarsWeight(weight)

    def result(_: Any) -> Mesh:
        light = decimation.GetOutput()
        colors = None
        if mesh.colors is not None:
            colors = levels(vtk_to_numpy(light.GetPointData().GetScalars()))
        corners = vtk_to_numpy(light.GetPolys().GetConnectivityArray()).reshape(-1, 3)
        vertices = vtk_to_numpy(light.GetPoints().GetData())
        return Mesh(vertices.astype(np.float64), corners.astype(np.int32), colors)

    return decimation.Update, result


def meshoptimizer(mesh: Mesh, triangles: int, weight: float) -> Prepared:
    """Prepare meshoptimizer, which updates positions and colours (0 to 1).

    Its lengths are relative to the mesh's extent.
    """
    library = native.meshoptimizer()
    indices = mesh.triangles.astype(np.uint32)
    positions = mesh.vertices.astype(np.float32)
    colors = np.zeros((len(positions), 0), np.float32)
    if mesh.colors is not None:
        colors = mesh.colors.astype(np.float32) / 255
    weights = np.full(colors.shape[1], weight, np.float32)

    def call() -> int:
        return library.simplify(
            pointer(indices),
            ctypes.c_size_t(len(indices)),
            pointer(positions),
            pointer(colors),
            ctypes.c_size_t(len(positions)),
            pointer(weights),
            ctypes.c_size_t(len(weights)),
            ctypes.c_size_t(triangles),
        )

    def result(left: int) -> Mesh:
        # meshoptimizer keeps removed vertices in the arrays.
        used, corners = np.unique(indices[:left], return_inverse=True)
        return Mesh(
            positions[used].astype(np.float64),
            corners.reshape(-1, 3).astype(np.int32),
            None if mesh.colors is None else levels(colors[used] * 255),
        )

    return call, result


def cgal(function: str) -> Callable[[Mesh, int], Prepared]:
    """Return a function that prepares one of the simplifiers of cgal.cpp."""

    def prepare(mesh: Mesh, triangles: int) -> Prepared:
        library = native.cgal()
        sizes = [ctypes.c_size_t(len(mesh.vertices)), ctypes.c_size_t(len(mesh.triangles))]
        handle = ctypes.c_void_p(
            library.load(pointer(mesh.vertices), sizes[0], pointer(mesh.triangles), sizes[1])
        )
        if not handle:
            raise Missing("CGAL rejects the mesh as non-manifold")

        def result(_: Any) -> Mesh:
            light = Mesh(
                np.empty((library.vertex_count(handle), 3)),
                np.empty((library.triangle_count(handle), 3), np.int32),
            )
            library.unload(handle, pointer(light.vertices), pointer(light.triangles))
            return light

        return lambda: getattr(library, function)(handle, ctypes.c_size_t(triangles)), result

    return prepare


def open3d_version() -> str:
    """Return Open3D's version."""
    try:
        return str(open3d().__version__)
    except StageError as error:
        raise Missing(str(error)) from error


def cgal_version() -> str:
    """Return CGAL's version."""
    return str(native.cgal().version().decode())


def meshoptimizer_version() -> str:
    """Return the version of the crate `meshopt` from its lock file."""
    native.meshoptimizer()
    lock = (native.HERE / "meshoptimizer/Cargo.lock").read_text()
    return "crate meshopt " + lock.split('name = "meshopt"\nversion = "')[1].split('"')[0]


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    """Return the address of an array's data."""
    return array.ctypes.data_as(ctypes.c_void_p)


def rgba(colors: np.ndarray) -> np.ndarray:
    """Convert 8-bit colours to opaque RGBA, 0 to 1."""
    return np.hstack([colors / 255, np.ones((len(colors), 1))])


def levels(colors: np.ndarray) -> np.ndarray:
    """Round colours (0 to 255) to 8 bits."""
    return np.rint(colors).clip(0, 255).astype(np.uint8)


def weights(*values: float, prefix: str = "weight ") -> dict[str, dict[str, float]]:
    """Make a setting for each weight."""
    return {f"{prefix}{value:g}": {"weight": value} for value in values}


ONE_WAY: dict[str, dict[str, float]] = {"": {}}
# The default has to be first.
OUR_WAYS = {"default": {"weight": 1.0}} | weights(0, 0.3, 3, 10, 30, prefix="default × ")

OURS = "scanloom"
TOOLS = (
    Tool(OURS, ours, lambda: "this package", True, OUR_WAYS),
    Tool("CGAL Lindstrom–Turk", cgal("lindstrom_turk"), cgal_version, False, ONE_WAY, is_quadric=False),
    Tool("CGAL Garland–Heckbert", cgal("garland_heckbert"), cgal_version, False, ONE_WAY),
    Tool("VTK", vtk, package("vtk"), True, weights(0.003, 0.01, 0.03, 0.1, 0.3, 1)),
    Tool("meshoptimizer", meshoptimizer, meshoptimizer_version, True, weights(0.03, 0.1, 0.3, 1, 3, 10)),
    Tool("PyMeshLab", pymeshlab, package("pymeshlab"), True, ONE_WAY),
    Tool("Open3D legacy", open3d_legacy, open3d_version, True, ONE_WAY),
    Tool("Open3D tensor", open3d_tensor, open3d_version, False, ONE_WAY),
    Tool("fast-simplification", fast_simplification, package("fast_simplification"), False, ONE_WAY),
)
