"""Distance colours: brighter for larger distances, with a single colour above full scale."""

import numpy as np
import pytest
from coloured_meshes import sheet

from scanloom.stages.comparing.distance_map import paint_distances
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box


def compute_brightness(mesh):
    return mesh.colors.astype(float) @ (0.299, 0.587, 0.114)


def test_brightness_increases_with_distance_up_to_full_scale():
    mesh = sheet(20, noise=0.0)
    lift = 0.1 * mesh.vertices[:, :1] * (0, 0, 1)
    other = mesh.with_(vertices=mesh.vertices + lift)
    surface = RaycastingSurface(other, compute_bounding_box(mesh, other))
    painted, full_scale = paint_distances(mesh, surface, 0.05)
    assert full_scale == 0.05
    distances = surface.find_closest_points(mesh.vertices).distances
    order = np.argsort(distances[distances < 0.05])
    assert (np.diff(compute_brightness(painted)[distances < 0.05][order]) > -2).all()
    last = painted.colors[distances >= 0.05]
    assert len(last) > 10
    assert (last == last[0]).all()
    assert last[0, 0] > 240 > last[0, 2] + 150, "yellow is last"
    np.testing.assert_array_equal(painted.vertices, mesh.vertices)


def test_the_default_scale_includes_99_percent():
    mesh = sheet(20, noise=0.0)
    far = mesh.vertices.copy()
    far[7, 2] += 5
    other = mesh.with_(vertices=far)
    moved = other.with_(vertices=far + np.array((0, 0, 0.01)))
    _, full_scale = paint_distances(other, RaycastingSurface(moved, compute_bounding_box(other, moved)))
    assert full_scale == pytest.approx(0.01, rel=0.3)


def test_equal_meshes_are_dark_everywhere():
    mesh = sheet(8)
    painted, full_scale = paint_distances(mesh, RaycastingSurface(mesh))
    assert full_scale < 1e-6
    painted, _ = paint_distances(mesh, RaycastingSurface(mesh), 0.01)
    assert compute_brightness(painted).max() < 40
