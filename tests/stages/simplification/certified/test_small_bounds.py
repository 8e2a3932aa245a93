"""A bound below the resolution of a proof is reported as unmet, and what is stated holds."""

from __future__ import annotations

import numpy as np
import pytest
from coloured_meshes import sheet

from scanloom import certify
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh


def make_thin_sheet(size: float, thickness: float, offset: float = 0.0) -> Mesh:
    """Make a sheet of this size in metres; thickness (noise) and offset are relative to the size."""
    mesh = sheet(12).with_(colors=None)
    noise = thickness * np.random.default_rng(3).standard_normal(len(mesh.vertices))
    flat = np.column_stack([mesh.vertices[:, :2], noise])
    return mesh.with_(vertices=(flat + offset) * size)


@pytest.mark.parametrize(
    ("size", "offset"), [(1.0, 0.0), (1e-9, 0.0), (1e-9, 1e3), (1e-30, 0.0), (1e20, 0.0)]
)
@pytest.mark.parametrize("ratio", [1e-2, 1e-6, 1e-9])
def test_a_bound_is_proven_or_unmet(size: float, offset: float, ratio: float) -> None:
    mesh = make_thin_sheet(size, 0.5 * ratio, offset)
    light = simplify(mesh, method="certified", max_shape=ratio * size)
    real = certify(mesh, light.mesh, slack=1e-13 * size).shape_attained_m
    assert real <= light.details.shape_bound_m
    unmet = [one for one in light.diagnostics if one.severity.value == "unmet"]
    if light.details.shape_bound_m <= ratio * size * (1 + 1e-9):
        assert not unmet
        assert real <= ratio * size * (1 + 1e-9)
    else:
        (one,) = unmet
        assert one.code == "simplify.bound-not-proven"
        assert "below the resolution of a proof" in one.message
    assert bool(unmet) == (ratio < 1e-5 or (offset > 0 and ratio < 1e-3))
