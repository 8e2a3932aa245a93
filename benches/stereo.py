"""Stereo depth against ground truth, compared with OpenCV's matcher.

    python benches/stereo.py DATA [--model FILE.onnx]

DATA holds `stereo/middlebury2014_motorcycle`, `stereo/middlebury2003_cones` and, for the time of a whole
sequence, `stereo/kitti_sequence_1`. OpenCV is called as its users call it.

- "coverage": ratio of valid pixels among the pixels that both cameras see.
- "error": ratio of pixels with a larger disparity error among all valid pixels, and ("visible") among those
  that both cameras see.
- "s": CPU seconds.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from scanloom.stages.scans.model.scan import Camera, StereoRig
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.stereo.depth import depth, depth_scan
from scanloom.stages.stereo.disparity import stereo_disparity

Image = np.ndarray


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--model", help="also measure a stereo network, with its sidecar file")
    words = parser.parse_args()
    stereo = words.data / "stereo"
    print(f"OpenCV {cv2.__version__}, {os.cpu_count()} cores\n")
    print("| pair | setting | coverage % | error > 1 px % | > 2 px % | visible > 2 px % | median px | s |")
    print("|---|---|---:|---:|---:|---:|---:|---:|")
    for name, pair in (("Motorcycle", read_motorcycle(stereo)), ("Cones", read_cones(stereo))):
        for setting, run in make_settings(*pair[:3], words.model).items():
            print(f"| {name} | {setting} | {format_row(run, pair[3])} |")
    print_reliability(stereo)
    print_sequence(stereo / "kitti_sequence_1")


def make_settings(
    left: Image, right: Image, rig: StereoRig, model: str | None = None
) -> dict[str, Callable[[], tuple[Image, Image]]]:
    """Return the compared functions by name.

    Each computes a disparity map (h, w) and the mask of its valid pixels.
    """

    def make_scanloom_setting(**changes: object) -> Callable[[], tuple[Image, Image]]:
        def run() -> tuple[Image, Image]:
            result = depth(left, right, rig, **changes)
            return result.disparity, result.depth > 0

        return run

    count = -(-(rig.disparity_count or 64) // 16) * 16
    return {
        "OpenCV SGBM": lambda: match_opencv(left, right, count, "sgbm"),
        "OpenCV HH4 + WLS, padded": lambda: match_opencv(left, right, count, "hh4"),
        "stereo_disparity": lambda: match_scanloom(left, right, count, 0.8),
        "stereo_disparity, min_confidence=0": lambda: match_scanloom(left, right, count, 0),
        "depth": make_scanloom_setting(),
        "depth, sgbm.left_right=match": make_scanloom_setting(sgbm={"left_right": "match"}),
        "depth, matcher=sgbm": make_scanloom_setting(matcher="sgbm"),
        "depth, matcher=hh4": make_scanloom_setting(matcher="hh4"),
        "depth, matcher=3way": make_scanloom_setting(matcher="3way"),
        "depth, sgbm.block_size=5": make_scanloom_setting(sgbm={"block_size": 5}),
        "depth, min_confidence=1": make_scanloom_setting(min_confidence=1),
        "depth, sgbm.smooth=true": make_scanloom_setting(sgbm={"smooth": True}),
        **({} if model is None else {"depth, model": make_scanloom_setting(model=model)}),
    }


def match_scanloom(left: Image, right: Image, count: int, min_confidence: float) -> tuple[Image, Image]:
    """Run `stereo_disparity`; return disparity and valid pixels."""
    found = stereo_disparity(left, right, count - 1, min_confidence=min_confidence)
    return found.disparity, np.isfinite(found.disparity)


def match_opencv(left: Image, right: Image, count: int, mode: str) -> tuple[Image, Image]:
    """Run OpenCV's matcher; return disparity and valid pixels.

    Mode "sgbm" is plain SGBM. Mode "hh4" runs HH4 in both directions on a padded pair, with weighted least
    squares (WLS) smoothing.
    """
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (left, right)]
    if mode == "sgbm":
        matcher = cv2.StereoSGBM.create(0, count, 3, 72, 288, 1, 31, 10, 100, 1)
        disparity = matcher.compute(*grey) / 16.0
        return disparity, disparity >= 0
    matcher = cv2.StereoSGBM.create(0, count, 3, 36, 216, -1, 31, mode=cv2.STEREO_SGBM_MODE_HH4)
    first = matcher.compute(*(pad(image, count, 0) for image in grey))[:, count:]
    # The search from the right image extends beyond the right border of the left image.
    other = cv2.ximgproc.createRightMatcher(matcher)
    second = other.compute(*(pad(image, 0, count) for image in grey[::-1]))[:, :-count]
    wls = cv2.ximgproc.createDisparityWLSFilterGeneric(True)
    wls.setLambda(1000)
    wls.setSigmaColor(1.5)
    wls.setDepthDiscontinuityRadius(2)
    disparity = wls.filter(np.ascontiguousarray(first), left, None, np.ascontiguousarray(second)) / 16.0
    return disparity, disparity >= 0


def pad(image: Image, before: int, after: int) -> Image:
    """Pad an image horizontally, so that the matcher covers border pixels."""
    return cv2.copyMakeBorder(image, 0, 0, before, after, cv2.BORDER_REPLICATE)


def format_row(run: Callable[[], tuple[Image, Image]], truth: Image) -> str:
    """Measure one function and format its row.

    The time is the best of three runs.
    """
    seconds = []
    for _ in range(3):
        start = time.process_time()
        disparity, given = run()
        seconds.append(time.process_time() - start)
    seen = mark_visible(truth)
    error = np.abs(disparity - truth)
    judged, judged_seen = error[given & np.isfinite(truth)], error[given & seen]
    shares = [given[seen], judged > 1, judged > 2, judged_seen > 2]
    text = " | ".join(f"{100 * np.mean(share):.2f}" for share in shares)
    return f"{text} | {np.median(judged):.3f} | {min(seconds):.3f}"


def mark_visible(truth: Image) -> Image:
    """Mark the pixels whose match in the right image is not occluded."""
    rows, columns = np.nonzero(np.isfinite(truth))
    target = np.round(columns - truth[rows, columns]).astype(int)
    inside = target >= 0
    rows, columns, target = rows[inside], columns[inside], target[inside]
    nearest = np.full(truth.shape, -np.inf)
    np.maximum.at(nearest, (rows, target), truth[rows, columns])
    seen = np.zeros(truth.shape, bool)
    seen[rows, columns] = truth[rows, columns] >= nearest[rows, target] - 1
    return seen


def read_motorcycle(stereo: Path) -> tuple[Image, Image, StereoRig, Image]:
    """Read the Motorcycle pair with calibration and true disparity."""
    folder = stereo / "middlebury2014_motorcycle"
    rig = read_scan(folder).rig
    assert rig is not None
    truth = cv2.imread(str(folder / "disp0.pfm"), cv2.IMREAD_UNCHANGED)
    return read_rgb(folder / "im0.png"), read_rgb(folder / "im1.png"), rig, truth


def read_cones(stereo: Path) -> tuple[Image, Image, StereoRig, Image]:
    """Read the Cones pair with its true disparity.

    The pair has no calibration, so one is assumed.
    """
    folder = stereo / "middlebury2003_cones"
    camera = Camera(450, 375, 600.0, 600.0, 224.5, 187.0)
    right_from_left = np.eye(4)
    right_from_left[0, 3] = -0.1
    truth = cv2.imread(str(folder / "disp2.pgm"), cv2.IMREAD_UNCHANGED) / 4.0
    truth[truth == 0] = np.inf
    left, right = (read_rgb(next(folder.glob(f"{name}.*"))) for name in ("im2", "im6"))
    return left, right, StereoRig(camera, camera, right_from_left, is_rectified=True), truth


def read_rgb(path: Path) -> Image:
    """Read an image file as RGB."""
    return cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)


def print_reliability(stereo: Path) -> None:
    """Print the calibration of the confidence.

    Compares confidence with the ratio of errors of at most 2 px.
    """
    print("\n| confidence % | pixels % | mean confidence % | correct % |\n|---|---:|---:|---:|")
    confidence, is_correct = [], []
    for left, other, rig, truth in (read_motorcycle(stereo), read_cones(stereo)):
        found = stereo_disparity(left, other, (rig.disparity_count or 64) - 1, min_confidence=0)
        known = np.isfinite(truth)
        confidence.append(found.confidence[known])
        is_correct.append(np.abs(found.disparity[known] - truth[known]) <= 2)
    sure, is_right = np.concatenate(confidence), np.concatenate(is_correct)
    edges = (0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 1)
    for low, high in pairwise(edges):
        chosen = (sure >= low) & (sure < high)
        shares = (chosen.mean(), sure[chosen].mean(), is_right[chosen].mean())
        print(f"| {100 * low:g} to {100 * high:g} | " + " | ".join(f"{100 * s:.1f}" for s in shares) + " |")


def print_sequence(folder: Path) -> None:
    """Print the time of a whole sequence, from files to depth maps."""
    scan = read_scan(folder)
    start, cpu = time.perf_counter(), time.process_time()
    used = [np.mean(result.depth > 0) for _, result in depth_scan(scan)]
    wall, cpu = time.perf_counter() - start, time.process_time() - cpu
    print(f"\n{len(used)} pairs of {folder.name}: {wall:.2f} s on {os.cpu_count()} cores, {cpu:.2f} s of "
          f"CPU time, {100 * np.mean(used):.1f} % coverage")  # fmt: skip


if __name__ == "__main__":
    main()
