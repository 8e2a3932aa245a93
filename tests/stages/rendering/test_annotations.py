"""Captions and scale bars: a bar is as long as an object of its length at the stated distance."""

import numpy as np
import pytest

from scanloom.stages.rendering.annotations import (
    choose_scale_bar,
    draw_caption,
    draw_scale_bar,
    find_focus,
    format_length,
)
from scanloom.stages.rendering.render import RenderModel
from scanloom.stages.rendering.viewpoints import Viewpoint
from scanloom.stages.scans.model.scan import Camera
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface

AHEAD = Viewpoint("ahead", Camera(320, 240, 300, 300, 159.5, 119.5), np.eye(4))
INK = np.array((29, 37, 48))


def make_wall(depth: float, wide: float, right: float = 0.0) -> Mesh:
    """Make a square perpendicular to the view, shifted by `right`."""
    vertices = wide / 2 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]) + (right, 0, depth)
    return Mesh(vertices, np.array([[0, 2, 1], [0, 3, 2]], np.int32))


def mask_ink(image: np.ndarray) -> np.ndarray:
    return np.asarray((image.astype(int) == INK).all(axis=2))


@pytest.mark.parametrize("depth", [0.05, 0.4, 2.0, 30.0])
def test_a_scale_bar_is_as_long_as_an_object_of_its_length(depth: float) -> None:
    bar = choose_scale_bar(AHEAD, depth)
    thing = RenderModel(RaycastingSurface(make_wall(depth, bar.length))).draw(AHEAD, "plain")
    empty = RenderModel(RaycastingSurface(make_wall(-depth, 1))).draw(AHEAD, "plain")
    seen = np.flatnonzero((thing != empty).any(axis=2)[120])
    drawn = draw_scale_bar(empty, bar)
    longest = max(int(row.sum()) for row in mask_ink(drawn))
    assert longest == pytest.approx(len(seen), abs=1)
    assert 0.25 / 2.6 * 320 < longest <= 0.25 * 320
    assert f"{bar.length:e}"[0] in "125"


def test_a_scale_bar_states_its_distance() -> None:
    assert choose_scale_bar(AHEAD, 1.5).label == "20 cm at 1.5 m"
    assert [format_length(x) for x in (0.002, 0.01, 0.5, 1.0, 20.0)] == [
        "2 mm",
        "1 cm",
        "50 cm",
        "1 m",
        "20 m",
    ]


def test_the_focus_is_the_depth_at_the_centre_or_of_the_visible_surface() -> None:
    assert find_focus(RenderModel(RaycastingSurface(make_wall(3.0, 1.0))), AHEAD) == pytest.approx(3.0)
    assert find_focus(RenderModel(RaycastingSurface(make_wall(2.0, 0.5, right=0.5))), AHEAD) == pytest.approx(
        2.0
    )
    assert find_focus(RenderModel(RaycastingSurface(make_wall(-2.0, 1.0))), AHEAD) is None


def test_captions_are_at_the_upper_left_and_cut_if_too_long() -> None:
    image = np.full((240, 320, 3), 128, np.uint8)
    before = image.copy()
    drawn = draw_caption(image, "chair.ply · 1,234 triangles")
    np.testing.assert_array_equal(image, before)
    changed = (drawn != image).any(axis=2)
    rows, columns = np.nonzero(changed)
    assert rows.max() < 50
    assert columns.min() < 12
    assert mask_ink(drawn)[rows.min() : rows.max()].any()
    long = (draw_caption(image, 60 * "wide ") != image).any(axis=2)
    assert 250 < np.nonzero(long)[1].max() < 320 - 4


def test_equal_captions_are_equal_bytes() -> None:
    image = np.full((100, 200, 3), 200, np.uint8)
    np.testing.assert_array_equal(draw_caption(image, "same"), draw_caption(image, "same"))
