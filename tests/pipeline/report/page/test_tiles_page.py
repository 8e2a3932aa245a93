"""The page of tiles in a browser.

No holes from far, from near and in mixed levels, and no external requests.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from browsers import PAGE, launch_browser, run_node, run_server
from numpy.typing import NDArray

from scanloom.pipeline.report.page.folder_server import FolderServer
from scanloom.pipeline.report.page.tileset_page import make_tileset_page, write_tileset_page
from scanloom.stages import Mesh, lod
from scanloom.stages.rendering.render import render
from scanloom.stages.rendering.viewpoints import Viewpoint
from scanloom.stages.scans.model.scan import Camera

WIDTH, HEIGHT = 480, 360
COMPRESS = Path(__file__).resolve().parents[3] / "made" / "compress_tiles.mjs"
PAPER = {"light": (0xF4, 0xF5, 0xF7), "dark": (0x17, 0x1B, 0x21)}
# Eye, target, and the screen-space error limit in pixels.
VIEWS = {
    "far": ((2.0, -15.0, 9.0), (0.0, 0.0, 0.0), 8.0),
    "near": ((5.5, -2.5, 1.5), (4.5, 0.0, 0.0), 1.0),
    "mixed": ((8.5, -1.0, 1.2), (-2.0, 0.0, 0.0), 1.5),
}
ORIGIN = np.zeros(3)
GREEN = (20, 200, 60)
pytestmark = pytest.mark.slow

Mask = NDArray[np.bool_]


def make_long_ring() -> Mesh:
    """Make a closed mesh, long along x, whose colours differ from both page backgrounds."""
    import trimesh

    made = trimesh.creation.torus(1.0, 0.4, major_sections=64, minor_sections=24)
    vertices = np.asarray(made.vertices) * (5.0, 1.5, 1.0)
    colors = np.stack(
        [120 + 80 * np.sin(vertices[:, 0]), 40 + 0 * vertices[:, 1], 60 + 20 * vertices[:, 2]], 1
    )
    return Mesh(vertices, np.asarray(made.faces, np.int32), np.rint(colors).astype(np.uint8))


@pytest.fixture(scope="module")
def tiles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    outdir = tmp_path_factory.mktemp("page") / "tiles"
    hierarchy = lod.build(make_long_ring(), cell_triangles=256, root_triangles=200, ratio=3.0, threads=2)
    lod.write_tiles(hierarchy, outdir, up="+z")
    write_tileset_page(outdir)
    return outdir


@pytest.fixture(scope="module")
def textured_tiles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make tiles of a grey ring with green images."""
    outdir = tmp_path_factory.mktemp("textured") / "tiles"
    ring = make_long_ring()
    grey = ring.with_(colors=np.full((len(ring.vertices), 3), 128, np.uint8))
    green = ring.with_(colors=np.tile(np.array(GREEN, np.uint8), (len(ring.vertices), 1)))
    hierarchy = lod.build(grey, cell_triangles=256, root_triangles=200, ratio=3.0, threads=2)
    images = lod.TileImageParams(image_side=128)
    lod.write_tiles(hierarchy, outdir, texture=green, images=images, up="+z")
    write_tileset_page(outdir)
    return outdir


@dataclass
class OpenedPage:
    """Page in the browser with its console messages and requests."""

    page: Any
    said: list[str]
    asked: list[str]

    def picture(self, view: str, moved: NDArray[np.float64] = ORIGIN) -> Mask:
        """Render a view of the model, which may be shifted, and return its mask."""
        eye, target, error = VIEWS[view]
        self.page.evaluate(
            "settings => { scanloom.set(settings); return scanloom.settled(); }",
            {"eye": (moved + eye).tolist(), "target": (moved + target).tolist(), "error": error},
        )
        return self.mask()

    def image(self) -> NDArray[np.int64]:
        """Take a screenshot (h, w, 3), RGB."""
        data = np.frombuffer(self.page.screenshot(), np.uint8)
        return np.asarray(cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB).astype(int))

    def mask(self) -> Mask:
        image = self.image()
        scheme = (
            "dark" if self.page.evaluate("matchMedia('(prefers-color-scheme: dark)').matches") else "light"
        )
        return np.asarray(np.abs(image - PAPER[scheme]).max(axis=2) > 8)

    def to_dict(self) -> dict[str, Any]:
        return dict(self.page.evaluate("scanloom.metrics()"))


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with launch_browser() as started:
        yield started


def open_page(chromium: Any, address: str, scheme: str = "light") -> OpenedPage:
    page = chromium.new_context(viewport={"width": WIDTH, "height": HEIGHT}, color_scheme=scheme).new_page()
    seen = OpenedPage(page, [], [])
    page.on("console", lambda message: seen.said.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: seen.said.append(f"error: {error}"))
    page.on("request", lambda request: seen.asked.append(request.url))
    page.goto(address)
    page.add_style_tag(content="#bar { display: none !important }")
    page.evaluate("scanloom.settled()")
    return seen


def render_silhouette(view: str) -> Mask:
    """Render the mask of the input mesh from a view with scanloom's own renderer."""
    mesh = make_long_ring()
    eye, target = (np.array(point) for point in VIEWS[view][:2])
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, (0.0, 0.0, 1.0))
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3] = np.stack([x, np.cross(z, x), z, eye], axis=1)
    focal = 0.5 * HEIGHT / np.tan(np.radians(50) / 2)
    camera = Camera(WIDTH, HEIGHT, focal, focal, WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5)
    black = Mesh(mesh.vertices, mesh.triangles, np.zeros((len(mesh.vertices), 3), np.uint8))
    return np.asarray(render(black, Viewpoint(view, camera, pose)).max(axis=2) < 100)


def dilate_mask(mask: Mask, pixels: int) -> Mask:
    """Dilate a mask by a number of pixels, or erode it for a negative number."""
    kernel = np.ones((2 * abs(pixels) + 1,) * 2, np.uint8)
    change = cv2.dilate if pixels > 0 else cv2.erode
    return np.asarray(change(mask.astype(np.uint8), kernel, borderValue=int(pixels < 0)), bool)


def count_hole_pixels(seen: Mask, view: str) -> int:
    """Count background pixels inside the silhouette of the model, which is shrunk by the allowed error."""
    return int((dilate_mask(render_silhouette(view), -int(VIEWS[view][2]) - 2) & ~seen).sum())


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_model_has_no_holes_from_far_near_and_in_mixed_levels(
    chromium: Any, tiles: Path, scheme: str
) -> None:
    with run_server(FolderServer(tiles)) as server:
        seen = open_page(chromium, server.address, scheme)
        found = {}
        for view, (_, _, error) in VIEWS.items():
            mask, own = seen.picture(view), render_silhouette(view)
            assert own.mean() > 0.04
            assert count_hole_pixels(mask, view) == 0
            assert not (mask & ~dilate_mask(own, int(error) + 2)).any()
            found[view] = seen.to_dict()
        assert found["far"]["triangles"] < found["mixed"]["triangles"]
        assert found["far"]["errorM"] > found["near"]["errorM"]
        assert len(set(found["mixed"]["levels"])) > 1
        assert all(address.startswith(server.address) for address in seen.asked)
        assert [text for text in seen.said if "versions at 1.1 or higher have limited" not in text] == []


def test_holes_are_detected_in_damaged_tiles(chromium: Any, tiles: Path, tmp_path: Path) -> None:
    shutil.copytree(tiles, tmp_path / "tiles")
    for tile in (tmp_path / "tiles" / "tiles").iterdir():
        # Overwrite the last indices, at the end of the file, to make degenerate triangles.
        data = tile.read_bytes()
        tile.write_bytes(data[:-60] + data[-64:-60] * 15)
    with run_server(FolderServer(tmp_path / "tiles")) as server:
        assert count_hole_pixels(open_page(chromium, server.address).picture("near"), "near") > 0


@pytest.mark.parametrize("packed_by", ["scanloom", "another tool"])
def test_compressed_tiles_are_drawn(chromium: Any, tiles: Path, tmp_path: Path, packed_by: str) -> None:
    if packed_by == "scanloom":
        hierarchy = lod.build(make_long_ring(), cell_triangles=256, root_triangles=200, ratio=3.0, threads=2)
        lod.write_tiles(hierarchy, tmp_path / "tiles", up="+z", compress="meshopt")
        write_tileset_page(tmp_path / "tiles")
    else:
        shutil.copytree(tiles, tmp_path / "tiles")
        run_node(COMPRESS, PAGE, tmp_path / "tiles" / "tiles")
    before, after = (
        sum(f.stat().st_size for f in (at / "tiles").iterdir()) for at in (tiles, tmp_path / "tiles")
    )
    assert after < 0.8 * before
    with run_server(FolderServer(tmp_path / "tiles")) as server:
        seen = open_page(chromium, server.address)
        for view in VIEWS:
            mask = seen.picture(view)
            assert count_hole_pixels(mask, view) == 0
            assert mask.any()
        assert [text for text in seen.said if "versions at 1.1 or higher have limited" not in text] == []


def test_a_model_far_from_the_origin_has_no_holes(chromium: Any, tmp_path: Path) -> None:
    away = np.array((450_000.0, 5_400_000.0, 120.0))
    mesh = make_long_ring()
    far = Mesh(mesh.vertices + away, mesh.triangles, mesh.colors)
    hierarchy = lod.build(far, cell_triangles=256, root_triangles=200, ratio=3.0, threads=2)
    lod.write_tiles(hierarchy, tmp_path / "tiles", up="+z")
    with run_server(FolderServer(tmp_path / "tiles", extra_files=make_tileset_page())) as server:
        seen = open_page(chromium, server.address)
        for view in VIEWS:
            mask = seen.picture(view, away)
            assert count_hole_pixels(mask, view) == 0
            assert not (mask & ~dilate_mask(render_silhouette(view), int(VIEWS[view][2]) + 2)).any()


def test_the_first_view_shows_all_of_the_model(chromium: Any, tiles: Path) -> None:
    with run_server(FolderServer(tiles)) as server:
        seen = open_page(chromium, server.address)
        mask = seen.mask()
        assert mask.any(axis=0).mean() > 0.3
        assert not mask[[0, -1]].any()
        assert not mask[:, [0, -1]].any()
        # The same on a narrow screen.
        seen.page.set_viewport_size({"width": 300, "height": 600})
        seen.page.evaluate("scanloom.showAll(); scanloom.settled()")
        assert not seen.mask()[:, [0, -1]].any()
        assert seen.page.evaluate("document.documentElement.scrollWidth") <= 300


def test_keys_controls_and_address_change_the_picture(chromium: Any, tiles: Path) -> None:
    with run_server(FolderServer(tiles)) as server:
        seen = open_page(chromium, server.address + "#eye=0,-9,3&target=1,0,0&error=4&mode=levels")
        page = seen.page
        view = page.evaluate("scanloom.view()")
        np.testing.assert_allclose([view["eye"], view["target"]], [[0, -9, 3], [1, 0, 0]], atol=1e-9)
        assert page.evaluate("scanloom.settings()") == {"error": 4, "mode": "levels", "wireframe": False}
        assert page.input_value("#target") == "2"
        page.evaluate("document.querySelector('#picture').focus()")
        page.keyboard.press("+")
        assert np.linalg.norm(np.subtract(page.evaluate("scanloom.view().eye"), [1, 0, 0])) < 9
        page.keyboard.press("ArrowLeft")
        assert page.evaluate("scanloom.view().eye[0]") < 0.1
        page.keyboard.press("Home")
        assert page.evaluate("scanloom.view().target") != view["target"]
        # Mouse wheel and drag.
        page.mouse.move(WIDTH / 2, HEIGHT / 2)
        whole = seen.mask().sum()
        page.mouse.wheel(0, -240)
        page.evaluate("scanloom.settled()")
        assert seen.mask().sum() > whole
        before = page.evaluate("scanloom.view().eye")
        page.mouse.down()
        page.mouse.move(WIDTH / 2 + 60, HEIGHT / 2)
        page.mouse.up()
        assert np.linalg.norm(np.subtract(page.evaluate("scanloom.view().eye"), before)) > 1
        page.evaluate("document.querySelector('#picture').focus()")
        page.keyboard.press("Home")
        page.evaluate("scanloom.settled()")
        whole = seen.mask().sum()
        page.evaluate("scanloom.set({wireframe: true, mode: 'colors'}); scanloom.settled()")
        assert 0 < seen.mask().sum() < whole


def test_a_missing_tile_is_reported(chromium: Any, tiles: Path, tmp_path: Path) -> None:
    shutil.copytree(tiles, tmp_path / "tiles")
    for tile in (tmp_path / "tiles" / "tiles").iterdir():
        tile.unlink()
    with run_server(FolderServer(tmp_path / "tiles")) as server:
        page = chromium.new_page()
        page.goto(server.address)
        page.wait_for_selector("#message:has-text('could not be loaded')")
        page.close()


def test_the_library_is_built_from_its_packages(tmp_path: Path) -> None:
    run_node(PAGE / "build.mjs", tmp_path)
    for name in ("library.js", "LICENSES.txt"):
        assert (tmp_path / name).read_bytes() == (PAGE / name).read_bytes()


def test_a_page_has_its_licences_and_no_external_addresses(tiles: Path) -> None:
    page = make_tileset_page()
    assert {path.relative_to(tiles).as_posix() for path in tiles.rglob("*.*")} >= set(page)
    for name, content in page.items():
        assert (tiles / name).read_bytes() == content
    licences = page["page/LICENSES.txt"].decode()
    assert all(f"\n{name} " in f"\n{licences}" for name in ("three", "3d-tiles-renderer", "meshoptimizer"))
    assert "resolved" not in (PAGE / "package-lock.json").read_text("utf-8")


def test_images_of_tiles_are_shown(chromium: Any, textured_tiles: Path) -> None:
    with run_server(FolderServer(textured_tiles)) as server:
        seen = open_page(chromium, server.address)
        for view in VIEWS:
            assert seen.picture(view).any()
            there = dilate_mask(render_silhouette(view), -int(VIEWS[view][2]) - 2)
            # Except for a few pixels along outlines, which are mixed with the background.
            assert np.quantile(np.abs(seen.image()[there] - GREEN).max(axis=1), 0.999) <= 4, view
        assert [line for line in seen.said if "tiles versions" not in line] == []


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_first_view_of_a_wall_is_from_its_scanned_side(
    chromium: Any, tmp_path: Path, side: float
) -> None:
    x, z = np.meshgrid(np.linspace(-2, 2, 40), np.linspace(0, 2, 20))
    places = np.stack([x, 0.1 * np.sin(3 * x), z], 2).reshape(-1, 3)
    at = np.arange(800).reshape(20, 40)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]
    faces = np.stack([a, b, d, a, d, c], 2).reshape(-1, 3)
    # Counter-clockwise seen from -y, or from +y.
    wall = Mesh(places, (faces if side < 0 else faces[:, ::-1]).astype(np.int32))
    hierarchy = lod.build(wall, cell_triangles=256, root_triangles=100)
    lod.write_tiles(hierarchy, tmp_path / "tiles", up="+z")
    write_tileset_page(tmp_path / "tiles")
    with run_server(FolderServer(tmp_path / "tiles")) as server:
        seen = open_page(chromium, server.address)
        eye = seen.page.evaluate("scanloom.view()")["eye"]
        assert side * eye[1] > 1
        assert seen.mask().any()
