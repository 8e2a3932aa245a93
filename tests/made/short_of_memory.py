"""Kernels with too little memory, each run in a separate process.

`python -m tests.made.short_of_memory` reads lines of KERNEL SIDE. Each kernel runs on a sheet of 2 SIDE²
triangles with increasing address space until it suffices, and with a limit that is set after a delay. The
outcome of each run is written as a line of JSON: "done", "memory" for a MemoryError, otherwise the failure.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels as kernels
from scanloom.stages.surface.mesh import Mesh
from tests.made.coloured_meshes import sheet

DONE, MEMORY = "done", "memory"
_ENDS = {0: DONE, 1: MEMORY, 2: "another exception"}
# Blocks of the free heap below 1 MiB are left to the interpreter.
MIN_FILLED_EXPONENT = 20
_fillings: list[NDArray[np.uint8]] = []

Call = Callable[[], object]


def make_kernel_call(kernel: str, side: int) -> Call:
    """Make a call of a kernel whose arguments are already allocated."""
    if kernel == "decode_normal_mesh":
        return partial(_decode_all_levels, _make_in_subprocess(lambda: _remesh(sheet(side)).data))
    if kernel == "decode_rows":
        packed = _make_in_subprocess(lambda: kernels.encode_rows(np.zeros((side * side, 16), np.uint8)))
        return partial(kernels.decode_rows, packed, side * side, 16, "NONE")
    if kernel == "decode_indices":
        same = np.tile(np.array([[0, 1, 2]], np.int32), (side * side, 1))
        packed = _make_in_subprocess(lambda: kernels.encode_triangles(same, 3))
        return partial(kernels.decode_indices, packed, same.size, 4, "TRIANGLES")
    return _make_calls(sheet(side), side)[kernel]


def _make_calls(mesh: Mesh, side: int) -> dict[str, Call]:
    count, triangles = len(mesh.vertices), len(mesh.triangles)
    locked, labels = np.zeros(0, bool), np.zeros(0, np.int32)
    importance = np.zeros(0)
    labels_of_all = np.zeros(triangles, np.int32)
    soup = (mesh.vertices, mesh.colors, mesh.triangles)
    running = kernels.RunSettings(target_triangles=triangles // 10, threads=2, record=True)
    told = {"progress": _ignore_progress}
    lengths = np.linalg.norm(np.diff(mesh.vertices[mesh.triangles], axis=1), axis=2)
    corners = np.zeros((3 * triangles, 5))
    corners[:, :2] = mesh.vertices[mesh.triangles].reshape(-1, 3)[:, :2]
    sets = np.arange(count, dtype=np.int32)
    image = np.arange(3 * side * side, dtype=np.uint8).reshape(side, side, 3)
    patches = {
        "cosines": (0.9, 0.9, 0.0),
        "bounds": (0.01, 50.0),
        "threads": 2,
    }
    return {
        "compute_side_lengths": partial(
            kernels.compute_side_lengths, mesh.vertices, mesh.triangles, wanted_threads=2
        ),
        "find_intersecting_triangles": partial(
            kernels.find_intersecting_triangles, mesh.vertices, mesh.triangles, wanted_threads=2, **told
        ),
        "find_irregular_elements": partial(
            kernels.find_irregular_elements,
            mesh.vertices,
            mesh.triangles,
            corner_deg=1.0,
            fold_deg=10.0,
            spike_deg=60.0,
            wanted_threads=2,
        ),
        "optimize_strip_order": partial(kernels.optimize_strip_order, mesh.triangles, count),
        "encode_rows": partial(kernels.encode_rows, mesh.vertices.view(np.uint8)),
        "encode_triangles": partial(kernels.encode_triangles, mesh.triangles, count),
        "smooth_boundaries": partial(
            kernels.smooth_boundaries, mesh.vertices, mesh.triangles, max_move_ratio=0.5, wanted_threads=2
        ),
        "refine_surface": partial(_refine_surface, mesh),
        "align_boundaries": partial(_align_boundaries, mesh),
        "compute_spatial_order": partial(kernels.compute_spatial_order, mesh.vertices, mesh.triangles),
        "build_levels": partial(
            kernels.build_levels,
            *soup,
            locked,
            first=float(lengths.mean()) / 100,
            ratio=4.0,
            max_cell_triangles=500,
            root_triangles=100,
            weight=1e-4,
            share=0.9,
            tolerance=(0.05, 0.05),
            effort=1.0,
            single=True,
            running=running,
            **told,
        ),
        "assemble_front": partial(
            kernels.assemble_front,
            mesh.triangles.astype(np.uint32),
            np.zeros(0, np.uint32),
            roots=count,
            start=np.zeros(1, np.int64),
            count=np.full(1, triangles, np.int64),
            below=np.full(1, count, np.int64),
        ),
        "lay_out_atlas": partial(
            kernels.lay_out_atlas,
            mesh.vertices,
            mesh.triangles,
            np.full(triangles, 100.0, np.float32),
            side=512,
            padding=2,
            **told,
        ),
        "rasterize_texels": partial(
            kernels.rasterize_texels,
            corners[:, :2].reshape(-1, 3, 2) * 1000,
            np.zeros(triangles, np.int32),
            page=0,
            width=1024,
            height=1024,
        ),
        "draw_sources": partial(
            kernels.draw_sources,
            (corners[:, :2].reshape(-1, 3, 2) * 1000, labels_of_all, mesh.vertices[mesh.triangles]),
            (corners[:, :2].reshape(-1, 3, 2) * 1000, labels_of_all, mesh.vertices[mesh.triangles]),
            np.full(triangles, np.inf),
            width=1024,
            height=1024,
            wanted_threads=2,
        ),
        "locate_texels": partial(
            kernels.locate_texels,
            corners[:, :2].reshape(-1, 3, 2) * 1000,
            np.zeros(1 << 18, np.int32),
            np.arange(1 << 18, dtype=np.int64),
            width=1024,
            wanted_threads=2,
        ),
        "sample_texels": lambda: kernels.sample_texels(
            np.zeros((1024, 1024, 3), np.uint8),
            np.zeros((1024, 1024), np.int32),
            corners[:, :2].reshape(-1, 3, 2) * 1000,
            np.ascontiguousarray(corners[:, :2].reshape(-1, 3, 2)),
            np.ones(triangles, bool),
            image,
            wrap=("repeat", "clamp"),
            wanted_threads=2,
        ),
        "sample_points": partial(
            kernels.sample_points,
            image,
            np.random.default_rng(1).random((1 << 18, 2)),
            channels=3,
            wrap=("repeat", "mirror"),
            wanted_threads=2,
        ),
        "render_zbuffer": lambda: kernels.MeshRenderer(mesh.vertices, mesh.triangles).render_zbuffer(
            ((800.0, 800.0, 500.0, 500.0, 1000, 1000), np.eye(4)), near=1e-3
        ),
        "weld_sheets": partial(kernels.weld_sheets, sets, mesh.triangles),
        "label_components": partial(
            kernels.label_components, len(mesh.vertices), mesh.triangles[:, 0], mesh.triangles[:, 1]
        ),
        "choose_color_weight": partial(
            kernels.choose_color_weight, *soup, target=triangles // 10, run_trial=True, wanted_threads=2
        ),
        "simplify": partial(
            kernels.simplify,
            *soup,
            locked,
            bounds=(float(lengths.mean()) * 4, np.inf, np.inf),
            scales=(1.0, 1.0, 1.0),
            soft_length=False,
            attribute_scale=1.0,
            paper_rule=False,
            triangle_limit=8 * triangles,
            running=running,
            **told,
        ),
        "simplify_by_quadrics": partial(
            kernels.simplify_by_quadrics, *soup, locked, importance, weight=1e-4, running=running, **told
        ),
        "fit": partial(
            kernels.fit, *soup, locked, *soup, np.arange(count, dtype=np.int32), threads=2, **told
        ),
        "simplify_certified": partial(
            kernels.simplify_certified,
            *soup,
            locked,
            importance,
            bounds=(0.02, 60.0),
            weight=1e-4,
            share=0.8,
            tolerance=(0.1, 0.1),
            effort=1.0,
            close=False,
            running=running,
            **told,
        ),
        "certify": partial(
            kernels.certify,
            soup,
            soup,
            tolerance=(0.1, 0.1),
            absolute_tolerance=(1e-6, 0.1),
            limit=None,
            effort=1.0,
            slack=None,
            threads=2,
            **told,
        ),
        "simplify_planar": partial(
            kernels.simplify_planar, *soup, labels, locked, partial=False, **patches, **told
        ),
        "find_planar_patches": partial(kernels.find_planar_patches, *soup, labels, **patches, **told),
        "simplify_seams": partial(
            kernels.simplify_seams,
            mesh.vertices,
            sets,
            mesh.triangles,
            corners,
            np.ones(triangles, bool),
            np.zeros(triangles, np.int32),
            np.zeros(triangles, np.int32),
            importance,
            np.zeros(count, bool),
            knobs=kernels.SeamWeights(
                material_border_penalty=1.0,
                part_border_penalty=1.0,
                valence_penalty=0.1,
                duplicate_penalty=0.1,
                shape_weight=0.1,
                seam_drift=1.0,
            ),
            fit=True,
            running=running,
            **told,
        ),
        "match_descriptors": partial(
            kernels.match_descriptors,
            *np.tile(image.reshape(2, -1, 1)[:, : side * side], 128),
            max_distance_ratio=0.8,
        ),
        "match_pair": partial(kernels.match_pair, image, image, lowest=0, count=64, wanted_threads=2),
        "sweep_planes": partial(
            kernels.sweep_planes,
            image[..., 0],
            [(image[..., 1], np.ones_like(image[..., 1]), np.eye(3, dtype=np.float32)[[0] * 64])],
            np.zeros(image.shape[:2], np.int32),
            np.full(image.shape[:2], 64, np.uint16),
            planes=64,
            wanted_threads=2,
        ),
        "refine_inverse_depth": partial(
            kernels.refine_inverse_depth,
            image[..., 0],
            [(np.eye(3, 4), image[..., 0])] * 4,
            image[..., 0].astype(np.float32),
            step=1.0,
            wanted_threads=2,
        ),
        "count_supporting_views": partial(
            kernels.count_supporting_views,
            image[..., 0].astype(np.float32),
            [(np.eye(3, 4), image[..., 0].astype(np.float32))] * 4,
            tolerances=(0.01, 0.02),
            min_depth_ratio=0.9,
            wanted_threads=2,
        ),
        "is_inside_all_masks": partial(
            kernels.is_inside_all_masks,
            image[..., 0].astype(np.float32),
            [(np.eye(3, 4), image[..., 0] < 9)] * 4,
            wanted_threads=2,
        ),
        "fuse_depth_maps": partial(
            kernels.fuse_depth_maps,
            image[..., 0].astype(np.float32),
            image[..., 1],
            [(np.eye(3, 4), np.eye(3, 4), image[..., 0].astype(np.float32), image[..., 1])] * 4,
            tolerances=(0.01, 0.02),
            wanted_threads=2,
        ),
        "find_hull_entry": partial(
            kernels.find_hull_entry,
            image[..., 0] < 9,
            [(np.eye(3, 4), image[..., 0] < 9)] * 4,
            min_views=1,
            depth_range=(1.0, 2.0),
            steps=2,
            wanted_threads=2,
        ),
        "compute_weighted_medians": partial(
            kernels.compute_weighted_medians,
            image,
            image[..., 0].astype(np.float32),
            image[..., 0] < 9,
            lowest=0,
            count=256,
            radius=5,
            falloff=8.0,
            wanted_threads=2,
        ),
        "filter_depth": partial(
            kernels.filter_depth,
            np.ones((side, side), np.float32),
            (side, side, side / 2, side / 2, side, side),
            limits=(0.0, np.inf, 0.05, 0.05),
            wanted_threads=2,
        ),
        "find_touched_blocks": partial(_find_touched_blocks, side),
        "integrate": partial(_integrate_wall, side),
        "remesh": partial(_remesh, mesh),
        "remesh_alone": partial(_remesh, mesh, levels=0),
    }


def _ignore_progress(_done: int, _total: int) -> None:
    pass


def _find_touched_blocks(side: int, voxel_size: float = 1e-4) -> NDArray[np.uint64]:
    """Find the blocks of a wall 1 m away whose width is 1 m."""
    flat = np.zeros((side, side), np.float32)
    return kernels.find_touched_blocks(
        _make_wall_camera(side),
        flat + 1,
        (flat, flat, flat - 1),
        flat + 1,
        flat == 0,
        voxel_size=voxel_size,
        truncation=3 * voxel_size,
        within=None,
    )


def _integrate_wall(side: int) -> object:
    volume = kernels.Volume(2e-3, 6e-3, color=True, max_blocks=1 << 20)
    wall = np.ones((side, side), np.float32)
    color = np.zeros((side, side, 3), np.uint8)
    keys = _find_touched_blocks(side, 2e-3)
    for _ in range(3):
        volume.integrate(
            keys, _make_wall_camera(side), wall, wall, color, weighing=(1.0, 1.0, 0.0), wanted_threads=2
        )
    return (
        volume.extract_surface(1, within=None, wanted_threads=2),
        volume.observation_histogram(within=None),
        volume.copy_voxels(),
    )


def _make_wall_camera(side: int) -> tuple[tuple[float, float, float, float, int, int], NDArray[np.float64]]:
    return (side, side, side / 2, side / 2, side, side), np.eye(4)


def _make_refinement_view() -> tuple[
    tuple[tuple[float, float, float, float, int, int], NDArray[np.float64]], NDArray[np.float32]
]:
    pose = np.eye(4)
    pose[2, 3] = -1.0
    return ((100.0, 100.0, 50.0, 50.0, 100, 100), pose), np.ones((100, 100), np.float32)


def _align_boundaries(mesh: Mesh) -> object:
    aligner = kernels.BoundaryAligner(mesh.vertices, mesh.triangles, wanted_threads=2)
    aligner.observe(*_make_refinement_view(), (0.01, 0.0))
    return aligner.finish()


def _refine_surface(mesh: Mesh) -> object:
    refiner = kernels.SurfaceRefiner(mesh.vertices, mesh.triangles, strength=1.0, wanted_threads=2)
    camera, depth = _make_refinement_view()
    refiner.observe(camera, depth, (0.01, 0.0))
    refiner.filter()
    refiner.observe(camera, depth, (0.01, 0.0))
    refiner.correct()
    refiner.flatten()
    return refiner.finish()


def _remesh(mesh: Mesh, levels: int = 3) -> kernels.NormalMesh:
    assert mesh.colors is not None
    return kernels.remesh(
        mesh.vertices,
        mesh.colors,
        np.zeros(0),
        mesh.triangles,
        None,
        levels=levels,
        base_triangles=len(mesh.triangles) // 50 if levels else len(mesh.triangles),
        base_error=0.0,
        ignore_cost_limit=False,
        max_error=0.0,
        butterfly=True,
        relaxations=1,
        tolerance=1e-5,
        color_tolerance=1.0,
        up=None,
        threads=2,
        progress=_ignore_progress,
    )


def _make_in_subprocess(make: Callable[[], bytes]) -> bytes:
    """Compute bytes in another process, so that freed memory is not available to the runs."""
    reading, writing = os.pipe()
    if os.fork() == 0:
        os.close(reading)
        with os.fdopen(writing, "wb") as file:
            file.write(make())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as file:
        data = file.read()
    os.wait()
    return data


def _decode_all_levels(file: bytes) -> object:
    made = kernels.decode_normal_mesh(file, -1)
    level = made.levels
    tables = (made.kinds, made.offsets, made.predicted, made.frames)
    attributes = (made.colors, made.confidence, made.hit_triangle)
    return [table(level) for table in (made.vertices, made.triangles, *attributes, *tables)]


def run_limited(call: Call, *, spare: int = 0, after: float = 0.0) -> str:
    """Run a call in a child process that may grow by `spare` bytes from `after` seconds on.

    Returns the outcome: done, a MemoryError, or the failure.
    """
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        _run_and_exit(call, spare, after)
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    return f"killed by {signal.Signals(-code).name}" if code < 0 else _ENDS.get(code, f"exit code {code}")


def _run_and_exit(call: Call, spare: int, after: float) -> None:
    code = 2
    try:
        if after > 0:
            threading.Thread(target=limit_memory, args=(spare, after), daemon=True).start()
        else:
            limit_memory(spare)
        call()
        code = 0
    except MemoryError:
        code = 1
    finally:
        os._exit(code)


def run_until_done(runs: Mapping[str, Callable[[], str]]) -> dict[str, str]:
    """Run with increasing memory until two consecutive runs are done; a single one may be luck."""
    ends: dict[str, str] = {}
    for name, run in runs.items():
        ends[name] = run()
        if list(ends.values())[-2:] == [DONE, DONE]:
            break
    return ends


def limit_memory(spare: int, after: float = 0.0) -> None:
    """Limit the growth of this process to `spare` bytes from `after` seconds on."""
    time.sleep(after)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (most, most + spare))
    _fill_free_heap()
    resource.setrlimit(resource.RLIMIT_AS, (most + spare, most + spare))


def _fill_free_heap() -> None:
    """Allocate the free blocks of the heap for ever.

    Inputs leave free blocks of 100 MB and more, in which a kernel would find the memory that it is denied.
    """
    for exponent in range(30, MIN_FILLED_EXPONENT - 1, -1):
        with suppress(MemoryError):
            while True:
                _fillings.append(np.empty(1 << exponent, np.uint8))


def main() -> None:
    for line in sys.stdin:
        kernel, side = line.split()
        # A fork per kernel: memory freed by another kernel must not be available.
        child = os.fork()
        if child == 0:
            code = 1
            try:
                _write_outcomes(kernel, int(side))
                code = 0
            finally:
                os._exit(code)
        _, status = os.waitpid(child, 0)
        if status != 0:
            sys.stdout.write(f"{json.dumps({'all': {'all': f'status {status}'}})}\n")
            sys.stdout.flush()


def _write_outcomes(kernel: str, side: int) -> None:
    call = make_kernel_call(kernel, side)
    rising = run_until_done(
        {f"{m} MiB": partial(run_limited, call, spare=m << 20) for m in (*range(0, 260, 20), 1500)}
    )
    late = run_until_done(
        {f"{ms} ms": partial(run_limited, call, after=ms / 1000) for ms in (1, 2, 4, 8, 15, 30, 60, 120, 240)}
    )
    sys.stdout.write(f"{json.dumps({'rising': rising, 'late': late})}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
