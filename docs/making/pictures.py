"""Generator of the pictures in docs/tutorial.md, with the commands of the tutorial.

    PYTHONPATH=.:docs python -m making.pictures

Headless Chromium draws the page (playwright, in the extra `dev`).
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
TO = ROOT / "docs" / "tutorial"
_WIDTH = 480
_QUALITY = 85
_PAGE = (900, 640)


def main() -> None:
    """Run the tutorial's commands in a temporary folder and keep the pictures."""
    TO.mkdir(exist_ok=True)
    with TemporaryDirectory() as folder:
        here = Path(folder)
        (here / "samples").symlink_to(ROOT / "samples")
        _scanloom(here, "inspect samples/rgbd --picture scan.png")
        _keep([here / "scan.png"], "scan.jpg", 900)
        _scanloom(here, "run samples/rgbd -o my_mesh")
        _drawn(here, "before")
        _keep([here / "before.png", here / "before-triangles.png"], "result.jpg", _WIDTH)
        _page(here / "my_mesh" / "report.html", here / "page.png")
        _keep([here / "page.png"], "page.jpg", _PAGE[0])
        _scanloom(here, "run samples/rgbd -o my_mesh --set simplify.max_shape=0.003")
        _drawn(here, "after")
        _keep([here / "after.png", here / "after-triangles.png"], "lighter.jpg", _WIDTH)


def _scanloom(here: Path, words: str) -> None:
    subprocess.run(
        [sys.executable, "-m", "scanloom.cli.app", *words.split(), "--quiet"], cwd=here, check=True
    )


def _drawn(here: Path, name: str) -> None:
    """Render the textured mesh and its triangles from the scan's viewpoint."""
    common = f"--scan samples/rgbd --width {_WIDTH}"
    _scanloom(here, f"render my_mesh/textured.glb {name}.png {common}")
    _scanloom(here, f"render my_mesh/textured.glb {name}-triangles.png --shading edges {common}")


def _page(page: Path, picture: Path) -> None:
    """Take a screenshot of the page in a browser without a GPU."""
    from playwright.sync_api import sync_playwright

    switches = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-gl=angle", "--use-angle=swiftshader"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=switches)
        opened = browser.new_page(viewport={"width": _PAGE[0], "height": _PAGE[1]})
        opened.goto(page.as_uri())
        opened.wait_for_timeout(8000)
        opened.screenshot(path=str(picture))
        browser.close()


def _keep(parts: list[Path], name: str, width: int) -> None:
    """Join pictures side by side and save them as JPEG.

    Parameters
    ----------
    width : of each picture, pixels.
    """
    images = [Image.open(part).convert("RGB") for part in parts]
    images = [
        one.resize((width, round(one.height * width / one.width)), Image.Resampling.LANCZOS) for one in images
    ]
    whole = Image.new("RGB", (sum(one.width for one in images), images[0].height))
    for number, one in enumerate(images):
        whole.paste(one, (number * width, 0))
    whole.save(TO / name, quality=_QUALITY, optimize=True)


if __name__ == "__main__":
    main()
