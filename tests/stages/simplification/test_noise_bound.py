"""Default bound of scanned surfaces: twice the standard deviation of each vertex."""

import numpy as np
import pytest

from scanloom import Mesh, UsageError, simplify
from scanloom.stages.simplification.noise_bound import derive_noise_bound
from scanloom.stages.surface.raycasting import RaycastingSurface

SIDE = 81


def make_noisy_square(seed: int) -> tuple[Mesh, np.ndarray]:
    """Make a coloured square of 1 m, whose right part is ten times as noisy as its left part."""
    rng = np.random.default_rng(seed)
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 1, SIDE), np.linspace(0, 1, SIDE)))
    deviations = np.where(x < 0.4, 0.0005, 0.005)
    z = 0.02 * np.sin(9 * x) + deviations * rng.uniform(-1, 1, len(x))
    corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    triangles = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + SIDE + 1], axis=1),
            np.stack([corner, corner + SIDE + 1, corner + SIDE], axis=1),
        ]
    ).astype(np.int32)
    colors = rng.integers(0, 256, (len(x), 3), np.uint8)
    return Mesh(np.stack([x, y, z], axis=1), triangles, colors), deviations


def test_the_median_gives_the_bound_and_smaller_deviations_an_importance() -> None:
    bound, importance = derive_noise_bound(np.repeat([0.001, 0.004, 0.02], [30, 40, 30]), 2.0)
    assert bound == pytest.approx(0.008)
    assert importance == pytest.approx(np.repeat([4.0, 1.0, 1.0], [30, 40, 30]))


def test_vertices_without_a_deviation_get_the_smallest_one() -> None:
    deviations = np.concatenate([[0.0], np.full(20, 0.001), np.full(79, 0.002)])
    bound, importance = derive_noise_bound(deviations, 2.0)
    assert bound == pytest.approx(0.004)
    assert importance[0] == importance.max() == pytest.approx(2.0)


@pytest.mark.parametrize("seed", range(3))
def test_every_vertex_stays_within_its_noise(seed: int) -> None:
    mesh, deviations = make_noisy_square(seed)
    found = simplify(mesh, deviations=deviations, attribute_scale=0)
    assert found.method == "certified"
    assert found.default_max_shape == pytest.approx(0.01)
    assert found.details.proven
    assert found.details.shape_bound_m <= 0.01
    assert found.details.color_bound_levels is None
    distances = RaycastingSurface(found.mesh).find_closest_points(mesh.vertices).distances
    assert (distances <= 2 * deviations).all()
    left = mesh.vertices[:, 0] < 0.4
    assert distances[~left].max() > 2 * deviations[left].max()
    assert len(found.mesh.triangles) < len(mesh.triangles) / 20


def test_a_larger_factor_leaves_fewer_triangles() -> None:
    mesh, deviations = make_noisy_square(0)
    found = [
        simplify(mesh, deviations=deviations, attribute_scale=0, noise_factor=factor)
        for factor in (1.0, 2.0, 3.0)
    ]
    assert [one.default_max_shape for one in found] == pytest.approx([0.005, 0.01, 0.015])
    counts = [len(one.mesh.triangles) for one in found]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[2]


def test_a_target_replaces_the_default_bound() -> None:
    mesh, deviations = make_noisy_square(0)
    given = simplify(mesh, deviations=deviations, ratio=0.5)
    assert given.default_max_shape is None
    assert np.array_equal(given.mesh.vertices, simplify(mesh, ratio=0.5).mesh.vertices)


@pytest.mark.parametrize("deviations", [np.ones(3), np.zeros(SIDE**2), np.full(SIDE**2, np.nan)])
def test_deviations_must_fit_the_mesh(deviations: np.ndarray) -> None:
    with pytest.raises(UsageError, match="deviations must be one finite number for each of the"):
        simplify(make_noisy_square(0)[0], deviations=deviations)
