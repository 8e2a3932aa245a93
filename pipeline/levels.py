"""The optional stage `lod`: levels of detail of the clean mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from stages.fusion.noise import depth_noise
from stages.lod.build import LevelsParams, LodParams, build
from stages.lod.slod import write_slod
from stages.params import param
from stages.progress import Progress
from stages.scans.scan import Frame
from stages.surface.mesh import Mesh

# Raised by hand when the same clean mesh and frames come to another base error.
RESULT_VERSION = 1

FILE = "lod.slod"
# A place of the surface that four frames saw is off by half of what one of them is.
_SHARE_OF_NOISE = 0.5


@dataclass(frozen=True, kw_only=True)
class LodSection(LevelsParams):
    """Whether a run builds levels of detail of the clean mesh, and which."""

    enabled: bool = param(
        False,
        "Build levels of detail of the clean mesh, each proven.",
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


def make(
    folder: Path, mesh: Mesh, frames: Sequence[Frame], params: LodSection, progress: Progress
) -> dict[str, Any]:
    """Write lod.slod, and return the figures.

    Parameters
    ----------
    mesh : the clean one.
    frames : with poses and depth, which tell the noise.
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
    return hierarchy.figures() | {
        "base_error_m": error,
        "base_error_source": "given" if noise is None else "noise",
        "depth_noise_m": noise,
        "file_bytes": (folder / FILE).stat().st_size,
        "warnings": [*warnings, *hierarchy.notes[len(mesh.notes) :]],
    }
