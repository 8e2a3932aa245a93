"""Regularised fusion on fields with known answers."""

import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.optimize
import scipy.spatial
from small_scans import write_small_scan

import scanloom
from scanloom.stages.surface.mesh import Mesh

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))
from peers.data_terms import Histograms, SquaredDifferences
from peers.regularised_fusion import (
    REGULARISERS,
    MeasuredBand,
    extract_mesh,
    find_band,
    fuse_regularised,
    measure_band,
)
from peers.total_variation import VoxelOperators, minimise


def make_grid(*size: int) -> np.ndarray:
    return np.stack(np.unravel_index(np.arange(np.prod(size)), size), axis=1).astype(np.int32)


def make_histograms(field: np.ndarray, count: int, noise: float) -> Histograms:
    """Make histograms with one bin per measurement, so that the median is exact."""
    values = field + np.random.default_rng(0).normal(0, noise, (count, len(field)))
    return Histograms(np.sort(values, axis=0).astype(np.float32), np.ones_like(values, np.float32))


@pytest.mark.parametrize("is_robust", [True, False])
def test_the_proximal_step_is_the_minimum(is_robust: bool):
    rng = np.random.default_rng(0)
    levels = np.sort(rng.uniform(-2, 2, (5, 300)), axis=0).astype(np.float32)
    weights = (rng.uniform(0, 3, levels.shape) * (rng.random(levels.shape) < 0.7)).astype(np.float32)
    field = rng.normal(0, 2, 300).astype(np.float32)

    histograms = Histograms(levels, weights)
    histograms.weights[0] += 0.01
    data = histograms if is_robust else SquaredDifferences.from_histograms(histograms)
    found = data.apply_proximal(field, 0.3)

    costs = (found - field) ** 2 / 2
    candidates = np.linspace(-8, 8, 801)
    for k in range(0, 300, 15):
        at = Histograms(levels[:, [k]], weights[:, [k]])
        single = at if is_robust else SquaredDifferences.from_histograms(at)
        values = [
            (c - field[k]) ** 2 / 2 + 0.3 * single.compute_cost(c) for c in candidates.astype(np.float32)
        ]
        assert costs[k] + 0.3 * single.compute_cost(found[[k]]) <= min(values) + 1e-5


def test_operators_are_differences_within_the_field():
    # Leave out one voxel.
    positions = np.delete(make_grid(4, 3, 3), 13, axis=0)
    operators = VoxelOperators(positions[::-1] - 7)
    x, y, z = (positions[::-1] - 7).astype(np.float32).T
    field = 2 * x - y + 3 * z
    found = (operators.gradient @ field).reshape(3, -1)
    for axis, slope in enumerate((2, -1, 3)):
        np.testing.assert_allclose(found[axis], slope * operators.has_next[axis], atol=1e-5)
    # Two planes of 4 × 3 gaps of each kind, minus the two at the missing voxel.
    assert operators.has_next.sum(axis=1).tolist() == [27 - 2, 24 - 2, 24 - 2]

    # A rotation has no symmetrised gradient where all differences exist.
    turning = np.stack([-y, x, 0 * z]).ravel()
    bends = (operators.symmetrised @ turning).reshape(6, -1)
    inner = [(positions[::-1] == at).all(axis=1).argmax() for at in ((2, 1, 2), (3, 2, 2))]
    assert np.abs(bends[:, inner]).max() < 1e-5
    stretching = np.stack([x, 2 * x, 0 * x]).ravel()
    bends = (operators.symmetrised @ stretching).reshape(6, -1)
    np.testing.assert_allclose(bends[:, inner[1]], (1, 0, 0, 2**0.5, 0, 0), atol=1e-5)


def solve_line(histograms: Histograms, data_weight: float, order: int) -> float:
    """Compute the minimum energy on a line of voxels by linear programming."""
    bins, count = histograms.levels.shape
    forward, none = np.diff(np.eye(count), axis=0), np.zeros((count - 1, count))
    slopes, bends = (np.eye(count)[:-1], forward) if order == 2 else (none, none)
    # The energy is a weighted sum of absolute values of affine functions of field and slopes.
    factors = np.block(
        [
            [forward, -slopes],
            [none, bends],
            [np.tile(np.eye(count), (bins, 1)), np.zeros((bins * count, count))],
        ]
    )
    offsets = np.concatenate([np.zeros(2 * count - 2), histograms.levels.ravel()])
    weights = np.concatenate(
        [np.ones(count - 1), np.full(count - 1, 2.0), data_weight * histograms.weights.ravel()]
    )
    bound = -np.eye(len(offsets))
    found = scipy.optimize.linprog(
        np.concatenate([np.zeros(2 * count), weights]),
        np.block([[factors, bound], [-factors, bound]]),
        np.concatenate([offsets, -offsets]),
        bounds=(None, None),
    )
    assert found.status == 0
    return float(found.fun)


@pytest.mark.parametrize("order", [1, 2])
def test_the_minimum_on_a_line_equals_linear_programming(order: int):
    x = np.arange(24.0)
    histograms = make_histograms(np.where(x < 10, 0.5 * x, 8 - 0.3 * x), 3, 1.0)
    energies: list[float] = []

    minimise(
        VoxelOperators(make_grid(24, 1, 1)), histograms, 0.3, order=order, iterations=3000, energies=energies
    )

    best = solve_line(histograms, 0.3, order)
    assert energies[-1] == pytest.approx(best, rel=2e-3)
    assert energies[0] > 1.1 * best


@pytest.mark.parametrize("order", [1, 2])
def test_the_energy_decreases(order: int):
    positions = make_grid(16, 16, 16)
    radii = np.linalg.norm(positions - 7.5, axis=1)
    energies: list[float] = []

    minimise(
        VoxelOperators(positions),
        make_histograms(radii - 5, 5, 0.5),
        0.3,
        order=order,
        iterations=200,
        energies=energies,
    )

    assert energies[-1] < 0.93 * energies[0]
    # Primal-dual iterations converge, but not monotonically.
    assert energies[-1] <= 1.002 * min(energies)
    assert energies[-1] == pytest.approx(energies[-50], rel=0.01)


@pytest.mark.parametrize("is_robust", [True, False])
def test_a_noisy_plane_becomes_exact(is_robust: bool):
    positions = make_grid(18, 18, 8)
    plane = (0.3 * positions[:, 0] - 0.2 * positions[:, 1] + positions[:, 2] - 4) / 1.06
    histograms = make_histograms(plane, 9, 0.6)
    data = histograms if is_robust else SquaredDifferences.from_histograms(histograms)

    found = minimise(VoxelOperators(positions), data, 0.02, order=2, iterations=1000)

    design = np.column_stack([positions, np.ones(len(positions))])
    affine = design @ np.linalg.lstsq(design, found, rcond=None)[0]
    assert np.abs(found - affine).max() < 0.003
    assert np.abs(found - plane).max() < 0.05
    assert np.sqrt(np.mean((data.compute_mean() - plane) ** 2)) > 0.15


@pytest.mark.parametrize("order", [1, 2])
def test_a_large_weight_returns_the_data(order: int):
    positions = make_grid(6, 6, 6)
    operators = VoxelOperators(positions)
    histograms = make_histograms(positions[:, 2] - 2.5, 5, 0.7)

    found = minimise(operators, histograms, 1000, order=order)
    np.testing.assert_allclose(found, np.median(histograms.levels, axis=0), atol=1e-4)

    squares = SquaredDifferences.from_histograms(histograms)
    found = minimise(operators, squares, 10_000, order=order)
    np.testing.assert_allclose(found, histograms.levels.mean(axis=0), atol=0.001)


def test_the_surface_is_where_enough_frames_measured():
    positions = make_grid(10, 8, 6)
    heights = positions[:, 2] - 2.5
    band = MeasuredBand(
        positions + 20,
        make_histograms(heights, 1, 0),
        positions[:, 0] < 5,
        0.01,
        np.array((1.0, 0, 0)),
    )

    mesh = extract_mesh(band, heights.astype(np.float32))

    np.testing.assert_allclose(mesh.vertices.min(axis=0), (1.2, 0.2, 0.225), atol=1e-6)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), (1.24, 0.27, 0.225), atol=1e-6)
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert normals[:, 2].min() > 0
    assert normals[:, 2].sum() / 2 == pytest.approx(0.04 * 0.07, rel=1e-5)


def test_without_regularisation_the_mesh_equals_the_fused_mesh(tmp_path: Path):
    scan = scanloom.read_scan(write_small_scan(tmp_path / "made", 0))
    fused = scanloom.fuse(scan)
    band = measure_band(scan)

    mesh = extract_mesh(band, band.histograms.compute_mean())

    assert measure_distance(mesh, fused.mesh, 0.99) < 1e-3 * fused.voxel_size
    assert measure_distance(fused.mesh, mesh, 0.99) < 1e-3 * fused.voxel_size
    operators = VoxelOperators(band.positions)
    for regulariser in REGULARISERS:
        near, far = (
            measure_distance(fused.mesh, fuse_regularised(band, operators, regulariser, weight), 0.9)
            for weight in (100, 0.3)
        )
        assert near < 0.5 * far


def measure_distance(mesh: Mesh, other: Mesh, quantile: float) -> float:
    """Compute a quantile of the distances from vertices to the nearest vertices of another mesh."""
    distances = scipy.spatial.cKDTree(other.vertices).query(mesh.vertices)[0]
    return float(np.quantile(distances, quantile))


def test_a_field_without_sign_change_has_no_surface():
    positions = make_grid(3, 3, 3)
    band = MeasuredBand(positions, make_histograms(np.ones(27), 1, 0), np.ones(27, bool), 0.01, np.zeros(3))

    assert len(extract_mesh(band, np.ones(27, np.float32)).triangles) == 0


def test_the_band_is_around_the_surface():
    positions = make_grid(4, 4, 12)
    is_front = positions[:, 2] >= 6
    assert set(positions[find_band(positions, is_front), 2]) == {3, 4, 5, 6, 7, 8}
    # Voxels that are not neighbours have no surface between them.
    apart = (positions[:, 2] < 5) | (positions[:, 2] > 6)
    assert len(find_band(positions[apart], is_front[apart])) == 0
