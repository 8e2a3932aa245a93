"""A looser bound never leaves method planar more triangles, as tighter ones are tried too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from partial_meshes import select_quarter

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.simplification.planar.bound_search import estimate_min_patches, search_fewest_triangles
from scanloom.stages.simplification.planar.run import planar_patches
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh

BENCHES = Path(__file__).resolve().parents[4] / "benches"
KITCHEN = (
    Path(__file__).resolve().parents[5] / "shared" / "data" / "meshes" / "redkitchen_fused_vertexcolor.ply"
)
# Of the diagonal.
LADDER = np.geomspace(1e-6, 1e-1, 10)


def chamfered_box(cuts: int) -> Mesh:
    """A cube of 2 m, edges and corners cut off by 0.1 m: 26 flat faces, triangles cut so often in four."""
    signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).T.reshape(-1, 3)
    corners = np.concatenate([signs * (1 - 0.1 * (np.arange(3) != axis)) for axis in range(3)])
    made = trimesh.convex.convex_hull(corners)
    for _ in range(cuts):
        made = made.subdivide()
    return Mesh(np.array(made.vertices), np.array(made.faces, np.int32))


def revolved(name: str, monkeypatch: pytest.MonkeyPatch) -> Mesh:
    monkeypatch.syspath_prepend(str(BENCHES))
    from surfaces_of_revolution import REDUCTIONS

    made: Mesh = REDUCTIONS[name][0]()
    return made


def diagonal(mesh: Mesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))


def at(mesh: Mesh, part: float) -> SimplificationResult:
    return simplify(mesh, method="planar", max_shape=part * diagonal(mesh))


def triangles_left(mesh: Mesh, ladder: NDArray[np.float64] = LADDER) -> NDArray[np.float64]:
    return np.array([len(at(mesh, part).mesh.triangles) for part in ladder], float)


def most_above_tighter(left: NDArray[np.float64]) -> float:
    """How many times as many triangles a bound leaves as the best of those that are tighter."""
    return float((left / np.minimum.accumulate(left)).max())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cone", "cup", "bottle"])
def test_a_looser_bound_leaves_no_more_of_what_is_round(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert most_above_tighter(triangles_left(revolved(name, monkeypatch))) == 1


def test_a_looser_bound_leaves_no_more_of_a_box() -> None:
    left = triangles_left(chamfered_box(3))
    assert most_above_tighter(left) == 1
    # All faces, and at last the six alone.
    assert (left[0], left[-1]) == (44, 12)


@pytest.mark.slow
def test_bounds_side_by_side_leave_hardly_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the very bound that was asked for finds may be missed by one just above it; it was 1.13 times."""
    left = triangles_left(revolved("bottle", monkeypatch), np.geomspace(1.8e-3, 2.7e-3, 6))
    assert most_above_tighter(left) <= 1.1


def test_a_cone_keeps_its_sectors_whatever_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """119 vertices stayed at a thousandth of the diagonal, and 41 at a hundredth of that."""
    mesh = revolved("cone", monkeypatch)
    tight, loose = at(mesh, 1e-5), at(mesh, 1e-3)
    assert len(loose.mesh.vertices) == len(tight.mesh.vertices) == 41
    # What is told is what the result has; what was asked for stays what it was.
    assert loose.details.max_shape_m == 1e-3 * diagonal(mesh)
    assert loose.details.shape_bound_m < 1e-5 * diagonal(mesh)
    assert loose.details.patches.count == 40
    assert loose.details.patch_shape_m <= 1e-5 * diagonal(mesh)


def test_the_patches_are_those_of_the_bound_that_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = revolved("bottle", monkeypatch)
    details = at(mesh, 2.2e-3).details
    assert details.patch_shape_m < details.max_shape_m
    found = planar_patches(mesh, max_shape=details.patch_shape_m)
    assert np.array_equal(found.triangle_patch, details.patches.triangle_patch)


@pytest.mark.slow
def test_a_looser_bound_leaves_no_more_of_fine_flat_faces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Too many triangles to try all bounds: the tightest is tried still, as the faces are flat."""
    cone = revolved("cone", monkeypatch)
    finer = trimesh.Trimesh(cone.vertices, cone.triangles, process=False).subdivide().subdivide()
    mesh = Mesh(np.array(finer.vertices), np.array(finer.faces, np.int32))
    assert most_above_tighter(triangles_left(mesh)) == 1
    assert most_above_tighter(triangles_left(chamfered_box(5))) == 1


@pytest.mark.slow
@pytest.mark.skipif(not KITCHEN.exists(), reason="the public scans are not here")
def test_a_looser_bound_leaves_hardly_more_of_a_room() -> None:
    """With 2.8 % of the diagonal there was an eighth more than with 0.8 %."""
    room = clean(select_quarter(read_mesh(KITCHEN))).mesh
    assert most_above_tighter(triangles_left(room)) <= 1.03


def test_a_tighter_bound_is_the_same_on_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = revolved("cone", monkeypatch)
    shape = 1e-3 * diagonal(mesh)
    one, three = (simplify(mesh, method="planar", max_shape=shape, threads=threads) for threads in (1, 3))
    assert one.mesh.triangles.tobytes() == three.mesh.triangles.tobytes()
    assert one.vertex_source.tobytes() == three.vertex_source.tobytes()


@dataclass
class Made:
    """Stands for what the kernel makes."""

    triangles: NDArray[np.int32]
    bounds: NDArray[np.float64]
    is_partial: bool = False


def tried(
    left: Callable[[float], int],
    *,
    of: int,
    partial_at: int | None = None,
    progress: Progress = ignore_progress,
) -> tuple[list[float], Made, bool]:
    """Return the bounds tried, asked for 0.1 on triangles with no edge in common, and what came of it."""
    bounds: list[float] = []

    def simplified(bound: float, progress: Progress) -> Made:
        for done in range(0, 101, 10):
            progress(done, 100)
        bounds.append(bound)
        made = np.zeros((left(bound), 3), np.int32)
        return Made(made, np.array([[bound, 0.0]]), len(bounds) == partial_at)

    fewest = search_fewest_triangles(
        simplified,
        vertices=np.zeros((3 * of, 3)),
        triangles=np.arange(3 * of, dtype=np.int32).reshape(-1, 3),
        max_shape=0.1,
        diagonal=1.0,
        progress=progress,
    )
    assert fewest.max_shape == fewest.result.bounds[0, 0]
    return bounds, fewest.result, fewest.is_partial


def test_small_meshes_try_all_bounds_and_large_ones_stop_where_it_gets_worse() -> None:
    def worse(bound: float) -> int:
        return int(100 - 100 * np.log2(bound))

    small, large = tried(worse, of=8000)[0], tried(worse, of=9000)[0]
    assert small == sorted(small, reverse=True)
    assert (small[0], small[-1]) == (0.1, 2**-20)
    assert large == [0.1, 2**-4, 2**-5, 2**-6, 2**-7]


def test_of_as_many_triangles_the_tightest_is_taken() -> None:
    bounds, fewest, _ = tried(lambda bound: 100 if bound > 2**-12 else 101, of=1000)
    assert fewest.bounds[0, 0] == 2**-11
    assert len(bounds) > 20


def test_nothing_is_tried_any_more_where_all_stays_or_enough_was_said() -> None:
    assert tried(lambda _: 1000, of=1000)[0] == [0.1]
    bounds, fewest, is_partial = tried(lambda bound: 50 if bound == 0.1 else 60, of=1000, partial_at=2)
    assert (len(bounds), len(fewest.triangles), is_partial) == (2, 50, True)


def test_progress_of_all_of_them_goes_on_and_not_beyond_its_end() -> None:
    seen: list[tuple[int, int]] = []
    tried(lambda _: 10, of=1000, progress=lambda done, total: seen.append((done, total)))
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    assert {total for _, total in seen} == {100}
    assert 50 < seen[-1][0] <= 100


def test_enough_said_to_the_whole_is_said_to_the_part() -> None:
    answers: list[object] = []

    def simplified(_: float, progress: Progress) -> Made:
        answers.append(progress(1, 2))
        return Made(np.zeros((1, 3), np.int32), np.zeros((1, 2)), True)

    search_fewest_triangles(
        simplified,
        vertices=np.zeros((3, 3)),
        triangles=np.array([[0, 1, 2]], np.int32),
        max_shape=1.0,
        diagonal=1.0,
        progress=lambda *_: False,
    )
    assert answers == [False]


def test_flat_faces_need_few_patches_and_noise_one_a_triangle() -> None:
    box = chamfered_box(4)
    assert estimate_min_patches(box.vertices, box.triangles, 1e-6) < 0.1 * len(box.triangles)
    noise = np.random.default_rng(0).normal(0, 1e-3, box.vertices.shape)
    assert estimate_min_patches(box.vertices + noise, box.triangles, 1e-6) > 0.9 * len(box.triangles)
    assert estimate_min_patches(np.zeros((0, 3)), np.zeros((0, 3), np.int32), 1.0) == 0
