"""New and removed surface between two scans of a scene, with known areas."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh

from scanloom import Mesh, MeshError, UsageError, changes


def make_scene(*boxes: tuple[float, float, float], step: float = 0.05) -> Mesh:
    """Make a floor of 4 × 4 m with closed boxes of 0.4 m that float 0.3 m above it."""
    count = round(4 / step) + 1
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 4, count), np.linspace(0, 4, count), indexing="ij"))
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    ahead, sideways = corner + count, corner + 1
    floor = np.concatenate(
        [np.stack([corner, ahead, sideways], 1), np.stack([sideways, ahead, ahead + 1], 1)]
    )
    vertices, triangles = [np.stack([x, y, 0 * x], 1)], [floor]
    for at in boxes:
        box: Any = trimesh.creation.box(extents=(0.4, 0.4, 0.4)).subdivide().subdivide()
        triangles.append(np.array(box.faces) + sum(map(len, vertices)))
        vertices.append(np.array(box.vertices) + at + np.array((0, 0, 0.5)))
    return Mesh(np.concatenate(vertices), np.concatenate(triangles).astype(np.int32))


def test_added_boxes_are_new_and_removed_boxes_are_gone():
    found = changes(make_scene((1, 1, 0), (3, 3, 0)), make_scene((1, 1, 0), (3, 1, 0)), change_distance=0.02)
    assert found.new_area == pytest.approx(6 * 0.4**2)
    assert found.gone_area == pytest.approx(6 * 0.4**2)
    new, gone = sorted(found.regions, key=lambda one: one["kind"], reverse=True)
    np.testing.assert_allclose(new["point_m"], (3, 1, 0.5), atol=1e-6)
    np.testing.assert_allclose(gone["point_m"], (3, 3, 0.5), atol=1e-6)
    told = found.to_dict()
    assert (told["new_regions"], told["gone_regions"]) == (1, 1)
    colors = found.painted_mesh.colors
    assert colors is not None
    for color, at in (((45, 160, 70), (3, 1)), ((200, 60, 40), (3, 3))):
        there = found.painted_mesh.vertices[(colors == color).all(axis=1)]
        np.testing.assert_allclose(there[:, :2].mean(axis=0), at, atol=1e-6)
    assert len(found.painted_mesh.triangles) == len(found.new_mask) + found.gone_mask.sum()


def test_noise_is_not_a_change():
    before = make_scene((1, 1, 0))
    noisy = before.vertices + np.random.default_rng(1).normal(0, 0.003, before.vertices.shape)
    # The default is 1 % of the diagonal of 5.7 m.
    found = changes(before, before.with_(vertices=noisy))
    assert found.change_distance == pytest.approx(0.01 * np.linalg.norm((4, 4, 0.7)))
    assert (found.new_area, found.gone_area, found.regions) == (0, 0, ())
    assert not found.new_mask.any()


def test_small_patches_are_ignored():
    before, after = make_scene(), make_scene((1, 1, 0))
    assert changes(before, after, change_distance=0.02, change_area=0.9).new_area == pytest.approx(0.96)
    left = changes(before, after, change_distance=0.02, change_area=1.0)
    assert (left.new_area, left.regions) == (0, ())
    assert not left.new_mask.any()


def test_a_slightly_moved_box_is_new_and_gone():
    found = changes(make_scene((1, 1, 0)), make_scene((1.1, 1, 0)), change_distance=0.05)
    assert 0 < found.new_area < 6 * 0.4**2
    assert found.new_area == pytest.approx(found.gone_area, rel=0.05)


def test_changes_of_a_simplified_mesh_are_found():
    from scanloom import simplify

    before, after = make_scene((1, 1, 0)), make_scene((1, 1, 0), (3, 1, 0))
    light = simplify(after, ratio=0.3).mesh
    assert changes(before, light, change_distance=0.02).new_area == pytest.approx(0.96, rel=0.02)


def test_invalid_parameters_are_refused():
    with pytest.raises(UsageError, match="change_distance"):
        changes(make_scene(), make_scene(), change_distance=0)
    with pytest.raises(MeshError, match="later"):
        changes(make_scene(), Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32)))
