"""Turntable views.

The up direction is kept, the whole mesh is visible, and videos contain the drawn images.
"""

import cv2
import numpy as np
import pytest
import trimesh

from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.errors import StageError, UsageError
from scanloom.stages.rendering.panels import Panels
from scanloom.stages.rendering.turntable import choose_turntable_viewpoints
from scanloom.stages.rendering.video import CODECS, write_video
from scanloom.stages.rendering.viewpoints import Viewpoint, look_at, viewpoints
from scanloom.stages.surface.mesh import Mesh

UPS = [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.0, -0.8)]


def make_body(up: tuple[float, float, float] | None = None) -> Mesh:
    made = trimesh.creation.box(extents=(3, 1, 2))
    vertices = np.array(made.vertices) + np.array((5, 6, 7))
    colors = np.tile(np.uint8((180, 60, 40)), (len(vertices), 1))
    return Mesh(vertices, np.array(made.faces, np.int32), colors, up=up)


def project_points(viewpoint: Viewpoint, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    seen = (points - viewpoint.world_from_camera[:3, 3]) @ viewpoint.world_from_camera[:3, :3]
    return (seen / seen[:, 2:]) @ viewpoint.camera.matrix.T[:, :2], seen[:, 2]


@pytest.mark.parametrize("up", UPS)
def test_views_make_one_turn_around_the_up_axis(up: tuple[float, float, float]) -> None:
    mesh = make_body(up)
    views = choose_turntable_viewpoints(mesh, 8, width=200, height=160, elevation=30)
    eyes = np.array([view.world_from_camera[:3, 3] for view in views]) - (5, 6, 7)
    np.testing.assert_allclose(eyes @ up, views[0].focus * np.sin(np.radians(30)), rtol=1e-9)
    steps = np.linalg.norm(eyes - np.roll(eyes, 1, axis=0), axis=1)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    # All in the same rotation direction.
    assert (np.cross(eyes, np.roll(eyes, -1, axis=0)) @ up > 0).all() or (
        np.cross(eyes, np.roll(eyes, -1, axis=0)) @ up < 0
    ).all()
    filled = 0.0
    for view in views:
        np.testing.assert_allclose(view.world_from_camera[:3, 1] @ up, -np.cos(np.radians(30)), rtol=1e-9)
        at, depth = project_points(view, mesh.vertices)
        assert depth.min() > 0
        assert at.min() >= 0
        assert (at.max(axis=0) <= (199, 159)).all()
        filled = max(filled, float((np.ptp(at, axis=0) / (200, 160)).max()))
    assert filled > 0.8


@pytest.mark.parametrize("up", UPS)
def test_the_up_direction_of_a_mesh_is_up_in_its_images(up: tuple[float, float, float]) -> None:
    told, given = viewpoints(make_body(up), 2, width=40), viewpoints(make_body(), 2, width=40, up=up)
    for one, other in zip(told, given, strict=True):
        np.testing.assert_array_equal(one.world_from_camera, other.world_from_camera)
        assert one.world_from_camera[:3, 1] @ up < -0.8


def test_a_free_view_is_centred_on_its_target() -> None:
    view = look_at((1, 2, 3), (4, 0, 3), (0, 0, 1), 300, 200, field=60)
    (at,), (depth,) = project_points(view, np.array([[4, 0, 3.0]]))
    np.testing.assert_allclose(at, (149.5, 99.5))
    assert depth == pytest.approx(view.focus) == pytest.approx(np.sqrt(13))
    edge_of_field = np.array((4, 0, 3 + np.tan(np.radians(30)) * np.sqrt(13)))
    (edge,), _ = project_points(view, edge_of_field[None])
    assert edge[1] == pytest.approx(-0.5)
    # A view straight down has no up direction, but still gives an image.
    down = look_at((0, 0, 5), (0, 0, 0), (0, 0, 1), 30, 20).world_from_camera[:3, :3]
    np.testing.assert_allclose(down.T @ down, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("eye", "look", "field", "said"),
    [
        ((0, 0, 0), (0, 0, 0), 40, "same point"),
        ((0, 0, float("nan")), (0, 0, 1), 40, "finite"),
        ((0, 0, 0), (0, 0, 1), 180, "below 180"),
        ((0, 0, 0), (0, 0, 1), 0, "above 0"),
    ],
)
def test_an_invalid_view_is_one_sentence(eye: object, look: object, field: float, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        look_at(eye, look, (0, 1, 0), 30, 20, field=field)  # type: ignore[arg-type]


@pytest.mark.parametrize("codec", CODECS)
def test_a_video_contains_the_drawn_images_and_is_deterministic(tmp_path, codec) -> None:
    panels = Panels([make_body((0, 1, 0)), make_body((0, 1, 0))], ["one", ""])
    drawn = [panels.draw(view) for view in choose_turntable_viewpoints(make_body(), 5, width=96, height=64)]
    for name in ("a.mp4", "b.mp4"):
        write_video(tmp_path / name, drawn, 12, codec)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mp4", "b.mp4"]
    opened = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    assert opened.get(cv2.CAP_PROP_FPS) == 12
    for image in drawn:
        found, frame = opened.read()
        assert found
        assert frame.shape == (64, 2 * 96 + 8, 3)
        assert np.abs(frame[:, :, ::-1].astype(int) - image).mean() < 12
    assert not opened.read()[0]


def test_a_failed_video_leaves_no_file(tmp_path) -> None:
    def broken():
        yield np.zeros((16, 16, 3), np.uint8)
        raise StageError(MACHINE_BUG, "the disk is full")

    with pytest.raises(StageError, match="full"):
        write_video(tmp_path / "a.mp4", broken(), 10)
    assert list(tmp_path.iterdir()) == []


def test_panels_show_images_side_by_side() -> None:
    (view,) = viewpoints(make_body(), 1, width=80)
    alone = Panels([make_body()], [""]).draw(view, "unlit")
    both = Panels([make_body(), make_body()], ["", ""]).draw(view, "unlit")
    np.testing.assert_array_equal(both[:, :80], alone)
    np.testing.assert_array_equal(both[:, 88:], alone)
    # Unlit: the colours are unchanged.
    assert (np.abs(alone.astype(int) - (180, 60, 40)).max(axis=2) <= 1).mean() > 0.15
