"""Random meshes through a kernel, and rules for the result."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import numpy as np

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.comparing.certify import certify
from scanloom.stages.normal_meshes.normal_mesh import decode
from scanloom.stages.normal_meshes.remesh import remesh
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from tests.campaign.kernel_rules import (
    assert_same_bytes,
    assert_sound,
    count_border_edges,
    measure_sampled_distance,
)
from tests.campaign.random_meshes import CLOSED, make_random_mesh


def run_kernel_case(seed: int) -> str:
    """Run the case of a seed and describe the result.

    Raises
    ------
    ScanloomError
        If the kernel refuses the mesh.
    AssertionError
        If a rule is broken.
    """
    draw = random.Random(seed)
    kind, mesh = make_random_mesh(draw)
    name = draw.choice(("simplify", "simplify", "simplify", "remesh", "clean", "certify"))
    return f"{name} of {kind}: {_CASES[name](mesh, kind in CLOSED, draw)}"


def _compute_diagonal(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))


def _check_simplify(mesh: Mesh, closed: bool, draw: random.Random) -> str:
    method = draw.choice(("auto", "quadric", "certified", "certified", "seams", "jia01", "planar"))
    changes: dict[str, Any] = {"method": method}
    needs_count = method in ("quadric", "seams")
    if needs_count or (method != "planar" and draw.random() < 0.5):
        changes["ratio"] = draw.choice((1.0, 0.7, 0.3, 0.05, 0.001))
    if method == "certified" or (not needs_count and draw.random() < 0.7):
        changes["max_shape"] = _compute_diagonal(mesh) * draw.choice((1e-6, 1e-3, 0.01, 0.1, 2.0))
    if not needs_count and draw.random() < 0.4 and mesh.colors is not None:
        changes["max_color"] = draw.choice((0.5, 5.0, 30.0, 500.0))
    if method in ("quadric", "certified", "jia01") and draw.random() < 0.2:
        changes["lock"] = [draw.randrange(len(mesh.vertices)) for _ in range(3)]
    if draw.random() < 0.2 and method in ("quadric", "seams", "jia01"):
        changes["record"] = True
    found = simplify(mesh, threads=1, **changes)
    light = found.mesh
    assert_sound(light)
    assert_same_bytes(light, simplify(mesh, threads=2, **changes).mesh)
    assert len(light.triangles) <= len(mesh.triangles), "more triangles than before"
    if closed:
        assert count_border_edges(light) == 0, "a closed mesh got a boundary"
    for source, most in ((found.vertex_source, mesh.vertices), (found.triangle_source, mesh.triangles)):
        assert source.size == 0 or 0 <= source.min() <= source.max() < len(most), "a source is out of range"
    if found.method == "certified" and len(light.triangles) > 0:
        _assert_within(light, mesh, found.details.shape_bound_m, draw)
        if found.details.proven and "max_shape" in changes:
            # Bounds contain twice the slack of single-precision searches.
            most = max(changes["max_shape"], 2 * found.details.slack_m)
            assert found.details.shape_bound_m <= most * (1 + 1e-9), "a proven bound exceeds the limit"
    if found.record is not None:
        assert_sound(found.record.replay(ratio=0.5).mesh)
    return f"{changes} {found.stopped_by} {light!r}"


def _check_remesh(mesh: Mesh, closed: bool, draw: random.Random) -> str:
    changes: dict[str, Any] = {"levels": draw.choice((1, 2, 3)), "base_triangles": draw.choice((8, 40, 200))}
    if draw.random() < 0.3:
        changes["scheme"] = "butterfly"
    found = remesh(mesh, threads=1, **changes)
    again = remesh(mesh, threads=2, **changes)
    assert found.data == again.data, "the file depends on the thread count"
    read = decode(found.data)
    assert len(read.levels) == len(found.levels), "the file has other levels"
    for made, held in zip(found.levels, read.levels, strict=True):
        assert_sound(made)
        assert_same_bytes(made.with_(diagnostics=()), held.with_(diagnostics=()))
        if closed:
            assert count_border_edges(made) == 0, "a closed mesh got a boundary"
    return repr(found)


def _check_clean(mesh: Mesh, closed: bool, draw: random.Random) -> str:
    changes: dict[str, Any] = {"stitch": draw.random() < 0.7, "keep_largest": draw.random() < 0.2}
    if draw.random() < 0.5:
        changes["fill_holes"] = _compute_diagonal(mesh) * draw.choice((0.01, 0.5, 10.0))
    if draw.random() < 0.2:
        changes["weld_distance"] = _compute_diagonal(mesh) * draw.choice((1e-6, 1e-2))
    found = clean(mesh, **changes).mesh
    assert_sound(found)
    assert_same_bytes(found, clean(mesh, **changes).mesh)
    if closed and "weld_distance" not in changes:
        assert count_border_edges(found) == 0, "a closed mesh got a boundary"
    return repr(found)


def _check_certify(mesh: Mesh, closed: bool, draw: random.Random) -> str:  # noqa: ARG001
    rng = np.random.default_rng(draw.randrange(2**32))
    moved = mesh.with_(
        vertices=mesh.vertices
        + rng.normal(0, _compute_diagonal(mesh) * draw.choice((0, 1e-6, 1e-3, 0.1)), mesh.vertices.shape)
    )
    changes: dict[str, Any] = {"effort": draw.choice((0.0, 1.0, 16.0))}
    if draw.random() < 0.3:
        changes["max_shape"] = _compute_diagonal(mesh) * draw.choice((1e-4, 0.05))
        changes["check_only"] = draw.random() < 0.5
    found, again = (certify(moved, mesh, threads=threads, **changes) for threads in (1, 2))
    assert found.to_dict() == again.to_dict(), "the bounds depend on the thread count"
    _assert_within(moved, mesh, found.shape_bound_m, draw, lines=True)
    if changes.get("max_shape") is not None and found.within_limits:
        _assert_within(moved, mesh, max(changes["max_shape"], 2 * found.slack_m), draw, lines=True)
    return f"{changes} {found!r}"


def _assert_within(
    light: Mesh, mesh: Mesh, bound: float, draw: random.Random, *, lines: bool = False
) -> None:
    rng = np.random.default_rng(draw.randrange(2**32))
    # Rounding error of the comparison itself, which is in double precision.
    least = 1e-12 * max(float(np.abs(mesh.vertices).max()), _compute_diagonal(mesh))
    for a, b in ((light, mesh), (mesh, light)):
        found = measure_sampled_distance(a, b, rng, lines=lines)
        assert found <= bound + least, f"{found!r} m apart, beyond the proven {bound!r} m"


_CASES: dict[str, Callable[[Mesh, bool, random.Random], str]] = {
    "simplify": _check_simplify,
    "remesh": _check_remesh,
    "clean": _check_clean,
    "certify": _check_certify,
}
