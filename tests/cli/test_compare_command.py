"""compare on files: signs, tolerance, alignment, pictures; and what bad words are told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from coloured_sheet import bumpy

from stages.surface.mesh_files import read_mesh, write_mesh

Run = Callable[..., Any]


@pytest.fixture
def larger(clean_ball: Path, tmp_path: Path) -> Path:
    """The ball, 1 % larger and moved by a little."""
    mesh = read_mesh(clean_ball)
    centre = mesh.vertices.mean(axis=0)
    write_mesh(tmp_path / "larger.ply", mesh.with_(vertices=centre + 1.01 * (mesh.vertices - centre)))
    return tmp_path / "larger.ply"


def test_signs_tolerance_and_pictures(scanloom: Run, clean_ball: Path, larger: Path, tmp_path: Path) -> None:
    target = tmp_path / "new"
    words = ("--tolerance", 1e-9, "--save-ply", target / "d.ply", "--picture", target / "d.png")
    ran = scanloom("compare", clean_ball, larger, *words, "--json")
    assert ran.exit_code == 0, ran.stderr
    told = ran.json["deviation"]
    assert told["is_signed"]
    assert told["lowest_m"] > 0
    assert told["share_over"] == pytest.approx(1)
    assert len(read_mesh(target / "d.ply").colors) == len(read_mesh(larger).vertices)
    assert cv2.imread(str(target / "d.png")).shape[1] > 1000
    text = scanloom("compare", clean_ball, larger, "--tolerance", 1).stdout
    assert "100.00% within 1 m" in text
    assert "mean, with signs" in text


def test_a_moved_mesh_is_aligned(scanloom: Run, tmp_path: Path) -> None:
    body = bumpy()
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
        (("--picture", "x.jpg"), "stands for no format"),
        (("--palette", "grey"), "palette"),
        (("--tolerance", "-1"), "tolerance"),
    ],
)
def test_wrong_words(scanloom: Run, clean_ball: Path, words: tuple[str, ...], message: str) -> None:
    ran = scanloom("compare", clean_ball, clean_ball, *words)
    assert ran.exit_code == 2
    assert message in ran.stderr


def test_what_is_new_and_gone_is_told_with_areas(scanloom: Run, tmp_path: Path) -> None:
    body = bumpy()
    size = float(np.ptp(body.vertices[:, 0]))
    far = body.vertices + np.array((1.5 * size, 0, 0))
    both = body.with_(
        vertices=np.concatenate([body.vertices, far]),
        triangles=np.concatenate([body.triangles, body.triangles + len(body.vertices)]),
        colors=None if body.colors is None else np.concatenate([body.colors, body.colors]),
    )
    write_mesh(tmp_path / "a.ply", body)
    write_mesh(tmp_path / "b.ply", both)
    pair = (tmp_path / "a.ply", tmp_path / "b.ply")
    ran = scanloom("compare", *pair, "--change", "--save-change", tmp_path / "c.ply", "--json")
    assert ran.exit_code == 0, ran.stderr
    told = ran.json["change"]
    assert (told["new_places"], told["gone_places"]) == (1, 0)
    assert told["gone_area_m2"] == 0
    assert told["new_area_m2"] > 0
    colors = read_mesh(tmp_path / "c.ply").colors
    assert ((colors == (45, 160, 70)).all(axis=1)).sum() == len(body.vertices)
    assert "New in B" in scanloom("compare", *pair, "--change").stdout
    assert scanloom("compare", *pair, "--json").json["change"] is None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--save-change", "c.ply"), "--save-change needs --change"),
        (("--change", "--save-change", "c.stl"), ".stl"),
    ],
)
def test_changes_need_their_option_and_colours(
    scanloom: Run, clean_ball: Path, words: tuple[str, ...], message: str
) -> None:
    ran = scanloom("compare", clean_ball, clean_ball, *words)
    assert ran.exit_code == 2
    assert message in ran.stderr
