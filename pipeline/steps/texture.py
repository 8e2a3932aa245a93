"""Stage `texture`: textures the simplified mesh with the photos.

The texture can include a normal map with the details of the refined mesh.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.artifacts.file_names import TEXTURE_MAPS
from scanloom.pipeline.artifacts.posed_frames import PosedFrames
from scanloom.pipeline.artifacts.up_direction import Up, UpDirection
from scanloom.pipeline.cost_model import MAX_BYTES_IN_CHUNKS, CostModel
from scanloom.pipeline.result_versions import make_fixed_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.pipeline.stage import Artifact, Context, Stage
from scanloom.pipeline.steps.refine import RefinedMesh
from scanloom.pipeline.steps.simplify import SimplifiedMesh
from scanloom.stages.files.images import read_stored_image
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.params import param
from scanloom.stages.progress import Progress
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh, write_mesh
from scanloom.stages.surface.texture import Image
from scanloom.stages.texturing.normal_map import NormalMapResult, bake_normal_map
from scanloom.stages.texturing.provenance_maps import write_maps
from scanloom.stages.texturing.shading_normals import add_shading_normals
from scanloom.stages.texturing.texture import TextureParams, TextureResult, texture

TEXTURED_FILE = "textured.glb"

# Golden angle in units of 2°, the hue unit of OpenCV.
_GOLDEN_ANGLE = 68.754

# Maximum growth of textured.glb by a normal map and vertex normals, and bytes of JSON for both.
_MAX_GROWTH_RATIO = 1 / 3
_JSON_BYTES = 1024


@dataclass(frozen=True, kw_only=True)
class TextureSection(TextureParams):
    """Texture of the simplified mesh from the photos."""

    enabled: bool = param(
        True,
        "Texture the simplified mesh with the photos, if frames have colour.",
        # Only decides if the stage runs, so the cache key ignores it.
        invalidates=False,
        common=True,
    )
    images: str | None = param(
        None,
        "Folder of other photos, with poses in the world frame of the scan in metres (COLMAP, nerfstudio, or "
        "any scan). These photos replace the photos of the frames.",
        # The cache key contains the content of the folder instead of its path.
        invalidates=False,
        is_path=True,
        common=True,
    )
    normal_map: bool = param(
        True,
        "Add a normal map with the details of the refined mesh, if it lowers the shading error and enlarges "
        "the file by a third or less.",
    )


@dataclass(frozen=True)
class TexturedMesh(Artifact):
    """Textured mesh, with per-texel maps of the photo with the largest weight."""

    NAME = "textured_mesh"

    def load(self) -> Mesh:
        """Load the mesh."""
        return read_mesh(self.folder / TEXTURED_FILE)

    def color_by_photo(self, mesh: Mesh) -> Mesh:
        """Colour the mesh by the photo with the largest weight per texel.

        Texels without a photo are grey.
        """
        return color_by_photo(mesh, self.folder / TEXTURE_MAPS)


@dataclass(frozen=True, kw_only=True)
class TextureInputs(PosedFrames):
    """Inputs of the stage `texture`.

    Attributes
    ----------
    refined_mesh : source of the normal map.
    photos : scan read from `texture.images`, used instead of the frames.
    """

    simplified_mesh: SimplifiedMesh
    up_direction: UpDirection
    refined_mesh: RefinedMesh | None = None
    photos: Scan | None = None


def _run(inputs: TextureInputs, params: TextureSection, context: Context) -> Mapping[str, Any]:
    scan = inputs.load_posed() if inputs.photos is None else inputs.photos
    mesh, up = inputs.simplified_mesh.load(), inputs.up_direction.load()
    refined = inputs.refined_mesh
    original = None if refined is None or refined.is_large else refined.load()
    metrics = write_textured(context.folder, mesh, scan.frames, params, up, context.progress, original)
    warn_skipped_frames(metrics["frames_skipped"])
    return metrics


def _list_ignored_inputs(config: Sections) -> Collection[str]:
    params = config.get(TextureSection)
    ignored = () if params.images is None else ("frames", "poses", "adjusted_cameras", "names")
    return ignored if params.normal_map else (*ignored, "refined_mesh")


def get_skip_reason(scan: Scan, config: Sections) -> str | None:
    """Return why the scan gets no texture; None if it gets one."""
    params = config.get(TextureSection)
    if not params.enabled:
        return "is switched off; set texture.enabled=true"
    if params.images is None and not any(frame.color is not None for frame in scan.frames):
        return "does not apply to this scan: its frames have no colour; set texture.images=FOLDER"
    return None


def write_textured(
    folder: Path,
    mesh: Mesh,
    frames: Sequence[Frame],
    params: TextureSection,
    up: Up | None,
    progress: Progress,
    original: Mesh | None = None,
) -> dict[str, Any]:
    """Texture the mesh, write textured.glb (upright) and the per-texel maps, and return metrics.

    Parameters
    ----------
    original : source of the normal map; None for no map.
    """
    textured = texture(mesh, frames, params, progress=progress)
    path = folder / TEXTURED_FILE
    write_mesh(path, textured.mesh.with_(up=up))
    detail = None if original is None else _write_normal_map(path, textured, original, up)
    (folder / TEXTURE_MAPS).mkdir()
    write_maps(folder / TEXTURE_MAPS, textured)
    return textured.to_dict() | {"normal_map": detail and detail.to_dict()}


def _write_normal_map(path: Path, textured: TextureResult, original: Mesh, up: Up | None) -> NormalMapResult:
    """Write the textured mesh with a normal map if it is worth its bytes."""
    plain_bytes = path.stat().st_size
    write_mesh(path, add_shading_normals(textured.mesh, textured.layout.uvs).with_(up=up))
    max_bytes = (1 + _MAX_GROWTH_RATIO) * plain_bytes - path.stat().st_size - _JSON_BYTES
    found = bake_normal_map(textured.mesh, original, textured.layout, max_bytes)
    write_mesh(path, (found.mesh or textured.mesh).with_(up=up))
    return found


def _format_headline(metrics: Mapping[str, Any]) -> str:
    found = metrics["normal_map"]
    text = (
        "{photos} photos on {triangles:,} triangles; {coverage_ratio:.0%} of the surface covered, "
        "texel size {texel_size_m:.2g} m"
    )
    return text + ("; normal map" if found and found["is_written"] else "")


def color_by_photo(mesh: Mesh, maps: Path) -> Mesh:
    """Colour a mesh by the photo with the largest weight per texel.

    Texels without a photo are grey.

    Parameters
    ----------
    mesh : textured mesh.
    maps : folder of the per-texel maps.
    """
    assert mesh.texture is not None
    palette = _make_palette()
    materials = tuple(
        replace(material, image=Image(given=palette[read_stored_image(maps / f"photo-{number}.png")]))
        for number, material in enumerate(mesh.texture.materials, 1)
    )
    return mesh.with_(texture=replace(mesh.texture, materials=materials))


def _make_palette() -> NDArray[np.uint8]:
    """Return a colour for each 16-bit photo index, (65536, 3); index 0 is grey."""
    import cv2

    hues = np.full((1, 1 << 16, 3), (0, 190, 230), np.uint8)
    # Hues in golden angle steps: photos that are close in time get very different colours.
    hues[0, :, 0] = np.arange(1 << 16) * _GOLDEN_ANGLE % 180
    colors = cv2.cvtColor(hues, cv2.COLOR_HSV2RGB)[0]
    colors[0] = 128
    return np.asarray(colors, np.uint8)


STAGE = Stage(
    name="texture",
    section=TextureSection,
    inputs=TextureInputs,
    labels=("names",),
    artifact=TexturedMesh,
    run=_run,
    versions=make_fixed_versions(texture),
    libraries=list_installed_versions("scanloom", "opencv", "scipy"),
    result_names=(TEXTURED_FILE, f"{TEXTURE_MAPS}/"),
    ignored_inputs=_list_ignored_inputs,
    skip_reason=get_skip_reason,
    cost=CostModel(
        seconds=2,
        seconds_per_megapixel=0.5,
        bytes=8e8,
        bytes_per_megapixel=3e6,
        depends_on_voxel_size=False,
        max_bytes=MAX_BYTES_IN_CHUNKS,
    ),
    headline=_format_headline,
)
