"""Command `lod tiles`: tileset, metrics, and messages about bad input."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from coloured_meshes import sheet
from tile_reader import read_tiles

from scanloom.stages import bake, lod, write_mesh

Run = Callable[..., Any]


@pytest.fixture(scope="module")
def slod(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the levels of detail of a small sheet."""
    path = tmp_path_factory.mktemp("levels") / "sheet.slod"
    hierarchy = lod.build(sheet(16), cell_triangles=128, root_triangles=100, ratio=4.0, threads=1)
    lod.write_slod(path, hierarchy)
    return path


def test_tiles_of_a_file_are_written(scanloom: Run, slod: Path, tmp_path: Path) -> None:
    target = tmp_path / "new" / "tiles"
    ran = scanloom("lod", "tiles", slod, target, "--set", "tiles.up=+z", "--json")
    assert (ran.exit_code, ran.stderr) == (0, "")
    root = read_tiles(target)
    assert ran.json["tiles"] == len(list(root.all())) == len(list((target / "tiles").iterdir()))
    assert ran.json["output"] == str(target / "tileset.json")
    assert ran.json["geometric_error_m"] == root.tree["geometricError"]
    assert ran.json["grid_displacement_m"] < root.tree["geometricError"]
    assert "transform" not in root.tree
    # The existing tiles are replaced by compressed tiles.
    ran = scanloom("lod", "tiles", slod, target, "--set", "tiles.compress=meshopt", "--json")
    assert (ran.exit_code, ran.stderr) == (0, "")
    assert any(b"EXT_meshopt_compression" in file.read_bytes() for file in (target / "tiles").iterdir())
    assert scanloom("lod", "tiles", slod, target, "--set", "tiles.compress=draco").exit_code == 2
    # The existing tiles are replaced with default parameters; the text output is checked.
    ran = scanloom("lod", "tiles", slod, target)
    assert ran.exit_code == 0
    assert ran.stdout.startswith(f"{target / 'tileset.json'}: {len(list(root.all()))} tiles, ")
    assert "Positions have 16 bits, on a grid of" in ran.stdout
    assert read_tiles(target).tree["transform"][:4] == [1, 0, 0, 0]


def test_page_option_writes_a_page_next_to_the_tiles(scanloom: Run, slod: Path, tmp_path: Path) -> None:
    target = tmp_path / "tiles"
    assert scanloom("lod", "tiles", slod, target, "--page").exit_code == 0
    assert sorted(path.name for path in target.iterdir()) == ["index.html", "page", "tiles", "tileset.json"]
    assert scanloom("lod", "tiles", slod, target).exit_code == 0
    assert sorted(path.name for path in target.iterdir()) == ["tiles", "tileset.json"]


@pytest.fixture(scope="module")
def textured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the same sheet with a texture."""
    path = tmp_path_factory.mktemp("model") / "textured.glb"
    write_mesh(path, bake(sheet(16), sheet(16), normal_map=False, occlusion_map=False).mesh)
    return path


def test_tiles_store_images_of_a_textured_model(
    scanloom: Run, slod: Path, textured: Path, tmp_path: Path
) -> None:
    target = tmp_path / "tiles"
    ran = scanloom(
        "lod", "tiles", slod, target, "--texture", textured, "--set", "tiles.image_format=webp", "--json"
    )
    assert (ran.exit_code, ran.stderr) == (0, "")
    tiles = list(read_tiles(target).all())
    assert all(tile.image is not None and tile.image[8:12] == b"WEBP" for tile in tiles)
    assert ran.json["images"]["total_bytes"] == sum(len(tile.image or b"") for tile in tiles)
    ran = scanloom("lod", "tiles", slod, target, "--texture", textured)
    assert ran.exit_code == 0
    assert "Of that, images are" in ran.stdout
    assert "as sampled." in ran.stdout
    assert all((tile.image or b"").startswith(b"\xff\xd8") for tile in read_tiles(target).all())


def test_tiles_take_images_from_the_source_mesh_by_default(
    scanloom: Run, textured: Path, tmp_path: Path
) -> None:
    source, target = tmp_path / "m.slod", tmp_path / "tiles"
    words = ("--set", "lod.cell_triangles=128", "--set", "lod.root_triangles=100", "--set", "lod.ratio=4")
    assert scanloom("lod", "build", textured, source, *words).exit_code == 0
    ran = scanloom("lod", "tiles", source, target, "--json")
    assert (ran.exit_code, ran.stderr) == (0, "")
    assert ran.json["images"]["color_rms_levels_sampled"]["largest"] < 10
    assert all(tile.image is not None for tile in read_tiles(target).all())
    ran = scanloom("lod", "tiles", source, target, "--texture", "none", "--json")
    assert (ran.exit_code, ran.stderr) == (0, "")
    assert ran.json["images"] is None
    assert all(tile.image is None for tile in read_tiles(target).all())


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("absent.slod", "out"), 3, "absent.slod: there is no such file."),
        (("notes.txt", "out"), 3, "notes.txt: this is not a .slod file."),
        (("{slod}", "notes.txt"), 3, "notes.txt: this is a file; a tileset of scanloom is a folder."),
        (("{slod}", "notes.txt/out"), 3, "notes.txt: this is a file; results need a folder."),
        (
            ("{slod}", "full"),
            3,
            "full: this folder is not empty and is not a tileset of scanloom; give a new folder.",
        ),
        (("{slod}", "out", "--texture", "absent.glb"), 3, "absent.glb: there is no such file."),
        (
            ("{slod}", "out", "--set", "tiles.image_side=8"),
            2,
            "--set tiles.image_side is 8 texels; it must be at least 64 texels.",
        ),
        (
            ("{slod}", "out", "--texture", "{plain}"),
            3,
            "{plain}: has neither an image nor vertex colours for the tiles.",
        ),
        (
            ("{slod}", "out", "--set", "tiles.up=y"),
            2,
            "--set tiles.up is 'y'; it must be one of +x, -x, +y, -y, +z, -z, none, or three numbers.",
        ),
    ],
)
def test_bad_input_is_one_error_and_writes_nothing(
    scanloom: Run,
    slod: Path,
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    code: int,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("notes.txt").write_text("These are notes, not levels of detail.")
    Path("full").mkdir()
    Path("full", "mine.txt").write_text("mine")
    plain = tmp_path_factory.mktemp("plain") / "plain.ply"
    write_mesh(plain, sheet(4).with_(colors=None))
    ran = scanloom("lod", "tiles", *(word.format(slod=slod, plain=plain) for word in words))
    message = message.format(plain=plain)
    assert (ran.exit_code, ran.stderr, ran.stdout) == (code, f"scanloom: {message}\n", "")
    assert sorted(path.as_posix() for path in Path().rglob("*")) == ["full", "full/mine.txt", "notes.txt"]


def test_a_truncated_file_gives_no_tiles(scanloom: Run, slod: Path, tmp_path: Path) -> None:
    short = tmp_path / "short.slod"
    short.write_bytes(slod.read_bytes()[:-1000])
    ran = scanloom("lod", "tiles", short, tmp_path / "out")
    assert ran.exit_code == 3
    assert ran.stderr.splitlines()[-1] == (
        "scanloom: the finest levels are missing; tiles require all levels. Build the file again."
    )
    assert not (tmp_path / "out").exists()
