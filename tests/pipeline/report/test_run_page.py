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

from scanloom import Mesh
from scanloom.pipeline.evaluation.camera_photos import write_photos
from scanloom.pipeline.report.page.packing import compute_page_rotation
from scanloom.pipeline.report.page.page_header import describe_mesh, format_file_size
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


def test_a_single_mesh_has_a_page(tmp_path: Path) -> None:
    write_ply(tmp_path / "thing.ply", sheet(4))
    content = read_page_content(make_mesh_page(tmp_path / "thing.ply", sheet(4), 5_000_000))
    assert (content["title"], [one["name"] for one in content["models"]]) == ("thing", ["thing"])
    assert content["cameras"] == []
    facts = {one["name"]: one["value"] for one in content["header"]["facts"]}
    assert list(facts) == ["Size", "Triangles", "File"]
    assert facts["Triangles"] == "32"
    assert facts["File"] == format_file_size((tmp_path / "thing.ply").stat().st_size)


def make_report(**stages: Any) -> dict[str, Any]:
    """Make a report whose stages have metrics."""
    about = {"cached": True, "compute_seconds": 1, "peak_memory_mb": 1, "reason": "", "seconds": 0}
    return {
        "scanloom": "9.9",
        "created": "2026-03-01T23:30:00+00:00",
        "scan": {"frames": 12},
        "stages": {name: {**about, "metrics": metrics} for name, metrics in stages.items()},
    }


def read_header(out: Path, report: Any) -> dict[str, Any]:
    (out / "report.json").write_text(json.dumps(report))
    header: dict[str, Any] = read_page_content(make_run_page(out, 5_000_000))["header"]
    return header


def test_the_header_separates_scan_noise_from_simplification_error(out: Path) -> None:
    report = make_report(
        refine={"deviation_median_m": 0.00042}, simplify={"details": {"shape_bound_m": 0.00123401}}
    )
    header = read_header(out, report)
    assert header["subtitle"] == "12 frames · processed 1 March 2026 · scanloom 9.9"
    facts = {one["name"]: one for one in header["facts"]}
    assert list(facts) == ["Size", "Triangles", "File", "Scan noise", "Simplification error", "Warnings"]
    assert facts["Size"]["value"] == describe_mesh(sheet(4), compute_page_rotation(sheet(4)))[0].value
    assert facts["Scan noise"]["value"] == "0.42 mm"
    # An upper bound is rounded up.
    assert facts["Simplification error"]["value"] == "≤ 1.235 mm"
    assert "proven" in facts["Simplification error"]["note"]
    assert (facts["Warnings"]["value"], facts["Warnings"]["link"]) == ("none", "")
    report["scan"]["metric"] = False
    facts = {one["name"]: one for one in read_header(out, report)["facts"]}
    assert facts["Scan noise"]["value"] == "0.00042 units"
    assert facts["Size"]["value"].endswith(" units")


def test_the_header_claims_no_proof_and_no_noise_without_one(out: Path) -> None:
    write_ply(out / "refined.ply", sheet(8))
    facts = {one["name"]: one for one in read_header(out, make_report(simplify={}))["facts"]}
    assert "Scan noise" not in facts
    assert "not proven" in facts["Simplification error"]["note"]
    assert float(facts["Simplification error"]["value"].removesuffix(" mm")) > 1


def test_warnings_and_the_picture_are_in_the_header(out: Path) -> None:
    report = make_report()
    warning = {"code": "scan.odd", "severity": "warning", "message": "Something is odd."}
    report["scan"]["diagnostics"] = [warning, {**warning, "severity": "info"}]
    assert read_header(out, report)["picture"] is None
    cv2.imwrite(str(out / "pictures" / "simplified-overview.png"), np.full((60, 800, 3), 90, np.uint8))
    header = read_header(out, report)
    assert header["facts"][-1]["value"] == "1, listed below"
    assert header["facts"][-1]["link"] == "warnings"
    kind, _, data = header["picture"].partition(",")
    assert kind == "data:image/jpeg;base64"
    assert cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR).shape[1] == 304
    assert make_run_page(out, 5_000_000) == make_run_page(out, 5_000_000)
    (out / "pictures" / "simplified-overview.png").write_text("no picture")
    with pytest.raises(InputError, match="simplified-overview"):
        make_run_page(out, 5_000_000)


@pytest.mark.parametrize("change", [{"created": "soon"}, {"created": 7}, {"scan": {"frames": "many"}}])
def test_a_damaged_header_is_an_input_error(out: Path, change: dict[str, Any]) -> None:
    (out / "report.json").write_text(json.dumps({**make_report(), **change}))
    with pytest.raises(InputError, match=r"report\.json"):
        make_run_page(out, 5_000_000)


def test_the_size_is_that_of_the_smallest_upright_box() -> None:
    import trimesh

    turn = trimesh.transformations.rotation_matrix(0.7, (0, 0, 1), (3, 2, 1))
    for scale, expected in ((1.0, "3.00 × 2.00 × 0.50 m"), (0.01, "30.0 × 20.0 × 5.0 mm")):
        box = trimesh.creation.box(extents=np.array((2, 3, 0.5)) * scale, transform=turn)
        # An unused vertex does not belong to the object.
        vertices = np.vstack([box.vertices, [(100, 0, 0)]]) + np.array((400_000, 5_000_000, 0))
        mesh = Mesh(vertices, np.array(box.faces, np.int32))
        assert describe_mesh(mesh, np.eye(3))[0].value == expected
