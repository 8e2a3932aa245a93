"""Records as version 1 of their files has them: whatever is written later, these replay as they did."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from stages import Image, Material, Mesh, Texture, load_record
from stages.simplification.records.steps import Replayed

HERE = Path(__file__).parent


def sheet(columns: int, rows: int) -> Mesh:
    """Coloured vertices at places that every machine has to the bit."""
    across, along = np.meshgrid(np.arange(columns), np.arange(rows))
    x, y = across.reshape(-1), along.reshape(-1)
    vertices = np.stack([x / 8, y / 8, (3 * x + 5 * y) % 7 / 64], axis=1)
    colors = np.stack([23 * x, 31 * y, 100 + 40 * (x > 4)], axis=1).astype(np.uint8)
    first = (columns * along + across)[:-1, :-1].reshape(-1)
    lower = np.stack([first, first + 1, first + columns + 1], axis=1)
    upper = np.stack([first, first + columns + 1, first + columns], axis=1)
    return Mesh(vertices, np.concatenate([lower, upper]).astype(np.int32), colors=colors)


def textured_sheet() -> Mesh:
    """The sheet in two charts, one with an image, the other a quarter of an image away."""
    mesh = sheet(6, 5)
    corners = mesh.vertices[mesh.triangles]
    right = corners[:, :, 0].mean(axis=1) > 0.3
    uvs = corners[:, :, :2] / 2
    uvs[right, :, 1] += 0.25
    checks = np.indices((4, 4)).sum(axis=0) % 2 * 255
    image = Image("checks.png", given=np.repeat(checks[:, :, None], 3, axis=2).astype(np.uint8))
    materials = (
        Material("left", image, wrap=("clamp", "mirror")),
        Material("right", None, (1.0, 0.5, 0.25, 1.0)),
    )
    return mesh.with_(
        texture=Texture(uvs, right.astype(np.int32), materials),
        part_ids=np.zeros(len(uvs), np.int32),
        part_names=("sheet",),
    )


def digest(replayed: Replayed) -> str:
    mesh = replayed.mesh
    arrays = [mesh.vertices, mesh.triangles, mesh.colors, replayed.vertex_source, replayed.triangle_source]
    if mesh.texture is not None:
        arrays += [mesh.texture.uvs, mesh.texture.material_ids, mesh.part_ids]
    found = hashlib.sha256()
    for array in arrays:
        assert array is not None
        found.update(array.tobytes())
    return found.hexdigest()


@pytest.mark.parametrize(
    ("name", "collapses", "replays"),
    [
        ("quadric", 0, "8ba21f3a14f99c01af6d7da660feb9ab7e2a1aec381288148da372058f4f2642"),
        ("quadric", 33, "e42bc015c1d0b55ebf2366edd30542f68d9fa7ea95635701ccade38962a59027"),
        ("quadric", 67, "45f324b4c42ef2049f1fd17ea8eb176ec8ac21006eb34832cf2301bfdac45d26"),
        ("certified", 13, "f2ea2e3175e4748ce6095ddb6d9f539460e7f4ab8f6db4d7071cd26098f2fbbe"),
        ("certified", 26, "b53d01e58eb8d56e8e141a7bd7ac442aa785b409524c3987ed2ef2c076437f62"),
        ("jia01", 0, "0dc897ed1ec663d1160d7a623576f8a1cccfdfdc552d0fba9122c585d8e5e963"),
        ("jia01", 33, "d57f38e75e453c4e6ac114a1cb0083d3c916359ae63424fa8b7637e5dffd6cbe"),
        ("jia01", 66, "de4e5d3a224ff461c78b703158eda7f99c22e965d13bf01740384f470c1792bd"),
        ("seams", 0, "aa78271133cebe3862c7421644e2c65b5e31c6bdfcafa5106e3f3d44ea76586c"),
        ("seams", 11, "949086ab08bf57e7bb426dfc905b9027ccd3cec9eab5e11c2ce3e3510abd5a77"),
        ("seams", 22, "1ab485b8ac14c86f71eab970a3ee8eb8e11b7bb34223cd3333eb7510080a2ed8"),
    ],
)
def test_a_file_of_version_1_replays_as_it_did(
    name: str, collapses: int, replays: str, tmp_path: Path
) -> None:
    """Collapses of vertices, with locks, with edges split before, and with wedges; then written anew."""
    record = load_record(HERE / f"record_1_{name}.npz")
    assert digest(record.replay(collapses=collapses)) == replays
    record.save(tmp_path / "again.npz")
    assert digest(load_record(tmp_path / "again.npz").replay(collapses=collapses)) == replays


@pytest.mark.parametrize(
    ("name", "made"), [("quadric", sheet(11, 8)), ("certified", sheet(11, 8)), ("seams", textured_sheet())]
)
def test_they_hold_the_mesh_they_were_made_from(name: str, made: Mesh) -> None:
    mesh = load_record(HERE / f"record_1_{name}.npz").mesh
    np.testing.assert_array_equal(mesh.vertices, made.vertices)
    np.testing.assert_array_equal(mesh.triangles, made.triangles)
    np.testing.assert_array_equal(mesh.colors, made.colors)
    assert mesh.part_names == made.part_names
    assert (mesh.texture is None) == (made.texture is None)
    if mesh.texture is not None and made.texture is not None:
        np.testing.assert_array_equal(mesh.texture.uvs, made.texture.uvs)
        np.testing.assert_array_equal(mesh.texture.images[0].pixels, made.texture.images[0].pixels)
        for read, of_made in zip(mesh.texture.materials, made.texture.materials, strict=True):
            assert (read.name, read.base_color, read.wrap) == (of_made.name, of_made.base_color, of_made.wrap)


def test_locked_vertices_of_a_file_of_version_1_are_known() -> None:
    record = load_record(HERE / "record_1_quadric.npz")
    np.testing.assert_array_equal(np.flatnonzero(record.lock), [40, 41])
    fitted = record.replay(ratio=0.3, fit=True)
    at = np.searchsorted(fitted.vertex_source, [40, 41])
    np.testing.assert_array_equal(fitted.mesh.vertices[at], record.mesh.vertices[[40, 41]])
