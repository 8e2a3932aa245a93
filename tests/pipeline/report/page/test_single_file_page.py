"""A page of models in one file.

It works from a local disk without requests, shows the models upright, and measures.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browsers import launch_browser

from scanloom import Image, Material, Mesh, Texture, export, preset
from scanloom.pipeline.report.page.single_file_page import (
    PageCamera,
    PageColoring,
    PageModel,
    PageScale,
    make_single_file_page,
)
from scanloom.stages.rendering.render import render
from scanloom.stages.rendering.viewpoints import Viewpoint
from scanloom.stages.scans.model.scan import Camera
from scanloom.stages.surface.formats.gltf_writer import write_gltf
from scanloom.stages.surface.mean_normal import estimate_mean_normal
from scanloom.stages.surface.up_direction import rotate_to_z

pytestmark = pytest.mark.slow
WIDTH, HEIGHT = 480, 360
ABOVE = 170
# Only the drawing, without the elements over it and the background behind it.
DRAWING = (
    "form, #corner, #metrics, #scale { display: none !important } "
    "#view { height: 360px !important; border: 0 !important; background: none !important }"
)
UP = (0.0, -1.0, 0.0)
EVIL = "</script><script>window.evil = 1</script><!--"


# Colour scales: low values are red, high values blue; the second set, green and white, is for colour
# blindness.
VALUES = PageScale(
    "photos", -0.5, 1.5, None, ["rgb(220, 0, 0)", "rgb(0, 0, 220)"], [0.5, 0.5],
    ["rgb(0, 220, 0)", "rgb(220, 220, 220)"], [0, 1],
)  # fmt: skip
SCALE = PageScale("mm", -2.0, 2.0, 0.5, ["rgb(1, 2, 3)", "rgb(4, 5, 6)"], [0.25, 0.75])


def make_camera(frame: str, eye: tuple[float, float, float], photo: bytes | None) -> PageCamera:
    """Make a camera that faces +y of the upright frame; 100 × 80 pixels, 90° field of view."""
    rows = [[1, 0, 0, eye[0]], [0, 0, 1, eye[1]], [0, -1, 0, eye[2]]]
    return PageCamera(
        frame, [float(x) for row in rows for x in row], [100, 80], [50, 50], [49.5, 39.5], photo
    )


def make_half_green_photo() -> bytes:
    """Make a white photo whose left half is green, smaller than the image size of its camera."""
    pixels = np.full((40, 50, 3), 255, np.uint8)
    pixels[:, :25] = (0, 200, 0)
    return cv2.imencode(".jpg", pixels)[1].tobytes()


CAMERAS = [
    make_camera(EVIL, (0, -3, 0), make_half_green_photo()),
    make_camera("second", (2, -3, 0), None),
    replace(make_camera("third", (2, -4, 0.5), make_half_green_photo()), mark="held out"),
]


def make_body(color: tuple[int, int, int]) -> Mesh:
    """Make a single-colour box of 3 × 2 × 1 m on its side, with a tower; all its views differ."""
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


def make_checked_body() -> Mesh:
    """Make the box with an image of 16 colours, projected from the front, and blue vertex colours."""
    mesh = make_body((20, 20, 200))
    pixels = np.random.default_rng(5).integers(0, 255, (4, 4, 3)).astype(np.uint8)
    pixels = pixels.repeat(16, 0).repeat(16, 1)
    flat = mesh.vertices[mesh.triangles][..., :2]
    uvs = (flat - flat.min(axis=(0, 1))) / np.ptp(flat, axis=(0, 1))
    texture = Texture(uvs, np.zeros(len(uvs), np.int32), (Material(image=Image(given=pixels)),))
    return mesh.with_(texture=texture)


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    models = []
    for name, color in (("red", (200, 20, 20)), ("blue", (20, 20, 200))):
        export(make_body(color), folder / "m.glb", preset("web"))
        models.append(PageModel(name, (folder / "m.glb").read_bytes(), 24, scale=SCALE if models else None))
    mesh = make_checked_body()
    # The second of the four value channels is high on the right side.
    values = np.zeros((len(mesh.vertices), 4), np.uint8)
    values[:, 1] = np.where(mesh.vertices[:, 0] > 0, 255, 0)
    write_gltf(folder / "m.glb", mesh, compress="meshopt", shading="unlit", values=values)
    looks = (PageColoring("values", 1, "which side", VALUES), PageColoring("vertex colours", None))
    models.append(PageModel("checked", (folder / "m.glb").read_bytes(), 24, colorings=looks))
    told = {
        "frames": EVIL,
        "warnings": [EVIL],
        "tables": [{"title": "Places", "head": ["a", ""], "rows": [[EVIL]],
                    "places": [{"target": [1, 0, 1], "away": 2}]}],
        "texts": [{"title": "text", "text": EVIL}],
    }  # fmt: skip
    (folder / "page.html").write_bytes(make_single_file_page(EVIL, models, told, CAMERAS))
    return folder / "page.html"


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with launch_browser() as started:
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
    # The page itself and its embedded files.
    assert [url for url in asked if not url.startswith(("data:", "blob:"))] == [page_file.as_uri()]
    opened.close()


def wait_for(page: Any, what: str) -> None:
    """Wait until an expression holds; the content security policy blocks playwright's own waiting."""
    for _ in range(300):
        if page.evaluate(what):
            return
        time.sleep(0.1)
    pytest.fail(what)


def take_screenshot(page: Any) -> np.ndarray:
    page.evaluate("scanloom.drawn()")
    data = page.locator("#picture").screenshot()
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1].astype(int)


def find_red(pixels: np.ndarray) -> np.ndarray:
    return np.asarray(pixels[..., 0] - pixels[..., 2] > 40)


def find_green(pixels: np.ndarray) -> np.ndarray:
    return np.asarray(pixels[..., 1] - pixels[..., [0, 2]].max(axis=2) > 60)


def find_blue(pixels: np.ndarray) -> np.ndarray:
    return np.asarray(pixels[..., 2] - pixels[..., 0] > 40)


@pytest.mark.parametrize(("number", "mesh"), [(0, make_body((200, 20, 20))), (2, make_checked_body())])
def test_the_drawn_model_matches_our_renderer(page: Any, number: int, mesh: Mesh) -> None:
    page.add_style_tag(content=DRAWING)
    page.evaluate(f"scanloom.show({number})")
    eye, target = np.array((4.0, -5.0, 3.0)), np.array((0.2, 0.1, 0.2))
    page.evaluate("view => scanloom.look(view)", {"eye": eye.tolist(), "target": target.tolist(), "fov": 50})
    seen = take_screenshot(page)
    height, width = seen.shape[:2]
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, (0, 0, 1))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    pose[:3, 3] = eye
    # From the upright frame to the axes of the scan.
    pose[:3] = rotate_to_z(np.array(UP)).T @ pose[:3]
    focal = height / 2 / np.tan(np.radians(25))
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    viewpoint = Viewpoint("same", camera, pose)
    drawn = render(mesh, viewpoint, shading="unlit").astype(int)
    nothing = mesh.with_(vertices=mesh.vertices - 100 * (target - eye) @ rotate_to_z(np.array(UP)))
    ours = (drawn != render(nothing, viewpoint)).any(axis=2)
    theirs = (seen != seen[0, 0]).any(axis=2)
    assert ours.mean() > 0.05
    # Except for pixels along outlines, whose shape and colour may differ; and along the borders of texture
    # pixels.
    assert (ours & theirs).sum() / (ours | theirs).sum() > 0.97
    off = np.abs(drawn - seen).max(axis=2)[ours & theirs]
    assert (off <= 4).mean() > (0.97 if number == 0 else 0.7)
    assert np.median(off) <= 2


def test_models_modes_keys_and_measuring(page: Any) -> None:
    # Crop to the part above the toolbar, which contains blue itself.
    assert find_red(take_screenshot(page)[:ABOVE]).any()
    page.keyboard.press("2")
    wait_for(page, "scanloom.settings().model === 1")
    assert find_blue(take_screenshot(page)[:ABOVE]).any()
    assert not find_red(take_screenshot(page)[:ABOVE]).any()
    page.select_option("#mode", "clay")
    assert not find_blue(take_screenshot(page)[:ABOVE]).any()
    page.select_option("#mode", "colors")
    page.click("#measure")
    # Measure the front, 3 m wide, between its two lower corners.
    page.evaluate("scanloom.look({ eye: [0, -12, 0], target: [0, 0, 0], fov: 30 })")
    page.evaluate("scanloom.drawn()")
    canvas = page.evaluate(
        "[document.getElementById('picture').clientWidth, document.getElementById('picture').clientHeight]"
    )
    pixels = canvas[1] / (2 * np.tan(np.radians(15)) * 11)
    for x in (-1.4, 1.4):
        assert page.evaluate("([x, y]) => scanloom.pick(x, y)", [canvas[0] / 2 + x * pixels, canvas[1] / 2])
    (found,) = page.evaluate("scanloom.annotations().annotations")
    assert (found["kind"], found["unit"]) == ("distance", "m")
    assert found["value"] == pytest.approx(2.8, abs=0.03)
    assert "2.8" in page.inner_text("#entries")
    assert "2.8" in page.inner_text(".tag")
    # An unfinished measurement ends with Escape, a complete measurement stays.
    assert page.evaluate("scanloom.pick(240, 150)")
    page.keyboard.press("Escape")
    assert page.locator("#measurements").is_hidden()
    assert page.evaluate("scanloom.measurements.pending()") == []
    assert len(page.evaluate("scanloom.annotations().annotations")) == 1
    assert page.inner_text("#scale").split()[1] in ("m", "cm", "mm")


def test_lengths_are_in_units_without_metric_scale(chromium: Any, tmp_path: Path) -> None:
    export(make_body((200, 20, 20)), tmp_path / "m.glb", preset("web"))
    models = [PageModel("red", (tmp_path / "m.glb").read_bytes(), 24)]
    (tmp_path / "page.html").write_bytes(make_single_file_page("units", models, {"unit": "units"}))
    page = chromium.new_page(viewport={"width": WIDTH, "height": HEIGHT})
    page.goto((tmp_path / "page.html").as_uri())
    page.wait_for_selector("#message", state="hidden", timeout=60_000)
    page.click("#measure")
    page.evaluate("scanloom.look({ eye: [0, -12, 0], target: [0, 0, 0], fov: 30 })")
    page.evaluate("scanloom.drawn()")
    canvas = "document.getElementById('picture')"
    width, height = page.evaluate(f"[{canvas}.clientWidth, {canvas}.clientHeight]")
    for x in (-20, 20):
        assert page.evaluate("([x, y]) => scanloom.pick(x, y)", [width / 2 + x, height / 2])
    assert " units" in page.inner_text("#entries")
    assert page.inner_text("#scale").split()[1] == "units"
    page.close()


def test_table_rows_move_the_camera_and_texts_are_escaped(page: Any) -> None:
    assert page.evaluate("window.evil") is None
    assert page.title() == EVIL
    assert page.inner_text(".warning") == EVIL
    before = page.evaluate("scanloom.view()")
    page.get_by_role("button", name="Show").click()
    after = page.evaluate("scanloom.view()")
    np.testing.assert_allclose(after["target"], (1, 0, 1), atol=1e-6)
    assert after["eye"] != before["eye"]
    assert np.linalg.norm(np.array(after["eye"]) - after["target"]) == pytest.approx(2, rel=0.01)


def find_columns(seen: np.ndarray) -> tuple[int, int]:
    """Find the first and last column of a mask."""
    found = np.flatnonzero(seen.any(axis=0))
    return int(found[0]), int(found[-1])


def test_two_models_meet_at_the_divider(page: Any) -> None:
    page.select_option("#beside", "1")
    page.evaluate("scanloom.look({ eye: [0, -4, 0], target: [0, 0, 0], fov: 50 })")
    wait_for(page, "!document.getElementById('divider').hidden")
    for share in (0.5, 0.3):
        page.evaluate("share => scanloom.divide(share)", share)
        seen = take_screenshot(page)[:ABOVE]
        edge = share * seen.shape[1]
        assert find_columns(find_blue(seen))[1] == pytest.approx(edge, abs=12)
        assert find_columns(find_red(seen))[0] == pytest.approx(edge, abs=12)
    page.locator("#divider").focus()
    page.keyboard.press("ArrowRight")
    assert page.get_attribute("#divider", "aria-valuenow") == "32"
    assert "left blue, right red" in page.inner_text("#metrics")
    page.select_option("#beside", "none")
    assert not find_blue(take_screenshot(page)[:ABOVE]).any()


def test_a_cut_hides_and_disables_geometry_beyond_it(page: Any) -> None:
    page.evaluate("scanloom.look({ eye: [0, -4, 0], target: [0, 0, 0], fov: 50 })")
    whole = find_columns(find_red(take_screenshot(page)[:ABOVE]))
    page.select_option("#cut", "x")
    cut = find_columns(find_red(take_screenshot(page)[:ABOVE]))
    assert cut[0] == whole[0]
    # The front view shows half of the box, which is 3 m wide.
    assert cut[1] == pytest.approx(sum(whole) / 2, abs=10)
    page.select_option("#cut", "z")
    # Below the lowest side, which is in the plane at 0.
    page.evaluate("scanloom.set({ at: -0.01 })")
    assert not find_red(take_screenshot(page)[:ABOVE]).any()
    # Geometry that is cut away cannot be measured.
    page.evaluate("scanloom.set({ measuring: true })")
    assert not page.evaluate("scanloom.pick(240, 100)")


def test_a_photo_overlays_the_model_in_its_pose(page: Any) -> None:
    page.add_style_tag(content=DRAWING)
    page.evaluate("scanloom.set({ cameras: true })")
    page.evaluate("scanloom.look({ eye: [0, -9, 0], target: [0, -3, 0], fov: 50 })")
    assert page.evaluate("scanloom.pickCamera(240, 180)") == 0
    wait_for(page, "scanloom.settings().photo === 0")
    view = page.evaluate("scanloom.view()")
    np.testing.assert_allclose(view["eye"], (0, -3, 0), atol=1e-6)
    np.testing.assert_allclose(view["target"][::2], (0, 0), atol=1e-6)
    page.evaluate("scanloom.set({ opacity: 1 })")
    wait_for(page, "scanloom.drawn().then(() => true)")
    seen = take_screenshot(page)
    height, width = seen.shape[:2]
    focal = height / 2 / np.tan(np.radians(view["fov"] / 2))
    left, right = find_columns(find_green(seen))
    assert left == pytest.approx(width / 2 - focal, abs=4)
    assert right == pytest.approx(width / 2, abs=4)
    rows = np.flatnonzero(find_green(seen).any(axis=1))
    assert np.ptp(rows) == pytest.approx(2 * 0.8 * focal, abs=6)
    page.evaluate("scanloom.set({ opacity: 0 })")
    assert not find_green(take_screenshot(page)).any()
    assert find_red(take_screenshot(page)).any()
    page.keyboard.press("Escape")
    wait_for(page, "scanloom.settings().photo === null")
    assert page.evaluate("scanloom.view().fov") == 50


def test_colormaps_of_a_model_share_its_geometry(page: Any) -> None:
    names = page.evaluate("[...document.getElementById('model').options].map((one) => one.text)")
    assert names == ["red", "blue", "checked", "values", "vertex colours"]
    # Hide the legend, which contains the same colours.
    page.add_style_tag(content="#legend { display: none !important }")
    page.evaluate("scanloom.look({ eye: [0, -6, 0], target: [0, 0, 0], fov: 50 })")
    page.evaluate("scanloom.show(3)")
    seen = take_screenshot(page)[:ABOVE]
    (first, last), (start, end) = find_columns(find_red(seen)), find_columns(find_blue(seen))
    assert first < last < start < end
    page.evaluate("scanloom.show(4)")
    seen = take_screenshot(page)[:ABOVE]
    assert not find_red(seen).any()
    assert find_columns(find_blue(seen)) == pytest.approx((first, end), abs=2)
    page.evaluate("scanloom.show(2)")
    assert len(np.unique(take_screenshot(page)[:ABOVE].reshape(-1, 3), axis=0)) > 16
    # Two models side by side.
    page.evaluate("scanloom.showBeside(4)")
    assert find_columns(find_blue(take_screenshot(page)[:ABOVE]))[0] == pytest.approx(first, abs=2)


def test_a_scale_has_colours_for_colour_blindness(page: Any) -> None:
    assert page.locator("#safe").is_hidden()
    page.evaluate("scanloom.show(3)")
    page.evaluate("scanloom.look({ eye: [0, -6, 0], target: [0, 0, 0], fov: 50 })")
    assert find_red(take_screenshot(page)[:ABOVE]).any()
    page.locator("#safe").check()
    seen = take_screenshot(page)[:ABOVE]
    assert find_green(seen).any()
    assert not find_red(seen).any()
    swatches = "[...document.querySelectorAll('#legend .swatch')].map((one) => one.style.background)"
    assert page.evaluate(swatches) == VALUES.safe[::-1]
    assert page.locator("#legend .mark").all_inner_texts() == ["0", "1"]
    page.evaluate("scanloom.show(0)")
    assert page.locator("#safe").is_hidden()


def test_photos_show_the_status_of_their_frames_and_move_the_camera(page: Any) -> None:
    photos = page.locator(".frames button")
    assert photos.count() == 2
    assert photos.nth(0).inner_text() == EVIL
    assert photos.nth(1).inner_text().split("\n") == ["third", "held out"]
    assert page.evaluate("document.querySelector('.frames img').naturalWidth") > 0
    photos.nth(1).click()
    wait_for(page, "scanloom.settings().photo === 2")
    np.testing.assert_allclose(page.evaluate("scanloom.view()")["eye"], (2, -4, 0.5), atol=1e-6)


def test_a_text_is_copied_or_selected(page: Any) -> None:
    page.click("summary")
    page.get_by_role("button", name="Copy").click()
    copied = "document.querySelector('details button').textContent === 'Copied'"
    wait_for(page, f"getSelection().toString() !== '' || {copied}")
    assert page.inner_text("pre") == EVIL


def test_every_control_has_a_name_and_a_visible_focus(page: Any) -> None:
    page.select_option("#cut", "x")
    page.evaluate("scanloom.showPhoto(0)")
    page.evaluate("scanloom.show(3)")
    page.evaluate("scanloom.showBeside(1)")
    found = page.evaluate(
        """[...document.querySelectorAll("button, select, input, summary, [tabindex], [role=slider]")]
        .filter((one) => one.checkVisibility())
        .map((one) => {
          one.focus({ focusVisible: true });
          const style = getComputedStyle(one);
          const label = one.labels?.[0]?.textContent ?? "";
          const name = one.getAttribute("aria-label") ?? (label.trim() || one.textContent.trim());
          const seen = style.outlineStyle !== "none" || style.strokeWidth === "3px";
          return [one.id || one.className.baseVal || one.className || one.tagName, name, seen];
        })"""
    )
    assert len(found) > 15
    assert [one for one in found if not one[1] or not one[2]] == []
    assert page.inner_text("h1") == EVIL
    # Every image with a meaning has a text alternative.
    assert page.evaluate("[...document.images].every((one) => one.hasAttribute('alt'))")
    assert page.evaluate("document.documentElement.lang") == "en"


def test_cameras_on_the_plan_and_their_photos_are_selected_by_keys(page: Any) -> None:
    circles = page.locator(".plan circle")
    assert circles.count() == 3
    buttons = page.locator(".plan circle[role=button]")
    assert buttons.count() == 2
    assert buttons.nth(0).get_attribute("aria-label") == f"Photo of frame {EVIL}"
    assert buttons.nth(1).get_attribute("aria-label") == "Photo of frame third, held out"
    at = [float(circles.nth(k).get_attribute(axis)) for k in (0, 2) for axis in ("cx", "cy")]
    assert at[2] > at[0], "x to the right"
    assert at[3] > at[1], "y away from the reader"
    buttons.nth(1).focus()
    page.keyboard.press("Enter")
    wait_for(page, "scanloom.settings().photo === 2")
    np.testing.assert_allclose(page.evaluate("scanloom.view()")["eye"], (2, -4, 0.5), atol=1e-6)
    assert page.locator("#photo option").count() == 3


def test_colours_with_a_meaning_have_a_scale(page: Any) -> None:
    assert page.locator("#legend").is_hidden()
    page.keyboard.press("2")
    wait_for(page, "!document.getElementById('legend').hidden")
    words = page.inner_text("#legend").split()
    assert page.inner_text("#legend .unit") == "mm · blue"
    assert {"+2", "-2", "+0.5", "-0.5"} <= set(words)
    bars = page.locator("#legend .share")
    # Highest share first.
    assert bars.nth(0).bounding_box()["width"] == pytest.approx(
        3 * bars.nth(1).bounding_box()["width"], rel=0.05
    )


@pytest.mark.parametrize(("width", "scheme"), [(360, "dark"), (1400, "light")])
def test_narrow_and_wide_windows_fit(chromium: Any, page_file: Path, width: int, scheme: str) -> None:
    opened = chromium.new_page(viewport={"width": width, "height": 700}, color_scheme=scheme)
    opened.goto(page_file.as_uri())
    opened.wait_for_selector("#message", state="hidden", timeout=60_000)
    assert opened.evaluate("document.documentElement.scrollWidth") <= width
    for name in ("#mode", "#measure", "#reset", "#scale", ".frames", ".plan"):
        box = opened.locator(name).bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= width
    paper = opened.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (paper == "rgb(23, 27, 33)") == (scheme == "dark")
    opened.close()


def test_the_mean_normal_of_a_wall_faces_its_scanned_side() -> None:
    wall = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1.0]]), np.array([[0, 1, 2]], np.int32))
    assert estimate_mean_normal(wall, np.eye(3)) == [0, -1, 0]
    assert estimate_mean_normal(make_body((1, 2, 3)), np.eye(3)) is None
