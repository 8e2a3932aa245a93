import sys
from pathlib import Path

import numpy as np
import pytest

from scanloom.stages.surface.mesh import Mesh, Texture

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))
from texture_soundness import find_border, measure_soundness

pytestmark = pytest.mark.slow


def make_strip(upper: float = 0.0, mirrored: bool = False) -> Mesh:
    """Make two unit squares with duplicated vertices on a seam, one of them raised by `upper`."""
    left = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    right = left + np.array([1, 0, 0])
    right[3, 2] = upper
    quad = np.array([[0, 1, 2], [0, 2, 3]])
    uvs = np.concatenate([left[quad][..., :2] / 4, right[quad][..., :2] / 4 + (0.4, 0)])
    if mirrored:
        uvs[2:, :, 0] = 1 - uvs[2:, :, 0]
    triangles = np.concatenate([quad, quad + 4]).astype(np.int32)
    return Mesh(np.concatenate([left, right]), triangles, texture=Texture(uvs, np.full(4, -1, np.int32)))


def test_a_seam_is_no_border():
    ends = find_border(make_strip(), 1e-6)
    assert np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum() == pytest.approx(6)
    found = measure_soundness(make_strip(), make_strip())
    assert found.new_border == 0
    assert (found.uv_flips, found.uv_triangles) == (0, 4)


def test_a_seam_that_opens_is_a_new_border_on_both_sides():
    found = measure_soundness(make_strip(), make_strip(upper=0.05))
    lengths = 1 + np.sqrt(1 + 0.05**2)
    assert found.new_border * np.sqrt(5) == pytest.approx(lengths, rel=1e-6)


def test_a_removed_triangle_leaves_new_border_inside_and_on_the_seam():
    whole = make_strip()
    torn = whole.with_triangles(whole.triangles[:3], np.arange(3))
    assert measure_soundness(whole, torn).new_border * np.sqrt(5) == pytest.approx(1 + np.sqrt(2), rel=1e-6)


def test_a_texture_turned_over_is_counted():
    found = measure_soundness(make_strip(), make_strip(mirrored=True))
    assert (found.uv_flips, found.uv_triangles) == (2, 4)
    # Nothing counts as flipped if the original is mirrored as well.
    assert measure_soundness(make_strip(mirrored=True), make_strip(mirrored=True)).uv_flips == 0


def test_meshes_without_texture_have_no_flips():
    bare = make_strip().with_(texture=None)
    assert measure_soundness(bare, bare).uv_triangles == 0
