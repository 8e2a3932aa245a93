"""Failed memory allocation: every kernel and every reader reports it, and the process survives."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanloom.stages import _kernels
from scanloom.stages.surface.mesh_files import write_mesh
from tests.made.coloured_meshes import sheet
from tests.made.short_of_memory import DONE, MEMORY

# Squares along the side of the test sheet, chosen so that each kernel works for a second or two.
SIDES = {
    "compute_side_lengths": 500,
    "compute_spatial_order": 400,
    "smooth_boundaries": 400,
    "find_intersecting_triangles": 120,
    "find_irregular_elements": 400,
    "weld_sheets": 400,
    "label_components": 1000,
    "choose_color_weight": 120,
    "simplify": 100,
    "simplify_by_quadrics": 100,
    "fit": 150,
    "simplify_certified": 40,
    "certify": 30,
    "build_levels": 30,
    "assemble_front": 400,
    "optimize_strip_order": 400,
    "encode_rows": 400,
    "encode_triangles": 400,
    "decode_rows": 1500,
    "decode_indices": 2000,
    "lay_out_atlas": 100,
    "rasterize_texels": 100,
    "draw_sources": 100,
    "locate_texels": 100,
    "sample_texels": 100,
    "sample_points": 100,
    "simplify_planar": 100,
    "find_planar_patches": 100,
    "simplify_seams": 100,
    "remesh": 22,
    "decode_normal_mesh": 20,
    "match_descriptors": 50,
    "match_pair": 300,
    "sweep_planes": 300,
    "refine_inverse_depth": 1200,
    "count_supporting_views": 400,
    "is_inside_all_masks": 400,
    "fuse_depth_maps": 300,
    "find_hull_entry": 400,
    "compute_weighted_medians": 150,
    "filter_depth": 1000,
    "find_touched_blocks": 700,
}
# Second variants of kernels: remeshing without levels only rounds the base mesh. Also calls on objects: a
# growing volume, refinement, and rendering.
OTHER_WAYS = {
    "remesh_alone": 60,
    "refine_surface": 150,
    "align_boundaries": 400,
    "integrate": 700,
    "render_zbuffer": 100,
}
# Allocates no memory.
NONE = {"release_free_memory"}


def test_every_kernel_is_listed() -> None:
    assert set(SIDES) | NONE == {name for name in _kernels.__all__ if name.islower()}


# A file of each kind, large enough that reading takes some memory.
FILES = ("rgb.png", "rgb.jpg", "z.exr", "z.npy", "z.png", "m.ply", "m.obj", "m.off", "m.stl", "m.glb")


@pytest.fixture(scope="module")
def kernels() -> Iterator[subprocess.Popen[str]]:
    """Start a process that has imported everything that kernels need, to run kernels one by one."""
    with start_process("short_of_memory") as process:
        yield process


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the address space is limited as Linux does it")
@pytest.mark.parametrize("kernel", SIDES | OTHER_WAYS)
def test_too_little_memory_raises_an_error_without_abort(kernel: str, kernels: subprocess.Popen[str]) -> None:
    ends = request_outcomes(kernels, f"{kernel} {(SIDES | OTHER_WAYS)[kernel]}")
    assert {end for how in ends.values() for end in how.values()} <= {DONE, MEMORY}, ends
    assert ends["rising"]["0 MiB"] == MEMORY


@pytest.fixture(scope="module")
def readers() -> Iterator[subprocess.Popen[str]]:
    """Start a process that has imported everything that readers need, to run readers one by one."""
    with start_process("readers_short_of_memory") as process:
        yield process


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the address space is limited as Linux does it")
@pytest.mark.parametrize("name", FILES)
def test_a_file_too_large_for_memory_is_not_reported_as_damaged(
    name: str, tmp_path: Path, readers: subprocess.Popen[str]
) -> None:
    write_file(tmp_path / name)
    ends = request_outcomes(readers, str(tmp_path / name))
    assert set(ends.values()) <= {DONE, MEMORY}, ends
    assert (ends["800 MiB"], ends["0 MiB"]) == (DONE, MEMORY)


def request_outcomes(process: subprocess.Popen[str], line: str) -> Any:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{line}\n")
    process.stdin.flush()
    return json.loads(process.stdout.readline())


def start_process(module: str) -> subprocess.Popen[str]:
    # A single arena: glibc otherwise reserves 64 MiB for each thread, which would hide failing allocations.
    return subprocess.Popen(
        [sys.executable, "-m", f"tests.made.{module}"],
        env={**os.environ, "MALLOC_ARENA_MAX": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def write_file(path: Path) -> None:
    import cv2
    import OpenEXR

    side = 2500
    if path.stem == "m":
        write_mesh(path, sheet(100))
    elif path.suffix == ".npy":
        np.save(path, np.ones((side, side), np.float32))
    elif path.suffix == ".exr":
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, {"Z": np.ones((side, side), np.float32)}) as file:
            file.write(str(path))
    else:
        shape, dtype = ((side, side), np.uint16) if path.stem == "z" else ((side, side, 3), np.uint8)
        assert cv2.imwrite(str(path), np.ones(shape, dtype))
