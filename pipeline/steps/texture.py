"""Stage `texture`: textures the simplified mesh with the photos."""

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
from scanloom.pipeline.steps.simplify import SimplifiedMesh
from scanloom.stages.files.images import read_stored_image
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.params import param
from scanloom.stages.progress import Progress
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh, write_mesh
from scanloom.stages.surface.texture import Image
from scanloom.stages.texturing.provenance_maps import write_maps
from scanloom.stages.texturing.texture import TextureParams, texture

TEXTURED_FILE = "textured.glb"

# Golden angle in units of 2°, the hue unit of OpenCV.
_GOLDEN_ANGLE = 68.754


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
    photos : scan read from `texture.images`, used instead of the frames.
    """

    simplified_mesh: SimplifiedMesh
    up_direction: UpDirection
    photos: Scan | None = None


def _run(inputs: TextureInputs, params: TextureSection, context: Context) -> Mapping[str, Any]:
    scan = inputs.load_posed() if inputs.photos is None else inputs.photos
    mesh, up = inputs.simplified_mesh.load(), inputs.up_direction.load()
    metrics = write_textured(context.folder, mesh, scan.frames, params, up, context.progress)
    warn_skipped_frames(metrics["frames_skipped"])
    return metrics


def _list_ignored_inputs(config: Sections) -> Collection[str]:
    is_given = config.get(TextureSection).images is not None
    return ("frames", "poses", "adjusted_cameras", "names") if is_given else ()


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
) -> dict[str, Any]:
    """Texture the mesh, write textured.glb (upright) and the per-texel maps, and return metrics."""
    textured = texture(mesh, frames, params, progress=progress)
    write_mesh(folder / TEXTURED_FILE, textured.mesh.with_(up=up))
    (folder / TEXTURE_MAPS).mkdir()
    write_maps(folder / TEXTURE_MAPS, textured)
    return textured.to_dict()


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
    libraries=list_installed_versions("scanloom", "opencv"),
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
    headline="{photos} photos on {triangles:,} triangles; {coverage_ratio:.0%} of the surface covered, "
    "texel size {texel_size_m:.2g} m",
)
