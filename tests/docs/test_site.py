"""The site of docs/ builds without warnings, has no broken links, and works from a local disk."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest
from browsers import launch_browser, skip_missing_tool

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
# Attributes whose targets a browser fetches without a click.
FETCHED = {"img": "src", "script": "src", "link": "href", "iframe": "src", "source": "src"}

pytestmark = pytest.mark.slow


class Page(HTMLParser):
    """Anchors of a page, and its links."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value for name, value in attrs if value is not None}
        self.ids |= {values[name] for name in ("id", "name") if name in values}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        if tag in FETCHED and FETCHED[tag] in values:
            self.fetched.append(values[FETCHED[tag]])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    for module in ("sphinx", "myst_parser", "furo"):
        if importlib.util.find_spec(module) is None:
            skip_missing_tool(f"{module} is missing: pip install 'scanloom[docs]'")
    folder = tmp_path_factory.mktemp("site")
    words = ["--fail-on-warning", "--keep-going", "--quiet", "-c", "docs", "-d", str(folder / "trees"), "."]
    made = subprocess.run(
        [sys.executable, "-m", "sphinx", *words, str(folder / "html")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (made.returncode, made.stdout, made.stderr) == (0, "", "")
    return folder / "html"


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {path: Page(path) for path in sorted(site.rglob("*.html"))}


def test_every_page_of_docs_is_there(site: Path):
    for path in DOCS.rglob("*.md"):
        assert (site / path.relative_to(ROOT)).with_suffix(".html").is_file()
    assert 'url=docs/index.html"' in (site / "index.html").read_text()


def test_no_link_is_broken(pages: dict[Path, Page]):
    wrong = []
    for path, page in pages.items():
        for link in (*page.links, *page.fetched):
            parts = urlsplit(link)
            if parts.scheme in ("http", "https"):
                is_right = "." in parts.netloc and " " not in link
            elif parts.scheme:
                is_right = parts.scheme == "data"
            else:
                target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
                anchors = pages[target].ids if target in pages else {""}
                is_right = target.is_file() and (not parts.fragment or unquote(parts.fragment) in anchors)
            if not is_right:
                wrong.append(f"{path.name}: {link}")
    assert sum(len(page.links) for page in pages.values()) > 1000
    assert wrong == []


def test_pages_load_no_external_resources(pages: dict[Path, Page], site: Path):
    for page in pages.values():
        assert not [link for link in page.fetched if urlsplit(link).netloc]
    for sheet in site.rglob("*.css"):
        assert "@import" not in sheet.read_text()
        assert "url(http" not in sheet.read_text()


def test_pictures_are_small():
    pictures = [path for path in DOCS.rglob("*") if path.suffix in (".png", ".jpg")]
    assert len(pictures) > 4
    # Composite pictures of three or four parts.
    larger = {"deform.png": 150_000, "scan-to-mesh.jpg": 250_000}
    assert all(path.stat().st_size < larger.get(path.name, 100_000) for path in pictures)


@pytest.fixture(scope="module")
def opened(site: Path) -> Iterator[Any]:
    with launch_browser() as started:
        page = started.new_page(viewport={"width": 360, "height": 800})
        asked: list[str] = []
        said: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.goto((site / "docs" / "when-it-goes-wrong" / "index.html").as_uri())
        yield page
        assert said == []
        assert all(url.startswith(site.as_uri()) for url in asked)


@pytest.mark.parametrize(
    ("message", "explained"),
    [
        (
            "my_scan/depth/000123.png: the image is cut short; copy it again or leave the frame out.",
            "Damaged or truncated files",
        ),
        (
            "warning: the poses are probably world-to-camera: overlapping depth maps then agree to 3 mm; as "
            "given: 240 mm",
            "Poses in another convention",
        ),
        (
            "--set fuse.voxel_size is -1 m; it must be more than 0 m.",
            "A value of the wrong type, or out of its range",
        ),
    ],
)
def test_a_pasted_message_is_found(opened: Any, message: str, explained: str):
    opened.fill("#pasted-message", message)

    first = opened.locator("#found-messages a").first

    assert first.inner_text() == explained
    address, _, anchor = first.evaluate("link => link.href").partition("#")
    assert anchor in Page(Path(unquote(urlsplit(address).path))).ids


def test_an_unknown_message_finds_nothing(opened: Any):
    opened.fill("#pasted-message", "hello world")

    assert opened.locator("#found-messages a").count() == 0
    assert opened.evaluate("document.documentElement.scrollWidth") <= 360
