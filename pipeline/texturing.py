"""The stage `texture`: the simplified mesh with what the photos saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.standing import Up
from stages.files.images import read_stored
from stages.params import param
from stages.progress import Progress
from stages.scans.scan import Frame
from stages.surface.mesh import Mesh
from stages.surface.mesh_files import write_mesh
from stages.surface.texture import Image
from stages.texturing.maps import write_maps
from stages.texturing.texture import TextureParams, texture

FILE, MAPS = "textured.glb", "texture_maps"

# The golden angle, in half degrees as OpenCV counts hues.
_GOLDEN = 68.754


@dataclass(frozen=True, kw_only=True)
class TextureSection(TextureParams):
    """Whether a run gives the simplified mesh a texture from the photos, and which."""

    enabled: bool = param(
        True,
        "Give the simplified mesh what the photos show, wherever frames have colour.",
        # It decides whether the stage is there, not what comes out of it.
        invalidates=False,
    )
    images: str | None = param(
        None,
        "Folder of other photos with poses in the scan's world, in metres (COLMAP, nerfstudio, or any scan): "
        "their colours are taken, and none of the frames'.",
        # What is in the folder decides, not its name.
        invalidates=False,
        is_path=True,
    )


def make(
    folder: Path,
    mesh: Mesh,
    frames: Sequence[Frame],
    params: TextureSection,
    up: Up | None,
    progress: Progress,
) -> dict[str, Any]:
    """Write textured.glb, which stands by what is up, and the maps of its images, and return the figures."""
    textured = texture(mesh, frames, params, progress=progress)
    write_mesh(folder / FILE, textured.mesh.with_(up=up))
    (folder / MAPS).mkdir()
    write_maps(folder / MAPS, textured)
    return textured.figures()


def by_photo(mesh: Mesh, maps: Path) -> Mesh:
    """Return the mesh with a colour for each photo where it counts most; grey where none shows it."""
    assert mesh.texture is not None
    palette = _palette()
    materials = tuple(
        replace(material, image=Image(given=palette[read_stored(maps / f"photo-{number}.png")]))
        for number, material in enumerate(mesh.texture.materials, 1)
    )
    return mesh.with_(texture=replace(mesh.texture, materials=materials))


def _palette() -> NDArray[np.uint8]:
    """Return a colour for each number that 16 bits hold; grey for 0."""
    import cv2

    wheel = np.full((1, 1 << 16, 3), (0, 190, 230), np.uint8)
    # Hues, of 180, apart by the golden angle: neighbours in time are far apart in colour.
    wheel[0, :, 0] = np.arange(1 << 16) * _GOLDEN % 180
    colors = cv2.cvtColor(wheel, cv2.COLOR_HSV2RGB)[0]
    colors[0] = 128
    return np.asarray(colors, np.uint8)
