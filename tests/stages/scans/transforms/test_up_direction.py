"""Up directions of scans.

From layouts with a defined world, for poses in that world, and from measurements.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from scanloom.stages.scans.layout_table import LAYOUTS
from scanloom.stages.scans.layouts import polycam
from scanloom.stages.scans.model.scan import Camera, Frame, Scan
from scanloom.stages.scans.model.world import Y_UP, Z_UP, WorldUp, create_layout_up
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.transforms.up_direction import find_up_direction, set_layout_up

CAMERA = Camera(4, 3, 5.0, 5.0, 1.5, 1.0)
FRAME = Frame("a", CAMERA, world_from_camera=np.eye(4))


def test_layouts_with_a_defined_world_give_the_up_direction():
    told = {layout.name: create_layout_up(layout.name, layout.up).source for layout in LAYOUTS if layout.up}
    assert told == {
        "polycam": "layout polycam: y up",
        "record3d": "layout record3d: y up",
        "stray-scanner": "layout stray-scanner: y up",
        "arkitscenes": "layout arkitscenes: z up",
        "replica": "layout replica: z up",
        "tartanair": "layout tartanair: z down",
        "euroc": "layout euroc: z up",
        "icl-nuim": "layout icl-nuim: y down",
    }


@pytest.mark.parametrize(
    ("scan", "options", "expected"),
    [
        (Scan("polycam", [FRAME]), {}, WorldUp(Y_UP, "layout polycam: y up")),
        (Scan("polycam", [FRAME]), {"poses": "other.tum"}, None),
        (Scan("polycam", [replace(FRAME, world_from_camera=None)]), {}, None),
        (Scan("polycam", [FRAME], up=WorldUp(Z_UP, "its file")), {}, WorldUp(Z_UP, "its file")),
        (Scan("polycam", [FRAME], up=WorldUp(Z_UP, "its file")), {"poses": "other.tum"}, None),
    ],
)
def test_it_holds_for_the_poses_of_the_folder_alone(scan, options, expected):
    assert set_layout_up(scan, polycam.LAYOUT, ScanParams(**options)).up == expected


@settings(max_examples=25)
@given(st.integers(0, 1 << 30))
def test_measured_up_directions_are_combined_by_median(seed):
    random = np.random.default_rng(seed)
    world = Rotation.random(random_state=seed)
    up = world.apply((0.0, 0.0, 1.0))
    frames = []
    for number in range(15):
        turn = Rotation.random(random_state=seed % 1000 + number)
        # A third of the readings are from a running person.
        shake = random.normal(0, 0.7 if number % 3 == 0 else 0.03, 3)
        pose = np.eye(4)
        pose[:3, :3] = turn.as_matrix()
        seen = turn.inv().apply(up + shake)
        frames.append(replace(FRAME, world_from_camera=pose, up=seen / np.linalg.norm(seen)))
    known = find_up_direction(Scan("made", frames))
    assert known.source == "gravity of the IMU"
    assert np.degrees(np.arccos(np.clip(known.direction @ up, -1, 1))) < 8


def test_the_layout_has_priority_over_measurements():
    told = WorldUp(Z_UP, "layout euroc: z up")
    assert find_up_direction(Scan("euroc", [replace(FRAME, up=np.array((0, -1.0, 0)))], up=told)) == told


def test_without_information_there_is_no_up_direction():
    assert find_up_direction(Scan("made", [FRAME])) is None
    assert (
        find_up_direction(Scan("made", [replace(FRAME, up=np.array((0, -1.0, 0)), world_from_camera=None)]))
        is None
    )


def test_a_measured_world_gives_each_camera_its_up_direction():
    """New poses define another world; gravity measured by the phone is converted."""
    turned = np.eye(4)
    turned[:3, :3] = ((0, 0, 1), (0, 1, 0), (-1, 0, 0))
    pose = turned @ np.diag((1.0, -1.0, -1.0, 1.0))
    frame = Frame("0", CAMERA, world_from_camera=pose)
    level = polycam.LAYOUT
    assert level.is_gravity_aligned
    known = set_layout_up(Scan("level", [frame]), level, ScanParams())
    np.testing.assert_allclose(known.frames[0].up, (0, -1, 0), atol=1e-12)
    elsewhere = replace(known.frames[0], world_from_camera=np.eye(4))
    found = find_up_direction(replace(known, frames=[elsewhere], up=None))
    np.testing.assert_allclose(found.direction, (0, -1, 0), atol=1e-12)
    # A world whose up is defined, not measured, gives no up direction of a camera.
    assert (
        set_layout_up(Scan("made", [frame]), replace(level, is_gravity_aligned=False), ScanParams())
        .frames[0]
        .up
        is None
    )
