"""Pages with a size limit.

Additional models are simplified before the main model, together with their colormaps.
"""

from __future__ import annotations

import numpy as np
import pytest
from coloured_meshes import ball, sheet
from page_content import read_page_content

from scanloom.pipeline.report.page.packing import PageModelSource, VertexColormap, make_packed_page
from scanloom.pipeline.report.page.single_file_page import PageScale
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.surface.mesh import Mesh

SCALE = PageScale("mm", -1.0, 1.0, 0.1, ["rgb(0, 0, 0)", "rgb(9, 9, 9)"], [0.5, 0.5])


def make_models() -> dict[str, PageModelSource]:
    main = sheet(60)
    paint = VertexColormap(np.linspace(-1, 1, len(main.vertices)), SCALE, "of it")
    return {
        "main": PageModelSource(main, "first", colormaps={"look": paint}),
        "beside": PageModelSource(ball()),
    }


def read_triangle_counts(page: bytes) -> dict[str, int]:
    return {one["name"]: one["triangles"] for one in read_page_content(page)["models"]}


def test_below_the_size_limit_nothing_is_simplified() -> None:
    page = make_packed_page("t", make_models(), 5_000_000)
    assert read_triangle_counts(page) == {"main": 7200, "beside": 5120, "look": 7200}
    told = {one["name"]: one for one in read_page_content(page)["models"]}
    look = told["look"]
    assert (look["look"], look["file"], look["note"]) == (0, told["main"]["file"], "of it")
    assert look["scale"]["unit"] == "mm"
    assert len(read_page_content(page)["files"]) == 2


def test_models_are_simplified_to_fit_the_main_model_last() -> None:
    complete = len(make_packed_page("t", make_models(), 5_000_000))
    page = make_packed_page("t", make_models(), complete - 5_000)
    assert len(page) <= complete - 5_000
    assert read_triangle_counts(page)["main"] == 7200
    assert 2_000 <= read_triangle_counts(page)["beside"] < 5120
    smaller = make_packed_page("t", make_models(), complete - 40_000)
    assert len(smaller) <= complete - 40_000
    assert read_triangle_counts(smaller)["main"] == read_triangle_counts(smaller)["look"] < 7200
    told = {one["name"]: one for one in read_page_content(smaller)["models"]}
    assert told["main"]["note"] == "first, reduced from 7,200 for this page"
    assert told["look"]["note"] == "of it, reduced from 7,200 for this page"
    assert smaller == make_packed_page("t", make_models(), complete - 40_000)


def test_the_main_model_is_simplified_if_others_cannot_be() -> None:
    # Disjoint tetrahedra cannot be simplified.
    rng = np.random.default_rng(0)
    corners = (rng.uniform(-1, 1, (1500, 1, 3)) + rng.normal(0, 0.01, (1500, 4, 3))).reshape(-1, 3)
    sides = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])
    loose = Mesh(corners, (sides + 4 * np.arange(1500)[:, None, None]).reshape(-1, 3).astype(np.int32))
    both = {"main": PageModelSource(sheet(120)), "loose": PageModelSource(loose)}
    most = len(make_packed_page("t", both, 5_000_000)) - 5_000
    page = make_packed_page("t", both, most)
    assert len(page) <= most
    assert read_triangle_counts(page)["loose"] == 6000
    assert 2_000 < read_triangle_counts(page)["main"] < 28_800


def test_a_page_above_the_size_limit_is_reported() -> None:
    with collecting() as diagnostics:
        page = make_packed_page("t", make_models(), 1000)
    assert len(page) > 1000
    assert [str(one) for one in diagnostics] == [
        f"the page has {len(page):,} bytes, more than 1,000, and cannot be reduced further."
    ]


@pytest.mark.parametrize("looks", [0, 4])
def test_a_model_has_every_given_colormap(looks: int) -> None:
    mesh = sheet(4)
    paints = {f"look {k}": VertexColormap(np.zeros(len(mesh.vertices)), SCALE) for k in range(looks)}
    told = read_page_content(
        make_packed_page("t", {"m": PageModelSource(mesh, colormaps=paints)}, 5_000_000)
    )["models"]
    assert [one["look"] for one in told] == ["own", *range(looks)]
