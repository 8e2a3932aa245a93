"""Colours of distances: dark where two meshes are near, the last colour where they are far."""

import numpy as np
import pytest
from coloured_meshes import sheet

from scanloom.stages.comparing.distance_map import paint_distances
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box


def brightness(mesh):
    return mesh.colors.astype(float) @ (0.299, 0.587, 0.114)


def test_colours_grow_brighter_with_distance_up_to_the_full_scale():
    mesh = sheet(20, noise=0.0)
    lift = 0.1 * mesh.vertices[:, :1] * (0, 0, 1)
    other = mesh.with_(vertices=mesh.vertices + lift)
    surface = RaycastingSurface(other, compute_bounding_box(mesh, other))
    painted, full_scale = paint_distances(mesh, surface, 0.05)
    assert full_scale == 0.05
    distances = surface.find_closest_points(mesh.vertices).distances
    order = np.argsort(distances[distances < 0.05])
    assert (np.diff(brightness(painted)[distances < 0.05][order]) > -2).all()
    last = painted.colors[distances >= 0.05]
    assert len(last) > 10
    assert (last == last[0]).all()
    assert last[0, 0] > 240 > last[0, 2] + 150, "yellow is last"
    np.testing.assert_array_equal(painted.vertices, mesh.vertices)


def test_by_default_all_but_a_hundredth_are_within_the_scale():
    mesh = sheet(20, noise=0.0)
    far = mesh.vertices.copy()
    far[7, 2] += 5
    other = mesh.with_(vertices=far)
    moved = other.with_(vertices=far + np.array((0, 0, 0.01)))
    _, full_scale = paint_distances(other, RaycastingSurface(moved, compute_bounding_box(other, moved)))
    assert full_scale == pytest.approx(0.01, rel=0.3)


def test_equal_meshes_are_dark_all_over():
    mesh = sheet(8)
    painted, full_scale = paint_distances(mesh, RaycastingSurface(mesh))
    assert full_scale < 1e-6
    painted, _ = paint_distances(mesh, RaycastingSurface(mesh), 0.01)
    assert brightness(painted).max() < 40
