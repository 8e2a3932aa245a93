"""The optional stage `lod`: levels of detail of the clean mesh, or of the simplified one of a large mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from pipeline.large import Proof
from stages.fusion.noise import depth_noise
from stages.lod.build import LevelsParams, LodParams, build, further_off
from stages.lod.hierarchy import Hierarchy
from stages.lod.slod import write_slod
from stages.params import param
from stages.printing import at_most
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
    hierarchy = _built(mesh, error, params, progress)
    source = "given" if noise is None else "noise"
    return _written(folder, hierarchy, error, source, noise, [*warnings, *hierarchy.notes[len(mesh.notes) :]])


def make_of_simplified(
    folder: Path,
    mesh: Mesh,
    proof: Proof | None,
    triangles: int,
    params: LodSection,
    progress: Progress,
) -> dict[str, Any]:
    """Write lod.slod of a simplified mesh, where the clean one is too large, and return the figures.

    Parameters
    ----------
    proof : how far it is from the clean mesh, which then counts in all bounds; None if that is not proven,
        and bounds are from the simplified mesh alone.
    triangles : of the clean mesh.
    """
    off = 0.0 if proof is None else proof.shape_bound_m
    error = max((params.base_error or 0.0) - off, 0.0)
    hierarchy = _built(mesh, error, params, progress)
    notes = hierarchy.notes[len(mesh.notes) :]
    if proof is None:
        said = (
            "the clean mesh is too large for levels of its own: they are those of the simplified mesh, and "
            "how far that is from the clean one is not proven; with a bound, simplify.max_shape, it is."
        )
    else:
        said = (
            "the clean mesh is too large for levels of its own: they begin with the simplified mesh, proven "
            f"to be within {at_most(off)} m of it, which counts in what is proven of each."
        )
        hierarchy = further_off(hierarchy, off, proof.color_bound_levels or 0.0)
        hierarchy = replace(hierarchy, input_triangles=triangles)
    hierarchy = replace(hierarchy, notes=(*hierarchy.notes, said))
    return _written(folder, hierarchy, off + error, "simplified", None, [said, *notes])


def _built(mesh: Mesh, error: float, params: LodSection, progress: Progress) -> Hierarchy:
    shared = {field.name: getattr(params, field.name) for field in fields(LevelsParams)}
    return build(mesh, LodParams(base_error=error, **shared), progress=progress)


def _written(
    folder: Path,
    hierarchy: Hierarchy,
    error: float,
    source: str,
    noise: float | None,
    warnings: Sequence[str],
) -> dict[str, Any]:
    write_slod(folder / FILE, hierarchy)
    return hierarchy.figures() | {
        "base_error_m": error,
        "base_error_source": source,
        "depth_noise_m": noise,
        "file_bytes": (folder / FILE).stat().st_size,
        "warnings": list(warnings),
    }
