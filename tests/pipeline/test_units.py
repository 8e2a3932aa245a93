"""Units of scans without metric scale in reports and pages; photos get the scale of their scan."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from coloured_meshes import sheet

from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.config import Config
from scanloom.pipeline.report.report_summary import make_deviation_tables, summarize_report
from scanloom.pipeline.report.run_page import make_run_page
from scanloom.pipeline.run.report_document import compose_report
from scanloom.pipeline.run.run import prepare_run
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.scan import Camera, Frame, Scan
from scanloom.stages.scans.model.world import Scale
from scanloom.stages.surface.formats.ply import write_ply

CAMERA = Camera(8, 6, 5.0, 5.0, 3.5, 2.5)


def test_a_report_states_if_the_scale_is_metric(tmp_path: Path) -> None:
    scan = Scan("colmap", [], is_metric=False)
    said = compose_report(scan, (), (), {}, tmp_path)["scan"]
    assert (said["metric"], said["scale"]) == (False, None)
    metric = replace(scan, is_metric=True, scale=Scale(0.3, "given"))
    said = json.loads(json.dumps(compose_report(metric, (), (), {}, tmp_path)["scan"]))
    assert said["metric"]
    assert said["scale"] == {"metres_per_unit": 0.3, "source": "given", "spread_ratio": None}


def test_a_page_shows_lengths_in_units_without_metric_scale(tmp_path: Path) -> None:
    assert "unit" not in summarize_report({"scan": {"metric": True}})
    assert summarize_report({"scan": {"metric": False}})["unit"] == "units"
    told = {"absolute_percentiles_m": {"95": 0.25}, "rms_m": 0.5, "within_ratio": 1.0, "tolerance_m": 2.0}
    told |= {"delta_e_2000": None, "worst": [{"distance_m": 0.75, "point_m": [1, 2, 3]}]}
    words = json.dumps(make_deviation_tables(told, 0.5, [], is_metric=False))
    assert "0.25 units" in words
    assert "location in scan coordinates, units" in words
    assert "mm" not in words
    assert "250 mm" in json.dumps(make_deviation_tables(told, 0.5, []))

    for name in ("simplified", "clean"):
        write_ply(tmp_path / f"{name}.ply", sheet(4))
    (tmp_path / "report.json").write_text(json.dumps({"scan": {"metric": False}}))
    page = make_run_page(tmp_path, 5_000_000)
    assert b'"unit": "units"' in page
    assert b'"unit": "mm"' not in page


@pytest.fixture
def both(tmp_path: Path) -> tuple[Path, Path]:
    """Make a scan, and photos in its coordinate system; neither has a known unit."""
    scan, images = tmp_path / "scan", tmp_path / "photos"
    entries = []
    for folder in (scan, images):
        folder.mkdir()
    for number in range(3):
        pose = np.eye(4)
        pose[0, 3] = 0.5 * number
        cv2.imwrite(str(scan / f"{number}.png"), np.full((6, 8), 1000, np.uint16))
        cv2.imwrite(str(images / f"{number}.png"), np.full((6, 8, 3), 90, np.uint8))
        entries.append((f"{number}.png", pose))
    frames = [
        Frame(name, CAMERA, color=images / name, depth=scan / name, world_from_camera=pose)
        for name, pose in entries
    ]
    write_scan_json(scan, [replace(one, color=None) for one in frames], is_metric=False)
    views = [{"file_path": name, "transform_matrix": pose.tolist()} for name, pose in entries]
    table = {"w": 8, "h": 6, "fl_x": 5.0, "cx": 4, "cy": 3, "frames": views}
    (images / "transforms.json").write_text(json.dumps(table))
    return scan, images


@pytest.mark.parametrize(
    ("settings", "factors", "told"),
    [
        ([], (1, 1), 2),
        (["scan.scale=0.5"], (0.5, 0.5), 0),
        (["scan.known_distance=2 1"], (0.5, 0.5), 0),
        (["scan.scale=0.5", "photos.scale=0.25"], (0.5, 0.25), 0),
        (["photos.scale=0.25"], (1, 0.25), 1),
    ],
)
def test_photos_are_scaled_with_their_scan(
    both: tuple[Path, Path], tmp_path: Path, settings: list[str], factors: tuple[float, float], told: int
) -> None:
    scan, images = both
    config = Config().set([f"texture.images={images}", *settings])
    wanted = prepare_run(scan, tmp_path / "out", config, None, (), Cache(tmp_path / "cache"))
    assert wanted.photos is not None
    places = [one.frames[2].world_from_camera for one in (wanted.scan, wanted.photos)]
    assert [None if one is None else one[0, 3] for one in places] == pytest.approx(list(factors))
    assert sum("no metric scale" in text for text in map(str, wanted.diagnostics)) == told
