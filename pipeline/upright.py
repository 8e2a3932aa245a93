"""The stage `upright`: what is up in a scan, for all results that stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.standing import Up, write_up
from stages.params import check, param
from stages.scans.scan import Frame
from stages.surface.mesh import Mesh
from stages.surface.upright import axis_or, direction_of, up_of_place

# Raised by hand when the same clean mesh and frames come to another up.
RESULT_VERSION = 1

# It is known to a degree; files need not say more.
_DIGITS = 7


@dataclass(frozen=True, kw_only=True)
class UprightSection:
    """What is up in the world of the scan: glTF files and tiles stand so. PLY files stay as they are."""

    up: str | None = param(
        None,
        "What is up in the scan: an axis (+x, -x, +y, -y, +z, -z), a direction as three numbers, or `as-is`, "
        "which turns nothing. By default where most of the surface looks that is within 60° of up in the "
        "frames: floors and tops of tables, also if they are left out by fuse.remove_plane.",
    )

    def __post_init__(self) -> None:
        check(self)
        if self.up is not None:
            direction_of(_words_of(self.up))


def make(
    folder: Path, mesh: Mesh, frames: Sequence[Frame], plane: Up | None, params: UprightSection
) -> dict[str, Any]:
    """Write what is up, and return the figures.

    Parameters
    ----------
    mesh : the clean one.
    frames : in its world; those without a pose tell nothing.
    plane : what is up from the table or floor that was left out of it; None if none was.
    """
    up, told = _found(mesh, frames, plane, params)
    write_up(folder, up)
    return {"up": up, "up_source": told}


def _found(
    mesh: Mesh, frames: Sequence[Frame], plane: Up | None, params: UprightSection
) -> tuple[Up | None, str]:
    """Return what is up, and what told it."""
    if params.up is not None:
        given = direction_of(_words_of(params.up))
        return None if given is None else _rounded(given), "given"
    if plane is not None:
        return _rounded(axis_or(np.array(plane))), "plane"
    poses = [frame.world_from_camera for frame in frames if frame.world_from_camera is not None]
    if not poses:
        return None, "nothing"
    found, told = up_of_place(mesh, np.array(poses))
    return _rounded(found), told


def _words_of(up: str) -> str:
    # In a configuration `none` gives a parameter back to being derived.
    return "none" if up == "as-is" else up


def _rounded(direction: NDArray[np.float64]) -> Up:
    rounded = direction.round(_DIGITS)
    x, y, z = (rounded / np.linalg.norm(rounded)).tolist()
    return x, y, z
