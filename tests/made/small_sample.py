"""Small version of the RGB-D sample: every fourth frame at half resolution."""

from __future__ import annotations

import json
from pathlib import Path

import cv2

SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "rgbd"


def write_small_sample(folder: Path) -> None:
    scan = json.loads((SAMPLE / "scan.json").read_text())
    camera = scan["camera"]
    scan["camera"] = {name: value / 2 if name in ("fx", "fy") else value for name, value in camera.items()}
    # Halving keeps the first of every two pixels, so pixel centres stay where they are.
    scan["camera"] |= {"width": 160, "height": 120, "cx": camera["cx"] / 2, "cy": camera["cy"] / 2}
    scan["frames"] = scan["frames"][::4]
    for frame in scan["frames"]:
        for kind in ("color", "depth"):
            image = cv2.imread(str(SAMPLE / frame[kind]), cv2.IMREAD_UNCHANGED)
            assert image is not None
            (folder / kind).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / frame[kind]), image[::2, ::2])
    (folder / "scan.json").write_text(json.dumps(scan))
