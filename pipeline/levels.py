"""The optional stage `lod`: levels of detail of the clean mesh, and 3D Tiles of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from stages.fusion.noise import depth_noise
from stages.lod.build import LevelsParams, LodParams, build
from stages.lod.slod import write_slod
from stages.lod.tiles import turn_of, write_tiles
from stages.params import param
from stages.picturing.viewpoints import up_of
from stages.progress import Progress
from stages.scans.scan import Frame
from stages.surface.mesh import Mesh
from stages.surface.upright import up_of_surface

# Raised by hand when the same clean mesh and frames come to another base error, or to another up.
RESULT_VERSION = 1

FILE = "lod.slod"
TILES = "tiles"
# A place of the surface that four frames saw is off by half of what one of them is.
_SHARE_OF_NOISE = 0.5


@dataclass(frozen=True, kw_only=True)
class LodSection(LevelsParams):
    """Whether a run builds levels of detail of the clean mesh, and which."""

    enabled: bool = param(
        False,
        "Build levels of detail of the clean mesh, each proven, and 3D Tiles of them.",
        # It decides whether the stage is there, not what comes out of it.
        invalidates=False,
    )
    base_error: float | None = param(
        None,
        "The finest level is the clean mesh simplified within this proven distance; 0 for the clean mesh "
        "itself. By default from the scan's noise: half of the standard deviation of a frame's depth at the "
        "median depth, which neighbouring frames show.",
        unit="m",
        low=0,
    )
    tiles: bool = param(True, "Write 3D Tiles of the levels, too.")
    up: str | None = param(
        None,
        "What is up in the scan, which the tiles turn along z: an axis (+x, -x, +y, -y, +z, -z), a direction "
        "as three numbers, or `as-is`, which turns nothing. By default where most of the surface looks "
        "that is within 60° of up in the frames: floors and tops of tables.",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.up is not None:
            turn_of(_words_of(self.up))


def make(
    folder: Path, mesh: Mesh, frames: Sequence[Frame], params: LodSection, progress: Progress
) -> dict[str, Any]:
    """Write lod.slod and, if asked for, the folder tiles/, and return the figures.

    Parameters
    ----------
    mesh : the clean one.
    frames : with poses and depth, which tell the noise and what is up.
    """
    error, noise, warnings = params.base_error, None, []
    if error is None:
        noise = depth_noise(frames)
        error = _SHARE_OF_NOISE * noise
        if noise == 0:
            warnings.append(
                "the frames do not tell how exact their depth is; the finest level is the clean mesh itself, "
                "and lod.base_error gives another."
            )
    shared = {field.name: getattr(params, field.name) for field in fields(LevelsParams)}
    hierarchy = build(mesh, LodParams(base_error=error, **shared), progress=progress)
    write_slod(folder / FILE, hierarchy)
    figures = hierarchy.figures() | {
        "base_error_m": error,
        "base_error_source": "given" if noise is None else "noise",
        "depth_noise_m": noise,
        "file_bytes": (folder / FILE).stat().st_size,
        "tiles": None,
        "warnings": [*warnings, *hierarchy.notes[len(mesh.notes) :]],
    }
    if params.tiles:
        up, source = _up(mesh, frames) if params.up is None else (_words_of(params.up), "given")
        written = write_tiles(hierarchy, folder / TILES, up=up).figures()
        figures["tiles"] = written.pop("tiles")
        figures["tileset"] = {"up": up, "up_source": source, **written}
    return figures


def _words_of(up: str) -> str:
    # In a configuration `none` gives a parameter back to being derived.
    return "none" if up == "as-is" else up


def _up(mesh: Mesh, frames: Sequence[Frame]) -> tuple[str, str]:
    """Return what is up as three numbers, and what tells it."""
    poses = np.array([frame.world_from_camera for frame in frames if frame.world_from_camera is not None])
    held = up_of(poses)
    found = up_of_surface(mesh, held)
    words = " ".join(f"{value:.6g}" for value in (held if found is None else found))
    return words, "frames" if found is None else "surface"
