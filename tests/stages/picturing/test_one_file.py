"""A page of models in one file: opens from a disk, asks nobody, stands upright, measures."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browsers import browser

from stages import Mesh, export, preset
from stages.picturing.page.one_file import PageModel, one_file
from stages.picturing.page.standing import facing
from stages.picturing.render import render
from stages.picturing.viewpoints import Viewpoint
from stages.scans.scan import Camera
from stages.surface.upright import turn_along_z

pytestmark = pytest.mark.slow
WIDTH, HEIGHT = 480, 360
ABOVE = 170
UP = (0.0, -1.0, 0.0)
EVIL = "</script><script>window.evil = 1</script><!--"


def body(color: tuple[int, int, int]) -> Mesh:
    """Return a box of 3 × 2 × 1 m on its side, in one colour, with a tower: no two sides look alike."""
    import trimesh

    parts = [
        trimesh.creation.box(extents=(3, 1, 2)),
        trimesh.creation.box(
            extents=(0.4, 1.5, 0.4), transform=trimesh.transformations.translation_matrix((1, -1, 0.5))
        ),
    ]
    made = trimesh.util.concatenate(parts)
    colors = np.tile(np.array(color, np.uint8), (len(made.vertices), 1))
    return Mesh(np.array(made.vertices), np.array(made.faces, np.int32), colors, up=UP)


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    models = []
    for name, color in (("red", (200, 20, 20)), ("blue", (20, 20, 200))):
        export(body(color), folder / "m.glb", preset("web"))
        models.append(PageModel(name, (folder / "m.glb").read_bytes(), 24))
    told = {
        "warnings": [EVIL],
        "tables": [{"title": "Places", "head": ["a", ""], "rows": [[EVIL]],
                    "places": [{"target": [1, 0, 1], "away": 2}]}],
        "texts": [{"title": "text", "text": EVIL}],
    }  # fmt: skip
    (folder / "page.html").write_bytes(one_file(EVIL, models, told))
    return folder / "page.html"


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as started:
        yield started


@pytest.fixture
def page(chromium: Any, page_file: Path) -> Iterator[Any]:
    said: list[str] = []
    asked: list[str] = []
    opened = chromium.new_page(viewport={"width": WIDTH, "height": HEIGHT})
    opened.on("console", lambda message: said.append(message.text))
    opened.on("pageerror", lambda error: said.append(str(error)))
    opened.on("request", lambda request: asked.append(request.url))
    opened.goto(page_file.as_uri())
    opened.wait_for_selector("#message", state="hidden", timeout=60_000)
    yield opened
    assert said == []
    # Itself, and what is inside of it.
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [page_file.as_uri()]
    opened.close()


def wait_for(page: Any, what: str) -> None:
    """Wait until an expression holds; the page forbids what playwright would wait with."""
    for _ in range(300):
        if page.evaluate(what):
            return
        time.sleep(0.1)
    pytest.fail(what)


def image(page: Any) -> np.ndarray:
    page.evaluate("scanloom.drawn()")
    data = page.locator("#picture").screenshot()
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1].astype(int)


def red(pixels: np.ndarray) -> np.ndarray:
    return np.asarray(pixels[..., 0] - pixels[..., 2] > 40)


def blue(pixels: np.ndarray) -> np.ndarray:
    return np.asarray(pixels[..., 2] - pixels[..., 0] > 40)


def test_it_is_seen_where_our_own_renderer_sees_it(page: Any) -> None:
    page.add_style_tag(
        content="form, #scale { display: none !important } #stage { height: 360px !important }"
    )
    eye, target = np.array((4.0, -5.0, 3.0)), np.array((0.2, 0.1, 0.2))
    page.evaluate("view => scanloom.look(view)", {"eye": eye.tolist(), "target": target.tolist(), "fov": 50})
    seen = image(page)
    height, width = seen.shape[:2]
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, (0, 0, 1))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = eye
    # From the upright frame back to the axes of the scan.
    pose[:3] = turn_along_z(np.array(UP)).T @ pose[:3]
    focal = height / 2 / np.tan(np.radians(25))
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    drawn = render(body((200, 20, 20)), Viewpoint("same", camera, pose)).astype(int)
    ours, theirs = red(drawn), red(seen)
    assert ours.mean() > 0.05
    # But for the pixels along outlines.
    assert (ours & theirs).sum() / (ours | theirs).sum() > 0.97


def test_models_modes_keys_and_measuring(page: Any) -> None:
    # Above the bar, which has a blue of its own.
    assert red(image(page)[:ABOVE]).any()
    page.keyboard.press("2")
    wait_for(page, "scanloom.settings().model === 1")
    assert blue(image(page)[:ABOVE]).any()
    assert not red(image(page)[:ABOVE]).any()
    page.select_option("#mode", "clay")
    assert not blue(image(page)[:ABOVE]).any()
    page.select_option("#mode", "colors")
    page.click("#measure")
    # Across the 3 m of the front, at its two lower corners from straight ahead.
    page.evaluate("scanloom.look({ eye: [0, -12, 0], target: [0, 0, 0], fov: 30 })")
    page.evaluate("scanloom.drawn()")
    canvas = page.evaluate(
        "[document.getElementById('picture').clientWidth, document.getElementById('picture').clientHeight]"
    )
    pixels = canvas[1] / (2 * np.tan(np.radians(15)) * 11)
    for x in (-1.4, 1.4):
        assert page.evaluate("([x, y]) => scanloom.pick(x, y)", [canvas[0] / 2 + x * pixels, canvas[1] / 2])
    assert page.evaluate("scanloom.distance()") == pytest.approx(2.8, abs=0.03)
    assert "2.8" in page.inner_text("#figures")
    page.keyboard.press("Escape")
    assert page.evaluate("scanloom.points()") == []
    assert page.inner_text("#scale").split()[1] in ("m", "cm", "mm")


def test_places_are_flown_to_and_words_are_no_html(page: Any) -> None:
    assert page.evaluate("window.evil") is None
    assert page.title() == EVIL
    assert page.inner_text(".warning") == EVIL
    before = page.evaluate("scanloom.view()")
    page.get_by_role("button", name="fly there").click()
    after = page.evaluate("scanloom.view()")
    np.testing.assert_allclose(after["target"], (1, 0, 1), atol=1e-6)
    assert after["eye"] != before["eye"]
    assert np.linalg.norm(np.array(after["eye"]) - after["target"]) == pytest.approx(2, rel=0.01)


@pytest.mark.parametrize(("width", "scheme"), [(360, "dark"), (1400, "light")])
def test_narrow_and_wide_fit(chromium: Any, page_file: Path, width: int, scheme: str) -> None:
    opened = chromium.new_page(viewport={"width": width, "height": 700}, color_scheme=scheme)
    opened.goto(page_file.as_uri())
    opened.wait_for_selector("#message", state="hidden", timeout=60_000)
    assert opened.evaluate("document.documentElement.scrollWidth") <= width
    for name in ("#mode", "#measure", "#all", "#scale"):
        box = opened.locator(name).bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= width
    paper = opened.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (paper == "rgb(23, 27, 33)") == (scheme == "dark")
    opened.close()


def test_what_was_seen_from_one_side_is_looked_at_from_there() -> None:
    wall = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1.0]]), np.array([[0, 1, 2]], np.int32))
    assert facing(wall, np.eye(3)) == [0, -1, 0]
    assert facing(body((1, 2, 3)), np.eye(3)) is None
