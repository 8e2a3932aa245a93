"""Correction of the scale and offset of predicted depth, on scans with known depth.

    python benches/predicted_depth.py SCAN [SCAN ...] [--deviation 0.05] [--step 4]

The depth of each frame is multiplied by a random scale and shifted by a random offset, as if a network had
predicted it. Prints a Markdown table with the standard deviation of the depth relative to the true one,
between views, before and after the correction.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from markdown_tables import print_head, print_row

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.scan import DepthImage, Frame, PackedImage
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.scans.transforms.depth_agreement import align_predicted_depth


def distort(frame: Frame, depth: DepthImage, scale: float, offset: float) -> Frame:
    """Return the frame with depth `scale` z + `offset`, without confidence and mask."""
    wrong = np.where(depth > 0, scale * depth + offset, 0).astype(np.float32)
    return replace(
        frame,
        depth=PackedImage(Path(frame.name), "depth", lambda: wrong),
        depth_scale=1.0,
        depth_missing=(),
        depth_correction=None,
        confidence=None,
        mask=None,
    )


def measure(frames: Sequence[Frame], exact: Sequence[DepthImage]) -> float:
    """Return the standard deviation of the median ratio of depth to exact depth between frames."""
    ratios = []
    for frame, depth in zip(frames, exact, strict=True):
        found = read_depth(frame)
        assert found is not None
        both = (found > 0) & (depth > 0)
        ratios.append(np.median(found[both] / depth[both]))
    return float(np.std(ratios))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scans", nargs="+", type=Path, metavar="SCAN")
    parser.add_argument("--deviation", type=float, default=0.05, help="of scale, and of offset per metre")
    parser.add_argument("--step", type=int, default=1, help="use every n-th frame")
    options = parser.parse_args()
    print_head(["scan", "views", "before", "after"], words=1)
    for folder in options.scans:
        rng = np.random.default_rng(0)
        frames = read_scan(folder).frames[:: options.step]
        exact = [depth for frame in frames if (depth := read_depth(frame)) is not None]
        numbers = options.deviation * rng.standard_normal((len(frames), 2))
        wrong = [
            distort(frame, depth, 1 + scale, offset)
            for frame, depth, (scale, offset) in zip(frames, exact, numbers.tolist(), strict=True)
        ]
        with collecting(forward=False):
            corrected = align_predicted_depth(wrong)
        cells = (f"{measure(some, exact):.2%}" for some in (wrong, corrected))
        print_row([folder.name, f"{len(frames)}", *cells])


if __name__ == "__main__":
    main()
