"""Colormaps of a run's page: deviations from the report, and photo counts from the texture stage."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from coloured_meshes import sheet
from page_content import read_page_content

import scanloom.pipeline.report.run_page
from scanloom import Image, Material, Mesh, Texture, deviations
from scanloom.pipeline.evaluation.camera_photos import write_photos
from scanloom.pipeline.evaluation.stored_deviations import (
    FIGURES,
    MESH_FILE,
    make_stored_deviations,
    read_deviations,
    write_deviations,
)
from scanloom.pipeline.report.run_page import make_run_page
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh_files import write_mesh

N = 8


def make_raised_sheet() -> Mesh:
    """Make a textured sheet that is 2 mm higher in one half."""
    mesh = sheet(N)
    vertices = mesh.vertices + np.where(mesh.vertices[:, :1] > 0.5, (0, 0, 0.002), 0)
    pixels = np.full((16, 16, 3), 99, np.uint8)
    uvs = mesh.vertices[mesh.triangles][..., :2]
    texture = Texture(uvs, np.zeros(len(uvs), np.int32), (Material(image=Image(given=pixels)),))
    return mesh.with_(vertices=vertices, colors=None, texture=texture, up=(0, 0, 1))


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """Write the results of a run without a report."""
    folder = tmp_path / "out"
    (folder / "texture_maps").mkdir(parents=True)
    (folder / "pictures").mkdir()
    write_ply(folder / "refined.ply", sheet(N))
    write_ply(folder / "simplified.ply", make_raised_sheet().with_(texture=None, colors=sheet(N).colors))
    write_mesh(folder / "textured.glb", make_raised_sheet())
    counts = np.zeros((16, 16), np.uint8)
    counts[:, 8:] = 6
    cv2.imwrite(str(folder / "texture_maps" / "count-1.png"), counts)
    return folder


def read_models(page: bytes) -> dict[str, Any]:
    return {one["name"]: one for one in read_page_content(page)["models"]}


def decode_values(page: bytes, channel: int, model: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Decode positions and values of a model from its file in the page."""
    from scanloom.stages._kernels import decode_rows

    glb = base64.b64decode(read_page_content(page)["files"][model])
    length = struct.unpack_from("<I", glb, 12)[0]
    tree = json.loads(glb[20 : 20 + length])
    binary = glb[20 + length + 8 :]
    attributes = tree["meshes"][0]["primitives"][0]["attributes"]
    node = next(one for one in tree["nodes"] if "mesh" in one)

    def rows(name: str, kind: Any, width: int) -> np.ndarray:
        view = tree["bufferViews"][tree["accessors"][attributes[name]]["bufferView"]]
        packed = view["extensions"]["EXT_meshopt_compression"]
        data = binary[packed["byteOffset"] :][: packed["byteLength"]]
        raw = decode_rows(data, packed["count"], packed["byteStride"], packed.get("filter", "NONE"))
        return np.frombuffer(raw, kind).reshape(-1, width)

    places = rows("POSITION", np.uint16, 4)[:, :3] * node["scale"] + node["translation"]
    return places, rows("_VALUES", np.uint8, 4)[:, channel]


def fail_on_call(text: str) -> None:
    raise AssertionError(text)


def test_without_a_report_the_page_measures_itself(out: Path) -> None:
    page = make_run_page(out, 5_000_000)
    looks = read_models(page)
    assert list(looks) == ["result", "refined mesh", "deviation", "confidence", "vertex colours"]
    scale = looks["deviation"]["scale"]
    assert scale["high"] == -scale["low"]
    assert 1.5 < scale["high"] < 2.1
    assert sum(scale["shares"]) == pytest.approx(1, abs=0.01)
    assert len(scale["safe"]) == len(scale["colors"])
    places, values = decode_values(page, 0)
    raised = values[places[:, 0] > 0.55]
    assert (raised > 220).all(), "over, as the reference looks up"
    assert (np.abs(values[places[:, 0] < 0.45].astype(int) - 127.5) < 3).all()


def test_confidence_is_the_number_of_photos(out: Path) -> None:
    page = make_run_page(out, 5_000_000)
    look = read_models(page)["confidence"]
    assert look["scale"]["marks"][-1] == 6
    assert (look["scale"]["low"], look["scale"]["high"]) == (-0.5, 6.5)
    places, values = decode_values(page, 1)
    counts = values / 255 * 7 - 0.5
    np.testing.assert_allclose(counts[places[:, 0] < 0.45], 0, atol=0.02)
    np.testing.assert_allclose(counts[places[:, 0] > 0.55], 6, atol=0.02)
    # Half of the surface, weighted by area.
    assert look["scale"]["shares"][0] == pytest.approx(0.5, abs=0.05)
    (out / "texture_maps" / "count-1.png").unlink()
    assert "confidence" not in read_models(make_run_page(out, 5_000_000))


FILLING = {"area_m2": 0.02, "border_m": 0.5, "point_m": [0.25, 0.75, 0.1]}
REFINE = {"filled_holes": 3, "filled_area_m2": 0.03, "largest_fillings": [FILLING, FILLING]}


def _write_refine_metrics(out: Path, metrics: Any) -> None:
    refine = {"metrics": metrics, "cached": True, "compute_seconds": 1, "peak_memory_mb": 1, "reason": "",
              "seconds": 0}  # fmt: skip
    (out / "report.json").write_text(json.dumps({"stages": {"refine": refine}}))


def test_filled_holes_are_marked_and_listed(out: Path) -> None:
    mesh = sheet(N)
    filled = (mesh.vertices[:, 0] > 0.45) & (mesh.vertices[:, 1] < 0.3)
    write_ply(out / "refined.ply", mesh, vertex_values={"filled": filled.astype(np.float64)})
    _write_refine_metrics(out, REFINE)
    page = make_run_page(out, 5_000_000)
    scale = read_models(page)["filled holes"]["scale"]
    assert len(scale["colors"]) == 2
    places, values = decode_values(page, 0, model=1)
    inside = (places[:, 0] > 0.45) & (places[:, 1] < 0.3)
    # The first half of the values is drawn in the first colour.
    np.testing.assert_array_equal(values > 127, inside)
    assert inside.any()
    of_filled = filled[mesh.triangles].any(axis=1).mean()
    assert scale["shares"][1] == pytest.approx(of_filled, abs=0.05)
    tables = read_page_content(page)["tables"]
    (table,) = (one for one in tables if one["title"].startswith("Filled holes"))
    assert table["title"] == "Filled holes: 3, 0.03 m² in total; the largest ones"
    assert table["rows"] == [["0.02 m²", "0.5 m", "0.25, 0.75, 0.1"]] * 2
    np.testing.assert_allclose(table["places"][0]["target"], FILLING["point_m"])


def test_nothing_is_marked_if_no_hole_was_filled(out: Path) -> None:
    for values in ({}, {"filled": np.zeros(len(sheet(N).vertices))}):
        write_ply(out / "refined.ply", sheet(N), vertex_values=values)
        _write_refine_metrics(out, {"filled_holes": 0, "filled_area_m2": 0.0, "largest_fillings": []})
        page = make_run_page(out, 5_000_000)
        assert "filled holes" not in read_models(page)
        assert not [one for one in read_page_content(page)["tables"] if one["title"].startswith("Filled")]


@pytest.mark.parametrize(
    "metrics",
    [7, [], {"largest_fillings": 7}, {"largest_fillings": [7]}, {**REFINE, "largest_fillings": [{}]},
     {**REFINE, "filled_area_m2": "x"}, {**REFINE, "largest_fillings": [{**FILLING, "point_m": [1]}]}],
)  # fmt: skip
def test_damaged_fillings_are_an_input_error(out: Path, metrics: Any) -> None:
    _write_refine_metrics(out, metrics)
    with pytest.raises(InputError, match=r"report\.json"):
        make_run_page(out, 5_000_000)


def test_deviations_of_the_report_are_reused(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = deviations(sheet(N), make_raised_sheet(), signed_samples=2000)
    write_deviations(out / "pictures", found)
    again = read_models(make_run_page(out, 5_000_000))
    monkeypatch.setattr(scanloom.pipeline.report.run_page.stages, "deviations", fail_on_call)
    assert read_models(make_run_page(out, 5_000_000))["deviation"] == again["deviation"]
    kept, read = make_stored_deviations(found), read_deviations(out / "pictures")
    assert read is not None
    np.testing.assert_array_equal(read.quantiles, kept.quantiles)
    np.testing.assert_allclose(read.at_vertices, kept.at_vertices, atol=1e-9)
    for low, high in ((-1, 1), (0.001, 0.003), (-0.0005, 0.0005)):
        share = ((found.sample_distances >= low) & (found.sample_distances <= high)).mean()
        assert read.compute_ratio_within(low, high) == pytest.approx(share, abs=0.002)


def test_deviations_of_another_result_are_not_shown(out: Path) -> None:
    write_deviations(out / "pictures", deviations(sheet(4), sheet(4), signed_samples=100))
    assert read_models(make_run_page(out, 5_000_000))["deviation"]["scale"]["high"] > 1.5


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"metrics": 7, "quantiles_m": []}', '{"metrics": {}, "quantiles_m": "x"}']
)
def test_damaged_metrics_are_an_input_error(out: Path, text: str) -> None:
    write_deviations(out / "pictures", deviations(sheet(N), make_raised_sheet(), signed_samples=100))
    (out / "pictures" / FIGURES).write_text(text)
    with pytest.raises(InputError, match="pictures"):
        make_run_page(out, 5_000_000)


CHANGES: dict[str, Callable[[Any], Any]] = {
    "no worst places": lambda told: told["metrics"].pop("worst"),
    "descending": lambda told: told["quantiles_m"].reverse(),
    "no percentiles": lambda told: told["metrics"].update(absolute_percentiles_m="x"),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_changed_metrics_are_an_input_error(out: Path, change: Any) -> None:
    write_deviations(out / "pictures", deviations(sheet(N), make_raised_sheet(), signed_samples=100))
    path = out / "pictures" / FIGURES
    told = json.loads(path.read_text())
    change(told)
    path.write_text(json.dumps(told))
    with pytest.raises(InputError, match="pictures"):
        make_run_page(out, 5_000_000)


def test_a_mesh_without_deviations_is_an_input_error(out: Path) -> None:
    write_deviations(out / "pictures", deviations(sheet(N), make_raised_sheet(), signed_samples=100))
    write_ply(out / "pictures" / MESH_FILE, make_raised_sheet().with_(texture=None))
    with pytest.raises(InputError, match="no property `deviation`"):
        make_run_page(out, 5_000_000)


def test_frames_are_marked_by_their_status(out: Path) -> None:
    lens = Camera(80, 60, 70, 70, 39.5, 29.5)
    frames = [Frame(f"f{k}", lens, color=np.zeros((60, 80, 3), np.uint8), world_from_camera=np.eye(4))
              for k in range(4)]  # fmt: skip
    write_photos(out / "pictures", frames[:3], 4, frames[3:])
    skipped = [{"frame": "f1", "reason": "its depth is damaged"}]
    report = {
        "scan": {"frames": 3, "frames_skipped": [{"frame": "lost", "reason": "no pose"}]},
        "held_out": {"photos": 1},
        "stages": {"fuse": {"metrics": {"frames_skipped": skipped}, "cached": True, "compute_seconds": 1,
                            "peak_memory_mb": 1, "reason": "", "seconds": 0}},
        "placed": {"fuse": {"fused.ply": "c0ffee"}}, "scanloom": "9.9", "libraries": {"numpy": "2"},
    }  # fmt: skip
    (out / "report.json").write_text(json.dumps(report))
    content = read_page_content(make_run_page(out, 5_000_000))
    marks = {one["frame"]: one["mark"] for one in content["cameras"]}
    assert marks == {"f0": "", "f1": "fuse: its depth is damaged", "f2": "", "f3": "held out"}
    assert content["frames"] == "3 frames were read; 1 were held out for evaluation; 2 were skipped."
    table = next(one for one in content["tables"] if one["title"] == "Skipped frames")
    assert table["rows"] == [["lost", "no pose"], ["f1", "fuse: its depth is damaged"]]
    digests = next(one["text"] for one in content["texts"] if one["title"] == "Versions and digests")
    assert {"scanloom 9.9", "numpy 2", "c0ffee  fused.ply"} <= set(digests.splitlines())
