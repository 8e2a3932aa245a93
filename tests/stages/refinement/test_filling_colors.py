"""Colours of filled holes from synthetic photos with known colours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scanloom.stages import Frame, Mesh
from scanloom.stages.refinement.filling_colors import color_fillings
from scanloom.stages.scans.model.scan import Camera

EDGE = 0.01
HOLE_RADIUS = 0.04
CAMERA = Camera(160, 160, 200.0, 200.0, 79.5, 79.5)


def _compute_colors(points: np.ndarray) -> np.ndarray:
    """Compute the true colours of the wall: a gradient, and a spot inside the hole."""
    x, y = points[..., 0], points[..., 1]
    spot = np.exp(-(x**2 + y**2) / (2 * 0.02**2))
    return np.stack([110 + 250 * x + 80 * spot, 110 - 250 * y, 120 - 70 * spot], axis=-1)


def _make_wall() -> tuple[Mesh, np.ndarray]:
    """Make a wall at z = 0 whose vertices in a round hole are black; return their mask as well."""
    x, y = (axis.reshape(-1) for axis in np.meshgrid(*[np.arange(-20, 21) * EDGE] * 2, indexing="ij"))
    first = (np.arange(40)[:, None] * 41 + np.arange(40)).reshape(-1)
    corners = np.stack([first, first + 41, first + 42, first + 1], axis=1)
    triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]]).astype(np.int32)
    vertices = np.stack([x, y, np.zeros(x.shape)], axis=1)
    is_filled = np.hypot(x, y) < HOLE_RADIUS
    colors = np.where(is_filled[:, None], 0, _compute_colors(vertices)).round().astype(np.uint8)
    return Mesh(vertices, triangles, colors), is_filled


def _photograph(x: float, exposure: float, height: float = 0.6) -> Frame:
    """Render a photo of the wall from a camera above that faces straight down."""
    pose = np.diag((1.0, -1.0, -1.0, 1.0))
    pose[:3, 3] = x, 0.0, height
    rows, columns = np.indices((CAMERA.height, CAMERA.width))
    rays = np.stack([(columns - CAMERA.cx) / CAMERA.fx, -(rows - CAMERA.cy) / CAMERA.fy], axis=-1)
    image = (_compute_colors(pose[:2, 3] + height * rays) + exposure).clip(0, 255).round().astype(np.uint8)
    return Frame.from_arrays(image, None, CAMERA, pose, name=f"{x:g}")


def _measure_errors(mesh: Mesh, colors: np.ndarray | None, is_filled: np.ndarray) -> np.ndarray:
    assert colors is not None
    assert mesh.colors is not None
    assert np.array_equal(colors[~is_filled], mesh.colors[~is_filled])
    return np.abs(colors[is_filled] - _compute_colors(mesh.vertices[is_filled]))


def test_fillings_get_the_colours_of_photos_without_their_exposure() -> None:
    mesh, is_filled = _make_wall()
    frames = [_photograph(-0.1, 30.0), _photograph(0.0, -25.0), _photograph(0.1, 20.0)]
    done: list[int] = []
    colors = color_fillings(mesh, is_filled, frames, done.append)
    assert _measure_errors(mesh, colors, is_filled).max() < 4
    assert done == [1, 2, 3]
    # Interpolation from the rim cannot reproduce the spot.
    assert _measure_errors(mesh, color_fillings(mesh, is_filled, []), is_filled).max() > 50


def test_occluded_and_reverse_views_are_not_used() -> None:
    """A plate is between the wall and one camera; another camera is behind the wall."""
    mesh, is_filled = _make_wall()
    plate = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.03 + (0, 0, 0.2)
    count = len(mesh.vertices)
    assert mesh.colors is not None
    both = Mesh(
        np.concatenate([mesh.vertices, plate]),
        np.concatenate([mesh.triangles, count + np.array([[0, 1, 2], [0, 2, 3]], np.int32)]),
        np.concatenate([mesh.colors, np.full((4, 3), 9, np.uint8)]),
    )
    filled = np.concatenate([is_filled, np.zeros(4, bool)])
    wrong = np.full((CAMERA.height, CAMERA.width, 3), 250, np.uint8)
    above = _photograph(0.0, 0.0).world_from_camera
    behind = np.eye(4)
    behind[2, 3] = -0.6
    frames = [Frame.from_arrays(wrong, None, CAMERA, pose) for pose in (above, behind)]
    rim_only = color_fillings(both, filled, [])
    assert np.array_equal(color_fillings(both, filled, frames), rim_only)
    visible = _photograph(0.18, 0.0)
    colors = color_fillings(both, filled, [*frames, visible])
    assert _measure_errors(both, colors, filled).max() < 6


def test_vertices_without_photos_continue_their_neighbours() -> None:
    """The photo covers half of the hole."""
    mesh, is_filled = _make_wall()
    camera = Camera(80, 160, 200.0, 200.0, 79.5, 79.5)
    whole = _photograph(0.0, 0.0)
    half = Frame.from_arrays(np.asarray(whole.color)[:, :80], None, camera, whole.world_from_camera)
    colors = color_fillings(mesh, is_filled, [half])
    errors = _measure_errors(mesh, colors, is_filled).max(axis=1)
    x = mesh.vertices[is_filled, 0]
    assert errors[x < -0.005].max() < 4
    # The spot is continued, and fades towards the rim.
    rim_only = _measure_errors(mesh, color_fillings(mesh, is_filled, []), is_filled).max(axis=1)
    assert errors[x > 0.005].mean() < 0.8 * rim_only[x > 0.005].mean()


def test_photos_that_cannot_be_read_are_ignored(tmp_path: Path) -> None:
    mesh, is_filled = _make_wall()
    (tmp_path / "damaged.jpg").write_bytes(b"no image")
    good = _photograph(0.0, 0.0)
    damaged = Frame(
        "damaged", CAMERA, color=tmp_path / "damaged.jpg", world_from_camera=good.world_from_camera
    )
    expected = color_fillings(mesh, is_filled, [good])
    assert np.array_equal(color_fillings(mesh, is_filled, [damaged, good]), expected)
    no_pose = Frame.from_arrays(good.color, None, CAMERA, name="no pose")
    assert np.array_equal(
        color_fillings(mesh, is_filled, [damaged, no_pose]), color_fillings(mesh, is_filled, [])
    )


@pytest.mark.parametrize("count", [1, 3])
def test_a_mesh_without_colours_or_fillings_is_unchanged(count: int) -> None:
    mesh, is_filled = _make_wall()
    frames = [_photograph(0.0, 0.0)] * count
    assert color_fillings(mesh.with_(colors=None), is_filled, frames) is None
    assert color_fillings(mesh, np.zeros(len(is_filled), bool), frames) is mesh.colors
