import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanloom.pipeline.cache.digest import (
    compute_digest,
    compute_file_digest,
    compute_label_digests,
    compute_scan_digest,
    to_canonical_json,
)
from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.scans.model.scan import Camera, Frame, Scan, StereoRig

CAMERA = Camera(4, 3, 5.0, 5.0, 1.5, 1.0)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@pytest.mark.slow
@given(json_values)
def test_canonical_json_reads_back_to_the_same_value(value):
    assert json.loads(to_canonical_json(value)) == value


@pytest.mark.slow
@given(st.dictionaries(st.text(), st.integers()))
def test_order_of_keys_does_not_matter(value):
    assert to_canonical_json(dict(reversed(value.items()))) == to_canonical_json(value)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), {"a": [1, -float("inf")]}])
def test_numbers_json_cannot_express_are_refused(value):
    with pytest.raises(ValueError, match="JSON cannot express"):
        to_canonical_json(value)


@pytest.mark.parametrize("value", [Path("a"), {1, 2}, {1: 2}, np.float64(1), np.zeros(2), b"a", object()])
def test_values_json_cannot_express_are_refused(value):
    with pytest.raises(TypeError, match="JSON cannot express"):
        to_canonical_json({"x": value})


def test_digests_are_plain_sha256(tmp_path):
    data = bytes(range(256)) * 9000
    (tmp_path / "file").write_bytes(data)
    assert compute_file_digest(tmp_path / "file") == hashlib.sha256(data).hexdigest()
    assert compute_digest({"b": 1, "a": None}) == hashlib.sha256(b'{"a":null,"b":1}').hexdigest()


def make_one_frame_scan(folder: Path) -> Scan:
    (folder / "left.png").write_bytes(b"left")
    (folder / "right.png").write_bytes(b"right")
    rig = StereoRig(CAMERA, CAMERA, np.eye(4), is_rectified=True)
    frame = Frame("a", CAMERA, folder / "left.png", folder / "right.png", world_from_camera=np.eye(4))
    return Scan("toy", [frame], rig)


def shift_pose(pose: np.ndarray) -> np.ndarray:
    other = pose.copy()
    other[0, 3] += 1e-9
    return other


@pytest.mark.parametrize(
    "change",
    [
        lambda f: replace(f, camera=replace(CAMERA, fx=5.1)),
        lambda f: replace(f, camera=replace(CAMERA, distortion=(0.1, 0.0, 0.0, 0.0))),
        lambda f: replace(f, world_from_camera=shift_pose(f.world_from_camera)),
        lambda f: replace(f, world_from_camera=None),
        lambda f: replace(f, right=None),
        lambda f: replace(f, right=f.color, color=f.right),
        lambda f: replace(f, depth_scale=5000.0),
        lambda f: replace(f, depth_missing=(65535,)),
    ],
)
def test_the_digest_depends_on_frame_data_read_by_stages(tmp_path, change):
    scan = make_one_frame_scan(tmp_path)
    before = compute_scan_digest(scan)
    after = compute_scan_digest(replace(scan, frames=[change(scan.frames[0])]))
    assert after.digest != before.digest
    assert after.parts["calibration"] == before.parts["calibration"]


def test_the_digest_ignores_names_and_times(tmp_path):
    scan = make_one_frame_scan(tmp_path)
    frame = replace(scan.frames[0], name="b", timestamp=12)
    other = replace(
        scan, frames=[frame], layout="other", folder=tmp_path, diagnostics=(MACHINE_BUG.warning("odd"),)
    )
    assert compute_scan_digest(other).digest == compute_scan_digest(scan).digest


def test_names_and_times_have_separate_digests(tmp_path):
    scan = make_one_frame_scan(tmp_path)
    frame = scan.frames[0]
    before = compute_label_digests(scan)
    later = compute_label_digests(replace(scan, frames=[replace(frame, timestamp=12)]))
    assert later["names"] == before["names"]
    assert later["times"] != before["times"]
    for other in (replace(frame, name="b"), replace(frame, color=frame.color.rename(tmp_path / "c.png"))):
        renamed = compute_label_digests(replace(scan, frames=[other]))
        assert renamed["names"] != before["names"]
        assert renamed["times"] == before["times"]


def test_names_are_relative_to_the_scan(tmp_path):
    def of(folder):
        folder.mkdir()
        return compute_label_digests(replace(make_one_frame_scan(folder), folder=folder))

    assert of(tmp_path / "here") == of(tmp_path / "there")


def test_the_digest_depends_on_the_rig(tmp_path):
    scan = make_one_frame_scan(tmp_path)
    other = replace(scan, rig=replace(scan.rig, right_from_left=shift_pose(np.eye(4))))
    assert compute_scan_digest(other).digest != compute_scan_digest(scan).digest
    assert (
        compute_scan_digest(replace(scan, rig=replace(scan.rig, is_rectified=False))).digest
        != compute_scan_digest(scan).digest
    )


def test_arrays_in_memory_are_digested_by_content():
    def of(depth):
        return compute_scan_digest(Scan("toy", [Frame("a", CAMERA, depth=depth)])).digest

    depth = np.ones((3, 4), np.float32)
    assert of(depth) == of(depth.copy()) == of(np.asfortranarray(depth))
    assert of(depth) != of(depth * 2)
    assert of(depth) != of(depth.astype(np.float64))
    assert of(depth) != of(depth.reshape(4, 3))


def test_an_unreadable_file_has_a_separate_digest(tmp_path):
    scan = make_one_frame_scan(tmp_path)
    whole = compute_scan_digest(scan).digest
    (tmp_path / "left.png").unlink()
    assert compute_scan_digest(scan).digest != whole


def test_a_file_that_changes_while_it_is_read_is_detected(tmp_path):
    scan = make_one_frame_scan(tmp_path)
    content = compute_scan_digest(scan)
    (tmp_path / "left.png").touch()
    content.require_unchanged()
    (tmp_path / "left.png").write_bytes(b"LEFT")
    with pytest.raises(StageError, match=r"left\.png changed while it was being read"):
        content.require_unchanged()
