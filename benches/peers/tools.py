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
from peers.native import PeerUnavailable
from scanloom.stages._open3d import import_open3d
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.simplification.color_weight import compute_color_weight
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import as_mesh, to_open3d, to_open3d_legacy

PreparedCall = tuple[Callable[[], Any], Callable[[Any], Mesh]]


@dataclass(frozen=True)
class Tool:
    """Simplifier and its settings.

    Attributes
    ----------
    prepare : returns the call to measure, and the conversion of its result.
    version : returns the version; raises PeerUnavailable if the tool cannot be called.
    keeps_color : True if the result has colours. Meshes without colours run with the first setting only.
    settings : keyword arguments of `prepare`, by name in the table.
    is_quadric : True if the tool uses quadric errors, as most do.
    """

    name: str
    prepare: Callable[..., PreparedCall]
    version: Callable[[], str]
    keeps_color: bool
    settings: Mapping[str, Mapping[str, float]]
    is_quadric: bool = True


def make_version_check(name: str) -> Callable[[], str]:
    """Return a function that imports a Python package and returns its version."""

    def read_version() -> str:
        try:
            importlib.import_module(name)
            return metadata.version(name)
        except (ImportError, OSError, metadata.PackageNotFoundError) as error:
            raise PeerUnavailable(str(error)) from error

    return read_version


def prepare_scanloom(mesh: Mesh, triangles: int, weight: float) -> PreparedCall:
    """Prepare `simplify`; `weight` multiplies the default colour weight."""
    # The default is derived inside the measured call, as it is for users.
    scale = None if weight == 1 else weight * compute_color_weight(mesh, triangles)
    return lambda: simplify(mesh, triangles=triangles, attribute_scale=scale), lambda result: result.mesh


def prepare_open3d_legacy(mesh: Mesh, triangles: int) -> PreparedCall:
    """Prepare Open3D's legacy quadric decimation, which averages colours."""
    given = to_open3d_legacy(mesh)
    return lambda: given.simplify_quadric_decimation(triangles), as_mesh


def prepare_open3d_tensor(mesh: Mesh, triangles: int) -> PreparedCall:
    """Prepare Open3D's tensor decimation, which uses VTK and drops colours."""
    given = to_open3d(mesh.with_(colors=None))
    reduction = 1 - triangles / len(mesh.triangles)
    return lambda: given.simplify_quadric_decimation(reduction), as_mesh


def prepare_pymeshlab(mesh: Mesh, triangles: int) -> PreparedCall:
    """Prepare MeshLab's quadric edge collapse with its defaults."""
    import pymeshlab

    colors = {} if mesh.colors is None else {"v_color_matrix": to_rgba(mesh.colors)}
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(mesh.vertices, mesh.triangles, **colors))

    def convert_result(_: Any) -> Mesh:
        light = meshes.current_mesh()
        colors = None if mesh.colors is None else to_8_bit(light.vertex_color_matrix()[:, :3] * 255)
        return Mesh(light.vertex_matrix(), light.face_matrix(), colors)

    return lambda: meshes.meshing_decimation_quadric_edge_collapse(targetfacenum=triangles), convert_result


def prepare_fast_simplification(mesh: Mesh, triangles: int) -> PreparedCall:
    """Prepare fast-simplification, which collapses edges below a rising threshold."""
    import fast_simplification

    def call() -> Any:
        return fast_simplification.simplify(mesh.vertices, mesh.triangles, target_count=triangles)

    return call, lambda result: Mesh(result[0], result[1].astype(np.int32))


def prepare_vtk(mesh: Mesh, triangles: int, weight: float) -> PreparedCall:
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

    def convert_result(_: Any) -> Mesh:
        light = decimation.GetOutput()
        colors = None
        if mesh.colors is not None:
            colors = to_8_bit(vtk_to_numpy(light.GetPointData().GetScalars()))
        corners = vtk_to_numpy(light.GetPolys().GetConnectivityArray()).reshape(-1, 3)
        vertices = vtk_to_numpy(light.GetPoints().GetData())
        return Mesh(vertices.astype(np.float64), corners.astype(np.int32), colors)

    return decimation.Update, convert_result


def prepare_meshoptimizer(mesh: Mesh, triangles: int, weight: float) -> PreparedCall:
    """Prepare meshoptimizer, which updates positions and colours (0 to 1).

    Its lengths are relative to the mesh's extent.
    """
    library = native.load_meshoptimizer()
    indices = mesh.triangles.astype(np.uint32)
    positions = mesh.vertices.astype(np.float32)
    colors = np.zeros((len(positions), 0), np.float32)
    if mesh.colors is not None:
        colors = mesh.colors.astype(np.float32) / 255
    weights = np.full(colors.shape[1], weight, np.float32)

    def call() -> int:
        return library.simplify(
            get_pointer(indices),
            ctypes.c_size_t(len(indices)),
            get_pointer(positions),
            get_pointer(colors),
            ctypes.c_size_t(len(positions)),
            get_pointer(weights),
            ctypes.c_size_t(len(weights)),
            ctypes.c_size_t(triangles),
        )

    def convert_result(left: int) -> Mesh:
        # meshoptimizer keeps removed vertices in the arrays.
        used, corners = np.unique(indices[:left], return_inverse=True)
        return Mesh(
            positions[used].astype(np.float64),
            corners.reshape(-1, 3).astype(np.int32),
            None if mesh.colors is None else to_8_bit(colors[used] * 255),
        )

    return call, convert_result


def make_cgal_prepare(function: str) -> Callable[[Mesh, int], PreparedCall]:
    """Return a function that prepares one of the simplifiers of cgal.cpp."""

    def prepare(mesh: Mesh, triangles: int) -> PreparedCall:
        library = native.load_cgal()
        sizes = [ctypes.c_size_t(len(mesh.vertices)), ctypes.c_size_t(len(mesh.triangles))]
        handle = ctypes.c_void_p(
            library.load(get_pointer(mesh.vertices), sizes[0], get_pointer(mesh.triangles), sizes[1])
        )
        if not handle:
            raise PeerUnavailable("CGAL rejects the mesh as non-manifold")

        def convert_result(_: Any) -> Mesh:
            light = Mesh(
                np.empty((library.vertex_count(handle), 3)),
                np.empty((library.triangle_count(handle), 3), np.int32),
            )
            library.unload(handle, get_pointer(light.vertices), get_pointer(light.triangles))
            return light

        return lambda: getattr(library, function)(handle, ctypes.c_size_t(triangles)), convert_result

    return prepare


def get_open3d_version() -> str:
    """Return Open3D's version."""
    try:
        return str(import_open3d().__version__)
    except StageError as error:
        raise PeerUnavailable(str(error)) from error


def get_cgal_version() -> str:
    """Return CGAL's version."""
    return str(native.load_cgal().version().decode())


def read_meshoptimizer_version() -> str:
    """Return the version of the crate `meshopt` from its lock file."""
    native.load_meshoptimizer()
    lock = (native.HERE / "meshoptimizer/Cargo.lock").read_text()
    return "crate meshopt " + lock.split('name = "meshopt"\nversion = "')[1].split('"')[0]


def get_pointer(array: np.ndarray) -> ctypes.c_void_p:
    """Return the address of an array's data."""
    return array.ctypes.data_as(ctypes.c_void_p)


def to_rgba(colors: np.ndarray) -> np.ndarray:
    """Convert 8-bit colours to opaque RGBA, 0 to 1."""
    return np.hstack([colors / 255, np.ones((len(colors), 1))])


def to_8_bit(colors: np.ndarray) -> np.ndarray:
    """Round colours (0 to 255) to 8 bits."""
    return np.rint(colors).clip(0, 255).astype(np.uint8)


def make_weight_settings(*values: float, prefix: str = "weight ") -> dict[str, dict[str, float]]:
    """Make a setting for each weight."""
    return {f"{prefix}{value:g}": {"weight": value} for value in values}


SINGLE_SETTING: dict[str, dict[str, float]] = {"": {}}
# The default has to be first.
OUR_SETTINGS = {"default": {"weight": 1.0}} | make_weight_settings(0, 0.3, 3, 10, 30, prefix="default × ")

OURS = "scanloom"
TOOLS = (
    Tool(OURS, prepare_scanloom, lambda: "this package", True, OUR_SETTINGS),
    Tool(
        "CGAL Lindstrom–Turk",
        make_cgal_prepare("lindstrom_turk"),
        get_cgal_version,
        False,
        SINGLE_SETTING,
        is_quadric=False,
    ),
    Tool(
        "CGAL Garland–Heckbert",
        make_cgal_prepare("garland_heckbert"),
        get_cgal_version,
        False,
        SINGLE_SETTING,
    ),
    Tool(
        "VTK",
        prepare_vtk,
        make_version_check("vtk"),
        True,
        make_weight_settings(0.003, 0.01, 0.03, 0.1, 0.3, 1),
    ),
    Tool(
        "meshoptimizer",
        prepare_meshoptimizer,
        read_meshoptimizer_version,
        True,
        make_weight_settings(0.03, 0.1, 0.3, 1, 3, 10),
    ),
    Tool("PyMeshLab", prepare_pymeshlab, make_version_check("pymeshlab"), True, SINGLE_SETTING),
    Tool("Open3D legacy", prepare_open3d_legacy, get_open3d_version, True, SINGLE_SETTING),
    Tool("Open3D tensor", prepare_open3d_tensor, get_open3d_version, False, SINGLE_SETTING),
    Tool(
        "fast-simplification",
        prepare_fast_simplification,
        make_version_check("fast_simplification"),
        False,
        SINGLE_SETTING,
    ),
)
