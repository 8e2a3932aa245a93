"""Export of a mesh for another program: axes, units, image formats and glTF compression."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scanloom.stages.cleaning.check import PRINTABLE, check
from scanloom.stages.cleaning.solids.booleans import require_manifold3d
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT, USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic, DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.exporting.codes import EXPORT_LEFT_OUT, EXPORT_UP_UNKNOWN
from scanloom.stages.exporting.image_conversion import IMAGE_FORMATS, convert_images, make_ktx2_encoder
from scanloom.stages.exporting.print_preparation import prepare_print
from scanloom.stages.exporting.threemf import write_3mf
from scanloom.stages.exporting.usd import USD_SUFFIXES as USD
from scanloom.stages.exporting.usd import require_usd, write_usd
from scanloom.stages.files.ktx2 import require_ktx2_encoder
from scanloom.stages.params import check_parameters as check_params
from scanloom.stages.params import param, resolve
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.surface.codes import USAGE_EXTENSION_UNKNOWN
from scanloom.stages.surface.formats.gltf_packing import COMPRESSIONS, SHADINGS, make_quantization_grid
from scanloom.stages.surface.formats.gltf_writer import write_gltf
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.mesh_files import MESH_EXTENSIONS, list_unsupported_data, write_mesh
from scanloom.stages.surface.up_direction import parse_up_direction, rotate_to_y, rotate_to_z

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import ExportKeywords

# Part of the cache key. Increase it when the same mesh and parameters produce a different file.
RESULT_VERSION = 2

PRINT_SUFFIX = ".3mf"
EXPORT_SUFFIXES = (*MESH_EXTENSIONS, *USD, PRINT_SUFFIX)
GLTF_SUFFIXES = (".glb", ".gltf")
# Formats with a fixed unit (metres) and a stated up axis.
Y_UP_METRE_SUFFIXES = (*GLTF_SUFFIXES, *USD)

AXES = ("scan", "y-up", "z-up")
_UNIT_FACTORS = {"m": 1.0, "mm": 1000.0}


@dataclass(frozen=True, kw_only=True)
class ExportParams:
    """Parameters of an export."""

    up: str | None = param(
        None,
        "Up direction of the mesh: an axis (+x, -x, +y, -y, +z, -z), a vector of three numbers, or `none` "
        "for no rotation. Default: as stated by the file. glTF is y-up, or stores the rotation of its scan.",
        common=True,
    )
    axes: str = param(
        "scan",
        "Up axis of formats that do not define one (PLY, OBJ, OFF, STL): y, z, or `scan` for unchanged axes. "
        "glTF and USD are always y-up.",
        choices=AXES,
    )
    unit: str = param(
        "m", "Unit of positions in PLY, OBJ, OFF and STL.", choices=tuple(_UNIT_FACTORS), common=True
    )
    on_floor: bool = param(
        False,
        "Move the mesh so that its lowest point is at height 0 and its centre is above the origin, in PLY, "
        "OBJ, OFF and STL.",
    )
    compress: str = param(
        "none",
        "Compression of glTF files: `quantize` stores positions, normals and texture coordinates as integers "
        "(KHR_mesh_quantization), `meshopt` also packs these (EXT_meshopt_compression). Viewers must support "
        "the extension.",
        choices=COMPRESSIONS,
        common=True,
    )
    position_bits: int = param(
        16,
        "Bits per coordinate of positions in a compressed glTF file; 16 bits give up to 65,535 steps along "
        "the longest side.",
        low=8,
        high=16,
    )
    texel_steps: int = param(
        0,
        "Steps of texture coordinates per texel in a compressed glTF file. Fewer steps make a smaller file, "
        "but viewers must support KHR_texture_transform. 0: 65,535 steps along each side of the image, "
        "without that extension.",
        low=0,
        high=64,
    )
    shading: str = param(
        "bare",
        "Lighting of a glTF file. `unlit`: none (KHR_materials_unlit), for colours with baked-in lighting, "
        "such as photos; material extensions for lighting are dropped. `lit`: always. `keep`: as the "
        "materials state; vertex colours are lit. `bare`: as `keep`, but vertex colours of an uncompressed "
        "file have no material, because trimesh drops colours next to a material; viewers then draw them as "
        "metal.",
        choices=SHADINGS,
    )
    images: str = param(
        "keep",
        "Format of texture images; `keep` stores them unchanged. `ktx2` stays compressed in the memory of a "
        "graphics card; viewers of this glTF file must support KHR_texture_basisu.",
        choices=IMAGE_FORMATS,
    )
    quality: int = param(90, "Quality of JPEG, WebP and KTX2 images that are encoded.", low=1, high=100)
    image_size: int = param(
        16384, "Maximum longer side of texture images; larger ones are downsampled.", unit="pixels", low=16
    )
    hollow: float = param(
        0.0,
        "Hollow a solid, leaving a wall of this thickness. 0: not hollow.",
        unit="m",
        low=0,
    )
    drain: float = param(
        0.0,
        "With hollow: diameter of the drain hole below each cavity. 0: none.",
        unit="m",
        low=0,
    )
    plate: float = param(0.0, "Put a solid on a base plate of this thickness. 0: none.", unit="m", low=0)
    bed: tuple[float, float, float] | None = param(
        None,
        "Size of the print bed; a larger solid is split into parts that fit, each an object of a 3MF or OBJ "
        "file.",
        unit="m",
    )
    watertight: bool = param(
        False,
        "Report defects that prevent 3-D printing: holes, inverted orientation, intersecting triangles.",
    )

    def __post_init__(self) -> None:
        check_params(self)
        if self.up is not None:
            parse_up_direction(self.up)
        if self.bed is not None and min(self.bed) <= 0:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "three positive sizes are expected.",
                DiagnosticLocation(parameter="bed"),
            )
        if self.drain > 0 and self.hollow == 0:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "applies only to hollow solids",
                DiagnosticLocation(parameter="drain"),
                remedy="give hollow, too.",
            )

    @property
    def is_prepared(self) -> bool:
        """True if the mesh is prepared for printing."""
        return self.hollow > 0 or self.plate > 0 or self.bed is not None


@dataclass(frozen=True, eq=False)
class ExportResult:
    """Result of an export.

    Attributes
    ----------
    file : path of the written file.
    triangles : triangle count of the mesh.
    bytes : size of the file without its companion files (images, materials, buffers).
    up : (3,) up direction of the mesh; None if unknown.
    position_error : largest distance in metres by which quantization moves a vertex; 0 without quantization.
    diagnostics : data that the format cannot hold, assumptions, and, with `watertight`, the reasons why the
        mesh cannot be printed.
    """

    file: Path
    triangles: int
    bytes: int
    up: tuple[float, float, float] | None
    position_error: float
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return the statistics of the export as JSON-compatible values."""
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
) -> ExportResult:
    """Write a mesh for another program.

    The extension of `path`, one of SUFFIXES, selects the format.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh triangle mesh, or (vertices, triangles), in metres.
    path : output file; an existing file is replaced. Images and materials of .obj, .ply, .gltf and .usda are
        written to the same folder.
    params : ExportParams; single fields can be given by name instead.

    Returns
    -------
    ExportResult
        File, sizes, quantization error and diagnostics.

    Raises
    ------
    UsageError
        If the extension is unknown, if a parameter is out of range or has no effect on the format, or if USD
        is requested without `usd-core` installed.
    InputError
        If KTX2 images are requested without their encoder installed.
    MeshError
        If the mesh is invalid.
    StageError
        If the file cannot be written.
    """
    with collecting() as diagnostics:
        exported = _write_export(mesh, Path(path), resolve(ExportParams, params, changes))
    return replace(exported, diagnostics=tuple(diagnostics))


def _write_export(mesh: MeshLike, path: Path, params: ExportParams) -> ExportResult:
    require_supported_params(path, params)
    if path.suffix.lower() == PRINT_SUFFIX:
        params = replace(params, axes="z-up", unit="mm")
    given = set_up_direction(as_mesh(mesh), params.up)
    written = convert_images(given, params.images, params.quality, params.image_size)
    suffix = path.suffix.lower()
    if suffix not in Y_UP_METRE_SUFFIXES:
        written = _transform_mesh(written, params)
        if suffix != PRINT_SUFFIX and (left_out := list_unsupported_data(suffix, given)):
            emit(
                EXPORT_LEFT_OUT.warning(
                    "{suffix} stores geometry only: the {left_out} are left out",
                    remedy="write .ply or .glb",
                    suffix=suffix,
                    left_out=left_out,
                )
            )
    if suffix in GLTF_SUFFIXES:
        write_gltf(
            path,
            written,
            compress=params.compress,
            shading=params.shading,
            position_bits=params.position_bits,
            texel_steps=params.texel_steps,
            encode_image=(
                make_ktx2_encoder(params.quality, params.image_size) if params.images == "ktx2" else None
            ),
        )
    elif suffix in USD:
        write_usd(path, written)
    elif suffix == PRINT_SUFFIX:
        write_3mf(path, written)
    else:
        write_mesh(path, written)
    if params.watertight:
        emit(*check(written if params.is_prepared else given).find_unmet([PRINTABLE]))
    is_compressed = suffix in GLTF_SUFFIXES and params.compress != "none" and len(given.triangles) > 0
    return ExportResult(
        file=path,
        triangles=len(written.triangles),
        bytes=path.stat().st_size,
        up=given.up,
        position_error=_compute_position_error(given, params.position_bits) if is_compressed else 0.0,
    )


def set_up_direction(mesh: Mesh, up: str | None) -> Mesh:
    """Return the mesh with another up direction, as in `ExportParams.up`; None keeps its own."""
    if up is None:
        return mesh
    direction = parse_up_direction(up)
    return mesh.with_(up=None if direction is None else (direction[0], direction[1], direction[2]))


def require_supported_params(path: Path, params: ExportParams) -> None:
    """Check that the extension is known and the format supports the parameters.

    Call it before any work begins.

    Raises
    ------
    UsageError
        If the extension is unknown, the format ignores a given parameter, or `usd-core` is missing.
    InputError
        If the encoder of KTX2 images is required and missing.
    """
    suffix = path.suffix.lower()
    if suffix not in EXPORT_SUFFIXES:
        ending = path.suffix or "(none)"
        raise UsageError(
            USAGE_EXTENSION_UNKNOWN,
            "the extension {ending} is unknown",
            remedy="use one of {suffixes}.",
            where=path,
            ending=ending,
            suffixes=", ".join(EXPORT_SUFFIXES),
        )
    if suffix not in GLTF_SUFFIXES and (params.compress != "none" or params.shading != "bare"):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "compress and shading apply only to glTF",
            remedy="write .glb.",
            where=path,
        )
    if suffix not in GLTF_SUFFIXES and params.images == "ktx2":
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "KTX2 images apply only to glTF",
            remedy="write .glb.",
            where=path,
        )
    if suffix in Y_UP_METRE_SUFFIXES and (params.unit != "m" or params.on_floor or params.is_prepared):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "unit, on_floor, hollow, plate and bed do not apply to {suffix}, which is always y-up and in "
            "metres",
            remedy="write .3mf, .stl or .obj.",
            where=path,
            suffix=suffix,
        )
    if params.bed is not None and suffix not in (PRINT_SUFFIX, ".obj"):
        raise UsageError(
            USAGE_OPTIONS_CONFLICT,
            "bed does not apply to {suffix}, which holds one object",
            remedy="write .3mf or .obj.",
            where=path,
            suffix=suffix,
        )
    if params.is_prepared:
        require_manifold3d()
    if suffix in USD:
        require_usd()
    if params.images == "ktx2":
        require_ktx2_encoder()


def _compute_position_error(mesh: Mesh, bits: int) -> float:
    return make_quantization_grid(mesh.vertices[np.unique(mesh.triangles)], bits).max_error


def _transform_mesh(mesh: Mesh, params: ExportParams) -> Mesh:
    """Rotate, translate and scale the mesh as `params` requests."""
    if params.axes != "scan":
        if mesh.up is None:
            emit(
                EXPORT_UP_UNKNOWN.warning(
                    "the up direction is unknown: the mesh is written as if it were {axes} already",
                    remedy="set `up`",
                    axes=params.axes,
                )
            )
        else:
            up = np.array(mesh.up)
            mesh = rotate_mesh(mesh, rotate_to_y(up) if params.axes == "y-up" else rotate_to_z(up))
    if params.is_prepared:
        mesh = prepare_print(mesh, wall=params.hollow, drain=params.drain, plate=params.plate, bed=params.bed)
    vertices = mesh.vertices
    if params.on_floor and len(vertices):
        height = 1 if params.axes == "y-up" else 2
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        origin = (low + high) / 2
        origin[height] = low[height]
        vertices = vertices - origin
    return mesh.with_(vertices=vertices * _UNIT_FACTORS[params.unit])


def rotate_mesh(mesh: Mesh, turn: np.ndarray) -> Mesh:
    """Rotate a mesh with an up direction by a matrix (3, 3)."""
    x, y, z = (turn @ np.array(mesh.up)).round(12).tolist()
    return mesh.with_(
        vertices=mesh.vertices @ turn.T,
        normals=None if mesh.normals is None else mesh.normals @ turn.T,
        corner_normals=None if mesh.corner_normals is None else mesh.corner_normals @ turn.T,
        up=(x, y, z),
    )
