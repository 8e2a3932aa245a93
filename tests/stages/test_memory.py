"""Memory that cannot be had: every kernel says so, and the process goes on."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from stages import _kernels
from tests.made.short_of_memory import DONE, MEMORY

# Squares along the sides of the sheet that each works on: as many as a second or two of work allow.
SIDES = {
    "side_lengths": 500,
    "spatial_order": 400,
    "weld_sheets": 400,
    "color_weight": 150,
    "simplify": 100,
    "simplify_by_quadrics": 150,
    "fit": 150,
    "simplify_certified": 40,
    "certify": 30,
    "simplify_planar": 100,
    "planar_patches": 100,
    "simplify_seams": 100,
    "remesh": 30,
    "decode_normal_mesh": 20,
}


def test_every_kernel_is_here() -> None:
    assert set(SIDES) == {name for name in _kernels.__all__ if name.islower()}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the address space is limited as Linux does it")
@pytest.mark.parametrize("kernel", SIDES)
def test_too_little_memory_is_an_error_and_no_abort(kernel: str) -> None:
    # One arena: glibc otherwise reserves 64 MiB for a thread, and most of these sheets find room in it.
    run = subprocess.run(
        [sys.executable, "-m", "tests.made.short_of_memory", kernel, str(SIDES[kernel])],
        env={**os.environ, "MALLOC_ARENA_MAX": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    ends = json.loads(run.stdout)
    assert {end for how in ends.values() for end in how.values()} <= {DONE, MEMORY}, ends
    assert ends["falling"]["0 MiB"] == MEMORY
