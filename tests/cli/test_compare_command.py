"""Command `compare`: signs, tolerance, alignment, images, and messages about wrong options."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from clouds import make_cloud, write_cloud
from coloured_sheet import make_bumpy_body

from scanloom.pipeline.report.page.single_file_page import is_page
from scanloom.stages.surface.mesh_files import read_mesh, write_mesh
from scanloom.stages.surface.point_cloud_files import read_mesh_or_cloud

Run = Callable[..., Any]


@pytest.fixture
def larger(clean_ball: Path, tmp_path: Path) -> Path:
    """Write the ball enlarged by 1 %."""
    mesh = read_mesh(clean_ball)
    centre = mesh.vertices.mean(axis=0)
    write_mesh(tmp_path / "larger.ply", mesh.with_(vertices=centre + 1.01 * (mesh.vertices - centre)))
    return tmp_path / "larger.ply"


def test_compare_reports_signs_and_tolerance_and_saves_images(
    scanloom: Run, clean_ball: Path, larger: Path, tmp_path: Path
) -> None:
    target = tmp_path / "new"
    words = (
        "--tolerance",
        1e-9,
        "--save-ply",
        target / "d.ply",
        "--picture",
        target / "d.png",
        "--set",
        "compare.samples=20000",
    )
    ran = scanloom("compare", clean_ball, larger, *words, "--json")
    assert ran.exit_code == 0, ran.stderr
    result = ran.json["deviation"]
    assert result["is_signed"]
    assert result["lowest_m"] > 0
    assert result["over_ratio"] == pytest.approx(1)
    assert len(read_mesh(target / "d.ply").colors) == len(read_mesh(larger).vertices)
    assert cv2.imread(str(target / "d.png")).shape[1] > 1000
    text = scanloom("compare", clean_ball, larger, "--tolerance", 1).stdout
    assert "100.00% within 1 m" in text
    assert "signed mean" in text


def test_a_translated_mesh_is_aligned(scanloom: Run, tmp_path: Path) -> None:
    body = make_bumpy_body()
    write_mesh(tmp_path / "a.ply", body)
    write_mesh(tmp_path / "b.ply", body.with_(vertices=body.vertices + np.array((0.03, 0, 0.01))))
    ran = scanloom(
        "compare", tmp_path / "a.ply", tmp_path / "b.ply", "--align", "icp",
        "--save-aligned", tmp_path / "c.ply", "--json",
    )  # fmt: skip
    assert ran.exit_code == 0, ran.stderr
    motion = np.array(ran.json["alignment"]["reference_from_mesh"])
    np.testing.assert_allclose(motion[:3, 3], (-0.03, 0, -0.01), atol=2e-3)
    np.testing.assert_allclose(read_mesh(tmp_path / "c.ply").vertices, body.vertices, atol=3e-3)
    assert ran.json["distance"]["symmetric"]["rms_m"] < 2e-3


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--align", "magic"), "none or icp"),
        (("--save-aligned", "x.ply"), "needs --align icp"),
        (("--picture", "x.jpg"), "unknown file extension"),
        (("--set", "deviation.palette=grey"), "palette"),
        (("--tolerance", "-1"), "tolerance"),
    ],
)
def test_wrong_options_are_reported(
    scanloom: Run, clean_ball: Path, words: tuple[str, ...], message: str
) -> None:
    ran = scanloom("compare", clean_ball, clean_ball, *words)
    assert ran.exit_code == 2
    assert message in ran.stderr


def test_new_and_missing_regions_are_reported_with_areas(scanloom: Run, tmp_path: Path) -> None:
    body = make_bumpy_body()
    size = float(np.ptp(body.vertices[:, 0]))
    far = body.vertices + np.array((1.5 * size, 0, 0))
    both = body.with_(
        vertices=np.concatenate([body.vertices, far]),
        triangles=np.concatenate([body.triangles, body.triangles + len(body.vertices)]),
        colors=None if body.colors is None else np.concatenate([body.colors, body.colors]),
    )
    write_mesh(tmp_path / "a.ply", body)
    write_mesh(tmp_path / "b.ply", both)
    pair = (tmp_path / "a.ply", tmp_path / "b.ply", "--set", "compare.samples=20000")
    ran = scanloom("compare", *pair, "--change", "--save-change", tmp_path / "c.ply", "--json")
    assert ran.exit_code == 0, ran.stderr
    result = ran.json["change"]
    assert (result["new_regions"], result["gone_regions"]) == (1, 0)
    assert result["gone_area_m2"] == 0
    assert result["new_area_m2"] > 0
    colors = read_mesh(tmp_path / "c.ply").colors
    assert ((colors == (45, 160, 70)).all(axis=1)).sum() == len(body.vertices)
    assert "New in B" in scanloom("compare", *pair, "--change").stdout
    assert scanloom("compare", *pair, "--json").json["change"] is None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--save-change", "c.ply"), "--save-change needs --change"),
        (("--change", "--save-change", "c.stl"), ".stl"),
        (("--set", "views.views=-1"), "--set views.views"),
        (("--page", "p.htm"), "unknown file extension"),
    ],
)
def test_saving_needs_the_matching_option_and_a_suitable_format(
    scanloom: Run, clean_ball: Path, words: tuple[str, ...], message: str
) -> None:
    ran = scanloom("compare", clean_ball, clean_ball, *words)
    assert ran.exit_code == 2
    assert message in ran.stderr


NUMBER = r"[+-]?\d[\d.,]*(?:e[+-]\d+)?"
UNIT = r" (?:mm|m|dB|levels|points|samples|regions?)\b| m²| ?%|°"


def test_every_number_of_the_tables_has_a_unit(scanloom: Run, tmp_path: Path) -> None:
    """Every number is followed by a unit; ΔE2000 counts as a unit."""
    body = make_bumpy_body()
    pair = tmp_path / "a.ply", tmp_path / "b.ply"
    colors = np.tile(np.array((200, 120, 40), np.uint8), (len(body.vertices), 1))
    write_mesh(pair[0], body.with_(colors=colors))
    write_mesh(pair[1], body.with_(vertices=1.02 * body.vertices, colors=colors // 2))
    few = ("--set", "compare.samples=2000", "--set", "deviation.signed_samples=2000")
    change = ("--change", "--set", "change.change_distance=0.01")
    text = scanloom("compare", *pair, "--tolerance", 0.02, *change, "--align", "icp", *few).stdout
    assert "ΔE2000" in text
    assert "largest changes" in text
    assert "Deviations are unsigned" not in text
    for line in text.splitlines():
        # The unit of a point follows the bracket.
        stripped = re.sub(r"\([^)]*\) m\b|\d+(\.\d+)? ΔE2000|ΔE2000", "", line)
        for found in re.finditer(rf"(?<![\w.]){NUMBER}", stripped):
            rest = stripped[found.end() :]
            assert re.match(UNIT, rest) or rest.startswith(" on average"), line


@pytest.mark.slow
def test_rendered_views_are_compared_and_saved(
    scanloom: Run, clean_ball: Path, larger: Path, tmp_path: Path
) -> None:
    files = ("--save-views", tmp_path / "new" / "v")
    words = ("--set", "views.views=2", "--set", "views.view_width=96", *files, "--set", "compare.samples=500")
    ran = scanloom("compare", clean_ball, larger, *words, "--json")
    assert ran.exit_code == 0, ran.stderr
    result = ran.json["views"]
    assert result["compared"] == "colors"
    assert result["psnr_db"] > 20
    assert result["worst"] in ("view1", "view2")
    assert 0.9 < result["silhouette_iou"] < 1
    for one in result["each"]:
        assert cv2.imread(str(tmp_path / "new" / "v" / f"{one['viewpoint']}.png")).shape == (72, 288, 3)
    text = scanloom("compare", clean_ball, larger, *words).stdout
    assert "The comparison uses unlit colours" in text
    assert re.search(r"all +\d+\.\d dB +0\.\d{4} +\d+\.\d\d %", text)
    alone = scanloom("compare", clean_ball, larger, "--set", "compare.samples=500", "--json")
    assert alone.json["views"] is None


@pytest.fixture
def points(clean_ball: Path, tmp_path: Path) -> Path:
    """Write the vertices of the ball, scaled by 1.01, as a coloured point cloud."""
    mesh = read_mesh(clean_ball)
    return write_cloud(tmp_path / "points.laz", make_cloud(1.01 * mesh.vertices, mesh.colors))


def test_deviations_of_a_cloud_from_a_mesh_are_measured_and_drawn(
    scanloom: Run, clean_ball: Path, points: Path, tmp_path: Path
) -> None:
    files = ("--save-ply", tmp_path / "d.ply", "--picture", tmp_path / "d.png")
    words = (*files, "--set", "compare.samples=500")
    ran = scanloom("compare", clean_ball, points, *words, "--tolerance", 0.005, "--json")
    assert ran.exit_code == 0, ran.stderr
    count = len(read_mesh(clean_ball).vertices)
    assert ran.json["clouds"] == {
        "a": None,
        "b": {"points": count, "spacing_m": pytest.approx(0.14, abs=0.03)},
    }
    result = ran.json["deviation"]
    assert result["is_signed"]
    assert result["mean_m"] == pytest.approx(0.01, abs=1e-4)
    assert result["over_ratio"] == 1
    painted = read_mesh_or_cloud(tmp_path / "d.ply")
    assert (len(painted.vertices), len(painted.triangles)) == (count, 0)
    assert (painted.colors[:, 0] > painted.colors[:, 2]).all()
    assert cv2.imread(str(tmp_path / "d.png")).shape[1] > 1000
    text = scanloom("compare", clean_ball, points, "--set", "compare.samples=500").stdout
    assert f"B: point cloud of {count:,} points, all measured" in text
    assert "of its points is within" in text


def test_distances_from_a_cloud_are_reported_with_its_point_spacing(
    scanloom: Run, clean_ball: Path, points: Path
) -> None:
    ran = scanloom("compare", points, clean_ball, "--set", "compare.samples=500")
    assert ran.exit_code == 0, ran.stderr
    assert "treated as a point cloud of" in ran.stderr
    assert "A is a point cloud: distances below its point spacing, 1" in ran.stdout
    assert "compare B A" in ran.stdout
    assert "A has no normals" in ran.stdout


def test_options_that_need_two_meshes_are_refused_for_a_cloud(
    scanloom: Run, clean_ball: Path, points: Path, tmp_path: Path
) -> None:
    for words in (("--change",), ("--set", "views.views=2")):
        ran = scanloom("compare", clean_ball, points, *words)
        assert ran.exit_code == 2
        assert f"{' '.join(words).partition('=')[0]} needs two meshes" in ran.stderr
        assert "points.laz is a point cloud" in ran.stderr
    ran = scanloom("compare", clean_ball, points, "--align", "icp", "--save-aligned", tmp_path / "moved.glb")
    assert ran.exit_code == 2
    ran = scanloom("clean", points, tmp_path / "c.ply")
    assert ran.exit_code == 3
    assert "unknown format '.laz'" in ran.stderr


def test_a_cloud_is_aligned_to_a_mesh(scanloom: Run, tmp_path: Path) -> None:
    body = make_bumpy_body()
    write_mesh(tmp_path / "a.ply", body)
    write_cloud(tmp_path / "b.las", make_cloud(body.vertices + np.array((0.02, 0, -0.01))))
    saved = ("--save-aligned", tmp_path / "c.ply")
    ran = scanloom("compare", tmp_path / "a.ply", tmp_path / "b.las", "--align", "icp", *saved, "--json")
    assert ran.exit_code == 0, ran.stderr
    moved = read_mesh_or_cloud(tmp_path / "c.ply")
    np.testing.assert_allclose(moved.vertices, body.vertices, atol=4e-3)


def test_a_comparison_page_is_written(
    scanloom: Run, clean_ball: Path, larger: Path, points: Path, tmp_path: Path
) -> None:
    for other, words in ((larger, ("--change",)), (points, ())):
        target = tmp_path / "pages" / f"{other.stem}.html"
        ran = scanloom("compare", clean_ball, other, "--set", "compare.samples=500", *words, "--page", target)
        assert ran.exit_code == 0, ran.stderr
        assert is_page(target)
        assert target.stat().st_size < 5e6
