"""The page of a comparison in a browser: models, texts, and camera movements."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from browsers import launch_browser
from clouds import make_cloud

from scanloom import Mesh, stages
from scanloom.pipeline.report.comparison_page import make_comparison_page

pytestmark = pytest.mark.slow
UP = (0.0, 0.0, 1.0)
# Map coordinates, beyond the resolution of single precision.
FAR = np.array((432_100.0, 5_211_000.0, 310.0))


def make_ball(at: tuple[float, float, float], radius: float) -> tuple[np.ndarray, np.ndarray]:
    made = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    return np.array(made.vertices) + at, np.array(made.faces, np.int32)


def join_parts(*parts: tuple[np.ndarray, np.ndarray], color: tuple[int, int, int]) -> Mesh:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    vertices = np.concatenate([vertices for vertices, _ in parts]) + FAR
    triangles = np.concatenate([rows + start for (_, rows), start in zip(parts, starts, strict=False)])
    return Mesh(
        vertices, triangles.astype(np.int32), np.tile(np.array(color, np.uint8), (len(vertices), 1)), up=UP
    )


def compute_metrics(a: Mesh, b: Mesh, found: Any, moved: Any, views: Any) -> dict[str, Any]:
    return {
        **stages.compare(a, b, samples=2000).to_dict(),
        "deviation": found.to_dict(),
        "change": None if moved is None else moved.to_dict(),
        "views": None if views is None else views.to_dict(),
    }


def fail_on_call(text: str) -> None:
    raise AssertionError(text)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Make two spheres that change.

    One grows, one disappears, a new one appears; and a cloud of the first two.
    """
    folder = tmp_path_factory.mktemp("pages")
    before = join_parts(make_ball((0, 0, 0), 1), make_ball((1.75, 0, 0), 0.3), color=(200, 120, 40))
    after = join_parts(make_ball((0, 0, 0), 1.02), make_ball((3, 0, 0), 0.5), color=(40, 120, 200))
    points = make_cloud(before.vertices * (1, 1, 1), before.colors).with_(up=UP)
    written = {}
    for name, other in (("meshes", after), ("points", points)):
        found = stages.deviations(before, other, tolerance=0.01, color_range=0.05, signed_samples=3000)
        moved = views = None
        if name == "meshes":
            moved = stages.changes(before, other, change_distance=0.2)
            views = stages.compare_views(before, other, views=1, view_width=64)
        metrics = compute_metrics(before, other, found, moved, views)
        names = ("before.ply", "<i>after</i>.ply")
        page = make_comparison_page(names, (before, other), found, moved, metrics, 5_000_000)
        written[name] = folder / f"{name}.html"
        written[name].write_bytes(page)
    return written


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with launch_browser() as started:
        yield started


@pytest.fixture(params=["meshes", "points"])
def page(request: pytest.FixtureRequest, chromium: Any, pages: dict[str, Path]) -> Iterator[Any]:
    said: list[str] = []
    asked: list[str] = []
    opened = chromium.new_page(viewport={"width": 640, "height": 480})
    opened.on("console", lambda message: said.append(message.text))
    opened.on("pageerror", lambda error: said.append(str(error)))
    opened.on("request", lambda request: asked.append(request.url))
    opened.goto(pages[request.param].as_uri())
    opened.wait_for_selector("#message", state="hidden", timeout=60_000)
    opened.is_of_meshes = request.param == "meshes"
    yield opened
    assert said == []
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [pages[request.param].as_uri()]
    opened.close()


def wait_for(page: Any, what: str) -> None:
    for _ in range(300):
        if page.evaluate(what):
            return
        time.sleep(0.1)
    pytest.fail(what)


def take_screenshot(page: Any, key: str) -> np.ndarray:
    """Show a model by its key and take a screenshot without toolbar and legend."""
    page.keyboard.press(key)
    wait_for(page, f"scanloom.settings().model === {int(key) - 1}")
    page.evaluate("scanloom.drawn()")
    data = page.locator("#picture").screenshot()
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1].astype(int)
    return image[: image.shape[0] * 2 // 3, : image.shape[1] * 3 // 4]


def count_colors(image: np.ndarray) -> dict[str, int]:
    red, green, blue = np.moveaxis(image, 2, 0)
    return {
        "red": int(((red - green > 60) & (red - blue > 60)).sum()),
        "green": int(((green - red > 50) & (green - blue > 20)).sum()),
        "blue": int(((blue - red > 60) & (blue - green > 30)).sum()),
    }


def test_models_have_their_colours_and_the_deviation_its_scale(page: Any) -> None:
    options = page.locator("#model option").all_inner_texts()
    assert options[:3] == ["deviation of B from A", "A: before.ply", "B: <i>after</i>.ply"]
    deviation = count_colors(take_screenshot(page, "1"))
    assert page.locator("#legend").is_visible()
    assert {"mm", "+50", "+10", "-10", "-50"} <= set(page.inner_text("#legend").split())
    assert count_colors(take_screenshot(page, "2"))["red"] > 500
    assert page.locator("#legend").is_hidden()
    if page.is_of_meshes:
        # The grown sphere is outside by more than the tolerance, and so is the new one.
        assert deviation["red"] > 500
        assert count_colors(take_screenshot(page, "3"))["blue"] > 500
        assert options[3:] == ["change"]
        change = count_colors(take_screenshot(page, "4"))
        assert change["green"] > 100
        assert change["red"] > 30
    else:
        assert deviation["green"] > 500
        assert deviation["red"] == 0
        assert count_colors(take_screenshot(page, "3"))["red"] > 500
        assert "points, each a triangle" in page.inner_text("#metrics")
        assert len(options) == 3


def test_the_table_lists_deviations_and_moves_the_camera(page: Any) -> None:
    facts = page.locator("#facts dd").all_inner_texts()
    assert facts[:4:2] == ["before.ply", "<i>after</i>.ply"]
    assert page.evaluate("document.querySelector('i')") is None
    text = page.inner_text("#report")
    assert "Deviation of B from A, sampled" in text
    assert "before.ply" in page.title()
    assert ("Farther than 200 mm" in text) == page.is_of_meshes
    assert ("Pictures from all around, in colour" in text) == page.is_of_meshes
    assert "nan" not in text.lower()
    if page.is_of_meshes:
        # The largest deviation is on the new sphere; the table gives its position in file coordinates.
        row = page.locator("#report table").nth(1).locator("tbody tr").first
        place = np.array([float(word) for word in row.locator("td").nth(1).inner_text().split(",")])
        assert np.linalg.norm(place - FAR - (3, 0, 0)) == pytest.approx(0.5, abs=0.02)
        row.get_by_role("button").click()
        np.testing.assert_allclose(page.evaluate("scanloom.view()")["target"], place, atol=2e-3)


def test_two_models_are_aligned(page: Any) -> None:
    """At map coordinates, single precision has a resolution of half a metre."""
    first, second = (take_screenshot(page, key) for key in ("2", "3"))
    background = first[0, 0]
    shown = [(np.abs(image - background).max(axis=2) > 20)[40:] for image in (first, second)]
    if not page.is_of_meshes:
        assert (shown[0] & shown[1]).sum() / (shown[0] | shown[1]).sum() > 0.9
