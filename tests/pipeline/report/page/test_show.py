"""A mesh in a notebook: a page in a sandboxed iframe that can draw but cannot access the notebook."""

from __future__ import annotations

import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from browsers import launch_browser
from coloured_meshes import ball, sheet

from scanloom import Mesh, MeshError, Page, UsageError, show, simplify

EVIL = "\"></iframe><script>window.parent.evil = 1</script>'"


@pytest.fixture(scope="module")
def page() -> Page:
    return show(simplify(sheet(20), ratio=0.5), beside={"before": sheet(20)}, title=EVIL, up="+z", height=300)


def test_the_frame_holds_the_page_and_nothing_else(page: Page) -> None:
    html = page._repr_html_()
    (source,) = re.findall(r'srcdoc="([^"]*)"></iframe>$', html)
    assert unescape(source).encode() == page.html
    assert html.count("<") == 2, "the frame, and its end"
    assert 'sandbox="allow-scripts allow-downloads"' in html
    assert "height:300px" in html


def test_repr_is_one_line(page: Page) -> None:
    text = repr(show(sheet(4)))
    assert text.startswith("Page(mesh, 1.")
    assert 'save("FILE.html")' in text
    assert len(repr(page)) < 300


def test_a_notebook_displays_the_page() -> None:
    from IPython.core.interactiveshell import InteractiveShell

    data, _ = InteractiveShell.instance().display_formatter.format(show(sheet(4)))
    assert data["text/html"].startswith("<iframe ")
    assert data["text/plain"].startswith("Page(")


@pytest.mark.slow
def test_the_page_draws_in_its_frame_and_cannot_leave_it(page: Page, tmp_path: Path) -> None:
    (tmp_path / "notebook.html").write_text(f"<!doctype html><body>{page._repr_html_()}</body>")
    said: list[str] = []
    with launch_browser() as chromium:
        opened = chromium.new_page(viewport={"width": 500, "height": 400})
        opened.on("console", lambda message: said.append(message.text))
        opened.on("pageerror", lambda error: said.append(str(error)))
        opened.goto((tmp_path / "notebook.html").as_uri())
        frame = opened.frames[1]
        frame.wait_for_selector("#message", state="hidden", timeout=60_000)
        frame.evaluate("scanloom.drawn()")
        assert frame.evaluate("document.title") == EVIL
        assert frame.evaluate("document.querySelectorAll('#bar select')[0].options.length") == 2
        assert opened.evaluate("window.evil") is None
        assert frame.evaluate("origin") == "null"
        pixels = opened.locator("iframe").screenshot()
    assert len(pixels) > 5000
    assert said == []


def test_the_up_direction_is_given_or_read_from_the_mesh() -> None:
    def facing(html: bytes) -> list[float]:
        found = re.search(rb'"facing": (\[[^\]]*\])', html)
        assert found is not None
        return [float(word) for word in found[1].decode().strip("[]").split(",")]

    mesh = sheet(20, height=0.01)
    assert facing(show(mesh, up="+z").html)[2] > 0.99
    assert facing(show(mesh.with_(up=(0.0, 0.0, -1.0))).html)[2] < -0.99
    assert facing(show(mesh.with_(up=(0.0, 0.0, -1.0)), up="+z").html)[2] > 0.99


def test_meshes_of_other_libraries_and_results_can_be_shown(tmp_path: Path) -> None:
    import trimesh

    made = trimesh.creation.box()
    pages = [show(made), show((made.vertices, made.faces)), show(simplify(ball(), ratio=0.1))]
    pages[-1].save(tmp_path / "a.html")
    assert (tmp_path / "a.html").read_bytes() == pages[-1].html


def test_a_page_keeps_to_its_size() -> None:
    large = show(sheet(250, noise=0.01), page_size=1.5)
    assert len(large.html) <= 1_500_000
    assert b"reduced from 125,000 for this page" in large.html


@pytest.mark.parametrize(
    ("thing", "how", "error", "told"),
    [
        (
            Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)),
            {},
            MeshError,
            "mesh: the mesh has no triangles",
        ),
        (5, {"title": "five"}, MeshError, "five: is a int"),
        (sheet(2), {"beside": {"other": 5}}, MeshError, "other: is a int"),
        (sheet(2), {"up": "z"}, UsageError, "up is 'z'"),
        (sheet(2), {"page_size": 1.0}, UsageError, "page_size is 1 MB; it must be at least 1.2 MB"),
        (sheet(2), {"height": 0}, UsageError, "height is 0 px"),
    ],
)
def test_showing_unsupported_objects_is_an_error(
    thing: object, how: dict[str, object], error: type, told: str
) -> None:
    with pytest.raises(error, match=told):
        show(thing, **how)
