"""One rectified pair without calibration (Middlebury 2001 to 2006): read when the person supplies it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from stages.errors import InputError
from stages.formats import trajectories
from stages.images import image_size
from stages.layouts.files import first_existing
from stages.layouts.layout import Layout
from stages.layouts.rigs import rig_of
from stages.scan import Frame, Scan

if TYPE_CHECKING:
    from stages.layouts.params import ScanParams

_PAIRS = (("im0", "im1"), ("im2", "im6"), ("view1", "view5"))
_SUFFIXES = (".png", ".ppm", ".pgm")


def _pair(folder: Path) -> tuple[Path, Path] | None:
    for names in _PAIRS:
        left, right = (first_existing(folder, *(name + suffix for suffix in _SUFFIXES)) for name in names)
        if left is not None and right is not None:
            return left, right
    return None


def _matches(folder: Path) -> str | None:
    found = _pair(folder)
    return f"{found[0].name} and {found[1].name}" if found else None


def _read(folder: Path, options: ScanParams) -> Scan:
    found = _pair(folder)
    if found is None:
        raise InputError("a pair im2.png and im6.png (or view1, view5) is needed.", folder)
    size = image_size(found[0])
    rig, warnings, missing = rig_of(folder, options, size, ("calibration.json", "calibration.toml"))
    path = options.file("poses", folder)
    poses = [None] if path is None else trajectories.match(trajectories.read_trajectory(path), ["0"], path)
    frame = Frame(
        name=found[0].stem, camera=rig.left, color=found[0], right=found[1], world_from_camera=poses[0]
    )
    lacking = "poses: a single pair has none; name one with scan.poses=FILE"
    if path is None:
        missing = (*missing, lacking)
    return Scan(LAYOUT.name, [frame], rig, folder, (), tuple(warnings), missing)


LAYOUT = Layout(
    name="pair",
    text="im2 and im6, or view1 and view5, .png or .ppm (Middlebury 2001 to 2006; calibration by hand)",
    matches=_matches,
    read=_read,
)
