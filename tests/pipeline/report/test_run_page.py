"""The page of an output folder: it includes only files of the run, and respects its size limit."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from coloured_meshes import sheet
from page_content import read_page_content

from scanloom.pipeline.evaluation.camera_photos import write_photos
from scanloom.pipeline.report.run_page import make_mesh_page, make_run_page
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.surface.formats.ply import write_ply

CAMERA = Camera(80, 60, 70, 70, 39.5, 29.5)


def make_frame(number: int) -> Frame:
    image = np.random.default_rng(number).integers(0, 255, (360, 480, 3), np.uint8)
    pose = np.eye(4)
    pose[0, 3] = number
    return Frame(f"f{number}", CAMERA, color=image, world_from_camera=pose)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """Write the results of a run that a page needs."""
    folder = tmp_path / "out"
    (folder / "pictures").mkdir(parents=True)
    write_ply(folder / "simplified.ply", sheet(4))
    write_photos(folder / "pictures", [make_frame(k) for k in range(8)], 4)
    return folder


def rewrite_json(path: Path, change: Any) -> None:
    document = json.loads(path.read_text())
    changed = change(document)
    path.write_text(json.dumps(document if changed is None else changed))


def test_cameras_and_photos_are_those_of_the_run(out: Path) -> None:
    cameras = read_page_content(make_run_page(out, 5_000_000))["cameras"]
    assert [one["frame"] for one in cameras] == [f"f{k}" for k in range(8)]
    photos = [one["photo"] for one in cameras if one["photo"]]
    assert len(photos) == 4
    files = sorted((out / "pictures" / "photos").iterdir())
    assert base64.b64decode(photos[0].partition(",")[2]) == files[0].read_bytes()


def test_photos_leave_space_for_the_model(out: Path) -> None:
    sizes = [path.stat().st_size for path in (out / "pictures" / "photos").iterdir()]
    with collecting() as diagnostics:
        cameras = read_page_content(make_run_page(out, 4 * (sum(sizes) - 1)))["cameras"]
    assert sum(one["photo"] is not None for one in cameras) == 2
    assert str(diagnostics[0]).startswith("2 photos are omitted to keep the page below")
    with collecting():
        assert read_page_content(make_run_page(out, 8))["cameras"][0]["photo"] is None


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("../../secret.jpg", "is not a path inside the folder"),
        ("/etc/hostname", "is not a path inside the folder"),
        ("photos/link.jpg", "is outside the folder"),
        ("photos/none.jpg", "is missing"),
        ("cameras.json", "not a JPEG"),
        ("photos", "is missing"),
        (7, "not written by a run, or is damaged"),
    ],
)
def test_no_other_file_gets_into_a_page(out: Path, name: object, said: str) -> None:
    secret = out.parent / "secret.jpg"
    cv2.imwrite(str(secret), np.zeros((8, 8, 3), np.uint8))
    (out / "pictures" / "photos" / "link.jpg").symlink_to(secret)
    rewrite_json(out / "pictures" / "cameras.json", lambda told: told["cameras"][0].update(photo=name))
    with pytest.raises(InputError, match=said):
        make_run_page(out, 5_000_000)


@pytest.mark.parametrize("key", ["frame", "world_from_camera", "size", "fy", "photo"])
@pytest.mark.parametrize("value", [..., "x", [], [0, 2], {}, -1, float("nan")])
def test_damaged_cameras_are_an_input_error(out: Path, key: str, value: object) -> None:
    def damaged(told: dict[str, Any]) -> None:
        if value is ...:
            del told["cameras"][1][key]
        else:
            told["cameras"][1][key] = value

    rewrite_json(out / "pictures" / "cameras.json", damaged)
    if key == "frame" and value is not ...:
        assert read_page_content(make_run_page(out, 5_000_000))["cameras"][1]["frame"] == str(value)
        return
    with pytest.raises(InputError, match=r"cameras\.json|pictures"):
        make_run_page(out, 5_000_000)


@pytest.mark.parametrize("text", ["", "[]", "{", "7", '{"cameras": 7}', '{"cameras": [7]}', "[[[[]]]]"])
@pytest.mark.parametrize("name", ["pictures/cameras.json", "report.json"])
def test_damaged_documents_are_an_input_error(out: Path, name: str, text: str) -> None:
    (out / name).write_text(text)
    if name == "report.json" and text.startswith(('{"', "[]")):
        make_run_page(out, 5_000_000)  # such a report has no content for the page
        return
    with pytest.raises(InputError, match=name):
        make_run_page(out, 5_000_000)


@pytest.mark.parametrize(
    "report", [{"stages": {"fuse": {}}}, {"stages": [1]}, {"scan": 7}, {"scan": {"frames_skipped": [1]}}]
)
def test_a_report_of_another_program_is_an_input_error(out: Path, report: object) -> None:
    (out / "report.json").write_text(json.dumps(report))
    with pytest.raises(InputError, match=r"report\.json"):
        make_run_page(out, 5_000_000)


def test_a_single_mesh_has_a_page() -> None:
    content = read_page_content(make_mesh_page("thing", sheet(4), 5_000_000))
    assert (content["title"], [one["name"] for one in content["models"]]) == ("thing", ["thing"])
    assert content["cameras"] == []
