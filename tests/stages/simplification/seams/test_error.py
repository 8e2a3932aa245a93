"""Shape error of method `seams`, compared with method `quadric` on the same surface."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages.comparing.compare import compare
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh

# Maximum ratio of the RMS distances of `seams` and `quadric`.
MOST_RATIO = 1.3


def make_bumpy_sheet(side: int, bumps: float, noise: float, seed: int) -> Mesh:
    """Make a sheet of up to 2 · side² triangles with a ragged hole and a ragged outline."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(0, 1, side + 1), np.linspace(0, 1, side + 1))
    phase = rng.uniform(0, 2 * np.pi, 4)
    z = bumps * (np.sin(9 * x + phase[0]) * np.cos(7 * y + phase[1]) + 0.4 * np.sin(23 * x * y + phase[2]))
    z += noise / side * rng.standard_normal(z.shape)
    grid = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    triangles = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    vertices = np.stack([x, y, z], -1).reshape(-1, 3)
    centres = vertices[triangles].mean(axis=1)
    away = np.linalg.norm(centres[:, :2] - (0.4, 0.55), axis=1)
    angle = np.arctan2(*(centres[:, :2] - (0.4, 0.55)).T)
    is_kept = away > 0.12 + 0.05 * np.sin(5 * angle + phase[3])
    is_kept &= centres[:, 0] < 0.93 + 0.04 * np.sin(40 * centres[:, 1])
    used, local = np.unique(triangles[is_kept], return_inverse=True)
    return Mesh(vertices[used], local.reshape(-1, 3).astype(np.int32))


def measure_rms(light: Mesh, mesh: Mesh) -> float:
    return compare(light, mesh, samples=20_000).symmetric.rms


def unweld(mesh: Mesh) -> Mesh:
    """Give each triangle three separate vertices, as at texture seams in files."""
    vertices = mesh.vertices[mesh.triangles].reshape(-1, 3)
    return Mesh(vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3))


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
@given(
    side=st.integers(40, 75),
    bumps=st.floats(0.01, 0.15),
    noise=st.floats(0, 0.4),
    ratio=st.sampled_from([0.1, 0.03, 0.015]),
    seed=st.integers(0, 1000),
)
def test_shape_error_is_close_to_that_of_quadric(
    side: int, bumps: float, noise: float, ratio: float, seed: int
) -> None:
    """The meshes have boundaries, and need several regions and rounds."""
    mesh = make_bumpy_sheet(side, bumps, noise, seed)
    plain = simplify(mesh, method="quadric", ratio=ratio)
    seams = simplify(unweld(mesh), method="seams", triangles=len(plain.mesh.triangles))
    assert measure_rms(seams.mesh, mesh) <= MOST_RATIO * measure_rms(plain.mesh, mesh)


def test_late_rounds_keep_the_order() -> None:
    """Without a limit on the priority, the last rounds collapsed whole regions at a ratio of 2 %."""
    mesh = make_bumpy_sheet(110, 0.08, 0.2, 3)
    errors = [measure_rms(simplify(mesh, method="seams", ratio=ratio).mesh, mesh) for ratio in (0.05, 0.02)]
    plain = measure_rms(simplify(mesh, method="quadric", ratio=0.02).mesh, mesh)
    assert errors[1] < 4 * errors[0]
    assert errors[1] <= MOST_RATIO * plain


@pytest.mark.parametrize("share", [0.005, 0.031, 0.1])
def test_joined_vertices_give_finite_positions_near_the_input(share: float) -> None:
    """Two sets of joined vertices with the same mean have edges of length 0."""
    rng = np.random.default_rng(1)
    sheet = make_bumpy_sheet(20, 0.02, 0.1, 5)
    offset = np.array([0, 0, 0.01])
    flipped = sheet.triangles[:, ::-1] + len(sheet.vertices)
    mesh = Mesh(
        np.concatenate(
            [sheet.vertices, sheet.vertices + offset * rng.uniform(0.2, 1, (len(sheet.vertices), 1))]
        ),
        np.concatenate([sheet.triangles, flipped]).astype(np.int32),
    )
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    light = simplify(mesh, method="seams", ratio=0.3, seams={"similar_distance": share * diagonal}).mesh
    assert np.isfinite(light.vertices).all()
    assert (light.vertices >= mesh.vertices.min(axis=0) - 0.02 * diagonal).all()
    assert (light.vertices <= mesh.vertices.max(axis=0) + 0.02 * diagonal).all()
