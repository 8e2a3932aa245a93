"""A mesh as another program wants it: turned, scaled, with images it reads, small enough to send."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scanloom.stages.cleaning.check import check
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.exporting.codes import EXPORT_LEFT_OUT, EXPORT_UP_UNKNOWN
from scanloom.stages.exporting.images import FORMATS, with_images
from scanloom.stages.exporting.usd import SUFFIXES as USD
from scanloom.stages.exporting.usd import require_usd, write_usd
from scanloom.stages.params import check as check_params
from scanloom.stages.params import param, resolve
from scanloom.stages.printing import by_figures, table
from scanloom.stages.surface.codes import USAGE_EXTENSION_UNKNOWN
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.formats.gltf_packing import COMPRESSIONS, SHADINGS, lattice_of
from scanloom.stages.surface.formats.gltf_writer import write_gltf
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import EXTENSIONS, lost_with, write_mesh
from scanloom.stages.surface.upright import direction_of, turn_along_y, turn_along_z

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import ExportKeywords

# Raised by hand when the same mesh and parameters come to another file.
RESULT_VERSION = 2

SUFFIXES = (*EXTENSIONS, *USD)
GLTF = (".glb", ".gltf")
# They say themselves what is up, and are in metres.
STANDING = (*GLTF, *USD)

AXES = ("scan", "y-up", "z-up")
_FACTORS = {"m": 1.0, "mm": 1000.0}


@dataclass(frozen=True, kw_only=True)
class ExportParams:
    """What a file for another program is like."""

    up: str | None = param(
        None,
        "What is up in the mesh: an axis (+x, -x, +y, -y, +z, -z), a direction as three numbers, or `none`, "
        "which turns nothing. By default what its file says: glTF is y-up, and that of a scan tells how it "
        "was turned.",
        common=True,
    )
    axes: str = param(
        "scan",
        "The axes of positions in formats that do not say what is up (PLY, OBJ, OFF, STL): those of the mesh "
        "as it is, or with y or z up. glTF and USD are y-up.",
        choices=AXES,
    )
    unit: str = param(
        "m", "The unit of positions in PLY, OBJ, OFF and STL.", choices=tuple(_FACTORS), common=True
    )
    on_floor: bool = param(False, "Move the mesh so that it stands on height 0, in the middle, in these.")
    compress: str = param(
        "none",
        "How a glTF file is made small: positions, normals and coordinates in whole numbers "
        "(KHR_mesh_quantization), or these packed by meshopt (EXT_meshopt_compression); viewers have to "
        "know these.",
        choices=COMPRESSIONS,
        common=True,
    )
    position_bits: int = param(
        16,
        "Of positions in a compressed glTF file: of the steps that so many tell apart, as many as there are "
        "along the longest side.",
        low=8,
        high=16,
    )
    texel_steps: int = param(
        0,
        "Steps of texture coordinates for a texel of the image, in a compressed glTF file: few make a small "
        "file, which viewers need KHR_texture_transform for. 0 for 65,535 steps along each side, without it.",
        low=0,
        high=64,
    )
    shading: str = param(
        "bare",
        "How a glTF file takes light: `unlit` not at all (KHR_materials_unlit), for colours that have their "
        "light, as a scan's do; `lit` in any case; `keep` as the mesh's materials say, and colours of "
        "vertices are lit; `bare` the same, but colours of vertices have no material in a file that is not "
        "compressed: trimesh forgets them beside one, and viewers draw them as metal without.",
        choices=SHADINGS,
    )
    images: str = param("keep", "How texture images are kept.", choices=FORMATS)
    quality: int = param(90, "Of JPEG and WebP images that are made.", low=1, high=100)
    image_size: int = param(
        16384, "Larger images are made smaller: their longer side.", unit="pixels", low=16
    )
    watertight: bool = param(False, "Say why the mesh has no inside to print, if it has none.")

    def __post_init__(self) -> None:
        check_params(self)
        if self.up is not None:
            direction_of(self.up)


@dataclass(frozen=True, eq=False)
class Exported:
    """What was written.

    Attributes
    ----------
    file : its path.
    triangles : of the mesh.
    bytes : of the file, without what stands beside it.
    up : (3,) what is up in the mesh; None where nothing tells.
    position_error : metres by which whole numbers move a vertex at most; 0 where there are none.
    diagnostics : what the format does not hold, what was assumed, and why the mesh cannot be printed, if that
        was asked.
    """

    file: Path
    triangles: int
    bytes: int
    up: tuple[float, float, float] | None
    position_error: float
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return what was written, in words fit for JSON."""
        return {
            "output": self.file.name,
            "triangles": self.triangles,
            "bytes": self.bytes,
            "up": self.up,
            "position_error_m": self.position_error,
        }


def export(
    mesh: MeshLike,
    path: Path | str,
    params: ExportParams | None = None,
    **changes: Unpack[ExportKeywords],
) -> Exported:
    """Write a mesh for another program; the extension tells the format, of SUFFIXES.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh triangle mesh, or (vertices, triangles), in metres.
    path : the file is replaced; images and materials of .obj, .ply, .gltf and .usda stand beside it.
    params : ExportParams; single fields can be given by name instead.

    Raises
    ------
    UsageError
        For an unknown extension, a parameter out of range or of no effect on the format, or USD where
        `usd-core` is not installed.
    MeshError
        If it is no valid mesh.
    StageError
        If the system refuses to write.
    """
    with collecting() as diagnostics:
        exported = _export(mesh, Path(path), resolve(ExportParams, params, changes))
    return replace(exported, diagnostics=tuple(diagnostics))


def _export(mesh: MeshLike, path: Path, params: ExportParams) -> Exported:
    require_fitting(path, params)
    given = as_mesh(mesh)
    if params.up is not None:
        direction = direction_of(params.up)
        given = given.with_(up=None if direction is None else (direction[0], direction[1], direction[2]))
    written = with_images(given, params.images, params.quality, params.image_size)
    suffix = path.suffix.lower()
    if suffix not in STANDING:
        written = _placed(written, params)
        if left_out := lost_with(suffix, given):
            emit(
                EXPORT_LEFT_OUT.warning(
                    "{suffix} holds the shape alone: the {left_out} are left out",
                    remedy="write .ply or .glb",
                    suffix=suffix,
                    left_out=left_out,
                )
            )
    if suffix in GLTF:
        write_gltf(
            path,
            written,
            compress=params.compress,
            shading=params.shading,
            position_bits=params.position_bits,
            texel_steps=params.texel_steps,
        )
    elif suffix in USD:
        write_usd(path, written)
    else:
        write_mesh(path, written)
    if params.watertight:
        _report_unprintable(given)
    is_small = suffix in GLTF and params.compress != "none" and len(given.triangles) > 0
    return Exported(
        file=path,
        triangles=len(given.triangles),
        bytes=path.stat().st_size,
        up=given.up,
        position_error=_position_error(given, params.position_bits) if is_small else 0.0,
    )


def require_fitting(path: Path, params: ExportParams) -> None:
    """Refuse an extension that is none, and what a format has no place for, before any work.

    Raises
    ------
    UsageError
        Naming it.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        ending = path.suffix or "(none)"
        raise UsageError(
            USAGE_EXTENSION_UNKNOWN,
            "the extension {ending} stands for no format",
            remedy="use {suffixes}.",
            where=path,
            ending=ending,
            suffixes=", ".join(SUFFIXES),
        )
    if suffix not in GLTF and (params.compress != "none" or params.shading != "bare"):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "compress and shading are of glTF",
            remedy="write .glb.",
            where=path,
        )
    if suffix in STANDING and (params.unit != "m" or params.on_floor):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "{suffix} is in metres, and placed by its own axes",
            remedy="write .stl or .obj.",
            where=path,
            suffix=suffix,
        )
    if suffix in USD:
        require_usd()


def _position_error(mesh: Mesh, bits: int) -> float:
    return lattice_of(mesh.vertices[np.unique(mesh.triangles)], bits).farthest


def _placed(mesh: Mesh, params: ExportParams) -> Mesh:
    """Return the mesh with its positions turned, scaled and moved as asked."""
    if params.axes != "scan":
        if mesh.up is None:
            emit(
                EXPORT_UP_UNKNOWN.warning(
                    "nothing tells what is up: the axes are taken to be {axes} already",
                    remedy="`up` says it",
                    axes=params.axes,
                )
            )
        else:
            up = np.array(mesh.up)
            mesh = _turned(mesh, turn_along_y(up) if params.axes == "y-up" else turn_along_z(up))
    vertices = mesh.vertices
    if params.on_floor and len(vertices):
        height = 1 if params.axes == "y-up" else 2
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        origin = (low + high) / 2
        origin[height] = low[height]
        vertices = vertices - origin
    return mesh.with_(vertices=vertices * _FACTORS[params.unit])


def _turned(mesh: Mesh, turn: np.ndarray) -> Mesh:
    x, y, z = (turn @ np.array(mesh.up)).round(12).tolist()
    return mesh.with_(
        vertices=mesh.vertices @ turn.T,
        normals=None if mesh.normals is None else mesh.normals @ turn.T,
        corner_normals=None if mesh.corner_normals is None else mesh.corner_normals @ turn.T,
        up=(x, y, z),
    )


def _report_unprintable(mesh: Mesh) -> None:
    """Report why a mesh has no inside that could be printed."""
    found = check(mesh)
    emit(
        *(found.unmet(["watertight"]) or found.unmet(["outward"])),
        *found.unmet(["no-intersecting-triangles"]),
    )
