"""The scale of a world from tags of known size in photos, and reports of unsuitable tags."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tagged_wall
from scipy.spatial.transform import Rotation
from tagged_wall import CAMERA, TAGS, Tag

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model import tags
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.scans.model.tags import TAG_FAMILIES
from scanloom.stages.scans.transforms.tag_scale import estimate_scale_from_tags

FOLDER = Path("scan")
EDGE = 0.12
FAMILY = "apriltag-36h11"


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """Render six views of two tags, in a world of 0.31 m per unit."""
    return tagged_wall.frames(metres_per_unit=0.31)


def far(frames):
    """Transform the views to a rotated world far from the origin."""
    world = np.eye(4)
    world[:3, :3] = Rotation.from_euler("xyz", (0.3, -1.2, 2.0)).as_matrix()
    world[:3, 3] = (4e5, -2e5, 300)
    return [replace(one, world_from_camera=world @ one.world_from_camera) for one in frames]


@pytest.mark.parametrize("moved", [list, far])
def test_the_true_scale_comes_out(frames, moved):
    scale = estimate_scale_from_tags(moved(frames), EDGE, FAMILY, FOLDER)
    assert scale.metres_per_unit == pytest.approx(0.31, rel=0.005)
    assert scale.source == "2 tags of 0.12 m in 6 photos"
    assert scale.spread_ratio < 0.005


@pytest.mark.parametrize("family", TAG_FAMILIES)
def test_every_family_is_found_to_a_part_of_a_pixel(family):
    pose = tagged_wall.poses(1)[0]
    known = getattr(cv2.aruco, tags._OPENCV_DICTIONARIES[family])
    photo = tagged_wall.photo(tagged_wall.wall([Tag(2, (0.1, -0.05), EDGE, known)]), pose)
    found = tags.find_tags(photo, family)
    assert list(found) == [2]
    around = EDGE / 2 * np.array([(-1, -1, 0, 0), (1, -1, 0, 0), (1, 1, 0, 0), (-1, 1, 0, 0)])
    seen = (np.linalg.inv(pose) @ np.add(around, (0.1, -0.05, 0, 1)).T)[:3]
    true = (CAMERA.matrix @ (seen / seen[2]))[:2].T
    assert np.abs(found[2] - true).max() < 0.8
    edges = [np.linalg.norm(np.roll(one, -1, axis=0) - one, axis=1).mean() for one in (found[2], true)]
    assert edges[0] == pytest.approx(edges[1], rel=0.01)


def test_tags_in_a_separate_distorted_colour_camera(frames):
    # The colour camera has lens distortion and is 0.2 m from the depth camera, whose poses are given.
    apart = np.eye(4)
    apart[:3, 3] = (0.2, 0.0, 0.05)
    bent = replace(CAMERA, distortion=(-0.12, 0.03, 0.001, -0.0005))
    columns, rows = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    straight = cv2.undistortPoints(pixels, bent.matrix, np.array(bent.distortion), P=bent.matrix)
    maps = straight.reshape(CAMERA.height, CAMERA.width, 2).astype(np.float32)
    shown = []
    for frame in frames:
        color = cv2.remap(frame.color, maps[..., 0], maps[..., 1], cv2.INTER_CUBIC)
        pose = frame.world_from_camera.copy()
        pose[:3, 3] *= 0.31
        shown.append(
            replace(
                frame,
                camera=Camera(64, 48, 50, 50, 31.5, 23.5),
                color=color,
                depth=np.ones((48, 64), np.float32),
                color_camera=bent,
                color_from_depth=apart,
                world_from_camera=pose @ apart,
            )
        )
    scale = estimate_scale_from_tags(shown, EDGE, FAMILY, FOLDER)
    assert scale.metres_per_unit == pytest.approx(1, rel=0.005)


def test_a_pose_that_is_wrong_costs_its_view_alone(frames):
    off = frames[2].world_from_camera.copy()
    off[:3, 3] += 0.2
    wrong = [*frames[:2], replace(frames[2], world_from_camera=off), *frames[3:]]
    scale = estimate_scale_from_tags(wrong, EDGE, FAMILY, FOLDER)
    assert scale.metres_per_unit == pytest.approx(0.31, rel=0.005)
    assert scale.source.endswith("in 5 photos")


def test_an_image_that_cannot_be_read_or_has_no_pose_is_left_out(frames):
    spoiled = [replace(frames[0], color=Path("missing.png")), replace(frames[1], world_from_camera=None)]
    scale = estimate_scale_from_tags([*spoiled, *frames[2:]], EDGE, FAMILY, FOLDER)
    assert scale.source.endswith("in 4 photos")


def test_tags_of_another_size_are_left_out_if_they_are_fewer():
    made = tagged_wall.frames([*TAGS, Tag(9, (0.25, 0.25), 0.18)], count=3)
    with collecting() as found:
        scale = estimate_scale_from_tags(made, EDGE, FAMILY, FOLDER)
    assert scale.metres_per_unit == pytest.approx(1, rel=0.005)
    (said,) = map(str, found)
    assert (
        said == "tags ignored for the scale, because they differ in size from most tags or are not square: 9"
    )


def test_tags_that_disagree_are_refused():
    made = tagged_wall.frames([TAGS[0], Tag(9, (0.25, 0.2), 0.18)], count=3)
    with pytest.raises(
        InputError, match=r"scan: the tags give different .*: tag 3 0\.99\d+, tag 9 0\.66\d+\."
    ):
        estimate_scale_from_tags(made, EDGE, FAMILY, FOLDER)


def test_a_tag_that_is_no_square_by_the_poses_is_refused(frames):
    # A camera with a wrong field of view.
    squeezed = [replace(one, camera=replace(CAMERA, fx=1.3 * CAMERA.fx)) for one in frames]
    with pytest.raises(InputError, match=r"is not square|none in two photos from different positions"):
        estimate_scale_from_tags(squeezed, EDGE, FAMILY, FOLDER)


def without_pictures(made):
    return [replace(one, color=np.zeros_like(one.color)) for one in made]


def without_poses(made):
    return [replace(one, world_from_camera=None) for one in made]


@pytest.mark.parametrize(
    ("change", "family", "words"),
    [
        (lambda made: made[:1], FAMILY, r"tags were detected \(3, 7\), but none in two"),
        (lambda made: made[:1] * 5, FAMILY, "none in two photos from different positions"),
        (lambda made: made, "aruco-5x5", r"no tag of aruco-5x5 .* 6 photos.*scan\.tag_family=apriltag-36h11"),
        (without_pictures, FAMILY, "scan.tag_family=NAME"),
        (without_poses, FAMILY, "photos with poses"),
        (lambda made: made[:0], FAMILY, "photos with poses"),
    ],
)
def test_where_there_is_no_scale_the_reason_is_reported(frames, change, family, words):
    with pytest.raises(InputError, match=rf"^scan: .*{words}"):
        estimate_scale_from_tags(change(frames), EDGE, family, FOLDER)
