"""Progress of long kernels never decreases and never exceeds the total."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanloom.stages import (
    Mesh,
    ScanParams,
    certify,
    check,
    clean,
    lod,
    planar_patches,
    read_scan,
    register,
    remesh,
    repair,
    simplify,
)
from scanloom.stages.progress import Progress
from scanloom.stages.simplification.methods import METHODS

SAMPLE = Path(__file__).parents[2] / "samples" / "rgbd"

pytestmark = pytest.mark.slow


@functools.cache
def make_hills(n: int) -> Mesh:
    """Make a noisy, coloured height field of n × n vertices on one square metre."""
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    noise = 0.002 * np.random.default_rng(1).normal(size=x.shape)
    vertices = np.stack([x, y, 0.05 * np.sin(9 * x) * np.cos(7 * y) + noise], -1).reshape(-1, 3)
    at = np.arange(n * n).reshape(n, n)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]))
    triangles = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).astype(np.int32)
    return Mesh(vertices, triangles, np.clip(128 + 100 * np.sin(20 * vertices), 0, 255).astype(np.uint8))


@functools.cache
def simplify_hills() -> Mesh:
    return simplify(make_hills(100), ratio=0.1).mesh


ASKED: dict[str, dict[str, Any]] = {
    "quadric": {"ratio": 0.05},
    "certified": {"max_shape": 0.004, "max_color": 30},
    "jia01": {"jia01": {"resolution": 0.02}},
    "seams": {"ratio": 0.05},
    "planar": {"max_shape": 0.01},
}


def write_tiles_with_images(progress: Progress) -> None:
    hierarchy = lod.build(make_hills(60), cell_triangles=500, root_triangles=100)
    with tempfile.TemporaryDirectory() as folder:
        lod.write_tiles(hierarchy, Path(folder) / "tiles", texture=make_hills(60), progress=progress)


WORK: dict[str, Callable[[Progress], object]] = {
    **{
        method.name: functools.partial(
            # Long enough for a report: quadrics are the fastest.
            lambda progress, method, **asked: simplify(
                make_hills(400 if method == "quadric" else 200), method=method, progress=progress, **asked
            ),
            method=method.name,
            **ASKED[method.name],
        )
        for method in METHODS
    },
    "certified, to a number": lambda progress: simplify(
        make_hills(100), max_shape=0.004, triangles=4000, progress=progress
    ),
    "certify": lambda progress: certify(simplify_hills(), make_hills(100), progress=progress),
    "certify within a limit": lambda progress: certify(
        simplify_hills(), make_hills(100), max_shape=0.008, progress=progress
    ),
    "check": lambda progress: check(make_hills(250), progress=progress),
    "lod": lambda progress: lod.build(make_hills(100), progress=progress),
    "tiles, with images": write_tiles_with_images,
    "lod, from a base": lambda progress: lod.build(make_hills(70), base_error=0.002, progress=progress),
    "repair": lambda progress: repair(make_hills(200), corner_angle=30, progress=progress),
    "clean, with repairs": lambda progress: clean(make_hills(100), repair=True, progress=progress),
    "patches": lambda progress: planar_patches(make_hills(400), progress=progress),
    "register": lambda progress: register(read_scan(SAMPLE, ScanParams(every=3)), progress=progress),
    "remesh": lambda progress: remesh(simplify_hills(), progress=progress),
}


@pytest.mark.parametrize("name", WORK)
def test_progress_never_decreases_or_exceeds_its_total(name: str) -> None:
    seen: list[tuple[int, int]] = []
    WORK[name](lambda done, total: seen.append((done, total)))
    assert seen
    assert all(0 <= done <= total for done, total in seen)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    # The total may be 0 before the work starts; after that it is constant.
    assert len({total for _, total in seen} - {0}) <= 1
