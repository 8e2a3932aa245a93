"""Upright glTF files: a root node rotates the up axis to +y, and reading restores the axes of the scan."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from coloured_sheet import sheet
from hypothesis import given
from hypothesis import strategies as st

from scanloom import read_mesh, simplify, write_mesh
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.surface.formats.color_conversion import convert_srgb_to_linear
from scanloom.stages.surface.formats.gltf_container import read_container
from scanloom.stages.surface.up_direction import parse_up_direction, rotate_to_y, rotate_to_z

AXES = ("+x", "-x", "+y", "-y", "+z", "-z")


def parse_direction(word: str) -> tuple[float, float, float]:
    direction = parse_up_direction(word)
    assert direction is not None
    x, y, z = direction.tolist()
    return x, y, z


@pytest.mark.parametrize("word", AXES)
def test_the_up_axis_of_the_scan_is_y_in_the_file(tmp_path, word):
    mesh = sheet().with_(up=parse_direction(word))
    write_mesh(tmp_path / "a.glb", mesh)
    # trimesh is an independent reader that applies node transforms.
    seen = trimesh.load(tmp_path / "a.glb", force="mesh", process=False)
    heights = mesh.vertices @ np.array(mesh.up)
    np.testing.assert_allclose(seen.vertices[:, 1], heights, atol=1e-6)
    assert np.linalg.det(rotate_to_y(np.array(mesh.up))) == pytest.approx(1)
    light = np.rint(255 * convert_srgb_to_linear(mesh.colors / 255))
    np.testing.assert_allclose(seen.visual.vertex_colors[:, :3], light, atol=1)


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_any_direction_is_rotated_to_y_and_z(direction):
    words = " ".join(map(repr, direction))
    up = parse_up_direction(words)
    assert up is not None
    for turn, axis in ((rotate_to_y(up), 1), (rotate_to_z(up), 2)):
        np.testing.assert_allclose(turn @ up, np.eye(3)[axis], atol=1e-12)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(turn) == pytest.approx(1)


@pytest.mark.parametrize("up", ["sideways", "0 0 0", "1 2", "nan 0 0", "inf 0 0"])
def test_an_invalid_direction_is_refused(up):
    with pytest.raises(UsageError):
        parse_up_direction(up)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("up", [*map(parse_direction, AXES), (0.6, 0.0, 0.8), (0.01055, -0.001654, 0.9999)])
def test_positions_are_restored_exactly_in_the_axes_of_the_scan(tmp_path, suffix, up):
    mesh = sheet().with_(up=up)
    write_mesh(tmp_path / f"a{suffix}", mesh)
    back = read_mesh(tmp_path / f"a{suffix}")
    np.testing.assert_array_equal(back.vertices, mesh.vertices)
    np.testing.assert_array_equal(back.triangles, mesh.triangles)
    np.testing.assert_allclose(back.up, np.array(up) / np.linalg.norm(up), atol=1e-12)
    assert back.diagnostics == ()
    # A second round trip changes nothing.
    write_mesh(tmp_path / f"b{suffix}", back)
    np.testing.assert_array_equal(read_mesh(tmp_path / f"b{suffix}").vertices, mesh.vertices)


def test_positions_far_from_the_origin_are_restored(tmp_path):
    mesh = sheet().with_(vertices=sheet().vertices + np.array((4e5, 0, -3e5)), up=(0.6, 0.0, 0.8))
    write_mesh(tmp_path / "a.glb", mesh)
    back = read_mesh(tmp_path / "a.glb")
    np.testing.assert_allclose(back.vertices, mesh.vertices, atol=1e-6)


def test_without_an_up_direction_nothing_is_rotated(tmp_path):
    write_mesh(tmp_path / "a.glb", sheet())
    gltf = read_container(tmp_path / "a.glb")
    assert "extras" not in gltf.tree["asset"]
    assert not any("matrix" in node for node in gltf.tree["nodes"])
    assert read_mesh(tmp_path / "a.glb").up is None


@pytest.mark.parametrize(
    "given",
    [
        [1.0] * 16,
        [0.0] * 16,
        [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1],
        [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
        [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1],
        [1, 0, 0],
        "upwards",
        {"a": 1},
        [float("nan")] * 16,
        [1e400] * 16,
    ],
)
def test_an_invalid_rotation_is_dropped_with_a_diagnostic(tmp_path, given):
    write_mesh(tmp_path / "a.gltf", sheet().with_(up=parse_direction("-y")))
    tree = json.loads((tmp_path / "a.gltf").read_text())
    tree["asset"]["extras"]["scan_from_world"] = given
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    back = read_mesh(tmp_path / "a.gltf")
    assert back.up is None
    assert any("scan_from_world" in one.message for one in back.diagnostics)
    # Positions follow the nodes of the file.
    np.testing.assert_allclose(back.vertices, sheet().vertices * (1, -1, -1))


def test_a_translation_by_another_program_is_kept(tmp_path):
    """The stored rotation is undone, and the translation is rotated with it."""
    write_mesh(tmp_path / "a.gltf", sheet().with_(up=parse_direction("-y")))
    tree = json.loads((tmp_path / "a.gltf").read_text())
    root = tree["scenes"][0]["nodes"][0]
    tree["nodes"][root]["matrix"][12:15] = [10, 20, 30]
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    np.testing.assert_allclose(
        read_mesh(tmp_path / "a.gltf").vertices, sheet().vertices + np.array((10, -20, -30))
    )


@pytest.mark.parametrize("up", [(0, 0, 0), (np.nan, 0, 0), (1, 0), "up"])
def test_a_mesh_with_an_invalid_up_direction_is_refused(up):
    with pytest.raises(MeshError, match="up is"):
        simplify(sheet().with_(up=up), ratio=0.5)
