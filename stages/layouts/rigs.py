"""The rig of a pair layout: from its calibration file, or from what the person states."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stages import calibration, documents
from stages.errors import InputError
from stages.layouts.files import first_existing
from stages.scan import Pose, StereoRig

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
        rig, warnings = calibration.read_rig(path, *size)
    elif stated is not None and options.baseline is not None:
        rig, warnings = StereoRig(stated, stated, np.eye(4), rectified=True), []
    elif (folder / "intrinsics.yml").exists() and (folder / "extrinsics.yml").exists():
        # OpenCV's stereo sample writes the two halves as two files.
        document = {
            **documents.read_document(folder / "intrinsics.yml"),
            **documents.read_document(folder / "extrinsics.yml"),
        }
        # The projections in it are those of the images once rectified, which these are not yet.
        rig, warnings = calibration.read_rig(folder / "extrinsics.yml", *size, document)
    else:
        looked_for = f" ({names[0]})" if names else ""
        raise InputError(
            f"no calibration{looked_for}: name one with scan.calibration=FILE, or set "
            "scan.intrinsics=fx,fy,cx,cy and scan.baseline=METRES for a rectified pair.",
            folder,
        )
    if stated is not None:
        rig = replace(rig, left=stated, right=stated)
    if options.baseline is not None:
        rig = replace(rig, right_from_left=_with_baseline(rig, options.baseline))
    return rig, warnings


def _with_baseline(rig: StereoRig, baseline: float) -> Pose:
    matrix: Pose = rig.right_from_left.copy()
    matrix[:3, 3] *= baseline / rig.baseline
    return matrix
