"""Plots: valid files with the expected content, deterministic."""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import cv2
import numpy as np
import pytest
from coloured_meshes import sheet

from scanloom import UsageError, tradeoff
from scanloom.stages.rendering.plots import plot_seconds, plot_tradeoff, require_plots


def count_dark_pixels(pixels: np.ndarray) -> int:
    return int((pixels.max(axis=2) < 200).sum())


@pytest.mark.slow
@pytest.mark.parametrize("mesh", [sheet(12), sheet(12).with_(colors=None)], ids=["coloured", "plain"])
def test_the_curve_is_drawn(tmp_path: Path, mesh: object) -> None:
    found = tradeoff(mesh, steps=5, samples=500)
    plot_tradeoff(tmp_path / "a.png", found)
    image = cv2.imread(str(tmp_path / "a.png"))
    assert image.shape[1] == 1050
    assert count_dark_pixels(image) > 5000
    for name in ("a.svg", "b.svg"):
        plot_tradeoff(tmp_path / name, found)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    assert ElementTree.parse(tmp_path / "a.svg").getroot().tag.endswith("svg")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "a.svg", "b.svg"]


@pytest.mark.slow
def test_a_curve_without_error_can_be_drawn(tmp_path: Path) -> None:
    plot_tradeoff(tmp_path / "a.png", tradeoff(sheet(4), counts=[10**6], samples=50))
    assert cv2.imread(str(tmp_path / "a.png")) is not None


def test_bars_are_proportional_to_the_time_of_stages(tmp_path: Path) -> None:
    plot_seconds(tmp_path / "a.png", {"fuse": 4.0, "simplify": 1.0}, {"simplify"})
    image = cv2.imread(str(tmp_path / "a.png")).astype(int)
    blue = image[..., 0] - image[..., 2] > 80
    grey = (image == 0x99).all(axis=2)
    lengths = [int(part.sum(axis=1).max()) for part in (blue, grey)]
    assert lengths[0] == pytest.approx(4 * lengths[1], rel=0.03)
    assert np.flatnonzero(blue.any(axis=1)).max() < np.flatnonzero(grey.any(axis=1)).min(), "in their order"


def test_without_matplotlib_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(UsageError, match=r"plots require matplotlib; install scanloom\[plot\]\."):
        require_plots()
