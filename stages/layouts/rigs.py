"""The rig of a pair layout: from its calibration file, or from what the person states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stages import calibration, documents
from stages.errors import InputError
from stages.layouts.files import first_existing, has
from stages.scan import StereoRig

if TYPE_CHECKING:
    from stages.layouts.params import ScanParams


def rig_of(
    folder: Path, options: ScanParams, size: tuple[int, int], names: Sequence[str]
) -> tuple[StereoRig, list[str]]:
    """Return the rig and what is odd about its calibration.

    Parameters
    ----------
    folder, options : of the scan.
    size : of the images, (width, height) in pixels.
    names : calibration files to look for in the folder, the preferred first.

    Raises
    ------
    InputError
        If there is no calibration and `intrinsics` and `baseline` do not stand in for it.
    """
    stated = options.camera(*size)
    path = options.file("calibration", folder) or first_existing(folder, *names)
    if path is not None:
        rig, warnings = calibration.read_rig(path, *size, baseline=options.baseline)
    elif stated is not None and options.baseline is not None:
        beside = calibration.with_baseline(np.eye(4), options.baseline)
        return StereoRig(stated, stated, beside, rectified=True), []
    elif has(folder, "intrinsics.yml", "extrinsics.yml"):
        # OpenCV's stereo sample writes the two halves as two files.
        halves = [documents.read_document(folder / name) for name in ("intrinsics.yml", "extrinsics.yml")]
        rig, warnings = calibration.read_rig(
            folder / "extrinsics.yml", *size, document=halves[0] | halves[1], baseline=options.baseline
        )
    else:
        raise InputError(
            f"no calibration ({names[0]}): name one with scan.calibration=FILE, or set "
            "scan.intrinsics=fx,fy,cx,cy and scan.baseline=METRES for a rectified pair.",
            folder,
        )
    return (rig if stated is None else replace(rig, left=stated, right=stated)), warnings
