"""USD writer: .usda (text, with separate images) and .usdz (one package, which phones open).

Follows Pixar, "Universal Scene Description", schemas UsdGeom and UsdPreviewSurface. Requires the optional
package `usd-core`.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import StageError, UsageError
from scanloom.stages.exporting.codes import EXPORT_IMAGE_AS_PNG, EXPORT_LEFT_OUT, EXPORT_USD_FAILED
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.files.image_bytes import encode_png
from scanloom.stages.surface.codes import MACHINE_EXTRA_MISSING, USAGE_EXTENSION_UNKNOWN
from scanloom.stages.surface.finite_check import FLOAT32_MAX
from scanloom.stages.surface.formats.color_conversion import convert_srgb_to_linear
from scanloom.stages.surface.mesh import Mesh, require_writable
from scanloom.stages.surface.texture import Image, Material, Texture
from scanloom.stages.surface.up_direction import rotate_to_y

USD_SUFFIXES = (".usda", ".usdz")
# Image formats that phones and usdview support.
_SUPPORTED_IMAGES = {"image/jpeg": ".jpg", "image/png": ".png"}
_WRAP_TOKENS = {"repeat": "repeat", "clamp": "clamp", "mirror": "mirror"}


def require_usd() -> None:
    """Check that `usd-core` is installed.

    Raises
    ------
    UsageError
        If `usd-core` is not installed; the message names the package to install.
    """
    try:
        import pxr  # noqa: F401
    except ImportError:
        raise UsageError(
            MACHINE_EXTRA_MISSING, "writing USD requires usd-core", remedy="install scanloom[usd]."
        ) from None


def write_usd(path: Path, mesh: Mesh) -> None:
    """Write a mesh as .usda or .usdz, y-up, in metres.

    Positions are stored unchanged, below a transform that rotates the up direction to y. Images become JPEG
    or PNG. Data that the format does not hold is reported as a warning.

    Raises
    ------
    UsageError
        If `usd-core` is not installed, or the extension is neither .usda nor .usdz.
    MeshError
        If coordinates are not finite or exceed single precision.
    StageError
        If the file cannot be written.
    """
    require_usd()
    require_writable(mesh, path, single_precision=True)
    if path.suffix.lower() not in USD_SUFFIXES:
        raise UsageError(
            USAGE_EXTENSION_UNKNOWN,
            "the extension of a USD file must be {suffixes}.",
            where=path,
            suffixes=" or ".join(USD_SUFFIXES),
        )
    with tempfile.TemporaryDirectory(prefix="scanloom-", ignore_cleanup_errors=True) as kept:
        folder = Path(kept)
        text = folder / f"{path.stem}.usda"
        images = _write_stage(text, mesh)
        if path.suffix.lower() == ".usda":
            for name in images:
                with write_file_atomically(path.with_name(name)) as part:
                    shutil.copyfile(folder / name, part)
            with write_file_atomically(path) as part:
                shutil.copyfile(text, part)
        else:
            _pack(text, folder / "packed.usdz", path)


def _pack(text: Path, packed: Path, path: Path) -> None:
    from pxr import UsdUtils

    if not UsdUtils.CreateNewUsdzPackage(str(text), str(packed)):
        raise StageError(
            EXPORT_USD_FAILED, "usd-core could not create the package", remedy="write .usda.", where=path
        )
    with write_file_atomically(path) as part:
        shutil.copyfile(packed, part)


def _write_stage(path: Path, mesh: Mesh) -> list[str]:
    """Write a .usda file and its images; return the image file names.

    Data that USD does not hold is reported as a warning.
    """
    from pxr import Gf, Usd, UsdGeom

    stage: Any = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, "/scan")
    stage.SetDefaultPrim(root.GetPrim())
    if mesh.up is not None:
        turn = np.eye(4)
        turn[:3, :3] = rotate_to_y(np.array(mesh.up))
        # USD multiplies row vectors from the left, so its matrix is transposed.
        root.AddTransformOp().Set(Gf.Matrix4d(*turn.T.reshape(-1).tolist()))
    names = {} if mesh.texture is None else _write_images(mesh.texture, path.parent)
    if mesh.part_ids is not None:
        emit(EXPORT_LEFT_OUT.warning("the parts are left out: USD is written as one mesh"))
    define_mesh(stage, "/scan/mesh", mesh, names)
    stage.GetRootLayer().Save()
    return list(names.values())


def define_mesh(stage: Any, path: str, mesh: Mesh, image_names: Mapping[int, str]) -> Any:
    """Define a mesh with its colours or materials; return its schema.

    Parameters
    ----------
    path : path of the mesh; materials are its siblings.
    image_names : file of each texture image, relative to the stage, by `id` of the image.
    """
    from pxr import Gf, Sdf, UsdGeom, Vt

    shape = UsdGeom.Mesh.Define(stage, path)
    shape.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(mesh.vertices.astype(np.float32)))
    shape.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.triangles), 3, np.int32)))
    shape.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.triangles.reshape(-1)))
    shape.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    shape.CreateDoubleSidedAttr(True)
    if len(mesh.vertices):
        low, high = (side.astype(float).tolist() for side in (mesh.vertices.min(0), mesh.vertices.max(0)))
        shape.CreateExtentAttr([Gf.Vec3f(*low), Gf.Vec3f(*high)])
    _add_normals(shape, mesh)
    primvars = UsdGeom.PrimvarsAPI(shape)
    if mesh.colors is not None:
        light = convert_srgb_to_linear(mesh.colors / 255).astype(np.float32)
        primvars.CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, UsdGeom.Tokens.vertex).Set(
            Vt.Vec3fArray.FromNumpy(light)
        )
    parent = path.rpartition("/")[0]
    if mesh.texture is not None:
        _add_texture(stage, shape, mesh.texture, parent, image_names)
    elif mesh.colors is not None:
        _add_colors_material(stage, shape, f"{parent}/colors")
    return shape


def _add_normals(shape: Any, mesh: Mesh) -> None:
    from pxr import UsdGeom, Vt

    normals: NDArray[np.float64] | None = None
    if mesh.corner_normals is not None:
        normals, where = mesh.corner_normals.reshape(-1, 3), UsdGeom.Tokens.faceVarying
    elif mesh.normals is not None:
        normals, where = mesh.normals, UsdGeom.Tokens.vertex
    if normals is not None:
        shape.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
        shape.SetNormalsInterpolation(where)


def _write_images(texture: Texture, folder: Path) -> dict[int, str]:
    """Write the images of a texture; return their file names by `id` of the image."""
    used = np.unique(texture.material_ids)
    images = [texture.materials[number].image for number in used[used >= 0]]
    names: dict[int, str] = {}
    for image in images:
        if image is not None and id(image) not in names:
            names[id(image)] = _write_image(image, len(names), folder)
    return names


def _add_texture(
    stage: Any, shape: Any, texture: Texture, parent: str, image_names: Mapping[int, str]
) -> None:
    """Add texture coordinates and materials below `parent`."""
    from pxr import Sdf, UsdGeom, UsdShade, Vt

    primvars = UsdGeom.PrimvarsAPI(shape)
    uvs = texture.uvs.reshape(-1, 2).clip(-FLOAT32_MAX, FLOAT32_MAX)
    primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying).Set(
        Vt.Vec2fArray.FromNumpy(uvs.astype(np.float32))
    )
    for number, material in enumerate(texture.materials):
        rows = np.flatnonzero(texture.material_ids == number).astype(np.int32)
        if len(rows) == 0:
            continue
        name = None if material.image is None else image_names[id(material.image)]
        made = _add_material(stage, f"{parent}/material{number}", material, name)
        part = UsdGeom.Subset.CreateGeomSubset(
            shape, f"material{number}", UsdGeom.Tokens.face, Vt.IntArray.FromNumpy(rows), "materialBind"
        )
        UsdShade.MaterialBindingAPI.Apply(part.GetPrim()).Bind(made)


def _write_image(image: Image, number: int, folder: Path) -> str:
    """Write an image as JPEG or PNG; return its file name."""
    mime = image.mime
    if mime in _SUPPORTED_IMAGES:
        data, suffix = image.file_bytes, _SUPPORTED_IMAGES[mime]
    else:
        data, suffix = encode_png(image.pixels), ".png"
        emit(
            EXPORT_IMAGE_AS_PNG.info(
                "the image {name} is stored as PNG, because USD viewers read only PNG and JPEG",
                name=image.name or number,
            )
        )
    name = f"texture{number}{suffix}"
    (folder / name).write_bytes(data)
    return name


def _add_material(stage: Any, path: str, material: Material, image: str | None) -> Any:
    from pxr import Gf, Sdf, UsdShade

    made = UsdShade.Material.Define(stage, path)
    surface = _add_preview_surface(stage, made, path)
    color = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    base = material.base_color or (1.0, 1.0, 1.0, 1.0)
    light = [float(value) for value in convert_srgb_to_linear(np.array(base[:3]))]
    if image is None:
        color.Set(Gf.Vec3f(*light))
        return made
    reader = UsdShade.Shader.Define(stage, f"{path}/coordinates")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    place = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    picture = UsdShade.Shader.Define(stage, f"{path}/image")
    picture.CreateIdAttr("UsdUVTexture")
    picture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(f"./{image}"))
    picture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
    for axis, wrap in zip("ST", material.wrap, strict=True):
        picture.CreateInput(f"wrap{axis}", Sdf.ValueTypeNames.Token).Set(_WRAP_TOKENS[wrap])
    if light != [1.0, 1.0, 1.0]:
        picture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(*light, 1.0))
    picture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(place)
    color.ConnectToSource(picture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3))
    return made


def _add_colors_material(stage: Any, shape: Any, path: str) -> None:
    """Bind a material that displays the vertex colours.

    Viewers draw a mesh without a material in grey.
    """
    from pxr import Sdf, UsdShade

    made = UsdShade.Material.Define(stage, path)
    surface = _add_preview_surface(stage, made, path)
    reader = UsdShade.Shader.Define(stage, f"{path}/reader")
    reader.CreateIdAttr("UsdPrimvarReader_float3")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("displayColor")
    color = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    color.ConnectToSource(reader.CreateOutput("result", Sdf.ValueTypeNames.Float3))
    UsdShade.MaterialBindingAPI.Apply(shape.GetPrim()).Bind(made)


def _add_preview_surface(stage: Any, made: Any, path: str) -> Any:
    from pxr import Sdf, UsdShade

    surface = UsdShade.Shader.Define(stage, f"{path}/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(1.0)
    surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
    made.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    return surface
