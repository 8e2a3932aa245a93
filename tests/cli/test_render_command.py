"""Command `render`: labels, scale bar, side by side, free views, videos, and refused options."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

Run = Callable[..., Any]


def read_image(path: Path) -> np.ndarray:
    return np.asarray(cv2.imread(str(path))).astype(int)


def test_labels_and_scale_bar_are_drawn_over_the_same_image(
    scanloom: Run, clean_ball: Path, tmp_path: Path
) -> None:
    plain, worded = tmp_path / "plain.png", tmp_path / "worded.png"
    words = ("--width", 240, "--set", "picture.height=200")
    assert scanloom("render", clean_ball, plain, *words).exit_code == 0
    ran = scanloom(
        "render", clean_ball, worded, *words, "--set", "picture.labels=files", "--scale-bar", "--json"
    )
    assert ran.exit_code == 0, ran.stderr
    assert read_image(plain).shape == (200, 240, 3)
    changed = (read_image(plain) != read_image(worded)).any(axis=2)
    assert changed[:30].any()
    assert changed[170:].any()
    assert not changed[40:150, 130:].any()
    assert ran.json["scale_bar_m"] > 0
    assert ran.json["scale_bar_at_m"] > ran.json["scale_bar_m"]


def test_two_meshes_are_drawn_side_by_side_from_one_viewpoint(
    scanloom: Run, clean_ball: Path, tmp_path: Path
) -> None:
    target, alone = tmp_path / "both.png", tmp_path / "alone.png"
    ran = scanloom("render", clean_ball, clean_ball, target, "--width", 100, "--set", "picture.labels=off")
    assert ran.exit_code == 0, ran.stderr
    scanloom("render", clean_ball, alone, "--width", 100)
    np.testing.assert_array_equal(
        read_image(target), np.hstack([read_image(alone), np.full((75, 8, 3), 255), read_image(alone)])
    )
    named = scanloom(
        "render", clean_ball, clean_ball, target, "--width", 100, "--set", "picture.labels=A | B"
    )
    assert named.exit_code == 0, named.stderr
    left, right = read_image(target)[:, :100], read_image(target)[:, 108:]
    assert (left != read_image(alone)).any()
    assert (left != right).any()


def test_a_free_view_and_a_turntable_are_rendered(scanloom: Run, clean_ball: Path, tmp_path: Path) -> None:
    free, video = tmp_path / "free.png", tmp_path / "turn.mp4"
    ran = scanloom("render", clean_ball, free, "--width", 64, "--eye", 0, 0, 9, "--look", 0, 0, 0, "--json")
    assert (ran.exit_code, ran.json["viewpoint"]) == (0, "free")
    ran = scanloom(
        "render",
        clean_ball,
        video,
        "--width",
        64,
        "--set",
        "turntable.frames=3",
        "--set",
        "turntable.fps=10",
        "--up",
        "+z",
        "--json",
    )
    assert ran.exit_code == 0, ran.stderr
    opened = cv2.VideoCapture(str(video))
    assert (ran.json["frames"], opened.get(cv2.CAP_PROP_FRAME_COUNT)) == (3, 3)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("out.png",), "one or more mesh files"),
        (("ball.ply", "out.png", "--eye", "0", "0", "1"), "both --eye and --look"),
        (("ball.ply", "out.png", "--set", "turntable.frames=9"), "--set turntable.frames needs a video"),
        (
            ("ball.ply", "out.png", "--set", "picture.field_of_view=50"),
            "--set picture.field_of_view needs --eye and --look",
        ),
        (("ball.ply", "out.mp4", "--viewpoint", "2"), "no single viewpoint"),
        (("ball.ply", "out.mp4", "--width", "101"), "even"),
        (("ball.ply", "out.png", "--set", "picture.labels=a|b"), "2 texts for 1 mesh"),
        (("ball.ply", "out.png", "--up", "left"), "up is 'left'"),
        (("ball.ply", "out.png", "--up", "none"), "needs an up axis"),
        (("ball.ply", "out.png", "--scan", ".", "--set", "picture.height=90"), "cameras of --scan"),
    ],
)
def test_options_without_effect_are_refused(
    scanloom: Run, ball: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], message: str
) -> None:
    monkeypatch.chdir(ball.parent)
    ran = scanloom("render", *words)
    assert (ran.exit_code, message in ran.stderr) == (2, True), ran.stderr
    assert not list(ball.parent.glob("out.*"))
