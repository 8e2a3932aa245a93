"""The page of a tileset is written into its folder and replaced with it."""

from __future__ import annotations

from pathlib import Path

import pytest
from coloured_meshes import sheet

from scanloom.pipeline.report.page.tileset_page import make_tileset_page, write_tileset_page
from scanloom.stages import InputError, StageError, lod


@pytest.fixture(scope="module")
def hierarchy() -> lod.Hierarchy:
    return lod.build(sheet(16), cell_triangles=128, root_triangles=100, ratio=4.0, threads=1)


def test_all_files_of_a_page_are_written(hierarchy: lod.Hierarchy, tmp_path: Path) -> None:
    lod.write_tiles(hierarchy, tmp_path / "out")
    before = set((tmp_path / "out").rglob("*"))
    write_tileset_page(tmp_path / "out")
    added = {path for path in (tmp_path / "out").rglob("*") if path.is_file()} - before
    page = {path.relative_to(tmp_path / "out").as_posix(): path.read_bytes() for path in added}
    assert page == make_tileset_page()
    assert {"index.html", "page/library.js", "page/LICENSES.txt", "page/tiles/main.js"} <= set(page)


def test_a_tileset_is_replaced_with_its_page(hierarchy: lod.Hierarchy, tmp_path: Path) -> None:
    out = tmp_path / "out"
    lod.write_tiles(hierarchy, out)
    write_tileset_page(out)
    lod.write_tiles(hierarchy, out)
    assert sorted(path.name for path in out.iterdir()) == ["tiles", "tileset.json"]
    write_tileset_page(out)
    # State of the folder after an interrupted command.
    (out / "index.html").unlink()
    lod.write_tiles(hierarchy, out)
    assert not (out / "page").exists()
    write_tileset_page(out)
    (out / "notes.txt").write_text("of somebody")
    with pytest.raises(InputError, match="is not a tileset of scanloom"):
        lod.write_tiles(hierarchy, out)


def test_a_folder_that_cannot_be_written_is_one_message(tmp_path: Path) -> None:
    (tmp_path / "page").write_text("a file")
    with pytest.raises(StageError, match="cannot be written"):
        write_tileset_page(tmp_path)
