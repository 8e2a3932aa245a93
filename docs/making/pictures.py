"""Generator of the pictures of README.md and docs/tutorial.md, with the commands of the pages.

    PYTHONPATH=.:docs python -m making.pictures

Headless Chromium draws the page (playwright, in the extra `dev`).
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
OUT_FOLDER = ROOT / "docs" / "tutorial"
_WIDTH = 480
# The picture of the README: a photo, and the mesh from its camera without and with texture.
_README = "../scan-to-mesh.jpg"
_PHOTO = 5
_QUALITY = 85
# Window of the page, and width of its picture.
_PAGE_SIZE, _PAGE_WIDTH = (1200, 840), 900


def main() -> None:
    """Run the tutorial's commands in a temporary folder and keep the pictures."""
    OUT_FOLDER.mkdir(exist_ok=True)
    with TemporaryDirectory() as folder:
        here = Path(folder)
        (here / "samples").symlink_to(ROOT / "samples")
        _draw_readme(here)
        _run_scanloom(here, "inspect samples/rgbd --picture scan.png")
        _save_pictures([here / "scan.png"], "scan.jpg", 900)
        _run_scanloom(here, "run samples/rgbd -o my_mesh")
        _render_result(here, "before")
        _save_pictures([here / "before.png", here / "before-triangles.png"], "result.jpg", _WIDTH)
        _take_screenshot(here / "my_mesh" / "report.html", here / "page.png")
        _save_pictures([here / "page.png"], "page.jpg", _PAGE_WIDTH)
        _run_scanloom(here, "run samples/rgbd -o my_mesh --set simplify.max_shape=5mm")
        _render_result(here, "after")
        _save_pictures([here / "after.png", here / "after-triangles.png"], "lighter.jpg", _WIDTH)


def _run_scanloom(here: Path, words: str) -> None:
    subprocess.run(
        [sys.executable, "-m", "scanloom.cli.app", *words.split(), "--quiet"], cwd=here, check=True
    )


def _draw_readme(here: Path) -> None:
    """Draw a photo, the mesh without texture and the mesh with texture side by side."""
    _run_scanloom(here, "run samples/rgbd -o best --quality best --set report.enabled=false")
    # Viewpoint 1 is an overview, and viewpoint 2 a camera of the middle of the path.
    common = "--scan samples/rgbd --viewpoint 2 --width 960"
    _run_scanloom(here, f"render best/textured.glb shape.png --shading plain {common}")
    _run_scanloom(here, f"render best/textured.glb texture.png --shading unlit {common}")
    photo = here / "samples" / "rgbd" / "color" / f"{_PHOTO - 1:04}.jpg"
    _save_pictures([photo, here / "shape.png", here / "texture.png"], _README, 620, gap=8)


def _render_result(here: Path, name: str) -> None:
    """Render the textured mesh and its triangles from the scan's viewpoint."""
    common = f"--scan samples/rgbd --width {_WIDTH}"
    _run_scanloom(here, f"render my_mesh/textured.glb {name}.png {common}")
    _run_scanloom(here, f"render my_mesh/textured.glb {name}-triangles.png --shading edges {common}")


def _take_screenshot(page: Path, picture: Path) -> None:
    """Take a screenshot of the page in a browser without a GPU."""
    from playwright.sync_api import sync_playwright

    switches = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader"]
    with sync_playwright() as playwright:
        program = shutil.which("chromium-headless-shell") or shutil.which("chromium")
        browser = playwright.chromium.launch(executable_path=program, args=switches)
        opened = browser.new_page(viewport={"width": _PAGE_SIZE[0], "height": _PAGE_SIZE[1]})
        opened.goto(page.as_uri())
        opened.wait_for_timeout(8000)
        opened.screenshot(path=str(picture))
        browser.close()


def _save_pictures(parts: list[Path], name: str, width: int, gap: int = 0) -> None:
    """Join pictures of one width side by side, and save them as JPEG."""
    images = [Image.open(part).convert("RGB") for part in parts]
    images = [
        one.resize((width, round(one.height * width / one.width)), Image.Resampling.LANCZOS) for one in images
    ]
    size = (len(images) * (width + gap) - gap, images[0].height)
    whole = Image.new("RGB", size, "white")
    for number, one in enumerate(images):
        whole.paste(one, (number * (width + gap), 0))
    whole.save(OUT_FOLDER / name, quality=_QUALITY, optimize=True)


if __name__ == "__main__":
    main()
