"""Controls of the page in a browser: touch, centre, measurements, crop box, cameras and saved files."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browsers import launch_browser

from scanloom import Mesh
from scanloom.pipeline.report.page.packing import PageModelSource, make_packed_page
from scanloom.pipeline.report.page.page_header import PageFact, make_page_header
from scanloom.pipeline.report.page.single_file_page import PageCamera, make_image_url
from scanloom.stages.surface.up_direction import rotate_to_z

pytestmark = pytest.mark.slow
EVIL = '</script><img src=x onerror="window.evil = 1"><!--'
# The scan's y axis points down.
UP = (0.0, -1.0, 0.0)
# Extents of the box in scan coordinates, metres: wide, flat and deep.
EXTENTS = np.array((0.6, 0.2, 0.4))
CENTRE = np.array((1.0, 0.5, 2.0))
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
DESK = {"viewport": {"width": 1440, "height": 900}}


def make_box(extents: np.ndarray = EXTENTS) -> Mesh:
    import trimesh

    box = trimesh.creation.box(extents=extents)
    colors = np.tile(np.array((200, 60, 20), np.uint8), (len(box.vertices), 1))
    return Mesh(np.array(box.vertices) + CENTRE, np.array(box.faces, np.int32), colors, up=UP)


def make_camera(frame: str, eye: tuple[float, float, float]) -> PageCamera:
    """Make a camera without a photo that faces +y of the upright frame."""
    rows = [[1, 0, 0, eye[0]], [0, 0, 1, eye[1]], [0, -1, 0, eye[2]]]
    return PageCamera(frame, [float(x) for row in rows for x in row], [100, 80], [50, 50], [49.5, 39.5])


# Far in front of the box, beyond the planes that the model alone requires.
EYES = [(1.0, -2.0, -0.4), (3.0, -1.0, 0.5)]


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("controls") / "page.html"
    picture = make_image_url(cv2.imencode(".jpg", np.full((30, 40, 3), 90, np.uint8))[1].tobytes())
    facts = [PageFact(EVIL, EVIL, EVIL, "warnings"), PageFact("Size", "1 m")]
    report_data = {
        "header": make_page_header(facts, EVIL, picture),
        "warnings": [EVIL],
        "tables": [
            {"title": "Rows", "head": ["a", "b"], "rows": [["1", "2"]] * 40},
            {"title": EVIL, "text": EVIL, "head": ["a"], "rows": [[EVIL]], "folded": True},
        ],
    }
    cameras = [make_camera(str(number), eye) for number, eye in enumerate(EYES)]
    models = {"box": PageModelSource(make_box()), "copy": PageModelSource(make_box())}
    file.write_bytes(make_packed_page(EVIL, models, 5_000_000, report_data, cameras))
    return file


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with launch_browser() as started:
        yield started


Open = Callable[..., Any]


@pytest.fixture
def open_page(chromium: Any, page_file: Path) -> Iterator[Open]:
    """Open a page in a window, and check that it reports no error."""
    contexts, said = [], []

    def open_file(window: dict[str, Any], file: Path = page_file) -> Any:
        contexts.append(chromium.new_context(**window))
        page = contexts[-1].new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        started = time.monotonic()
        page.goto(file.as_uri())
        page.wait_for_selector("#message", state="hidden", timeout=60_000)
        print(f"first picture after {time.monotonic() - started:.2f} s")  # noqa: T201
        return page

    yield open_file
    for context in contexts:
        context.close()
    assert said == []


@pytest.fixture
def page(open_page: Open) -> Any:
    return open_page(DESK)


def get_size(page: Any) -> tuple[float, float]:
    canvas = page.locator("#picture").bounding_box()
    return canvas["width"], canvas["height"]


def project(page: Any, point: Any) -> np.ndarray:
    """Project a point of the upright frame to canvas pixels, with the view that the page reports."""
    view = page.evaluate("scanloom.view()")
    eye, target = np.array(view["eye"]), np.array(view["target"])
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, (0, 0, 1))
    right /= np.linalg.norm(right)
    width, height = get_size(page)
    focal = height / 2 / np.tan(np.radians(view["fov"] / 2))
    offset = np.asarray(point) - eye
    x, y = offset @ right, offset @ np.cross(forward, right)
    return np.array((width, height)) / 2 + focal * np.array((x, y)) / (offset @ forward)


def to_upright(point: Any) -> np.ndarray:
    return rotate_to_z(np.array(UP)) @ np.asarray(point)


def look_at_front(page: Any) -> list[np.ndarray]:
    """Look at the front of the box; return its four corners in scan coordinates, in order around it."""
    target = to_upright(CENTRE)
    eye = target - (0, 2, 0)
    page.evaluate("view => scanloom.look(view)", {"eye": eye.tolist(), "target": target.tolist()})
    page.evaluate("scanloom.drawn()")
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    front = [CENTRE + EXTENTS / 2 * np.array((x, y, 0)) for x, y in corners]
    depth = min((-1, 1), key=lambda side: to_upright((0, 0, side))[1])
    return [corner + np.array((0, 0, depth * EXTENTS[2] / 2)) for corner in front]


def pick(page: Any, point: np.ndarray) -> None:
    """Click the surface at a point in scan coordinates."""
    canvas = page.locator("#picture").bounding_box()
    x, y = project(page, to_upright(point))
    page.mouse.click(canvas["x"] + x, canvas["y"] + y)


def shrink(corners: list[np.ndarray]) -> list[np.ndarray]:
    """Move corners of the front to 90 % of their distance from its centre, where the surface is hit."""
    middle = np.mean(corners, axis=0)
    return [middle + 0.9 * (corner - middle) for corner in corners]


def take_screenshot(page: Any) -> np.ndarray:
    page.evaluate("scanloom.drawn()")
    data = page.locator("#picture").screenshot()
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).astype(int)


def touch(page: Any, *paths: list[tuple[float, float]]) -> None:
    """Move fingers along paths of one length, in pixels of the window."""
    session = page.context.new_cdp_session(page)
    for step, points in enumerate(zip(*paths, strict=True)):
        kind = "touchMove" if step else "touchStart"
        touches = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": touches})
        page.evaluate("scanloom.drawn()")
    session.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    time.sleep(0.3)


def make_path(start: tuple[float, float], move: tuple[float, float]) -> list[tuple[float, float]]:
    return [(start[0] + share * move[0], start[1] + share * move[1]) for share in np.linspace(0, 1, 12)]


def get_distance(page: Any) -> float:
    view = page.evaluate("scanloom.view()")
    return float(np.linalg.norm(np.array(view["eye"]) - view["target"]))


def test_the_header_has_its_facts_and_interprets_no_text(page: Any) -> None:
    assert page.evaluate("window.evil") is None
    assert page.evaluate("document.images.length") == 1, "only the picture of the header"
    assert page.inner_text("h1") == page.inner_text("#subtitle") == EVIL
    assert page.locator("#facts dt").all_inner_texts() == [EVIL, "Size"]
    assert page.locator("#facts dd").all_inner_texts() == [EVIL, EVIL, "1 m"]
    assert page.locator("#portrait").is_visible()
    assert page.evaluate("document.getElementById('portrait').naturalWidth") == 40
    page.locator("#facts a").click()
    assert page.evaluate("location.hash") == "#warnings"
    assert page.evaluate("scrollY") > 0
    page.locator("summary").click()
    assert EVIL in page.inner_text("details")


def test_a_vertical_swipe_scrolls_and_a_horizontal_swipe_rotates(open_page: Open) -> None:
    page = open_page(PHONE)
    canvas = page.locator("#picture").bounding_box()
    middle = (canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2)
    before = page.evaluate("scanloom.view()")
    touch(page, make_path(middle, (0, -150)))
    assert page.evaluate("scrollY") > 60
    np.testing.assert_allclose(page.evaluate("scanloom.view().eye"), before["eye"], atol=0.05)
    page.evaluate("scrollTo(0, 0)")
    before = page.evaluate("scanloom.view()")
    touch(page, make_path(middle, (120, 0)))
    after = page.evaluate("scanloom.view()")
    assert page.evaluate("scrollY") == 0
    assert np.linalg.norm(np.subtract(after["eye"], before["eye"])) > 0.2
    np.testing.assert_allclose(after["target"], before["target"], atol=1e-6)


def test_two_fingers_zoom_and_pan(open_page: Open) -> None:
    page = open_page(PHONE)
    canvas = page.locator("#picture").bounding_box()
    x, y = canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2
    away = get_distance(page)
    touch(page, make_path((x - 30, y), (-70, 0)), make_path((x + 30, y), (70, 0)))
    assert get_distance(page) < 0.8 * away
    target = page.evaluate("scanloom.view().target")
    touch(page, make_path((x - 30, y), (0, -90)), make_path((x + 30, y), (0, -90)))
    assert np.linalg.norm(np.subtract(page.evaluate("scanloom.view().target"), target)) > 0.02
    assert page.evaluate("scrollY") == 0


def test_mouse_buttons_are_those_of_blender(page: Any) -> None:
    canvas = page.locator("#picture").bounding_box()
    start = canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2
    for button, keys, pans in (("middle", [], False), ("middle", ["Shift"], True), ("left", [], False),
                               ("left", ["Shift"], True), ("right", [], True)):  # fmt: skip
        page.evaluate("scanloom.reset()")
        before = page.evaluate("scanloom.view()")
        page.mouse.move(*start)
        for key in keys:
            page.keyboard.down(key)
        page.mouse.down(button=button)
        page.mouse.move(start[0] + 90, start[1] + 10, steps=4)
        page.mouse.up(button=button)
        for key in keys:
            page.keyboard.up(key)
        after = page.evaluate("scanloom.view()")
        moved = np.linalg.norm(np.subtract(after["target"], before["target"])) > 0.01
        assert (bool(moved), button, keys) == (pans, button, keys)
        assert after["eye"] != before["eye"]


def test_a_double_click_sets_the_centre_and_reset_restores_the_view(page: Any) -> None:
    first = page.evaluate("scanloom.view()")
    corner = shrink(look_at_front(page))[1]
    canvas = page.locator("#picture").bounding_box()
    x, y = project(page, to_upright(corner))
    page.mouse.dblclick(canvas["x"] + x, canvas["y"] + y)
    np.testing.assert_allclose(page.evaluate("scanloom.view().target"), to_upright(corner), atol=0.01)
    np.testing.assert_allclose(project(page, to_upright(corner)), np.array(get_size(page)) / 2, atol=1)
    page.click("#reset")
    for name in ("eye", "target"):
        np.testing.assert_allclose(page.evaluate("scanloom.view()")[name], first[name], atol=1e-6)


def test_measurements_are_kept_listed_and_exported(page: Any, tmp_path: Path) -> None:
    corners = shrink(look_at_front(page))
    width, height = 0.9 * EXTENTS[0], 0.9 * EXTENTS[1]
    page.click("#measure")
    assert page.locator("#export").is_disabled()
    for kind, points in (
        ("distance", corners[:2]),
        ("angle", corners[:3]),
        ("area", corners),
        ("note", corners[:1]),
    ):
        page.click(f"[data-kind={kind}]")
        for point in points:
            pick(page, point)
        if kind == "area":
            page.click("#finish")
    page.keyboard.type(EVIL)
    page.evaluate("scanloom.drawn()")
    expected = ["Distance 540 mm", "Angle 90.0°", "Area 972 cm²", "Note"]
    for text, wanted in zip(page.locator("#entries .value").all_inner_texts(), expected, strict=True):
        numbers = [[float(x) for x in re.findall(r"[\d.]+", one)] for one in (text, wanted)]
        assert re.sub(r"[\d.]+", "", text) == re.sub(r"[\d.]+", "", wanted)
        assert numbers[0] == pytest.approx(numbers[1], rel=0.02)
    assert page.locator(".tag").count() == 4
    assert page.locator(".tag").nth(3).inner_text() == EVIL
    with page.expect_download() as started:
        page.click("#export")
    started.value.save_as(tmp_path / "found.json")
    assert started.value.suggested_filename.endswith(".json")
    document = json.loads((tmp_path / "found.json").read_text())
    assert (document["title"], document["unit"]) == (EVIL, "m")
    found = document["annotations"]
    assert [one["unit"] for one in found] == ["m", "deg", "m2", None]
    assert found[0]["value"] == pytest.approx(width, abs=0.01)
    assert found[1]["value"] == pytest.approx(90, abs=1)
    assert found[2]["value"] == pytest.approx(width * height, rel=0.03)
    assert found[3]["text"] == EVIL
    # Points are in the coordinates of the scan, not of the page.
    np.testing.assert_allclose(found[2]["points"], corners, atol=0.006)
    assert page.evaluate("window.evil") is None
    # Measurements outlast the panel, another model and a new view, until they are deleted.
    page.click("#measure")
    page.keyboard.press("2")
    page.click("#reset")
    assert page.locator(".tag:visible").count() == 4
    page.click("#measure")
    page.locator("#entries li").nth(1).get_by_role("button").nth(1).click()
    assert page.locator("#entries .value").count() == page.locator(".tag").count() == 3


def test_a_double_click_while_measuring_adds_one_point(page: Any) -> None:
    corner = shrink(look_at_front(page))[0]
    page.click("#measure")
    canvas = page.locator("#picture").bounding_box()
    x, y = project(page, to_upright(corner))
    page.mouse.dblclick(canvas["x"] + x, canvas["y"] + y)
    assert len(page.evaluate("scanloom.measurements.pending().map((one) => one.toArray())")) == 1
    assert page.locator("#entries li").count() == 0


def test_the_crop_box_is_dragged_typed_and_copied(page: Any) -> None:
    corners = look_at_front(page)
    page.select_option("#cut", "box")
    low, high = CENTRE - EXTENTS / 2, CENTRE + EXTENTS / 2
    words = page.inner_text("#option").split()
    assert words[0] == "--box"
    sides = np.array(words[1:], float)
    np.testing.assert_allclose(sides, [*low, *high], atol=0.0015)
    assert (sides[:3] <= low + 1e-9).all()
    assert (sides[3:] >= high - 1e-9).all()
    # Drag the highest x to the middle.
    canvas = page.locator("#picture").bounding_box()
    handle = page.get_by_role("button", name="Highest x").bounding_box()
    assert min(handle["width"], handle["height"]) >= 40
    page.mouse.move(handle["x"] + 20, handle["y"] + 20)
    page.mouse.down()
    goal = project(page, to_upright(CENTRE))
    page.mouse.move(canvas["x"] + goal[0], canvas["y"] + goal[1], steps=5)
    page.mouse.up()
    sides = np.array(page.inner_text("#option").split()[1:], float)
    assert sides[3] == pytest.approx(CENTRE[0], abs=0.02)
    np.testing.assert_allclose(sides[[0, 1, 2, 4, 5]], [*low, *high[1:]], atol=0.0015)
    # Geometry outside of the box cannot be picked.
    assert not page.evaluate(
        "([x, y]) => scanloom.pick(x, y)", project(page, to_upright(shrink(corners)[1])).tolist()
    )
    page.get_by_label("Highest x", exact=True).fill("1.1")
    page.keyboard.press("Tab")
    page.get_by_role("button", name="Lowest y").focus()
    page.keyboard.press("ArrowRight")
    sides = np.array(page.inner_text("#option").split()[1:], float)
    assert sides[3] == 1.1
    assert sides[1] == pytest.approx(low[1] + 0.002, abs=0.0015)
    # A side does not pass the opposite side.
    page.get_by_label("Lowest x", exact=True).fill("9")
    page.keyboard.press("Tab")
    assert float(page.inner_text("#option").split()[1]) == pytest.approx(1.0999)
    page.click("#copy-box")
    page.click("#reset-box")
    np.testing.assert_allclose(
        np.array(page.inner_text("#option").split()[1:], float), [*low, *high], atol=0.0015
    )
    page.select_option("#cut", "none")
    assert page.locator("#box").is_hidden()
    assert page.locator(".handle:visible").count() == 0


def test_cameras_are_in_the_picture_when_they_are_shown(page: Any) -> None:
    before = page.evaluate("scanloom.view()")
    page.click("#cameras")
    width, height = get_size(page)
    places = [project(page, eye) for eye in EYES]
    for x, y in places:
        assert 0 < x < width
        assert 0 < y < height
    shown = take_screenshot(page)
    page.click("#cameras")
    changed = np.abs(shown - take_screenshot(page)).max(axis=2) > 40
    for x, y in places:
        assert changed[round(y) - 12 : round(y) + 13, round(x) - 12 : round(x) + 13].any(), (
            "lines of the camera"
        )
    page.click("#reset")
    np.testing.assert_allclose(page.evaluate("scanloom.view().eye"), before["eye"], atol=1e-6)


@pytest.mark.parametrize("thin", [0, 1, 2])
def test_the_first_view_is_never_edge_on(open_page: Open, tmp_path: Path, thin: int) -> None:
    extents = np.full(3, 0.5)
    extents[thin] = 0.002
    file = tmp_path / "thin.html"
    file.write_bytes(make_packed_page("thin", {"thin": PageModelSource(make_box(extents))}, 5_000_000))
    page = open_page(DESK, file)
    view = page.evaluate("scanloom.view()")
    direction = np.subtract(view["eye"], view["target"])
    normal = to_upright(np.eye(3)[thin])
    assert abs(direction @ normal) / np.linalg.norm(direction) > 0.5


def test_the_picture_and_the_model_are_saved(page: Any, tmp_path: Path) -> None:
    with page.expect_download() as started:
        page.click("#save-picture")
    started.value.save_as(tmp_path / "view.png")
    picture = cv2.imread(str(tmp_path / "view.png")).astype(int)
    width, height = get_size(page)
    assert picture.shape[:2] == (round(height), round(width))
    red = (picture[..., 2] - picture[..., 0] > 40).mean()
    assert 0.05 < red < 0.9
    # The scale bar is in the picture.
    bar = page.locator("#scale").bounding_box()
    canvas = page.locator("#picture").bounding_box()
    column = round(bar["x"] - canvas["x"] + bar["width"] / 2)
    assert picture[round(bar["y"] - canvas["y"] + bar["height"]) - 3 :, column].min(axis=1)[:6].min() < 100
    with page.expect_download() as started:
        page.click("#save-model")
    started.value.save_as(tmp_path / "model.glb")
    assert (tmp_path / "model.glb").read_bytes()[:4] == b"glTF"


def test_help_and_full_screen(page: Any) -> None:
    page.keyboard.press("?")
    assert page.locator("#help").is_visible()
    page.keyboard.press("Escape")
    assert page.locator("#help").is_hidden()
    page.click("#explain")
    page.get_by_role("button", name="Close").click()
    assert page.locator("#help").is_hidden()
    page.click("#full")
    for _ in range(50):
        if page.evaluate("document.fullscreenElement?.id") == "stage":
            break
        time.sleep(0.1)
    assert page.evaluate("document.fullscreenElement?.id") == "stage"
    assert page.locator("#full").get_attribute("aria-pressed") == "true"
    # Nothing scrolls there: one finger rotates in every direction.
    assert page.evaluate("document.getElementById('picture').style.touchAction") == "none"
    page.click("#full")


@pytest.mark.parametrize("window", [PHONE, DESK], ids=["phone", "desk"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_targets_are_large_enough_and_the_page_does_not_scroll_sideways(
    open_page: Open, window: dict[str, Any], scheme: str
) -> None:
    page = open_page({**window, "color_scheme": scheme})
    page.evaluate("scanloom.set({ measuring: true, cut: 'box' })")
    page.evaluate("scanloom.showBeside(1)")
    width = window["viewport"]["width"]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    found = page.evaluate(
        """[...document.querySelectorAll("button, select, input:not(#safe), summary, [role=slider]")]
        .filter((one) => one.checkVisibility())
        .map((one) => [one.id || one.textContent, one.offsetWidth, one.offsetHeight])"""
    )
    assert len(found) > 20
    assert [one for one in found if min(one[1:]) < 40] == []
    small = page.evaluate(
        """[...document.querySelectorAll("body *")].filter((one) => one.checkVisibility() &&
        [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim()) &&
        Number.parseFloat(getComputedStyle(one).fontSize) < 12).map((one) => one.outerHTML)"""
    )
    assert small == []
