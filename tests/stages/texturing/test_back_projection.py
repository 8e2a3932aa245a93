"""Details that are lost in the mean of many photos are restored, and nothing else is changed."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from wall_photos import CAMERA, photos, wall

from scanloom.stages.scans.model.scan import Frame
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.surface_color import compute_surface_colors
from scanloom.stages.texturing import photo_painting
from scanloom.stages.texturing.back_projection import add_residual
from scanloom.stages.texturing.texture import texture

ALL = np.ones((CAMERA.height, CAMERA.width), bool)
# Supersampling per axis: each pixel is a mean.
FINER = 5


def paint_checks(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Compute a chessboard whose squares are about two photo pixels wide."""
    dark = (np.floor(x * 90) + np.floor(y * 90)) % 2
    return np.stack([60 + 130 * dark, 190 - 110 * dark, 90 + 60 * dark], axis=-1)


def render_checks(frame: Frame) -> Frame:
    v, u = np.mgrid[: FINER * CAMERA.height, : FINER * CAMERA.width]
    pose = np.asarray(frame.world_from_camera)
    pixels = [(one + 0.5) / FINER - 0.5 for one in (u, v)]
    rays = np.stack(
        [
            (pixels[0] - CAMERA.cx) / CAMERA.fx,
            (pixels[1] - CAMERA.cy) / CAMERA.fy,
            np.ones(u.shape),
        ],
        axis=-1,
    )
    way = rays @ pose[:3, :3].T
    at = pose[:3, 3] - way * (pose[2, 3] / way[..., 2])[..., None]
    size = (CAMERA.width, CAMERA.height)
    levels = cv2.resize(paint_checks(at[..., 0], at[..., 1]), size, interpolation=cv2.INTER_AREA)
    shown = np.asarray(frame.color).max(axis=2, keepdims=True) > 0
    return replace(frame, color=np.where(shown, np.rint(levels), 0).astype(np.uint8))


def measure_errors(mesh: Mesh) -> np.ndarray:
    """Measure the mean channel error in levels in the middle of the wall."""
    rng = np.random.default_rng(3)
    chosen = rng.integers(0, len(mesh.triangles), 8000)
    weights = rng.dirichlet((1, 1, 1), len(chosen))
    x, y, _ = np.einsum("kc,kcx->xk", weights, mesh.vertices[mesh.triangles[chosen]])
    middle = (np.abs(np.stack([x, y]) - 0.5) < 0.25).all(axis=0)
    return np.abs(compute_surface_colors(mesh, chosen, weights) - paint_checks(x, y)).mean(axis=1)[middle]


@pytest.mark.slow
def test_details_are_restored():
    frames = [render_checks(frame) for frame in photos(12)]
    painted = [
        texture(wall(), frames, format="png", alignment_iterations=iterations).mesh for iterations in (0, 1)
    ]
    without, with_details = (measure_errors(mesh).mean() for mesh in painted)
    assert with_details < 0.9 * without


def test_misaligned_photos_add_no_details(monkeypatch: pytest.MonkeyPatch):
    def never(*_: object, **__: object) -> None:
        raise AssertionError("asked for details")

    monkeypatch.setattr(photo_painting, "resample_with_details", never)
    frames, move = photos(8), np.float32([[1, 0, 1.2], [0, 1, 0.5]])
    moved = [
        replace(one, color=cv2.warpAffine(np.asarray(one.color), move, (CAMERA.width, CAMERA.height)))
        for one in frames[::2]
    ]
    assert texture(wall(), [*moved, *frames[1::2]]).shift_ratio > 0.3 / 640
    with pytest.raises(AssertionError, match="asked for details"):
        texture(wall(), frames)


def test_small_details_of_a_photo_are_added():
    drawn = np.full((*ALL.shape, 3), 100, np.uint8)
    seen = drawn.copy()
    seen[60, 70:72] = (130, 100, 80), (70, 100, 120)
    once = add_residual(seen, seen, drawn, ALL)
    assert np.abs(once[60, 70:72] - [(160.0, 100.0, 60.0), (40.0, 100.0, 140.0)]).max() <= 1
    once[60, 70:72] = 100
    assert (once == 100).all()
    # A second texture that already has the detail gets nothing added.
    assert np.array_equal(add_residual(seen, seen, seen, ALL), seen)


def test_other_content_is_not_added():
    drawn = np.full((*ALL.shape, 3), 100, np.uint8)
    seen = drawn.copy()
    seen[30:90, 50:110] = (130, 90, 100)
    inner = np.s_[36:84, 56:104]
    assert np.array_equal(add_residual(seen, seen, drawn, ALL)[inner], seen[inner])


def test_nothing_is_added_beyond_the_mesh():
    drawn = np.full((*ALL.shape, 3), 100, np.uint8)
    seen = drawn.copy()
    seen[:, 78], seen[:, 79] = 80, 120
    shown = ALL.copy()
    shown[:, 80:] = False
    assert np.array_equal(add_residual(seen, seen, drawn, shown), seen)
    assert add_residual(seen, seen, drawn, ALL)[60, 79].min() > 138


def test_levels_are_clipped():
    drawn = np.full((*ALL.shape, 3), 128, np.uint8)
    seen = drawn.copy()
    seen[60, 70], seen[60, 90] = 250, 3
    found = add_residual(seen, seen, drawn, ALL)
    assert (found[60, 70] == 255).all()
    assert (found[60, 90] == 0).all()
