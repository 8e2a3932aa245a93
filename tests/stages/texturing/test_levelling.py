"""Levelling of seams between photos, compared with SciPy's solution of the same equation."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve
from wall_photos import paint, photo, pose, wall

from scanloom.stages import _kernels
from scanloom.stages.progress import ignore_progress
from scanloom.stages.surface.vertex_normals import compute_vertex_normals
from scanloom.stages.texturing import photo_painting
from scanloom.stages.texturing.exposure import make_identity_exposure
from scanloom.stages.texturing.photo_sampling import prepare_render_mesh, sample_photos
from scanloom.stages.texturing.photos import load_photos
from scanloom.stages.texturing.seam_visibility import SeamStatistics, sum_neighbour_differences
from scanloom.stages.texturing.texture import texture

SIDE = 120
REACH = 8.0
# Photos that differ more than this from the dominant colour show other content.
ELSE = 40


class SampledWall(NamedTuple):
    """The wall in an image of SIDE × SIDE pixels: covered pixels, photo samples, and blended colours."""

    points: _kernels.SurfacePoints
    pixels: np.ndarray
    colors: np.ndarray

    def levelled(self, threads: int = 1, reach: float = REACH) -> np.ndarray:
        found = self.colors.copy()
        self.points.level_seams(found, self.pixels, width=SIDE, reach=reach, wanted_threads=threads)
        return found


def sample_wall(offsets: list[float], there: np.ndarray | None = None) -> SampledWall:
    """Sample photos of parts of the wall with brightness offsets, at a mask of pixels (SIDE, SIDE)."""
    there = np.ones((SIDE, SIDE), bool) if there is None else there
    places = [(x, y) for x in (0.25, 0.5, 0.75) for y in (0.3, 0.7)]
    frames = [photo(n, pose(x, y, z=-0.9)) for n, (x, y) in enumerate(places[: len(offsets)])]
    frames = [
        replace(one, color=(np.array(one.color, float) + offset).clip(1, 254).astype(np.uint8))
        for one, offset in zip(frames, offsets, strict=True)
    ]
    mesh = wall(1)
    rows, columns = np.nonzero(there)
    x, y = (columns + 0.5) / SIDE, (rows + 0.5) / SIDE
    # The triangles of the cell are (0, 2, 1) and (1, 2, 3) of its corners (0, 0), (1, 0), (0, 1), (1, 1).
    is_second = x + y > 1
    shares = np.where(
        is_second[:, None], np.stack([1 - y, 1 - x, x + y - 1], 1), np.stack([1 - x - y, y, x], 1)
    )
    order = np.argsort(is_second, kind="stable")
    points = _kernels.SurfacePoints(
        mesh.vertices,
        compute_vertex_normals(mesh),
        mesh.triangles,
        is_second[order].astype(np.uint32),
        shares[order].astype(np.float32),
        samples_per_point=2,
    )
    used = load_photos(frames, ignore_progress)
    used = replace(used, weights=np.ones(len(used)))
    sample_photos(
        points, prepare_render_mesh(mesh), used, [make_identity_exposure()] * len(used), None, lambda: None
    )
    colors, _, _ = points.blend(blurred=1, details=1, deviations=50, levels=255, wanted_threads=1)
    return SampledWall(points, (rows * SIDE + columns)[order].astype(np.uint32), colors)


def list_pairs(pixels: np.ndarray) -> np.ndarray:
    """List pairs of points in horizontally or vertically adjacent pixels (k, 2)."""
    at = np.full(SIDE * SIDE, -1)
    at[pixels] = np.arange(len(pixels))
    at = at.reshape(SIDE, SIDE)
    beside = [np.stack([a.ravel(), b.ravel()], 1) for a, b in ((at[:, :-1], at[:, 1:]), (at[:-1], at[1:]))]
    both = np.concatenate(beside)
    return both[(both >= 0).all(axis=1)]


def find_changes(one: SampledWall) -> tuple[np.ndarray, np.ndarray]:
    """List the pairs, and mask the pairs with different sets of photos."""
    views = np.sort(one.points.samples()[0], axis=1)
    found = list_pairs(one.pixels)
    return found, (views[found[:, 0]] != views[found[:, 1]]).any(axis=1)


def solve_equation(one: SampledWall, reach: float) -> np.ndarray:
    """Solve the documented equation with SciPy."""
    views, colors, scores = one.points.samples()
    matrix = sparse.lil_matrix((len(one.pixels), len(one.pixels)))
    right = np.zeros((len(one.pixels), 3))
    for (a, b), differs in zip(*find_changes(one), strict=True):
        wanted = np.zeros(3)
        if (views[a] < 0).all() or (views[b] < 0).all():
            continue
        if differs:
            common = [
                (min(scores[a, i], scores[b, j]), colors[a, i].astype(float), colors[b, j].astype(float))
                for i in range(views.shape[1])
                for j in range(views.shape[1])
                if views[a, i] == views[b, j] >= 0
                and np.abs(colors[a, i] - one.colors[a]).max() <= ELSE
                and np.abs(colors[b, j] - one.colors[b]).max() <= ELSE
            ]
            if not common:
                continue
            total = sum(weight for weight, _, _ in common)
            wanted = sum(weight * (here - there) for weight, here, there in common) / total
            wanted = wanted - (one.colors[a] - one.colors[b])
        for i, sign in ((a, 1), (b, -1)):
            matrix[i, i] += 1
            right[i] += sign * wanted
        matrix[a, b] -= 1
        matrix[b, a] -= 1
    matrix.setdiag(matrix.diagonal() + 1 / reach**2)
    solution = np.stack([spsolve(matrix.tocsr(), right[:, k]) for k in range(3)], axis=1)
    return np.asarray((one.colors + solution).clip(0, 255))


OFFSETS = [8.0, -8.0, 5.0, -6.0, 9.0, -3.0]


def test_levelling_solves_its_equation():
    rng = np.random.default_rng(4)
    there = rng.random((SIDE, SIDE)) > 0.03
    there[:, 70:73] = False
    one = sample_wall(OFFSETS, there)
    found, wanted = one.levelled(), solve_equation(one, REACH)
    by = np.abs(wanted - one.colors).max()
    assert by > 3
    # The kernel uses a few multigrid sweeps instead of an exact solution.
    assert np.abs(found - wanted).max() < 0.03 * by
    assert np.sqrt(np.mean((found - wanted) ** 2)) < 0.03 * np.sqrt(np.mean((wanted - one.colors) ** 2))


def test_levelled_seams_are_hardly_visible():
    one = sample_wall(OFFSETS)
    at, differ = find_changes(one)
    assert 0.005 < differ.mean() < 0.3

    def ratio(colors: np.ndarray) -> float:
        apart = np.abs(colors[at[:, 0]] - colors[at[:, 1]]).mean(axis=1)
        return float(apart[differ].mean() / apart[~differ].mean())

    assert (one.points.samples()[0][:, 0] >= 0).all()
    truth = paint(*((np.stack([one.pixels % SIDE, one.pixels // SIDE]) + 0.5) / SIDE)).astype(np.float32)
    before, after, there = ratio(one.colors), ratio(one.levelled()), ratio(truth)
    assert before > 1.3 * there
    assert after < there + 0.25 * (before - there)
    off = [np.abs(colors - truth).mean() for colors in (one.colors, one.levelled())]
    assert off[1] < off[0] + 0.1


def get_labels(one: SampledWall) -> np.ndarray:
    return one.points.blend(blurred=1, details=1, deviations=50, levels=255, wanted_threads=1)[1]


def test_neighbours_are_sampled_from_the_dominant_photo():
    one = sample_wall(OFFSETS, np.random.default_rng(3).random((SIDE, SIDE)) < 0.7)
    labels = get_labels(one)
    pairs_found, shown = one.points.collect_neighbours(labels, one.pixels, width=SIDE, row_step=3)
    views, colors, scores = one.points.samples()
    wanted = {}
    for a, b in list_pairs(one.pixels):
        if one.pixels[a] // SIDE % 3:
            continue
        for label in (labels[a], labels[b]):
            here, there = (np.flatnonzero((views[n] == label) & (scores[n] > 0)) for n in (a, b))
            if len(here) and len(there):
                wanted[(a, b)] = [colors[a, here[0]].tolist(), colors[b, there[0]].tolist()]
                break
    assert len(wanted) > 1000
    assert {tuple(pair): both.tolist() for pair, both in zip(pairs_found, shown, strict=True)} == wanted


def test_neighbour_arguments_must_match_the_points():
    one = sample_wall(OFFSETS[:1])
    labels = get_labels(one)
    for wrong in (
        {"labels": labels[1:]},
        {"pixels": one.pixels[1:]},
        {"width": 0},
        {"row_step": 0},
    ):
        given = {"labels": labels, "pixels": one.pixels, "width": SIDE, "row_step": 1, **wrong}
        with pytest.raises(ValueError, match="do not match the points"):
            one.points.collect_neighbours(given.pop("labels"), given.pop("pixels"), **given)


def test_blended_seams_are_as_strong_as_photo_edges_and_unblended_ones_stronger():
    one = sample_wall([4.0 * offset for offset in OFFSETS])
    labels = get_labels(one)

    def over_photos(colors: np.ndarray) -> float:
        sums, image, label = (
            SeamStatistics(),
            np.zeros((SIDE * SIDE, 3), np.float32),
            np.full(SIDE * SIDE, -1),
        )
        image[one.pixels], label[one.pixels] = colors, labels
        beside = sum_neighbour_differences(one.points, colors, labels, one.pixels, SIDE)
        sums.add(image.reshape(SIDE, SIDE, 3), label.reshape(SIDE, SIDE).astype(np.int32), beside)
        return sums.compute_ratio_over_photos()

    # A single photo per point, without blending, so that exposure differences are visible.
    views, shown, _ = one.points.samples()
    alone = shown[np.arange(len(labels)), (views == labels[:, None]).argmax(axis=1)].astype(np.float32)
    assert over_photos(alone) > 1.15
    assert over_photos(one.levelled()) == pytest.approx(1, abs=0.1)


def test_without_seams_there_is_no_ratio():
    sums = SeamStatistics()
    sums.add(np.zeros((20, 20, 3), np.float32), np.zeros((20, 20), np.int32), np.zeros((2, 2)))
    assert sums.compute_ratio_over_photos() is None


def test_pixels_with_equal_photos_are_unchanged():
    one = sample_wall([8.0])
    assert np.array_equal(one.levelled(), one.colors)


def test_consistent_photos_are_hardly_changed():
    one = sample_wall([0.0] * 6)
    assert np.abs(one.levelled() - one.colors).max() < 2


def test_nothing_is_levelled_across_a_gap():
    there = np.ones((SIDE, SIDE), bool)
    there[:, 60] = False
    both, left = sample_wall(OFFSETS, there), sample_wall(OFFSETS, there & (np.arange(SIDE) < 60))
    at = {pixel: i for i, pixel in enumerate(both.pixels)}
    same = np.array([at[pixel] for pixel in left.pixels])
    assert np.array_equal(both.colors[same], left.colors)
    # Coarse cells have the same positions in both.
    np.testing.assert_allclose(both.levelled()[same], left.levelled(), atol=0.3)


@pytest.mark.parametrize("threads", [2, 5])
def test_results_do_not_depend_on_the_number_of_threads(threads: int):
    one = sample_wall(OFFSETS)
    assert np.array_equal(one.levelled(), one.levelled(threads))


@pytest.mark.parametrize("named", [{"width": 0}, {"reach": 0.0}, {"reach": float("nan")}, {"reach": 1e9}])
def test_invalid_arguments_are_refused(named: dict[str, float]):
    one = sample_wall([0.0])
    given = {"width": SIDE, "reach": REACH, "wanted_threads": 1} | named
    with pytest.raises(ValueError, match="do not match"):
        one.points.level_seams(one.colors, one.pixels, **given)


def test_each_point_needs_a_pixel():
    one = sample_wall([0.0])
    for pixels in (one.pixels[:-1], np.full_like(one.pixels, 2**32 - 1)):
        with pytest.raises(ValueError, match="do not match"):
            one.points.level_seams(one.colors, pixels, width=SIDE, reach=REACH, wanted_threads=1)


def test_levelling_reduces_seams_of_a_texture(monkeypatch: pytest.MonkeyPatch):
    # An occluder at a different position in each photo makes photo borders everywhere.
    rng = np.random.default_rng(2)
    frames = []
    for number, (x, y) in enumerate(rng.uniform(0.3, 0.7, (8, 2))):
        one = photo(number, pose(x, y, z=-0.5))
        color, depth = np.array(one.color), np.array(one.depth)
        left, top = rng.integers(20, 100), rng.integers(20, 70)
        color[top : top + 40, left : left + 40] = (200, 40, 40)
        depth[top : top + 40, left : left + 40] = 0.2
        light = np.where(color > 0, color.astype(float) + rng.uniform(-25, 25), 0)
        frames.append(replace(one, color=np.rint(light).clip(0, 254).astype(np.uint8), depth=depth))
    levelled = texture(wall(), frames, format="png", exposure=False, alignment_iterations=0)
    monkeypatch.setattr(photo_painting, "level_seams", lambda *_: None)
    without = texture(wall(), frames, format="png", exposure=False, alignment_iterations=0)
    assert without.seam_ratio > 1.5
    assert levelled.seam_ratio < 1 + 0.5 * (without.seam_ratio - 1)
